//! From a folder of files to volumes that can be rendered.
//!
//! What can be told from names alone (which files are volumes, whether two claim one id) is told
//! before the service listens, so that a wrong folder ends the start. The files themselves are read
//! while the service listens already and says how far it is.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use std::{fs, io};

use serde::Deserialize;
use tokio::task::JoinSet;

use super::App;
use super::classified::ClassifiedKey;
use super::request::RenderRequest;
use super::store::{Entry, LoadedVolume, Source};
use crate::volume::{Volume, decode, phantom};

/// Why a folder cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ScanError {
    #[error("volumes folder {path}: {error}")]
    Folder { path: PathBuf, error: io::Error },
    #[error("volumes folder: {first} and {second} both claim the id {id:?}; rename one of them")]
    TwoWithOneId { id: String, first: PathBuf, second: PathBuf },
    #[error("{path}: expected JSON with an optional string \"modality\": {detail}")]
    Sidecar { path: PathBuf, detail: String },
}

/// What a `.json` beside a volume may say; it may say more for others.
#[derive(Debug, Deserialize)]
struct Sidecar {
    modality: Option<String>,
}

/// The volumes to serve: those of `folder`, or the built-in demo volume.
///
/// # Errors
/// Where the folder or a `.json` in it cannot be read, or two files have one id.
pub fn scan(folder: Option<&Path>) -> Result<Vec<Entry>, ScanError> {
    let Some(folder) = folder else {
        return Ok(vec![Entry::new("demo".into(), "Demo head".into(), Source::Demo, Some("CT".into()))]);
    };
    let failed = |error| ScanError::Folder { path: folder.to_owned(), error };
    let mut paths = fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>())
        .map_err(failed)?;
    paths.sort();
    let mut found = BTreeMap::<String, PathBuf>::new();
    for path in paths {
        let Some(id) = path.file_name().and_then(|name| name.to_str()).and_then(decode::volume_id) else {
            if path.extension().is_none_or(|extension| extension != "json") {
                tracing::info!(file = %path.display(), "skipped: not a known volume format");
            }
            continue;
        };
        if let Some(first) = found.insert(id.clone(), path.clone()) {
            return Err(ScanError::TwoWithOneId { id, first, second: path });
        }
    }
    if found.is_empty() {
        tracing::warn!(folder = %folder.display(), "no volume in the folder");
    }
    found
        .into_iter()
        .map(|(id, path)| Ok(Entry::new(id.clone(), id.clone(), Source::File(path), modality(folder, &id)?)))
        .collect()
}

/// The modality that `<id>.json` in `folder` names, if there is one.
///
/// # Errors
/// [`ScanError::Sidecar`] for a file that does not say it as it should.
pub fn modality(folder: &Path, id: &str) -> Result<Option<String>, ScanError> {
    let path = folder.join(format!("{id}.json"));
    let text = match fs::read(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(ScanError::Sidecar { path, detail: error.to_string() }),
    };
    let sidecar: Sidecar =
        serde_json::from_slice(&text).map_err(|error| ScanError::Sidecar { path, detail: error.to_string() })?;
    Ok(sidecar.modality)
}

/// Loads every volume and the encodings of its default preset, as many at once as the pool runs jobs.
pub async fn load_all(app: Arc<App>) {
    let start = Instant::now();
    let mut tasks = JoinSet::new();
    for entry in app.store.entries() {
        tasks.spawn(load(Arc::clone(&app), Arc::clone(entry)));
    }
    let total = tasks.len();
    let mut done = 0;
    while tasks.join_next().await.is_some() {
        done += 1;
        tracing::info!(done, total, "loading");
    }
    let (ready, _, failed) = app.store.counts();
    tracing::info!(ready, failed, seconds = start.elapsed().as_secs_f64(), "all volumes are loaded");
}

