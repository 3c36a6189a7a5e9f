//! Shadows: asked for by a light.

use crate::service::{Running, header, problem, write_ball};

const FRAME: &str = "/v1/volumes/ball/frame";
const AROUND: &str = r##""image": {"width": 64, "height": 64, "format": "raw"},
    "transfer_function": {"points": [{"value": 50, "opacity": 0, "color": "#ffffff"}, {"value": 150, "opacity": 0.3, "color": "#ffffff"}]}"##;

async fn running(toml: &str) -> Running {
    let folder = tempfile::tempdir().unwrap();
    write_ball(&folder.path().join("ball.nrrd"), 11.0);
    Running::start_in(folder, toml).await
}

/// The mean of a frame's bytes.
async fn brightness(service: &Running, more: &str, lights: &str) -> f64 {
    let body = format!(r#"{{{AROUND}{more}, "shading": {{"lights": {lights}}}}}"#);
    let response = service.post(FRAME, &body).await;
    assert_eq!(response.status(), 200, "{body}");
    let pixels = response.bytes().await.unwrap();
    pixels.iter().map(|&byte| f64::from(byte)).sum::<f64>() / pixels.len() as f64
}

#[tokio::test(flavor = "multi_thread")]
async fn a_light_casts_shadows_if_it_is_told_to() {
    let service = running("").await;
    let behind = |shadows: bool| format!(r#"[{{"direction": [0.2, 1, 0.3], "shadows": {shadows}}}]"#);
    for more in [
        "",
        r#", "algorithm": "classified""#,
        r#", "algorithm": "fast-classification""#,
        r#", "algorithm": "raycast""#,
        r#", "quality": "high""#,
        r#", "quality": "draft""#,
        r#", "camera": {"projection": "perspective"}"#,
    ] {
        let (lit, dark) =
            (brightness(&service, more, &behind(false)).await, brightness(&service, more, &behind(true)).await);
        assert!(dark > 1.0 && dark < 0.85 * lit, "{more}: {dark} of {lit}");
    }
    // What stands between light and ball is cut away.
    let clip = r#", "clip": [{"plane": {"point": [0, 12, 0], "normal": [0, -1, 0]}}]"#;
    let (whole, cut) = (brightness(&service, "", &behind(true)).await, brightness(&service, clip, &behind(true)).await);
    assert!(cut > whole, "{cut} {whole}");
    service.gauge("shearwarp_shadows_bytes", |bytes| bytes > 24.0 * 24.0 * 24.0).await;
    // Projections are not lit.
    let body = |shadows: bool| {
        format!(
            r#"{{"image": {{"width": 8, "height": 8}}, "blend": "maximum", "shading": {{"lights": {}}}}}"#,
            behind(shadows)
        )
    };
    let etag = async |shadows| header(&service.post(FRAME, &body(shadows)).await, "etag").to_owned();
    assert_eq!(etag(false).await, etag(true).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn shadows_that_cannot_be_had_are_refused() {
    // An eighth of that is less than the ball has voxels.
    let service = running("[cache]\nclassified_bytes = 100_000").await;
    let casting = r#"{"direction": [0, 1, 0], "shadows": true}"#;
    let region = r#""regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}"#;
    for (body, pointer) in [
        (format!(r#"{{"shading": {{"lights": [{casting}, "headlight", {casting}]}}}}"#), "/shading/lights/2/shadows"),
        (format!(r#"{{{region}, "shading": {{"lights": [{casting}]}}}}]}}"#), "/regions/0/shading/lights/0/shadows"),
        (r#"{"shading": {"lights": [{"direction": [0, 1, 0], "shadows": 1}]}}"#.into(), "/shading/lights/0/shadows"),
        (format!(r#"{{"shading": {{"lights": [{casting}]}}}}"#), "/shading/lights"),
    ] {
        let response = service.post(FRAME, &body).await;
        assert_eq!(response.status(), 422, "{body}");
        assert_eq!(problem(response).await["errors"][0]["pointer"], pointer, "{body}");
    }
}
