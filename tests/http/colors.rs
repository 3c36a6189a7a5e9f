//! A colour volume, served like any other.

use serde_json::Value;

use crate::service::{Running, header, problem, write_ball};

const FRAME: &str = "/v1/volumes/paint/frame";

/// 12 x 12 x 12 voxels: red on the patient's right, blue on the left, some clear around them.
async fn running() -> Running {
    let folder = tempfile::tempdir().unwrap();
    write_ball(&folder.path().join("ball.nrrd"), 8.0);
    let mut file = b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 4 12 12 12\nencoding: raw\nkinds: RGBA-color domain domain domain\n\n".to_vec();
    for n in 0..12 * 12 * 12 {
        let [i, j, k] = [n % 12, n / 12 % 12, n / 144];
        let inside = [i, j, k].iter().all(|at| (2..10).contains(at));
        let color = if i < 6 { [255, 0, 0] } else { [0, 0, 255] };
        file.extend(color.into_iter().chain([if inside { 200 } else { 0 }]));
    }
    std::fs::write(folder.path().join("paint.nrrd"), file).unwrap();
    Running::start_in(folder, "").await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_colour_volume_is_shown_in_its_colours() {
    let service = running().await;
    let facts: Value = service.get("/v1/volumes/paint").await.json().await.unwrap();
    assert_eq!((&facts["components"], &facts["value_range"]), (&4.into(), &serde_json::json!([0.0, 200.0])));
    for (fields, algorithm) in [
        ("", "classified"),
        (r#", "quality": "draft""#, "classified"),
        (r#", "quality": "high""#, "preintegrated"),
        (r#", "algorithm": "preintegrated""#, "preintegrated"),
        (r#", "sampling": "opacity""#, "classified"),
        (r#", "algorithm": "fast-classification""#, "fast-classification"),
        (r#", "camera": {"projection": "perspective"}"#, "classified"),
    ] {
        let body = format!(r#"{{"image": {{"width": 32, "height": 32, "format": "raw"}}{fields}}}"#);
        let response = service.post(FRAME, &body).await;
        assert_eq!((response.status().as_u16(), header(&response, "x-render-algorithm")), (200, algorithm), "{fields}");
        let pixels = response.bytes().await.unwrap();
        let at = |x: usize| <[u8; 3]>::try_from(&pixels[3 * (32 * 16 + x)..][..3]).unwrap();
        // From in front the patient's right is on the left.
        let ([r, g, b], [r2, g2, b2]) = (at(12), at(19));
        assert!(r > 200 && g < 10 && b < 60 && r2 < 60 && g2 < 10 && b2 > 200, "{fields}: {:?} {:?}", at(12), at(19));
        assert_eq!(at(1), [0; 3]);
    }
    let by = async |sampling: &str| {
        let body = format!(r#"{{"image": {{"width": 32, "height": 32}}, "camera": {{"azimuth": 30}}{sampling}}}"#);
        let response = service.post(FRAME, &body).await;
        (header(&response, "etag").to_owned(), response.bytes().await.unwrap())
    };
    let (extinction, opacity) = (by("").await, by(r#", "sampling": "opacity""#).await);
    assert!(extinction.0 != opacity.0 && extinction.1 != opacity.1);
    assert_eq!(by(r#", "sampling": "extinction""#).await, extinction);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_goes_with_colours_only_or_with_scalars_only_is_refused() {
    let service = running().await;
    for (id, body, pointer) in [
        ("ball", r#"{"sampling": "extinction"}"#, "/sampling"),
        ("paint", r#"{"sampling": "color"}"#, "/sampling"),
        (
            "paint",
            r#"{"algorithm": "classified", "regions": [{"sphere": {"center": [6, 6, 6], "radius": 3}, "blend": "maximum"}]}"#,
            "/regions/0/blend",
        ),
    ] {
        let problem = problem(service.post(&format!("/v1/volumes/{id}/frame"), body).await).await;
        assert_eq!((&problem["status"], &problem["errors"][0]["pointer"]), (&422.into(), &pointer.into()), "{body}");
    }
    for body in [
        r#"{"blend": "maximum"}"#,
        r#"{"regions": [{"sphere": {"center": [6, 6, 6], "radius": 3}, "blend": "maximum"}]}"#,
        r#"{"blend": "maximum", "regions": [{"sphere": {"center": [6, 6, 6], "radius": 3}, "blend": "composite"}]}"#,
    ] {
        let response = service.post(FRAME, body).await;
        let told = (response.status().as_u16(), header(&response, "x-render-algorithm"));
        assert_eq!(told, (200, "preintegrated"), "{body}");
    }
}
