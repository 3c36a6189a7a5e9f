//! Every wrong request gets its status, its problem+json and, where a field is at fault, its pointer.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use reqwest::Method;

use crate::service::{Running, header, problem};

const FRAME: &str = "/v1/volumes/ball/frame";

#[tokio::test(flavor = "multi_thread")]
async fn wrong_bodies_are_refused_with_a_pointer_to_the_field() {
    let service = Running::start("").await;
    for (body, status, pointer) in [
        ("{", 400, ""),
        ("", 200, ""),
        ("NaN", 400, ""),
        ("[]", 422, ""),
        (r#"{"nonsense": 1}"#, 422, "/nonsense"),
        (r#"{"camera": {"azimuth": "x"}}"#, 422, "/camera/azimuth"),
        (r#"{"camera": {"azimuth": 1e999}}"#, 422, "/camera/azimuth"),
        (r#"{"camera": {"zoom": 0}}"#, 422, "/camera/zoom"),
        (r#"{"image": {"width": 0}}"#, 422, "/image/width"),
        (r#"{"image": {"width": 100000, "height": 100000}}"#, 422, "/image/width"),
        (r#"{"transfer_function": "no-such-preset"}"#, 422, "/transfer_function"),
        (r#"{"transfer_function": {"points": []}}"#, 422, "/transfer_function/points"),
        (r#"{"algorithm": "classified", "quality": "high"}"#, 422, "/quality"),
        (r##"{"image": {"format": "jpeg", "background": "transparent"}}"##, 422, "/image/background"),
    ] {
        let response = service.post(FRAME, body).await;
        assert_eq!(response.status().as_u16(), status, "{body}");
        if status != 200 {
            let problem = problem(response).await;
            assert_eq!(problem["errors"][0]["pointer"].as_str().unwrap_or_default(), pointer, "{body}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn wrong_queries_are_refused_by_the_name_that_the_client_wrote() {
    let service = Running::start("").await;
    for (query, pointer) in [
        ("azimuth=NaN", "/azimuth"),
        ("azimuth=", "/azimuth"),
        ("angle=3", "/angle"),
        ("width=100000", "/width"),
        ("width=3.5", "/width"),
        ("preset=none", "/preset"),
        ("shading=perhaps", "/shading"),
        ("azimuth=1&azimuth=2", "/azimuth"),
    ] {
        let response = service.get(&format!("/v1/volumes/ball/frame.png?{query}")).await;
        assert_eq!(response.status(), 422, "{query}");
        assert_eq!(problem(response).await["errors"][0]["pointer"], pointer, "{query}");
    }
    let response = service.get("/v1/volumes/ball/frame.jpg?background=transparent").await;
    assert_eq!(problem(response).await["errors"][0]["pointer"], "/background");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_there_is_404_and_what_cannot_be_done_with_it_405() {
    let service = Running::start("").await;
    for path in
        ["/nowhere", "/v1/volumes/none", "/v1/volumes/none/frame.png", "/v1/presets/none", "/v1/volumes/ball/frame.gif"]
    {
        let response = service.get(path).await;
        assert_eq!(response.status(), 404, "{path}");
        problem(response).await;
    }
    for (method, path, allow) in [
        (Method::DELETE, "/v1/volumes/ball", "GET,HEAD"),
        (Method::POST, "/v1/volumes", "GET,HEAD"),
        (Method::GET, FRAME, "POST"),
        (Method::PUT, "/metrics", "GET,HEAD"),
    ] {
        let response = service.request(method, path).send().await.unwrap();
        assert_eq!(response.status(), 405, "{path}");
        assert_eq!(header(&response, "allow"), allow, "{path}");
        problem(response).await;
    }
    let response = service.get("/v1/volumes/%ff/frame.png").await;
    assert_eq!(problem(response).await["status"], 400);
}

#[tokio::test(flavor = "multi_thread")]
async fn only_json_is_taken_and_not_too_much_of_it() {
    let service = Running::start("[http]\nmax_body_bytes = 1000").await;
    for (content_type, status) in [
        ("text/plain", 415),
        ("application/jsonp", 415),
        ("nonsense", 415),
        ("application/json; charset=utf-8", 200),
        ("Application/JSON", 200),
    ] {
        let request = service.request(Method::POST, FRAME).header("content-type", content_type);
        let response = request.body(r#"{"image": {"width": 8, "height": 8}}"#).send().await.unwrap();
        assert_eq!(response.status().as_u16(), status, "{content_type}");
    }
    let response = service.request(Method::POST, FRAME).body("{}").send().await.unwrap();
    assert_eq!(problem(response).await["status"], 415);
    let response = service.post(FRAME, &" ".repeat(1001)).await;
    assert_eq!(problem(response).await["status"], 413);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_sends_too_slowly_is_sent_away() {
    let service = Running::start("[http]\nheader_timeout_seconds = 0.3\nbody_timeout_seconds = 0.3").await;
    let answer = tokio::task::block_in_place(|| {
        let head = "POST /v1/volumes/ball/frame HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\n";
        sent_and_left(&service, &format!("{head}content-length: 9\r\nconnection: close\r\n\r\n{{"))
    });
    assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("problem+json"), "{answer}");
    let answer = tokio::task::block_in_place(|| sent_and_left(&service, "GET /healthz HT"));
    assert!(!answer.contains("200 OK"), "{answer}");
}

/// Sends the start of a request, nothing more, and reads until the service ends the connection.
fn sent_and_left(service: &Running, start: &str) -> String {
    let mut connection = TcpStream::connect(service.address).unwrap();
    connection.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    connection.write_all(start.as_bytes()).unwrap();
    let mut answer = String::new();
    connection.read_to_string(&mut answer).expect("the service ends the connection");
    answer
}
