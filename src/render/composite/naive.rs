//! The composite without runs, masks, links, buffers or bands: the standard for correctness checking.
//!
//! Every pixel gathers from its voxels in every slice anew, each looked up, shaded and weighted, and
//! tests for itself whether it is opaque. The kernel's pixels must be the same bit for bit.

use glam::Vec4;
use rayon::prelude::*;

use super::footprint::Footprint;
use super::lattice::{Lattice, Scaled, Unit};
use super::over;
use super::samples::{Position, VoxelRows, lerp};
use super::slabs::SlabComposite;
use super::sources::VoxelSource;
use super::voxels::{Voxels, Weights};
use crate::classify::preintegration::Slabs;
use crate::render::factorization::SlicePlacement;
use crate::render::intermediate::IntermediateImage;
use crate::render::slab::Correction;
use crate::render::{Cancel, RenderError};
use crate::volume::gradient::Code;

/// A composite told pixel by pixel.
pub trait Pixels: Sync {
    /// The ray of intermediate pixel (u, v).
    fn pixel(&self, u: usize, v: usize) -> Vec4;
}

/// Composites all slices into `image`, as [`Composite::run`](super::Composite::run) does.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub fn run(pixels: &impl Pixels, image: &mut IntermediateImage, cancel: &Cancel) -> Result<(), RenderError> {
    image.bands(1).try_for_each(|mut band| {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let v = band.first;
        for (u, pixel) in band.scanline(0).pixels.iter_mut().enumerate() {
            *pixel = pixels.pixel(u, v);
        }
        Ok(())
    })
}

impl<V: VoxelSource, const LIT: bool, const FACTORED: bool> Pixels for Voxels<'_, V, LIT, FACTORED> {
    fn pixel(&self, u: usize, v: usize) -> Vec4 {
        let f = self.factorization;
        let mut pixel = Vec4::ZERO;
        for step in 0..f.dims[2] {
            let k = if f.reversed { f.dims[2] - 1 - step } else { step };
            let slice = f.slice(k);
            if !contains(&slice, f.dims, [u, v]) || f.is_clipped() && !f.visible_pixels(v, k as f64).contains(&u) {
                continue;
            }
            let (i, j) = (u - slice.first[0], v - slice.first[1]);
            let material = self.material.slice(f.share(k));
            // Past the end, where the weight is zero, there is nothing.
            let voxel = |i: usize, j: usize| match self.source.voxel([i, j, k]).filter(|_| i < f.dims[0]) {
                Some((voxel, factor)) => material.color(voxel, factor),
                None => Vec4::ZERO,
            };
            let row = |j: usize| [voxel(i, j), voxel(i + 1, j)];
            let weights = Weights::new(slice.fraction[0], slice.fraction[1]);
            let mut sample = if slice.fraction[1] > 0.0 {
                weights.sample::<true>(row(j), row(j + 1))
            } else {
                weights.sample::<false>(row(j), [Vec4::ZERO; 2])
            };
            if let Some(cue) = self.cue {
                sample = (sample * (cue.slice(k as f64) * cue.along_v[v] * cue.along_u[u])).with_w(sample.w);
            }
            pixel = over(pixel, sample);
            if pixel.w >= self.opaque {
                break;
            }
        }
        pixel
    }
}

/// True where a pixel lies on a slice.
fn contains(slice: &SlicePlacement, dims: [usize; 3], pixel: [usize; 2]) -> bool {
    (0..2).all(|axis| {
        let between = usize::from(slice.fraction[axis] > 0.0);
        pixel[axis] >= slice.first[axis] && pixel[axis] - slice.first[axis] + between < dims[axis]
    })
}

/// A lattice's way to sample, told for one pixel.
pub trait NaiveLattice: Lattice {
    /// The sample at pixel (u, v), slices being continued by their borders.
    fn pixel<T: Code>(
        voxels: &VoxelRows<'_, T>,
        dims: [usize; 3],
        position: &Position<Self::Placement>,
        pixel: [usize; 2],
    ) -> Vec4;
}

impl<L: NaiveLattice, T: Code, S: Slabs, C: Correction> Pixels for SlabComposite<'_, L, T, S, C> {
    fn pixel(&self, u: usize, v: usize) -> Vec4 {
        let f = self.factorization;
        let mut pixel = Vec4::ZERO;
        for n in self.slabs() {
            let slab = self.place(n);
            let inside = slab.pixels.contains(&u) && slab.scanlines.contains(&v);
            if !inside || f.is_clipped() && !f.visible_pixels(v, slab.middle).contains(&u) {
                continue;
            }
            let [front, back] = [&slab.front, &slab.back].map(|position| {
                let sample = L::pixel(&self.voxels, f.dims, position, [u, v]);
                sample.with_x(self.table.coordinate(sample.x))
            });
            let length = if L::LENGTHS { f.relative_length(u, v) * slab.share } else { 1.0 };
            let mut sample = if self.voxels.is_lit() {
                self.sample::<true>(front, back, length)
            } else {
                self.sample::<false>(front, back, length)
            };
            if let Some(cue) = self.cue {
                sample = (sample * (slab.cue * cue.along_v[v] * cue.along_u[u])).with_w(sample.w);
            }
            pixel = over(pixel, sample);
            if pixel.w >= self.opaque {
                break;
            }
        }
        pixel
    }
}

impl NaiveLattice for Unit {
    fn pixel<T: Code>(
        voxels: &VoxelRows<'_, T>,
        dims: [usize; 3],
        position: &Position<SlicePlacement>,
        [u, v]: [usize; 2],
    ) -> Vec4 {
        let SlicePlacement { first, fraction } = position.placement;
        let clamped = |at: usize, axis: usize| at.saturating_sub(first[axis]).min(dims[axis] - 1);
        let before = |at: usize, axis: usize| clamped(at, axis);
        let after = |at: usize, axis: usize| clamped(at + 1, axis);
        let on_slice = |k: usize| {
            let voxel = |i: usize, j: usize| voxels.block(j, k, i)[0];
            let column = |i: usize| lerp(voxel(i, before(v, 1)), voxel(i, after(v, 1)), fraction[1]);
            lerp(column(before(u, 0)), column(after(u, 0)), fraction[0])
        };
        let near = on_slice(position.near);
        position.far.map_or(near, |(k, part)| lerp(near, on_slice(k), part))
    }
}

impl NaiveLattice for Scaled {
    fn pixel<T: Code>(
        voxels: &VoxelRows<'_, T>,
        _: [usize; 3],
        position: &Position<[Footprint; 2]>,
        [u, v]: [usize; 2],
    ) -> Vec4 {
        let [along_u, along_v] = position.placement;
        let under = |footprint: Footprint, at: usize| {
            let first = footprint.first(at);
            (first..first + footprint.taps()).map(move |voxel| (voxel, footprint.weight(at, voxel)))
        };
        let on_slice = |k: usize| {
            let column = |i: usize| sum(under(along_v, v).map(|(j, weight)| voxels.block(j, k, i)[0] * weight));
            sum(under(along_u, u).map(|(i, weight)| column(i) * weight))
        };
        let near = on_slice(position.near);
        position.far.map_or(near, |(k, part)| lerp(near, on_slice(k), part))
    }
}

/// The sum of one or more, from the first on.
fn sum(mut terms: impl Iterator<Item = Vec4>) -> Vec4 {
    let first = terms.next().expect("a voxel under every pixel");
    terms.fold(first, |sum, term| sum + term)
}
