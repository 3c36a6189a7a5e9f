//! A volume with the structures that depend on nothing else, built once when it is loaded.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use super::octree::MinMaxOctree;
use super::scanlines::{AnyScanlines, Scanlines, turned};
use super::{Scalars, Volume};

/// How long the structures took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PrepareTimings {
    /// The second copy of the codes.
    pub scanlines: Duration,
    pub octree: Duration,
    /// Ranges of gradient magnitude; zero until a transfer function asks for them.
    pub gradients: Duration,
}

/// A volume, its scanlines for every principal axis and its min-max octree.
#[derive(Clone, Debug)]
pub struct PreparedVolume {
    volume: Volume,
    /// The codes with y running fastest.
    turned: Scalars,
    octree: MinMaxOctree,
    /// The octree with ranges of gradient magnitude, and how long those took.
    gradient_octree: OnceLock<(MinMaxOctree, Duration)>,
    timings: PrepareTimings,
}

impl PreparedVolume {
    /// Builds the structures on the current rayon pool.
    pub fn build(volume: Volume) -> Self {
        let start = Instant::now();
        let turned = turned(&volume);
        let scanlines = start.elapsed();
        let octree = MinMaxOctree::of_scalars(scanlines_of(volume.scalars(), volume.dims(), 2));
        let timings = PrepareTimings { scanlines, octree: start.elapsed() - scanlines, gradients: Duration::ZERO };
        Self { volume, turned, octree, gradient_octree: OnceLock::new(), timings }
    }

    /// What was measured.
    pub fn volume(&self) -> &Volume {
        &self.volume
    }

    /// The codes as the principal axis `axis` (0: x, 1: y, 2: z) walks them.
    pub fn scanlines(&self, axis: usize) -> AnyScanlines<'_> {
        let codes = if axis == 0 { &self.turned } else { self.volume.scalars() };
        scanlines_of(codes, self.volume.dims(), axis)
    }

    /// Ranges of scalar; those of gradient magnitude are unknown.
    pub fn octree(&self) -> &MinMaxOctree {
        &self.octree
    }

    /// Ranges of scalar and gradient magnitude, the latter found on the current rayon pool when first
    /// asked for.
    pub fn gradient_octree(&self) -> &MinMaxOctree {
        let there = || self.gradient_octree.get().map(|(octree, _)| octree);
        // Found outside the lock: who waited for it here could be stealing work from who holds it.
        there().unwrap_or_else(|| {
            let start = Instant::now();
            let octree = self.octree.with_gradients(&self.volume, self.scanlines(2));
            let _the_first_one_stays = self.gradient_octree.set((octree, start.elapsed()));
            there().expect("it was just set")
        })
    }

    /// How long the structures took.
    pub fn timings(&self) -> PrepareTimings {
        let gradients = self.gradient_octree.get().map_or(Duration::ZERO, |(_, took)| *took);
        PrepareTimings { gradients, ..self.timings }
    }

    /// Bytes in memory, by structure: `volume`, `scanlines` (the second copy), `octree`, `gradients`.
    pub fn bytes(&self) -> [(&'static str, u64); 4] {
        [
            ("volume", self.volume.scalars().bytes() as u64),
            ("scanlines", self.turned.bytes() as u64),
            ("octree", self.octree.bytes()),
            ("gradients", self.gradient_octree.get().map_or(0, |(octree, _)| octree.bytes())),
        ]
    }
}

fn scanlines_of(codes: &Scalars, dims: [usize; 3], axis: usize) -> AnyScanlines<'_> {
    match codes {
        Scalars::U8(codes) => AnyScanlines::U8(Scanlines::new(codes, dims, axis)),
        Scalars::U16(codes) => AnyScanlines::U16(Scanlines::new(codes, dims, axis)),
    }
}
