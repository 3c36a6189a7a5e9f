//! The composite without runs, masks, links, buffers or bands: the standard for correctness checking.
//!
//! Every pixel gathers from its voxels in every slice anew, each looked up, shaded and weighted, and
//! tests for itself whether it is opaque. The kernel's pixels must be the same bit for bit.

use glam::Vec4;
use rayon::prelude::*;

use super::float_slabs::FloatSlabs;
use super::footprint::Footprint;
use super::lattice::{Lattice, Scaled, Unit};
use super::samples::{Position, Quads, lerp};
use super::short_slabs::ShortSlabs;
use super::slabs::{SlabComposite, SlabSource};
use super::sources::VoxelSource;
use super::voxels::{VoxelLattice, Voxels, cut};
use crate::classify::preintegration::Slabs;
use crate::render::bands;
use crate::render::factorization::{Factorization, Halves, Holes, SlicePlacement};
use crate::render::intermediate::{BandBuffer, IntermediateImage};
use crate::render::material::{Shader, ShortShadow, SliceShader};
use crate::render::pixel::Pixel;
use crate::render::simd::shorts::Short;
use crate::render::slab::{Correction, opacity_ratio};
use crate::render::{Cancel, RenderError};
use crate::volume::gradient::Code;

/// A composite told pixel by pixel.
pub trait Pixels: Sync {
    /// What bands are composited in.
    type Pixel: Pixel;

    /// The ray of intermediate pixel (u, v).
    fn pixel(&self, u: usize, v: usize) -> Self::Pixel;
}

/// Composites all slices into `image`, as [`Composite::run`](super::Composite::run) does.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub fn run<C: Pixels>(pixels: &C, image: &mut IntermediateImage, cancel: &Cancel) -> Result<(), RenderError> {
    bands::middle_first(image.strips(1)).try_for_each_init(BandBuffer::<C::Pixel>::default, |buffer, strip| {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let mut band = strip.open(buffer);
        let v = band.first;
        for (u, pixel) in band.scanline(0).pixels.iter_mut().enumerate() {
            *pixel = pixels.pixel(u, v);
        }
        strip.close(buffer);
        Ok(())
    })
}

impl<P: Pixel, L: NaiveVoxels<P> + VoxelLattice<P>, V: VoxelSource, M: Shader<Slice: SliceShader<Pixel = P>>> Pixels
    for Voxels<'_, L, V, M>
{
    type Pixel = P;

    fn pixel(&self, u: usize, v: usize) -> P {
        let f = self.factorization;
        let limit = P::limit(self.opaque);
        let mut pixel = P::CLEAR;
        for step in 0..f.slices.len() {
            let k = if f.reversed { f.slices.end - 1 - step } else { f.slices.start + step };
            let Some(whole) = clipped(f, [u, v], f.interval(k)) else { continue };
            let Some(mut sample) = L::on_slice(f, k, [u, v], |i, j| self.color([i, j, k])) else { continue };
            let length = if L::LENGTHS { f.relative_length(u, v) } else { 1.0 };
            if M::Slice::PAINTED {
                sample = self.material.slice(f.share(k)).resampled(sample, length);
            } else if L::LENGTHS {
                sample = sample.times(opacity_ratio(sample.opacity(), length));
            }
            if !whole {
                let left: f32 = f.left(u, v, f.interval(k)).map(|[enter, leave]| leave - enter).sum();
                sample = cut(sample, Some(left));
            }
            if let Some(cue) = self.cue {
                sample = sample.faded(cue.slice(k as f64).scanline(v).at(u));
            }
            pixel = pixel.over(sample);
            if pixel.is_opaque(limit) {
                break;
            }
        }
        pixel
    }
}

