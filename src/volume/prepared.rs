//! A volume with the structures that depend on nothing else, built once when it is loaded.

use std::time::{Duration, Instant};

use super::Volume;
use super::gradient::quantized_normals;
use super::octree::MinMaxOctree;

/// How long the structures took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PrepareTimings {
    pub gradients: Duration,
    pub octree: Duration,
}

/// A volume, its quantized normals and its min-max octree.
#[derive(Clone, Debug)]
pub struct PreparedVolume {
    volume: Volume,
    normals: Vec<u16>,
    octree: MinMaxOctree,
    timings: PrepareTimings,
}

impl PreparedVolume {
    /// Builds the structures on the current rayon pool.
    pub fn build(volume: Volume) -> Self {
        let start = Instant::now();
        let normals = quantized_normals(&volume);
        let gradients = start.elapsed();
        let octree = MinMaxOctree::build(&volume);
        let timings = PrepareTimings { gradients, octree: start.elapsed() - gradients };
        Self { volume, normals, octree, timings }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// Codes of the normals ([`super::gradient`]), `i` fastest.
    pub fn normals(&self) -> &[u16] {
        &self.normals
    }

    /// Ranges of scalar and gradient magnitude.
    pub fn octree(&self) -> &MinMaxOctree {
        &self.octree
    }

    /// How long the structures took.
    pub fn timings(&self) -> PrepareTimings {
        self.timings
    }

    /// Bytes in memory, by structure: `volume`, `gradients`, `octree`.
    pub fn bytes(&self) -> [(&'static str, u64); 3] {
        [
            ("volume", self.volume.scalars().bytes() as u64),
            ("gradients", size_of_val(&self.normals[..]) as u64),
            ("octree", self.octree.bytes()),
        ]
    }
}
