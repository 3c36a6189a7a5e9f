//! What the service says about its volumes, presets and itself.

use std::fs;

use serde_json::json;
use shearwarp::classify::presets;

use crate::service::{Running, header, problem, write_ball};

#[tokio::test(flavor = "multi_thread")]
async fn a_volume_is_described_in_full() {
    let service = Running::start("").await;
    let ball = service.json("/v1/volumes/ball").await;
    assert_eq!(ball["id"], "ball");
    assert_eq!(ball["status"], "ready");
    assert_eq!(ball["dimensions"], json!([24, 24, 24]));
    assert_eq!(ball["spacing"], json!([1.0, 1.0, 1.0]));
    assert_eq!(ball["direction"].as_array().unwrap().len(), 9);
    assert_eq!(ball["scalar_type"], "u8");
    assert_eq!(ball["components"], 1);
    assert_eq!(ball["value_range"], json!([0.0, 200.0]));
    // The codes, and their copy for rays along x.
    assert_eq!(ball["bytes"]["volume"], 2 * 24 * 24 * 24);
    assert_eq!(service.json("/v1/volumes").await["volumes"], json!([ball]));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_histogram_counts_every_voxel_once() {
    let service = Running::start("").await;
    let histogram = service.json("/v1/volumes/ball/histogram?bins=4").await;
    let counts: Vec<_> = histogram["counts"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).collect();
    assert_eq!((histogram["min"].as_f64(), histogram["max"].as_f64()), (Some(0.0), Some(200.0)));
    assert_eq!(counts.len(), 4);
    assert_eq!(counts.iter().sum::<u64>(), 24 * 24 * 24);
    assert_eq!(counts[1..3], [0, 0]);
    let refused = problem(service.get("/v1/volumes/ball/histogram?bins=5000").await).await;
    assert_eq!(refused["errors"][0]["pointer"], "/bins");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_cannot_be_read_is_listed_as_failed_and_the_others_are_served() {
    let folder = tempfile::tempdir().unwrap();
    write_ball(&folder.path().join("good.nrrd"), 8.0);
    fs::write(folder.path().join("good.json"), r#"{"modality": "MR"}"#).unwrap();
    fs::write(folder.path().join("bad.nii"), "not a scan").unwrap();
    let service = Running::start_in(folder, "").await;
    let bad = service.json("/v1/volumes/bad").await;
    assert_eq!(bad["status"], "failed");
    assert!(bad["detail"].as_str().is_some_and(|reason| !reason.is_empty()));
    let refused = problem(service.get("/v1/volumes/bad/frame.png").await).await;
    assert_eq!(refused["status"], 409);
    assert_eq!(service.json("/v1/volumes/good").await["modality"], "MR");
    assert_eq!(service.get("/v1/volumes/good/frame.png?width=8&height=8").await.status(), 200);
    assert_eq!(service.json("/readyz").await["volumes"], json!({"ready": 1, "loading": 0, "failed": 1}));
}

#[tokio::test(flavor = "multi_thread")]
async fn every_preset_is_listed_and_renders() {
    let service = Running::start("").await;
    let listed = service.json("/v1/presets").await;
    let names: Vec<_> = listed["presets"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(names, presets::all().iter().map(|preset| preset.name.as_str()).collect::<Vec<_>>());
    for (index, name) in names.iter().enumerate() {
        assert_eq!(service.json(&format!("/v1/presets/{name}")).await, listed["presets"][index]);
        let frame = service.get(&format!("/v1/volumes/ball/frame.png?width=8&height=8&preset={name}")).await;
        assert_eq!(frame.status(), 200, "{name}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_every_volume_and_may_load_nothing_from_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    write_ball(&folder.path().join("a&b.nrrd"), 8.0);
    let service = Running::start_in(folder, "").await;
    let response = service.get("/").await;
    assert!(header(&response, "content-security-policy").starts_with("default-src 'none'; img-src 'self'"));
    let page = response.text().await.unwrap();
    assert!(page.contains("src=\"v1/volumes/a%26b/frame.png?") && page.contains("a&amp;b, 24"), "{page}");
    assert!(!page.contains("<script") && !page.contains("http://") && !page.contains("https://"), "{page}");
    assert_eq!(service.get("/v1/volumes/a%26b/frame.png?width=8&height=8").await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_count_requests_and_time_the_stages() {
    let service = Running::start("").await;
    service.get("/v1/volumes/ball/frame.png?width=8&height=8").await;
    let text = service.get("/metrics").await.text().await.unwrap();
    for stage in ["queue", "prepare", "shade", "composite", "warp", "encode", "total"] {
        assert!(text.contains(&format!("shearwarp_stage_seconds_count{{stage=\"{stage}\"}}")), "{stage} in\n{text}");
    }
    let route = "route=\"/v1/volumes/{id}/frame.png\",method=\"GET\",status=\"200\"";
    assert!(text.contains(&format!("shearwarp_requests_total{{{route}}}")), "{text}");
    for name in
        ["shearwarp_refused_total", "shearwarp_panics_total", "shearwarp_cancelled_total", "shearwarp_queue_depth"]
    {
        assert!(service.metric(name).await >= 0.0);
    }
    assert!(service.metric("shearwarp_encodings").await >= 1.0);
}
