//! The kernel of single voxels: each slice's voxels, shaded and resampled, "over" what is in front.
//!
//! For a scanline of a slice:
//!
//! 1. *Which pixels?* A pixel needs work if it touches a voxel of a run and is not opaque itself. That is a shift and an
//!    intersection of machine words for each run of the two voxel scanlines that the pixels gather from (`touched.rs`);
//!    scanlines without a run are not even looked at.
//! 2. *Shade* the voxels those pixels touch into a row buffer, each once: the lower scanline of
//!    one pixel row is the upper one of the next (`rows.rs`).
//! 3. *Resample and blend*: four weights that are constant over the slice, then "over", and an
//!    opaque pixel's bit is cleared.

use glam::Vec4;

use super::clipped::ClippedPixels;
use super::cue::{Cue, ScanlineCue};
use super::lattice::{Lattice, Unit};
use super::rows::RowBuffers;
use super::sources::VoxelSource;
use super::touched::{Open, Touched};
use super::{BAND_HEIGHT, CANCEL_STEP, Composite, WORD, over, run_mask};
use crate::render::factorization::Factorization;
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::material::{Light, Material, SliceMaterial};
use crate::render::slab::opacity_ratio;
use crate::render::{Cancel, RenderError};

/// Where scanlines are is asked for so many slices before they are read.
const FARTHER: usize = 8;

/// Of which slices memory is asked for while slice `k` is walked: the next one's scanlines, and where those of a farther one are, which
/// may be none; `None` behind the last.
#[inline(always)]
pub(super) fn slices_ahead(factorization: &Factorization, k: usize) -> Option<[usize; 2]> {
    let [ahead, farther] = match factorization.reversed {
        true => [k.wrapping_sub(1), k.wrapping_sub(FARTHER)],
        false => [k + 1, k + FARTHER],
    };
    factorization.slices.contains(&ahead).then_some([ahead, farther])
}

/// What the bands of a frame share.
#[derive(Debug)]
pub struct Voxels<'a, L: Lattice, V, H, const FACTORED: bool> {
    pub lattice: L,
    pub source: V,
    pub factorization: &'a Factorization,
    /// Where slices lie, from the first one of the factorization's on.
    pub placements: Vec<L::Placement>,
    pub material: Material<'a, H, FACTORED>,
    /// `None`: nothing fades.
    pub cue: Option<&'a Cue>,
    /// Accumulated opacity at which a pixel is done.
    pub opaque: f32,
    pub cancel: &'a Cancel,
}

/// A lattice over slices of single voxels.
pub trait VoxelLattice: Lattice {
    /// Row buffers and masks of a thread.
    type Scratch: Send;

    /// Scratch for a part of a view.
    fn scratch(factorization: &Factorization) -> Self::Scratch;

    /// What a band's slices share. Called before the first.
    fn enter_band(factorization: &Factorization, band: &Band<'_>, scratch: &mut Self::Scratch);

    /// One slice into one band. Implementations are `#[inline(always)]`.
    fn slice<V: VoxelSource, H: Light, const FACTORED: bool>(
        voxels: &Voxels<'_, Self, V, H, FACTORED>,
        band: &mut Band<'_>,
        k: usize,
        scratch: &mut Self::Scratch,
    );
}

impl<L: VoxelLattice, V: VoxelSource, H: Light, const FACTORED: bool> Composite for Voxels<'_, L, V, H, FACTORED> {
    type Scratch = L::Scratch;

    fn scratch(&self, _: usize) -> Self::Scratch {
        L::scratch(self.factorization)
    }

    #[inline(always)]
    fn band(&self, band: &mut Band<'_>, scratch: &mut Self::Scratch) -> Result<(), RenderError> {
        L::enter_band(self.factorization, band, scratch);
        let slices = self.factorization.slices.clone();
        for step in 0..slices.len() {
            if step % CANCEL_STEP == 0 && self.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let k = if self.factorization.reversed { slices.end - 1 - step } else { slices.start + step };
            L::slice(self, band, k, scratch);
        }
        Ok(())
    }
}

impl VoxelLattice for Unit {
    type Scratch = (RowBuffers, Touched, ClippedPixels);

    fn scratch(factorization: &Factorization) -> Self::Scratch {
        (RowBuffers::new(factorization.dims[0]), Touched::new(factorization.size[0]), ClippedPixels::default())
    }

    #[inline(always)]
    fn enter_band(_: &Factorization, band: &Band<'_>, (_, _, clipped): &mut Self::Scratch) {
        clipped.enter_band(band);
    }

    #[inline(always)]
    fn slice<V: VoxelSource, H: Light, const FACTORED: bool>(
        voxels: &Voxels<'_, Self, V, H, FACTORED>,
        band: &mut Band<'_>,
        k: usize,
        scratch: &mut Self::Scratch,
    ) {
        voxels.slice(band, k, scratch);
    }
}

