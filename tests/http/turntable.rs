//! Frames around the vertical axis in one answer.

use std::io::{Cursor, Read};

use reqwest::Method;
use serde_json::json;

use crate::service::{Running, SLOW, header, problem};

const TURNTABLE: &str = "/v1/volumes/ball/turntable";

/// A draft of the ball with a part cut off by the picture, so that frames differ.
fn request(azimuth: f64) -> String {
    let camera = json!({"azimuth": azimuth, "target": [-11, -11, 11], "elevation": 10});
    json!({"camera": camera, "image": {"width": 24, "height": 20}, "quality": "draft"}).to_string()
}

async fn ask(service: &Running, path: &str, accept: &str) -> reqwest::Response {
    let post = service.request(Method::POST, path).header("content-type", "application/json");
    post.header("accept", accept).body(request(0.0)).send().await.unwrap()
}

/// The frames that the frame route gives.
async fn frames(service: &Running) -> Vec<Vec<u8>> {
    let mut frames = vec![];
    for number in 0..3 {
        let frame = service.post("/v1/volumes/ball/frame", &request(f64::from(number) * 120.0)).await;
        frames.push(frame.bytes().await.unwrap().to_vec());
    }
    assert!(frames[0] != frames[1] && frames[1] != frames[2]);
    frames
}

fn pixels(png: &[u8]) -> Vec<u8> {
    let mut reader = png::Decoder::new(Cursor::new(png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels
}

#[tokio::test(flavor = "multi_thread")]
async fn an_animation_is_the_frames_of_the_route_one_after_the_other() {
    let service = Running::start("").await;
    let response = ask(&service, &format!("{TURNTABLE}?frames=3&frames_per_second=5"), "*/*").await;
    assert_eq!((response.status().as_u16(), header(&response, "content-type")), (200, "image/apng"));
    let bytes = response.bytes().await.unwrap();
    let mut reader = png::Decoder::new(Cursor::new(&bytes[..])).read_info().unwrap();
    assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
    let mut turned = vec![0; reader.output_buffer_size().unwrap()];
    for frame in frames(&service).await {
        reader.next_frame(&mut turned).unwrap();
        assert!(turned == pixels(&frame));
        assert_eq!(reader.info().frame_control().unwrap().delay_den, 5);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_zip_holds_the_frames_as_files() {
    let service = Running::start("").await;
    let response = ask(&service, &format!("{TURNTABLE}?frames=3"), "application/zip").await;
    assert_eq!(header(&response, "content-type"), "application/zip");
    let mut archive = zip::ZipArchive::new(Cursor::new(response.bytes().await.unwrap())).unwrap();
    assert_eq!(archive.len(), 3);
    for (number, frame) in frames(&service).await.into_iter().enumerate() {
        let mut file = archive.by_name(&format!("{number:04}.png")).unwrap();
        let mut bytes = vec![];
        file.read_to_end(&mut bytes).unwrap();
        assert!(bytes == frame);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_parts_of_a_multipart_stream_are_the_frames_and_say_how_far_it_is() {
    let service = Running::start("").await;
    let response = ask(&service, &format!("{TURNTABLE}?frames=3"), "multipart/mixed").await;
    let boundary = header(&response, "content-type").split_once("boundary=").unwrap().1.to_owned();
    let mut expected = vec![];
    let bytes = response.bytes().await.unwrap();
    for (number, frame) in frames(&service).await.into_iter().enumerate() {
        let length = frame.len();
        let head = format!(
            "--{boundary}\r\nContent-Type: image/png\r\nContent-Length: {length}\r\nX-Frame: {}/3\r\n\r\n",
            number + 1
        );
        expected.extend([head.as_bytes(), &frame, b"\r\n"].concat());
    }
    expected.extend(format!("--{boundary}--\r\n").as_bytes());
    assert!(bytes == expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_turned_is_refused_and_a_client_that_leaves_ends_the_work() {
    let service = Running::start("[render]\njobs = 1").await;
    for (path, body, pointer) in [
        ("?frames=0", "{}", "/frames"),
        ("?frame=3", "{}", "/frame"),
        ("", r#"{"image": {"format": "jpeg"}}"#, "/image/format"),
        (
            "",
            r#"{"camera": {"look_at": {"position": [0, -90, 9], "target": [0, 0, 0]}}, "image": {"width": 9}}"#,
            "/camera/look_at",
        ),
        ("", r#"{"image": {"width": 100000}}"#, "/image/width"),
        ("", r#"{"image": {"stage": "intermediate"}}"#, "/image/stage"),
    ] {
        let response = service.post(&format!("{TURNTABLE}{path}"), body).await;
        assert_eq!(problem(response).await["errors"][0]["pointer"], pointer);
    }
    let none = service.request(Method::POST, TURNTABLE).header("accept", "text/html").send().await.unwrap();
    assert_eq!(problem(none).await["status"], 406);
    let slow = service.post(TURNTABLE, SLOW).await;
    assert_eq!(slow.status(), 200);
    service.load(1, 0).await;
    drop(slow);
    service.load(0, 0).await;
}
