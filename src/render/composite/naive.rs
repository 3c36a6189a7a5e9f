//! The composite without runs, masks, links, buffers or bands: the standard for correctness checking.
//!
//! Every pixel gathers from its voxels in every slice anew, each looked up, shaded and weighted, and
//! tests for itself whether it is opaque. The kernel's pixels must be the same bit for bit.

use glam::Vec4;
use rayon::prelude::*;

use super::over;
use super::samples::{self, Position, VoxelRows, lerp};
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
            if !contains(&slice, f.dims, [u, v]) || !(f.clip.is_empty() || f.visible_pixels(v, k as f64).contains(&u)) {
                continue;
            }
            let (i, j) = (u - slice.first[0], v - slice.first[1]);
            let material = self.material.slice(f.is_outermost(k));
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

impl<T: Code, S: Slabs, C: Correction> Pixels for SlabComposite<'_, T, S, C> {
    fn pixel(&self, u: usize, v: usize) -> Vec4 {
        let f = self.factorization;
        let mut pixel = Vec4::ZERO;
        for n in 0..self.slabs() {
            let middle = samples::along(f, n as f64 + 0.5, self.steps);
            if !contains(&f.placement(middle), f.dims, [u, v])
                || !(f.clip.is_empty() || f.visible_pixels(v, middle).contains(&u))
            {
                continue;
            }
            let [front, back] = [n, n + 1].map(|n| {
                let position = Position::new(f, n, self.steps);
                let sample = sample(&self.voxels, f.dims, &position, u, v);
                sample.with_x(self.table.coordinate(sample.x))
            });
            let lit = self.voxels.is_lit();
            let mut sample = if lit { self.sample::<true>(front, back) } else { self.sample::<false>(front, back) };
            if let Some(cue) = self.cue {
                sample = (sample * (cue.slice(middle) * cue.along_v[v] * cue.along_u[u])).with_w(sample.w);
            }
            pixel = over(pixel, sample);
            if pixel.w >= self.opaque {
                break;
            }
        }
        pixel
    }
}

/// The sample at a pixel, slices being continued by their borders.
fn sample<T: Code>(voxels: &VoxelRows<'_, T>, dims: [usize; 3], position: &Position, u: usize, v: usize) -> Vec4 {
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
