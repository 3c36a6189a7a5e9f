//! A volume with the structures that depend on nothing else, built once when it is loaded.

use std::time::{Duration, Instant};

use super::gradient::quantized_normals;
use super::octree::MinMaxOctree;
use super::scanlines::{AnyScanlines, Scanlines, turned};
use super::{Scalars, Volume};

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
    /// The codes with y running fastest.
    turned: Scalars,
    normals: Vec<u16>,
    octree: MinMaxOctree,
    timings: PrepareTimings,
}

impl PreparedVolume {
    /// Builds the structures on the current rayon pool.
    pub fn build(volume: Volume) -> Self {
        let turned = turned(&volume);
        let start = Instant::now();
        let normals = quantized_normals(&volume);
        let gradients = start.elapsed();
        let octree = MinMaxOctree::build(&volume);
        let timings = PrepareTimings { gradients, octree: start.elapsed() - gradients };
        Self { volume, turned, normals, octree, timings }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// The codes as the principal axis `axis` (0: x, 1: y, 2: z) walks them.
    pub fn scanlines(&self, axis: usize) -> AnyScanlines<'_> {
        let dims = self.volume.dims();
        match if axis == 0 { &self.turned } else { self.volume.scalars() } {
            Scalars::U8(codes) => AnyScanlines::U8(Scanlines::new(codes, dims, axis)),
            Scalars::U16(codes) => AnyScanlines::U16(Scanlines::new(codes, dims, axis)),
        }
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
            ("volume", (self.volume.scalars().bytes() + self.turned.bytes()) as u64),
            ("gradients", size_of_val(&self.normals[..]) as u64),
            ("octree", self.octree.bytes()),
        ]
    }
}
