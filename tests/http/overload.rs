//! More work than the service can do, and clients that do not wait for it.

use reqwest::Method;

use crate::service::{Running, SLOW, problem};

const FRAME: &str = "/v1/volumes/ball/frame";
const SMALL: &str = r#"{"image": {"width": 8, "height": 8}}"#;
const ONE_AT_A_TIME: &str = "[render]\njobs = 1\nqueue = 0\nretry_after_seconds = 7";

/// Starts a frame that takes minutes; aborting the task is the client's leaving.
fn start_slow_frame(service: &Running) -> tokio::task::JoinHandle<u16> {
    let request = service.request(Method::POST, FRAME).header("content-type", "application/json").body(SLOW);
    tokio::spawn(async move { request.send().await.map_or(0, |response| response.status().as_u16()) })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_is_refused_with_503_and_a_client_that_leaves_makes_room() {
    let service = Running::start(ONE_AT_A_TIME).await;
    let slow = start_slow_frame(&service);
    service.load(1, 0).await;
    let refused = service.post(FRAME, SMALL).await;
    assert_eq!(refused.headers()["retry-after"], "7");
    assert_eq!(problem(refused).await["status"], 503);
    assert_eq!(service.get("/healthz").await.status(), 200, "what needs no rendering is answered all the same");

    slow.abort();
    service.eventually("/v1/volumes/ball/frame.png?width=8&height=8", |response| response.status() == 200).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn past_its_deadline_a_frame_is_504_and_its_work_ends() {
    let service = Running::start("[render]\njobs = 1\nqueue = 0\ndeadline_seconds = 0.4").await;
    let response = service.post(FRAME, SLOW).await;
    assert_eq!(problem(response).await["status"], 504);
    service.eventually("/v1/volumes/ball/frame.png?width=8&height=8", |response| response.status() == 200).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_waits_in_the_queue_is_served_when_its_turn_comes() {
    let service = Running::start("[render]\njobs = 1\nqueue = 20").await;
    let requests = (0..20).map(|azimuth| {
        let path = format!("/v1/volumes/ball/frame.png?width=64&height=64&azimuth={azimuth}");
        tokio::spawn(service.request(Method::GET, &path).send())
    });
    for request in requests.collect::<Vec<_>>() {
        assert_eq!(request.await.unwrap().unwrap().status(), 200);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_that_leave_the_queue_leave_it_empty() {
    let service = Running::start("[render]\njobs = 1\nqueue = 3").await;
    let waiting: Vec<_> = (0..4).map(|_| start_slow_frame(&service)).collect();
    service.load(1, 3).await;
    waiting.iter().for_each(tokio::task::JoinHandle::abort);
    service.load(0, 0).await;
    assert_eq!(service.post(FRAME, SMALL).await.status(), 200);
}
