//! Encodings come behind the frames' backs and show in no picture.

use crate::service::{Running, header};

const FRAME: &str = "/v1/volumes/ball/frame";

/// Encodings of the default preset: of the volume itself and of the level that drafts show.
const DEFAULTS: f64 = 2.0;

/// A request with a transfer function of its own, for bare pixels.
fn body(further: &str) -> String {
    format!(
        r##"{{"transfer_function": {{"points": [{{"value": 20, "opacity": 0, "color": "#ff8000"}},
            {{"value": 200, "opacity": 0.7, "color": "#80c0ff"}}]}},
        "camera": {{"azimuth": 20, "elevation": 30}}, "image": {{"width": 48, "height": 48, "format": "raw"}}, {further}}}"##
    )
}

/// The validator and the pixels of a frame.
async fn frame(service: &Running, body: &str) -> (String, Vec<u8>) {
    let response = service.post(FRAME, body).await;
    assert_eq!(response.status(), 200, "{body}");
    (header(&response, "etag").to_owned(), response.bytes().await.unwrap().to_vec())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_ready_service_has_the_encodings_of_every_quality_of_the_empty_request() {
    let service = Running::start("").await;
    assert_eq!(service.metric("shearwarp_encodings").await, DEFAULTS);
    for quality in ["draft", "standard", "high"] {
        for _ in 0..3 {
            frame(&service, &format!(r#"{{"quality": "{quality}", "image": {{"width": 16, "height": 16}}}}"#)).await;
        }
    }
    service.gauge("shearwarp_encodings_building", |building| building == 0.0).await;
    assert_eq!(service.metric("shearwarp_encodings").await, DEFAULTS, "nothing was left to build");
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_before_and_after_the_encodings_are_the_same_bytes_under_one_etag() {
    let service = Running::start("").await;
    for (built, further) in [
        (1.0, r#""algorithm": "classified""#),
        (2.0, r#""algorithm": "preintegrated""#),
        (3.0, r#""algorithm": "classified", "quality": "draft""#),
        (4.0, r#""quality": "draft""#),
        // Those of the same transfer function at standard quality are there.
        (4.0, r#""quality": "high", "shading": false"#),
    ] {
        let body = body(further);
        let first = frame(&service, &body).await;
        assert!(first.1.iter().any(|byte| *byte > 20), "{further}: a picture of something");
        assert_eq!(frame(&service, &body).await, first, "{further}");
        service.gauge("shearwarp_encodings", |encodings| encodings == DEFAULTS + built).await;
        assert_eq!(frame(&service, &body).await, first, "{further}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_transfer_function_that_is_asked_for_once_gets_no_encodings() {
    let service = Running::start("").await;
    for shade in 10..30 {
        frame(&service, &body(r#""algorithm": "classified""#).replace("ff8000", &format!("ff80{shade}"))).await;
    }
    service.gauge("shearwarp_encodings_building", |building| building == 0.0).await;
    assert_eq!(service.metric("shearwarp_encodings").await, DEFAULTS);
}

#[tokio::test(flavor = "multi_thread")]
async fn without_room_for_encodings_frames_are_answered_all_the_same() {
    let (roomy, tight) = (Running::start("").await, Running::start("[cache]\nclassified_bytes = 8192").await);
    let body = body(r#""algorithm": "classified""#);
    let expected = frame(&roomy, &body).await;
    let small = tight.metric("shearwarp_encodings").await;
    for _ in 0..3 {
        assert_eq!(frame(&tight, &body).await, expected);
    }
    assert_eq!(tight.metric("shearwarp_encodings").await, small);
}