impl<L: Lattice, V: VoxelSource, M: Shader> Voxels<'_, L, V, M> {
    /// The colour of a voxel, zero where it is transparent. Past the end, where the weight is zero, there
    /// is nothing.
    fn color(&self, at: [usize; 3]) -> <M::Slice as SliceShader>::Pixel {
        let material = self.material.slice(self.factorization.share(at[2]));
        match self.source.voxel(at).filter(|_| at[0] < self.factorization.dims[0]) {
            Some((voxel, factor)) => material.voxel(voxel, factor, at),
            None => Pixel::CLEAR,
        }
    }
}

/// Whether clipping leaves all of a pixel's ray between two slices; `None` where it leaves nothing.
fn clipped(f: &Factorization, [u, v]: [usize; 2], slices: [f64; 2]) -> Option<bool> {
    let planes = f.slice_planes(slices);
    let [mut some, mut whole] =
        f.clipped_pixels::<1>(v, &planes, Halves::ALL).map(|spans| spans.pixels(0, f.size[0]).contains(&u));
    f.hollow_pixels::<1>(v, &planes, Holes::ALL, |hollow| {
        let [touched, gone] = hollow.map(|spans| spans.pixels(0, f.size[0]).contains(&u));
        some &= !gone;
        whole &= !touched;
    });
    if let Some(limits) = f.limits() {
        let (seen, between) = (limits.at(u, v), slices.map(|k| f.position(k) as f32));
        some &= seen.meets(between) && !limits.holes(u, v).any(|hole| hole.holds(between));
        whole &= seen.holds(between) && !limits.holes(u, v).any(|hole| hole.meets(between));
    }
    some.then_some(whole)
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
    fn pixel(voxels: &dyn Quads, dims: [usize; 3], position: &Position<Self::Placement>, pixel: [usize; 2]) -> Vec4;
}

/// The same of single voxels.
pub trait NaiveVoxels<P>: Lattice {
    /// What is resampled at pixel (u, v) of slice `k` of voxels, which `voxel` gives by i and j; `None` where
    /// the pixel does not lie on the slice.
    fn on_slice(
        factorization: &Factorization,
        k: usize,
        pixel: [usize; 2],
        voxel: impl Fn(usize, usize) -> P,
    ) -> Option<P>;
}

/// What slabs are told by, for one pixel.
pub trait NaiveSlabs<L: Lattice>: SlabSource<L> {
    /// The sample at pixel (u, v), slices being continued by their borders.
    fn sample_at(
        &self,
        factorization: &Factorization,
        position: &Position<L::Placement>,
        pixel: [usize; 2],
    ) -> Self::Sample;
}

impl<L: NaiveLattice, S: Slabs, C: Correction> NaiveSlabs<L> for FloatSlabs<'_, S, C> {
    fn sample_at(&self, factorization: &Factorization, position: &Position<L::Placement>, pixel: [usize; 2]) -> Vec4 {
        let sample = L::pixel(self.voxels, factorization.dims, position, pixel);
        sample.with_x(self.table.coordinate(sample.x))
    }
}

impl<T: Code, D: ShortShadow> NaiveSlabs<Unit> for ShortSlabs<'_, T, D> {
    fn sample_at(&self, _: &Factorization, position: &Position<SlicePlacement>, pixel: [usize; 2]) -> Short {
        self.sample_at(position, pixel)
    }
}

impl<L: Lattice, Q: NaiveSlabs<L>> Pixels for SlabComposite<'_, L, Q> {
    type Pixel = Q::Pixel;

    fn pixel(&self, u: usize, v: usize) -> Q::Pixel {
        let f = self.factorization;
        let limit = Q::Pixel::limit(self.opaque);
        let mut pixel = Q::Pixel::CLEAR;
        for slab in &self.slabs {
            let Some(whole) = clipped(f, [u, v], slab.ends) else { continue };
            if !(slab.pixels.contains(&u) && slab.scanlines.contains(&v)) {
                continue;
            }
            let [front, back] = [&slab.front, &slab.back].map(|position| self.source.sample_at(f, position, [u, v]));
            let length = if L::LENGTHS { f.relative_length(u, v) * slab.share } else { 1.0 };
            let left = (!whole).then(|| f.left(u, v, slab.ends));
            let mut sample = self.source.slab(front, back, length, left);
            if let Some(cue) = slab.cue {
                sample = sample.faded(cue.scanline(v).at(u));
            }
            pixel = pixel.over(sample);
            if pixel.is_opaque(limit) {
                break;
            }
        }
        pixel
    }
}