impl<V: VoxelSource, H: Light, const FACTORED: bool> Voxels<'_, Unit, V, H, FACTORED> {
    /// One slice into one band.
    #[inline(always)]
    fn slice(&self, band: &mut Band<'_>, k: usize, (rows, touched, clipped): &mut <Unit as VoxelLattice>::Scratch) {
        const { assert!(BAND_HEIGHT < WORD, "a word has a bit for each scanline under a band") }
        let f = self.factorization;
        let placement = self.placements[k - f.slices.start];
        let [first_u, first_v] = placement.first;
        let [fraction_u, fraction_v] = placement.fraction;
        // Pixels between the slice's first and last voxel scanline: nothing lies outside the box.
        let has_lower = fraction_v > 0.0;
        let end_v = (first_v + f.dims[1] - usize::from(has_lower)).min(band.first + band.height());
        let start_v = first_v.max(band.first);
        if start_v >= end_v {
            return;
        }
        let (start_j, count) = (start_v - first_v, end_v - start_v);
        let shown = self.source.shown(start_j, count + usize::from(has_lower), k);
        let mut under = if has_lower { (shown | shown >> 1) & run_mask(0, count) } else { shown };
        if under == 0 {
            return;
        }
        let slices = f.interval(k);
        if !clipped.enter(f, start_v..end_v, slices) {
            return;
        }
        let material = self.material.slice(f.share(k));
        let weights = Weights::new(fraction_u, fraction_v);
        let cue = self.cue.map(|cue| cue.slice(k as f64));
        let ahead = slices_ahead(f, k);
        rows.next_slice();
        let mut below = None;
        while under != 0 {
            let at = under.trailing_zeros() as usize;
            under &= under - 1;
            let (v, j) = (start_v + at, start_j + at);
            if let Some([_, farther]) = ahead {
                self.source.prefetch_place(j, farther);
            }
            let mut scanline = band.scanline(v - band.first);
            clipped.enter_scanline(f, v, slices, scanline.non_opaque);
            let upper = match below {
                Some((at, scanline)) if at == j => scanline,
                _ => self.source.scanline(j, k),
            };
            let lower = if has_lower { Some(self.source.scanline(j + 1, k)) } else { None };
            let mut open =
                Open { words: scanline.non_opaque, first: first_u, between: fraction_u > 0.0, length: f.dims[0] };
            below = lower.map(|lower| (j + 1, lower));
            if clipped.is_any() {
                let touches = self.source.touches(&upper, &open)
                    || lower.as_ref().is_some_and(|lower| self.source.touches(lower, &open));
                if !touches || !clipped.find(f, v, slices, scanline.non_opaque) {
                    continue;
                }
                open.words = clipped.open();
            }
            rows.go_on(j);
            self.source.touch(&upper, &open, touched, (rows.upper(), [j, k]), material);
            if let Some(lower) = &lower {
                self.source.touch(lower, &open, touched, (rows.lower(), [j + 1, k]), material);
            }
            if touched.is_empty() {
                continue;
            }
            if let Some([ahead, _]) = ahead {
                self.source.prefetch(j, ahead);
            }
            let cue = cue.map(|cue| cue.scanline(v));
            let at = Place { v, k, cue, clipped };
            let around = Around { rows: rows.voxels(j, has_lower), first_u, weights: &weights };
            self.blend(&mut scanline, &at, (&around, has_lower), touched, material);
        }
    }

    /// Resamples the row buffers at the touched pixels and blends behind what is there.
    #[inline(always)]
    fn blend(
        &self,
        scanline: &mut ScanlineMut<'_>,
        &Place { v, k, cue, clipped }: &Place<'_>,
        (around, has_lower): (&Around<'_>, bool),
        touched: &mut Touched,
        material: SliceMaterial<'_, H, FACTORED>,
    ) {
        let finish = |sample| material.resampled(sample, 1.0);
        let cued = |u, sample: Vec4| match cue {
            Some(cue) => (sample * cue.at(u)).with_w(sample.w),
            None => sample,
        };
        let left = |u, sample| {
            let left = self.left(u, v, k, clipped);
            cued(u, cut(sample, left))
        };
        let opaque = self.opaque;
        let is_cut = clipped.is_any() && clipped.cuts_any();
        match (has_lower, cue) {
            (true, _) if is_cut => {
                blend_clipped::<true>(scanline, touched, around, |u, sample| left(u, finish(sample)), opaque);
            }
            (false, _) if is_cut => {
                blend_clipped::<false>(scanline, touched, around, |u, sample| left(u, finish(sample)), opaque);
            }
            (true, None) => blend::<true>(scanline, touched, around, |_, sample| finish(sample), opaque),
            (false, None) => blend::<false>(scanline, touched, around, |_, sample| finish(sample), opaque),
            (true, Some(_)) => blend::<true>(scanline, touched, around, |u, sample| cued(u, finish(sample)), opaque),
            (false, Some(_)) => blend::<false>(scanline, touched, around, |u, sample| cued(u, finish(sample)), opaque),
        }
    }
}

