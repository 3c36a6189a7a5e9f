//! The volumes that are served.
//!
//! A volume is loaded once and stays; what is classified of it comes and goes ([`ClassifiedCache`]).

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use xxhash_rust::xxh3::Xxh3;

use super::classified::ClassifiedCache;
use super::error::Problem;
use crate::classify::presets::FittedPresets;
use crate::volume::histogram::Histogram;
use crate::volume::{PreparedVolume, Scalars, Volume, pyramid};

/// Where a volume comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// The built-in head.
    Demo,
    File(PathBuf),
}

/// A volume that was configured, loaded or not.
#[derive(Debug)]
pub struct Entry {
    /// What requests call it.
    pub id: String,
    /// What people call it.
    pub name: String,
    pub source: Source,
    /// As the operator wrote it (CT, MR, ...).
    pub modality: Option<String>,
    state: OnceLock<Result<Arc<LoadedVolume>, String>>,
}

/// Whether a volume can be rendered.
#[derive(Clone, Debug)]
pub enum Status {
    Loading,
    Ready(Arc<LoadedVolume>),
    /// With the reason.
    Failed(String),
}

impl Entry {
    /// A volume that is yet to be loaded.
    pub fn new(id: String, name: String, source: Source, modality: Option<String>) -> Self {
        Self { id, name, source, modality, state: OnceLock::new() }
    }

    /// Whether it can be rendered.
    pub fn status(&self) -> Status {
        match self.state.get() {
            None => Status::Loading,
            Some(Ok(loaded)) => Status::Ready(Arc::clone(loaded)),
            Some(Err(reason)) => Status::Failed(reason.clone()),
        }
    }

    /// Ends the loading; only the first end counts.
    pub fn settle(&self, outcome: Result<Arc<LoadedVolume>, String>) {
        let _ = self.state.set(outcome);
    }
}

/// A volume in memory with all that is known about it before anybody asks.
#[derive(Debug)]
pub struct LoadedVolume {
    /// The pyramid, from the volume itself on.
    levels: Vec<PreparedVolume>,
    pub histogram: Histogram,
    pub presets: FittedPresets,
    /// Names the content: voxels, rescale and placement.
    pub fingerprint: u128,
}

impl LoadedVolume {
    /// Builds the structures on the current rayon pool.
    pub fn build(volume: Volume, modality: Option<&str>) -> Self {
        let fingerprint = fingerprint(&volume);
        let histogram = Histogram::of(&volume);
        let presets = FittedPresets::of(&volume, modality);
        let count = pyramid::levels(volume.dims());
        let finer_first = std::iter::successors(Some(volume), |finer| Some(pyramid::coarser(finer)));
        let levels: Vec<_> = finer_first.take(count).map(PreparedVolume::build).collect();
        // Made when asked for; no frame shall wait for them.
        for level in &levels {
            level.normals(2);
        }
        Self { levels, histogram, presets, fingerprint }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        self.levels[0].volume()
    }

    /// A level of the pyramid, one of [`pyramid::levels`].
    pub fn level(&self, level: usize) -> &PreparedVolume {
        &self.levels[level]
    }

    /// Bytes in memory, by structure.
    pub fn bytes(&self) -> impl Iterator<Item = (&'static str, u64)> {
        let coarser = self.levels[1..].iter().flat_map(PreparedVolume::bytes).map(|(_, bytes)| bytes).sum();
        self.levels[0].bytes().into_iter().chain([("pyramid", coarser), ("histogram", self.histogram.bytes())])
    }
}

/// Names a volume by content, so that a file replaced under the same name is another volume to
/// every cache: ours, on disk, and the clients'.
fn fingerprint(volume: &Volume) -> u128 {
    let mut hash = Xxh3::new();
    for n in volume.dims() {
        hash.update(&(n as u64).to_le_bytes());
    }
    let placement = volume.placement();
    let (slope, intercept) = volume.rescale();
    let numbers = placement.spacing.to_array().into_iter().chain(placement.direction.to_cols_array());
    for number in numbers.chain(placement.origin.to_array()).chain([slope, intercept]) {
        hash.update(&number.to_le_bytes());
    }
    match volume.scalars() {
        Scalars::U8(codes) => {
            hash.update(&[1]);
            hash.update(codes);
        }
        Scalars::U16(codes) => {
            hash.update(&[2]);
            hash.update(bytemuck::cast_slice(codes));
        }
    }
    if let Some(colors) = volume.colors() {
        hash.update(&[volume.components()]);
        hash.update(colors.voxels.as_flattened());
    }
    hash.digest128()
}

/// Volumes by id, and what was classified of them.
#[derive(Debug)]
pub struct Store {
    entries: BTreeMap<String, Arc<Entry>>,
    pub classified: ClassifiedCache,
    retry_after: u64,
}

impl Store {
    /// A store of these volumes, none of them loaded.
    pub fn new(entries: Vec<Entry>, classified: ClassifiedCache, retry_after: u64) -> Self {
        let entries = entries.into_iter().map(|entry| (entry.id.clone(), Arc::new(entry))).collect();
        Self { entries, classified, retry_after }
    }

    /// Every volume, by id.
    pub fn entries(&self) -> impl Iterator<Item = &Arc<Entry>> {
        self.entries.values()
    }

    /// The volume of this id.
    ///
    /// # Errors
    /// 404 where there is none.
    pub fn entry(&self, id: &str) -> Result<&Arc<Entry>, Problem> {
        self.entries.get(id).ok_or_else(|| Problem::NoSuchVolume(id.to_owned()))
    }

    /// The volume of this id, in memory.
    ///
    /// # Errors
    /// 404 where there is none, 503 while it is loaded, 409 where it could not be.
    pub fn loaded(&self, id: &str) -> Result<Arc<LoadedVolume>, Problem> {
        match self.entry(id)?.status() {
            Status::Ready(volume) => Ok(volume),
            Status::Loading => Err(Problem::Loading { id: id.to_owned(), retry_after: self.retry_after }),
            Status::Failed(detail) => Err(Problem::VolumeFailed { id: id.to_owned(), detail }),
        }
    }

    /// Volumes (ready, loading, failed).
    pub fn counts(&self) -> (usize, usize, usize) {
        self.entries().fold((0, 0, 0), |(ready, loading, failed), entry| match entry.status() {
            Status::Ready(_) => (ready + 1, loading, failed),
            Status::Loading => (ready, loading + 1, failed),
            Status::Failed(_) => (ready, loading, failed + 1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::phantom;

    #[test]
    fn a_volume_is_named_by_its_content() {
        let ball = |radius, spacing| LoadedVolume::build(phantom::ball(24, radius, 200.0, spacing), None).fingerprint;
        assert_eq!(ball(8.0, 1.0), ball(8.0, 1.0));
        assert_ne!(ball(8.0, 1.0), ball(7.0, 1.0));
        assert_ne!(ball(8.0, 1.0), ball(8.0, 2.0));
    }

    #[test]
    fn the_pyramid_is_counted() {
        let loaded = LoadedVolume::build(phantom::ball(24, 8.0, 200.0, 1.0), None);
        assert_eq!(loaded.level(1).volume().dims(), [12; 3]);
        let bytes: BTreeMap<_, _> = loaded.bytes().collect();
        assert!(bytes["pyramid"] >= 12 * 12 * 12 && bytes["pyramid"] < bytes["volume"], "{bytes:?}");
    }
}
