//! A volume with the structures that depend on nothing else, built once when it is loaded.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use super::gradient::{GradientFrame, quantized_normals};
use super::octree::MinMaxOctree;
use super::scanlines::{AnyScanlines, Scanlines, turn, turned};
use super::{Scalars, Volume};

/// How long the structures took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PrepareTimings {
    /// The second copy of the codes.
    pub scanlines: Duration,
    pub octree: Duration,
    /// Normals and ranges of gradient magnitude; zero until they are asked for.
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
    /// Codes of the normals, as they are and with y running fastest, and how long they took.
    normals: OnceLock<([Vec<u16>; 2], Duration)>,
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
        Self { volume, turned, octree, gradient_octree: OnceLock::new(), normals: OnceLock::new(), timings }
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
        once(&self.gradient_octree, || self.octree.with_gradients(&self.volume, self.scanlines(2)))
    }

    /// Codes of the normals ([`super::gradient`]) as the principal axis `axis` walks them; found on the current rayon pool when first
    /// asked for.
    pub fn normals(&self, axis: usize) -> Scanlines<'_, u16> {
        let dims @ [nx, ny, _] = self.volume.dims();
        let [normals, turned] = once(&self.normals, || {
            let frame = GradientFrame::new(self.volume.placement(), self.volume.rescale().0);
            let normals = match self.scanlines(2) {
                AnyScanlines::U8(scanlines) => quantized_normals(scanlines, &frame),
                AnyScanlines::U16(scanlines) => quantized_normals(scanlines, &frame),
            };
            let turned = turn(&normals, nx, ny);
            [normals, turned]
        });
        Scanlines::new(if axis == 0 { turned } else { normals }, dims, axis)
    }

    /// How long the structures took.
    pub fn timings(&self) -> PrepareTimings {
        let octree = self.gradient_octree.get().map(|(_, took)| *took);
        let normals = self.normals.get().map(|(_, took)| *took);
        PrepareTimings { gradients: octree.into_iter().chain(normals).sum(), ..self.timings }
    }

    /// Bytes in memory, by structure: `volume` (with the second copy), `octree`, `gradients`.
    pub fn bytes(&self) -> [(&'static str, u64); 3] {
        let ranges = self.gradient_octree.get().map_or(0, |(octree, _)| octree.bytes());
        let normals =
            self.normals.get().map_or(0, |(both, _)| both.iter().map(|normals| size_of_val(&normals[..]) as u64).sum());
        let colors = self.volume.colors().map_or(0, |colors| size_of_val(&colors.voxels[..]));
        [
            ("volume", (self.volume.scalars().bytes() + self.turned.bytes() + colors) as u64),
            ("octree", self.octree.bytes()),
            ("gradients", ranges + normals),
        ]
    }
}

/// What `cell` holds, found first where nobody has; with how long that took.
fn once<T>(cell: &OnceLock<(T, Duration)>, find: impl FnOnce() -> T) -> &T {
    let there = || cell.get().map(|(found, _)| found);
    // Found outside the lock: who waited for it here could be stealing work from who holds it.
    there().unwrap_or_else(|| {
        let start = Instant::now();
        let found = find();
        let _the_first_one_stays = cell.set((found, start.elapsed()));
        there().expect("it was just set")
    })
}

fn scanlines_of(codes: &Scalars, dims: [usize; 3], axis: usize) -> AnyScanlines<'_> {
    match codes {
        Scalars::U8(codes) => AnyScanlines::U8(Scanlines::new(codes, dims, axis)),
        Scalars::U16(codes) => AnyScanlines::U16(Scanlines::new(codes, dims, axis)),
    }
}
