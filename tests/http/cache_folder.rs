//! Encodings kept across restarts, and what becomes of damaged ones.

use std::fs;
use std::path::PathBuf;

use crate::service::{Running, write_ball};

const FRAME: &str = "/v1/volumes/ball/frame.raw?width=32&height=32";

/// Of the volume itself and of the level that drafts show.
const DEFAULT_FILES: usize = 2;

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
    assert_eq!(files.len(), DEFAULT_FILES, "the default preset's encodings and no others");
    let sound: Vec<_> = files.iter().map(|file| fs::read(file).unwrap()).collect();

    for what in ["sound", "flipped", "truncated", "empty"] {
        for (file, sound) in files.iter().zip(&sound) {
            let mut bytes = sound.clone();
            match what {
                "flipped" => *bytes.last_mut().unwrap() ^= 1,
                "truncated" => bytes.truncate(sound.len() / 2),
                "empty" => bytes.clear(),
                _ => {}
            }
            fs::write(file, bytes).unwrap();
        }
        let service = Running::start_in(volumes, &config(cache.path())).await;
        assert_eq!(service.get(FRAME).await.bytes().await.unwrap(), picture, "{what}");
        (_, volumes) = service.stop().await;
        for (file, sound) in files.iter().zip(&sound) {
            assert!(fs::read(file).unwrap() == *sound, "{what}: the file is sound again");
        }
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
    assert_eq!(kept(cache.path()).len(), 2 * DEFAULT_FILES);
}

#[tokio::test(flavor = "multi_thread")]
async fn transfer_functions_of_clients_are_not_kept() {
    let cache = tempfile::tempdir().unwrap();
    let service = Running::start(&config(cache.path())).await;
    let body = r##"{"transfer_function": {"points": [{"value": 0, "opacity": 0, "color": "#000000"},
        {"value": 200, "opacity": 0.7, "color": "#ffffff"}]}}"##;
    for _ in 0..3 {
        assert_eq!(service.post("/v1/volumes/ball/frame", body).await.status(), 200);
    }
    service.gauge("shearwarp_encodings", |encodings| encodings > DEFAULT_FILES as f64).await;
    assert_eq!(kept(cache.path()).len(), DEFAULT_FILES);
}