impl NaiveLattice for Unit {
    fn pixel(voxels: &dyn Quads, dims: [usize; 3], position: &Position<SlicePlacement>, [u, v]: [usize; 2]) -> Vec4 {
        let SlicePlacement { first, fraction } = position.placement;
        let clamped = |at: usize, axis: usize| at.saturating_sub(first[axis]).min(dims[axis] - 1);
        let before = |at: usize, axis: usize| clamped(at, axis);
        let after = |at: usize, axis: usize| clamped(at + 1, axis);
        let on_slice = |k: usize| {
            let voxel = |i: usize, j: usize| voxels.sample([i, j, k]);
            let column = |i: usize| lerp(voxel(i, before(v, 1)), voxel(i, after(v, 1)), fraction[1]);
            lerp(column(before(u, 0)), column(after(u, 0)), fraction[0])
        };
        let near = on_slice(position.near);
        position.far.map_or(near, |(k, part)| lerp(near, on_slice(k), part))
    }
}

impl<P: Pixel> NaiveVoxels<P> for Unit {
    fn on_slice(
        factorization: &Factorization,
        k: usize,
        [u, v]: [usize; 2],
        voxel: impl Fn(usize, usize) -> P,
    ) -> Option<P> {
        let slice = factorization.slice(k);
        if !contains(&slice, factorization.dims, [u, v]) {
            return None;
        }
        let (i, j) = (u - slice.first[0], v - slice.first[1]);
        let row = |j: usize| [voxel(i, j), voxel(i + 1, j)];
        let weights = P::weights(slice.fraction);
        Some(if slice.fraction[1] > 0.0 {
            P::resample::<true>(&weights, row(j), row(j + 1))
        } else {
            P::resample::<false>(&weights, row(j), [P::CLEAR; 2])
        })
    }
}

impl NaiveLattice for Scaled {
    fn pixel(voxels: &dyn Quads, _: [usize; 3], position: &Position<[Footprint; 2]>, [u, v]: [usize; 2]) -> Vec4 {
        let on_slice = |k: usize| scaled(position.placement, [u, v], |i, j| voxels.sample([i, j, k]));
        let near = on_slice(position.near);
        position.far.map_or(near, |(k, part)| lerp(near, on_slice(k), part))
    }
}

impl NaiveVoxels<Vec4> for Scaled {
    fn on_slice(
        factorization: &Factorization,
        k: usize,
        [u, v]: [usize; 2],
        voxel: impl Fn(usize, usize) -> Vec4,
    ) -> Option<Vec4> {
        let placement = Self::placement(factorization, k as f64);
        let [us, vs] = Self::inside(factorization, &placement);
        (us.contains(&u) && vs.contains(&v)).then(|| scaled(placement, [u, v], voxel))
    }
}

/// The voxels under a pixel, weighted: scanlines first.
fn scaled([along_u, along_v]: [Footprint; 2], [u, v]: [usize; 2], voxel: impl Fn(usize, usize) -> Vec4) -> Vec4 {
    let under = |footprint: Footprint, at: usize| {
        let first = footprint.first(at);
        (first..first + footprint.taps()).map(move |voxel| (voxel, footprint.weight(at, voxel)))
    };
    let column = |i: usize| sum(under(along_v, v).map(|(j, weight)| voxel(i, j) * weight));
    sum(under(along_u, u).map(|(i, weight)| column(i) * weight))
}

/// The sum of one or more, from the first on.
fn sum(mut terms: impl Iterator<Item = Vec4>) -> Vec4 {
    let first = terms.next().expect("a voxel under every pixel");
    terms.fold(first, |sum, term| sum + term)
}
