//! The end: answers go out, nobody holds it open.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use reqwest::Method;

use crate::service::{Running, SLOW};

/// A client that has its answer and stays.
fn idle_connection(service: &Running) -> TcpStream {
    let mut idle = TcpStream::connect(service.address).unwrap();
    idle.write_all(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
    let mut answer = [0; 12];
    idle.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 200");
    idle
}

#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_do_not_hold_the_shutdown_open() {
    let service = Running::start("[http]\nshutdown_seconds = 30").await;
    let _idle = tokio::task::block_in_place(|| idle_connection(&service));
    let (took, _) = service.stop().await;
    assert!(took < Duration::from_secs(10), "{took:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_frame_is_answered_before_the_end() {
    let service = Running::start("[http]\nshutdown_seconds = 60").await;
    let body = r#"{"algorithm": "raycast", "sample_distance": 0.05, "image": {"width": 512, "height": 512}}"#;
    let request = service.request(Method::POST, "/v1/volumes/ball/frame").header("content-type", "application/json");
    let frame = tokio::spawn(request.body(body).send());
    while service.metric("shearwarp_jobs_running").await < 1.0 && !frame.is_finished() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    service.stop().await;
    let response = frame.await.unwrap().unwrap();
    assert_eq!(response.status(), 200);
    assert!(response.bytes().await.unwrap().starts_with(b"\x89PNG"));
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_clients_and_long_frames_end_at_the_hard_deadline() {
    let service = Running::start("[http]\nshutdown_seconds = 0.5").await;
    let mut half_a_head = TcpStream::connect(service.address).unwrap();
    half_a_head.write_all(b"GET /healthz HTTP/1.1\r\nho").unwrap();
    let request = service.request(Method::POST, "/v1/volumes/ball/frame").header("content-type", "application/json");
    let frame = tokio::spawn(request.body(SLOW).send());
    service.load(1, 0).await;
    let (took, _) = service.stop().await;
    assert!(took >= Duration::from_millis(400) && took < Duration::from_secs(10), "{took:?}");
    frame.abort();
}

#[test]
fn the_program_prints_its_address_and_ends_with_status_0_on_sigterm() {
    let mut program = Command::new(env!("CARGO_BIN_EXE_shearwarp"))
        .args(["serve", "--listen", "127.0.0.1:0"])
        .env_remove("SHEARWARP_DATA")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(program.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("listening on http://").unwrap_or_else(|| panic!("{line:?}")).to_owned();
    // An idle client, while the demo volume is still being made.
    let _idle = TcpStream::connect(&address).unwrap();
    let start = Instant::now();
    assert!(Command::new("kill").args(["-TERM", &program.id().to_string()]).status().unwrap().success());
    let status = program.wait().unwrap();
    assert_eq!(status.code(), Some(0));
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
}