impl<L: Lattice, V, H, const FACTORED: bool> Voxels<'_, L, V, H, FACTORED> {
    /// The share of slice `k` that clipping leaves of pixel (u, v), where that is not all.
    #[inline(always)]
    pub(super) fn left(&self, u: usize, v: usize, k: usize, clipped: &ClippedPixels) -> Option<f32> {
        if clipped.is_cut(u) { Some(share(self.factorization, [u, v], k)) } else { None }
    }
}

/// The share of slice `k` that clipping leaves of a pixel.
#[inline(never)]
fn share(factorization: &Factorization, [u, v]: [usize; 2], k: usize) -> f32 {
    factorization.left(u, v, factorization.interval(k)).map(|[enter, leave]| leave - enter).sum()
}

/// A scanline of pixels on a slice.
struct Place<'a> {
    v: usize,
    k: usize,
    cue: Option<ScanlineCue<'a>>,
    /// Where the view clips.
    clipped: &'a ClippedPixels,
}

/// A sample of which a share is left.
#[inline(always)]
pub(super) fn cut(sample: Vec4, left: Option<f32>) -> Vec4 {
    match left {
        None => sample,
        Some(left) if left > 0.0 => sample * opacity_ratio(sample.w, left),
        Some(_) => Vec4::ZERO,
    }
}

/// Bilinear weights of the four voxels around a pixel, the same for all of a slice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights {
    upper: [f32; 2],
    lower: [f32; 2],
}

impl Weights {
    #[inline(always)]
    pub(super) fn new(fraction_u: f32, fraction_v: f32) -> Self {
        let along = [1.0 - fraction_u, fraction_u];
        Self { upper: along.map(|w| w * (1.0 - fraction_v)), lower: along.map(|w| w * fraction_v) }
    }

    /// The resampled value between two voxels of the upper and two of the lower scanline.
    #[inline(always)]
    pub(super) fn sample<const LOWER: bool>(&self, upper: [Vec4; 2], lower: [Vec4; 2]) -> Vec4 {
        let above = upper[0] * self.upper[0] + upper[1] * self.upper[1];
        if LOWER { above + (lower[0] * self.lower[0] + lower[1] * self.lower[1]) } else { above }
    }
}

/// The voxels around the pixels of a scanline.
struct Around<'a> {
    /// Upper and lower.
    rows: [&'a [Vec4]; 2],
    /// The pixel on voxel 0 or after it.
    first_u: usize,
    weights: &'a Weights,
}

/// Blends the touched pixels; `finish` makes what is blended of a sample at pixel u. Pixels that become opaque are no longer open.
#[inline(always)]
fn blend<const LOWER: bool>(
    scanline: &mut ScanlineMut<'_>,
    touched: &mut Touched,
    &Around { rows: [upper, lower], first_u, weights }: &Around<'_>,
    finish: impl Fn(usize, Vec4) -> Vec4,
    opaque: f32,
) {
    // Pixels on voxels or after them, and both voxels of each: one length bounds all.
    let pixels = &mut scanline.pixels[first_u..];
    let length = pixels.len().min(upper.len() - 1).min(lower.len() - 1);
    let pixels = &mut pixels[..length];
    let [upper, upper_next] = [&upper[..length], &upper[1..=length]];
    let [lower, lower_next] = [&lower[..length], &lower[1..=length]];
    let (weights, opaque) = (*weights, Vec4::splat(opaque));
    let non_opaque = &mut *scanline.non_opaque;
    touched.take(|word, mut bits| {
        let mut done = 0;
        while bits != 0 {
            let at = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let i = word * WORD + at - first_u;
            // Always so.
            if i >= length {
                return;
            }
            let lower = if LOWER { [lower[i], lower_next[i]] } else { [Vec4::ZERO; 2] };
            let sample = weights.sample::<LOWER>([upper[i], upper_next[i]], lower);
            let pixel = over(pixels[i], finish(i + first_u, sample));
            pixels[i] = pixel;
            done |= u64::from(pixel.cmpge(opaque).bitmask() >> 3) << at;
        }
        non_opaque[word] &= !done;
    });
}

/// The same, compiled by itself: where clipping leaves a share of some pixels.
#[inline(never)]
fn blend_clipped<const LOWER: bool>(
    scanline: &mut ScanlineMut<'_>,
    touched: &mut Touched,
    around: &Around<'_>,
    finish: impl Fn(usize, Vec4) -> Vec4,
    opaque: f32,
) {
    blend::<LOWER>(scanline, touched, around, finish, opaque);
}
