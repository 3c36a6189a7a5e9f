//! Frames, their formats, and what keeps clients from asking for them again.

use glam::{DMat3, DVec3};
use reqwest::Method;

use crate::service::{Running, header, problem};

const PNG: &str = "/v1/volumes/ball/frame.png?width=40&height=30&azimuth=20";

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_comes_with_its_timings_algorithm_and_validators() {
    let service = Running::start("").await;
    let response = service.get(PNG).await;
    assert_eq!(response.status(), 200);
    assert_eq!(header(&response, "content-type"), "image/png");
    assert_eq!(header(&response, "x-render-algorithm"), "preintegrated");
    assert_eq!(header(&response, "vary"), "Accept");
    assert_eq!(header(&response, "cache-control"), "no-cache");
    let timing = header(&response, "server-timing").to_owned();
    let stages: Vec<_> = timing.split(", ").map(|entry| entry.split(";dur=").next().unwrap()).collect();
    assert_eq!(stages, ["queue", "prepare", "shade", "composite", "warp", "encode", "total"]);
    let total: f64 = timing.rsplit("dur=").next().unwrap().parse().unwrap();
    assert!(total > 0.0);
    let bytes = response.bytes().await.unwrap();
    assert!(bytes.starts_with(b"\x89PNG"));
    assert_eq!(bytes[16..24], [0, 0, 0, 40, 0, 0, 0, 30]);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_frame_shows_the_volume_and_not_one_colour() {
    let service = Running::start("").await;
    let response = service.get("/v1/volumes/ball/frame.raw?width=32&height=32").await;
    let size = ["x-image-width", "x-image-height", "x-image-channels"].map(|name| header(&response, name).to_owned());
    assert_eq!(size, ["32", "32", "3"]);
    let pixels = response.bytes().await.unwrap();
    assert_eq!(pixels.len(), 32 * 32 * 3);
    let brightness = |x: usize, y: usize| pixels[3 * (32 * y + x)..][..3].iter().copied().max().unwrap();
    assert_eq!(brightness(0, 0), 0);
    assert!(brightness(16, 16) > 20, "{}", brightness(16, 16));
}

/// The ball of radius 8 in the middle of 24 mm, from in front.
#[tokio::test(flavor = "multi_thread")]
async fn a_region_looks_otherwise_and_what_is_cut_out_is_gone() {
    let service = Running::start("").await;
    let frame = async |fields: &str| {
        let body = format!(
            r##"{{"image": {{"width": 33, "height": 33, "format": "raw", "background": "transparent"}}, "shading": false,
            "transfer_function": {{"points": [{{"value": 0, "opacity": 0, "color": "#ff0000"}},
                {{"value": 100, "opacity": 0.9, "color": "#ff0000"}}]}}{fields}}}"##
        );
        let response = service.post("/v1/volumes/ball/frame", &body).await;
        assert_eq!(response.status(), 200);
        response.bytes().await.unwrap()
    };
    let at = |pixels: &[u8], x: usize, y: usize| <[u8; 4]>::try_from(&pixels[4 * (33 * y + x)..][..4]).unwrap();
    let sphere = r#"{"sphere": {"center": [11.5, 11.5, 11.5], "radius": 9}"#;
    let whole = frame("").await;
    assert_eq!(at(&whole, 16, 16)[..3], [255, 0, 0]);
    // Green where the region is, which is nearly everywhere; the upper half as before.
    let points = r##"{"points": [{"value": 0, "opacity": 0, "color": "#00ff00"}, {"value": 100, "opacity": 0.9, "color": "#00ff00"}]}"##;
    let lower = format!(
        r#", "regions": [{{"plane": {{"point": [0, 0, 11.5], "normal": [0, 0, -1]}}, "transfer_function": {points}}}]"#
    );
    let pixels = frame(&lower).await;
    assert_eq!(at(&pixels, 16, 12)[..3], [255, 0, 0]);
    assert_eq!(at(&pixels, 16, 20)[..3], [0, 255, 0]);
    let faint = frame(&format!(r#", "regions": [{sphere}, "opacity": 0.01}}]"#)).await;
    assert!((1..100).contains(&at(&faint, 16, 16)[3]));
    let gray = frame(&format!(r#", "regions": [{sphere}, "blend": "maximum"}}]"#)).await;
    let [r, g, b, a] = at(&gray, 16, 16);
    assert!(r > 200 && r == g && g == b && a == 255);
    let gone = frame(&format!(r#", "clip": [{sphere}, "keep": "outside"}}], "regions": [{sphere}}}]"#)).await;
    assert!(gone.chunks(4).all(|pixel| pixel[3] == 0));
}

/// The ball of radius 8 in the middle of 24 mm: its centre is where the camera looks.
#[tokio::test(flavor = "multi_thread")]
async fn an_intermediate_image_comes_with_its_warp_and_without_what_is_empty() {
    let service = Running::start("").await;
    let ask = async |fields: &str, stage: &str| {
        let body = format!(
            r#"{{"image": {{"width": 60, "height": 40, "format": "raw", "stage": "{stage}"}}, "shading": false{fields}}}"#
        );
        service.post("/v1/volumes/ball/frame", &body).await
    };
    for fields in ["", r#", "camera": {"azimuth": 20, "roll": 30}"#, r#", "camera": {"projection": "perspective"}"#] {
        let (frame, image) = (ask(fields, "final").await, ask(fields, "intermediate").await);
        assert_ne!(header(&frame, "etag"), header(&image, "etag"));
        assert!(!frame.headers().contains_key("x-image-warp"));
        let warp: Vec<f64> = header(&image, "x-image-warp").split(", ").map(|n| n.parse().unwrap()).collect();
        let [width, height]: [usize; 2] =
            ["x-image-width", "x-image-height"].map(|name| header(&image, name).parse().unwrap());
        let (frame, image) = (frame.bytes().await.unwrap(), image.bytes().await.unwrap());
        let (frame, image): (&[u8], &[u8]) = (&frame, &image);
        assert!((10..40).contains(&width) && (10..40).contains(&height), "{width} x {height}");
        assert_eq!(image.len(), width * height * 3);
        // Where the frame's middle is, which shows the ball's.
        let warp = DMat3::from_cols_slice(&warp).transpose();
        let at = warp.inverse() * DVec3::new(30.0, 20.0, 1.0);
        let [u, v] = [at.x / at.z, at.y / at.z];
        assert!(u > 5.0 && v > 5.0 && u < width as f64 - 5.0 && v < height as f64 - 5.0, "{u}, {v} by {warp:?}");
        let middle = image[3 * (v as usize * width + u as usize)];
        assert!(middle > 20 && middle.abs_diff(frame[3 * (20 * 60 + 30)]) < 9, "{middle}");
    }
    let high = ask(r#", "quality": "high""#, "intermediate").await;
    assert_eq!((header(&high, "x-image-width"), high.headers().get("x-image-warp")), ("60", None));
    let wrong = service.post("/v1/volumes/ball/frame", r#"{"image": {"stage": "sheared"}}"#).await;
    assert_eq!(problem(wrong).await["errors"][0]["pointer"], "/image/stage");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_request_gives_the_same_bytes_by_query_by_body_and_again() {
    let service = Running::start("").await;
    let by_query = service.get(PNG).await;
    let etag = header(&by_query, "etag").to_owned();
    let by_query = by_query.bytes().await.unwrap();
    let body = r#"{"camera": {"azimuth": 20}, "image": {"height": 30, "width": 40}}"#;
    let by_body = service.post("/v1/volumes/ball/frame", body).await;
    assert_eq!(header(&by_body, "etag"), etag);
    assert_eq!(by_body.bytes().await.unwrap(), by_query);
    assert_eq!(service.get(PNG).await.bytes().await.unwrap(), by_query);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_known_frame_is_304_and_another_one_is_not() {
    let service = Running::start("").await;
    let etag = header(&service.get(PNG).await, "etag").to_owned();
    for known in [etag.clone(), format!("W/{etag}"), format!("\"x\", {etag}"), "*".into()] {
        for method in [Method::GET, Method::HEAD] {
            let response = service.request(method, PNG).header("if-none-match", &known).send().await.unwrap();
            assert_eq!(response.status(), 304, "{known}");
            assert_eq!(header(&response, "etag"), etag);
            assert_eq!(header(&response, "server-timing"), "", "nothing was rendered");
            assert!(response.bytes().await.unwrap().is_empty());
        }
    }
    let others = [PNG.replace("azimuth=20", "azimuth=21"), PNG.replace("frame.png", "frame.webp")];
    for other in others {
        let response = service.request(Method::GET, &other).header("if-none-match", &etag).send().await.unwrap();
        assert_eq!(response.status(), 200, "{other}");
        assert_ne!(header(&response, "etag"), etag);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn head_is_get_without_the_body() {
    let service = Running::start("").await;
    let got = service.get(PNG).await;
    let asked = service.request(Method::HEAD, PNG).send().await.unwrap();
    assert_eq!(asked.status(), 200);
    for name in ["etag", "content-type", "content-length", "x-render-algorithm"] {
        assert_eq!(header(&asked, name), header(&got, name), "{name}");
    }
    assert!(asked.bytes().await.unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn accept_chooses_where_the_request_leaves_the_format_open() {
    let service = Running::start("").await;
    let small = r#"{"image": {"width": 8, "height": 8}}"#;
    let named = r#"{"image": {"width": 8, "height": 8, "format": "webp"}}"#;
    let transparent = r##"{"image": {"width": 8, "height": 8, "background": "transparent"}}"##;
    for (accept, body, expected) in [
        ("*/*", small, "image/png"),
        ("image/*", small, "image/png"),
        ("image/jpeg", small, "image/jpeg"),
        ("image/png;q=0.1, image/webp", small, "image/webp"),
        ("application/octet-stream", small, "application/octet-stream"),
        ("image/jpeg", named, "image/webp"),
        ("image/jpeg, image/webp;q=0.5", transparent, "image/webp"),
        ("text/html", small, "application/problem+json"),
        ("image/jpeg", transparent, "application/problem+json"),
    ] {
        let request = service.request(Method::POST, "/v1/volumes/ball/frame").header("accept", accept);
        let response = request.header("content-type", "application/json").body(body).send().await.unwrap();
        assert_eq!(header(&response, "content-type"), expected, "{accept} {body}");
        let status = if expected.contains("problem") { 406 } else { 200 };
        assert_eq!(response.status(), status, "{accept} {body}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_extension_gives_its_format() {
    let service = Running::start("").await;
    for (extension, media_type, start) in [
        ("png", "image/png", &b"\x89PNG"[..]),
        ("jpg", "image/jpeg", b"\xff\xd8\xff"),
        ("jpeg", "image/jpeg", b"\xff\xd8\xff"),
        ("webp", "image/webp", b"RIFF"),
        ("raw", "application/octet-stream", b"\0\0\0"),
    ] {
        let response = service.get(&format!("/v1/volumes/ball/frame.{extension}?width=8&height=8")).await;
        assert_eq!(header(&response, "content-type"), media_type);
        assert!(response.bytes().await.unwrap().starts_with(start), "{extension}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_is_optional_and_may_name_the_reference_algorithm() {
    let service = Running::start("").await;
    let response = service.request(Method::POST, "/v1/volumes/ball/frame").send().await.unwrap();
    assert_eq!((response.status().as_u16(), header(&response, "content-type")), (200, "image/png"));
    let body = r#"{"algorithm": "raycast", "image": {"width": 8, "height": 8}}"#;
    let response = service.post("/v1/volumes/ball/frame", body).await;
    assert_eq!(header(&response, "x-render-algorithm"), "raycast");
}

#[tokio::test(flavor = "multi_thread")]
async fn either_table_of_slabs_may_be_asked_for() {
    let service = Running::start("").await;
    let mut tags = std::collections::HashSet::new();
    for table in ["2d", "1d"] {
        for quality in ["draft", "standard", "high"] {
            let body = format!(
                r#"{{"quality": "{quality}", "preintegration": {{"table": "{table}"}}, "image": {{"format": "raw", "width": 32, "height": 32}}}}"#
            );
            let response = service.post("/v1/volumes/ball/frame", &body).await;
            assert_eq!(response.status(), 200, "{body}");
            tags.insert(header(&response, "etag").to_owned());
            assert!(response.bytes().await.unwrap().iter().any(|&byte| byte > 20), "{body} shows nothing");
        }
    }
    assert_eq!(tags.len(), 6, "none is taken for another");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sane_request_id_is_kept_and_another_replaced() {
    let service = Running::start("").await;
    let response = service.request(Method::GET, "/healthz").header("x-request-id", "mine-1").send().await.unwrap();
    assert_eq!(header(&response, "x-request-id"), "mine-1");
    let response = service.request(Method::GET, "/nowhere").header("x-request-id", "not mine").send().await.unwrap();
    assert!(!header(&response, "x-request-id").contains(' '));
    assert!(!header(&response, "x-request-id").is_empty());
}
