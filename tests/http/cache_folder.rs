//! Encodings kept across restarts, and what becomes of damaged ones.

use std::fs;
use std::path::PathBuf;

use crate::service::{Running, write_ball};

const FRAME: &str = "/v1/volumes/ball/frame.raw?width=32&height=32";

fn config(folder: &std::path::Path) -> String {
    format!("[cache]\nfolder = {:?}", folder.to_str().unwrap())
}

fn kept(folder: &std::path::Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_takes_the_kept_encodings_and_rebuilds_damaged_ones() {
    let cache = tempfile::tempdir().unwrap();
    let service = Running::start(&config(cache.path())).await;
    let picture = service.get(FRAME).await.bytes().await.unwrap();
    let (_, mut volumes) = service.stop().await;
    let files = kept(cache.path());
    assert_eq!(files.len(), 2, "the default preset's encodings at both levels and no others");
    let sound = fs::read(&files[0]).unwrap();

    let mut flipped = sound.clone();
    *flipped.last_mut().unwrap() ^= 1;
    let truncated = sound[..sound.len() / 2].to_vec();
    for (what, bytes) in [("sound", sound.clone()), ("flipped", flipped), ("truncated", truncated), ("empty", vec![])] {
        fs::write(&files[0], &bytes).unwrap();
        let service = Running::start_in(volumes, &config(cache.path())).await;
        assert_eq!(service.get(FRAME).await.bytes().await.unwrap(), picture, "{what}");
        (_, volumes) = service.stop().await;
        assert!(fs::read(&files[0]).unwrap() == sound, "{what}: the file is sound again");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_volume_replaced_under_its_name_gets_encodings_of_its_own() {
    let cache = tempfile::tempdir().unwrap();
    let service = Running::start(&config(cache.path())).await;
    let etag = service.get(FRAME).await.headers()["etag"].clone();
    let picture = service.get(FRAME).await.bytes().await.unwrap();
    let (_, volumes) = service.stop().await;
    write_ball(&volumes.path().join("ball.nrrd"), 5.0);
    let service = Running::start_in(volumes, &config(cache.path())).await;
    assert_ne!(service.get(FRAME).await.headers()["etag"], etag);
    assert_ne!(service.get(FRAME).await.bytes().await.unwrap(), picture);
    assert_eq!(kept(cache.path()).len(), 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn transfer_functions_of_clients_are_not_kept() {
    let cache = tempfile::tempdir().unwrap();
    let service = Running::start(&config(cache.path())).await;
    let body = r##"{"transfer_function": {"points": [{"value": 0, "opacity": 0, "color": "#000000"},
        {"value": 200, "opacity": 0.7, "color": "#ffffff"}]}}"##;
    assert_eq!(service.post("/v1/volumes/ball/frame", body).await.status(), 200);
    assert_eq!(kept(cache.path()).len(), 2);
}