/// Loads one volume; whatever happens, its entry is settled afterwards.
async fn load(app: Arc<App>, entry: Arc<Entry>) {
    let start = Instant::now();
    let limits = decode::Limits { max_voxels: app.config.volume.max_voxels };
    let ticket = app.pool.own_work();
    let source = Arc::clone(&entry);
    let built: Result<_, String> = ticket
        .run(move |_| {
            let volume = read(&source.source, &limits)?;
            Ok(Arc::new(LoadedVolume::build(volume, source.modality.as_deref())))
        })
        .await
        .map_err(|panic| panic.to_string())
        .and_then(|(built, _)| built);
    let outcome = match built {
        Ok(volume) => warm_up(&app, &volume).await.map(|()| volume),
        Err(reason) => Err(reason),
    };
    match &outcome {
        Ok(volume) => {
            let [x, y, z] = volume.volume().dims();
            let report = volume.volume().report();
            tracing::info!(
                volume = entry.id,
                dimensions = format!("{x}x{y}x{z}"),
                format = report.format,
                non_finite = report.non_finite,
                quantized = report.quantized,
                volumes_left_out = report.volumes_left_out,
                preset = volume.presets.default.name,
                seconds = start.elapsed().as_secs_f64(),
                "volume is ready"
            );
        }
        Err(reason) => tracing::error!(volume = entry.id, %reason, "volume cannot be served"),
    }
    entry.settle(outcome);
}

fn read(source: &Source, limits: &decode::Limits) -> Result<Volume, String> {
    match source {
        Source::Demo => Ok(phantom::head()),
        Source::File(path) => decode::load(path, limits).map_err(|error| error.to_string()),
    }
}

/// Builds what the empty request needs at every quality, so that the first frame is as fast as the
/// second.
async fn warm_up(app: &App, volume: &Arc<LoadedVolume>) -> Result<(), String> {
    let mut wanted = vec![];
    for quality in ["standard", "draft", "high"] {
        // What is classified does not depend on the image's size; one pixel is within any operator's limits.
        let request = format!(r#"{{"image": {{"width": 1, "height": 1}}, "quality": "{quality}"}}"#);
        let resolved = RenderRequest::from_json(request.as_bytes())
            .and_then(|request| request.resolve(volume.volume(), &volume.presets, &app.config.image.limits()))
            .map_err(|error| error.to_string())?;
        wanted.extend(ClassifiedKey::of(&resolved.look).filter(|made_from| !wanted.contains(made_from)));
    }
    let ticket = app.pool.own_work();
    for made_from in wanted {
        app.store.classified.warm_up(&ticket, volume, made_from).await.map_err(|error| error.to_string())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_come_from_names_and_modalities_from_the_files_beside_them() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in
            [("a.nii.gz", ""), ("a.json", "{\"modality\": \"MR\", \"more\": 1}"), ("b.nrrd", ""), ("x.txt", "")]
        {
            fs::write(folder.path().join(name), text).unwrap();
        }
        let entries = scan(Some(folder.path())).unwrap();
        let found: Vec<_> = entries.iter().map(|e| (e.id.as_str(), e.modality.as_deref())).collect();
        assert_eq!(found, [("a", Some("MR")), ("b", None)]);
    }

    #[test]
    fn two_files_with_one_id_end_the_start() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.nii", "a.mha"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let error = scan(Some(folder.path())).unwrap_err().to_string();
        assert!(error.contains("a.mha") && error.contains("a.nii") && error.contains("\"a\""), "{error}");
    }

    #[test]
    fn a_missing_folder_and_a_broken_sidecar_end_the_start() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(scan(Some(&folder.path().join("none"))), Err(ScanError::Folder { .. })));
        fs::write(folder.path().join("a.nii"), "").unwrap();
        fs::write(folder.path().join("a.json"), "{\"modality\": 3}").unwrap();
        assert!(matches!(scan(Some(folder.path())), Err(ScanError::Sidecar { .. })));
    }
}
