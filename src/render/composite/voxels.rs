//! The kernel of single voxels: each slice's voxels, shaded and resampled, "over" what is in front.
//!
//! For a scanline of a slice:
//!
//! 1. *Which pixels?* The runs of the two voxel scanlines that the pixels gather from are marked
//!    as bits; a pixel needs work if a voxel it touches is marked and it is not opaque itself. That
//!    is a union, a shift and an intersection of machine words (`spans.rs`).
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
use super::spans::Spans;
use super::{CANCEL_STEP, Composite, WORD, clear_bits, first_run, over, run_mask};
use crate::render::factorization::{Factorization, SlicePlacement};
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::material::{Light, Material, SliceMaterial};
use crate::render::slab::opacity_ratio;
use crate::render::{Cancel, RenderError};

/// Where scanlines are is asked for so many slices before they are read.
const FARTHER: usize = 8;

/// What the bands of a frame share.
#[derive(Debug)]
pub struct Voxels<'a, L, V, H, const FACTORED: bool> {
    pub lattice: L,
    pub source: V,
    pub factorization: &'a Factorization,
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
    type Scratch = (RowBuffers, Spans, ClippedPixels);

    fn scratch(factorization: &Factorization) -> Self::Scratch {
        let length = factorization.dims[0];
        (RowBuffers::new(length), Spans::new(length), ClippedPixels::default())
    }

    #[inline(always)]
    fn enter_band(_: &Factorization, _: &Band<'_>, _: &mut Self::Scratch) {}

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
    fn slice(&self, band: &mut Band<'_>, k: usize, (rows, spans, clipped): &mut <Unit as VoxelLattice>::Scratch) {
        let placement = self.factorization.slice(k);
        let [fraction_u, fraction_v] = placement.fraction;
        let material = self.material.slice(self.factorization.share(k));
        // Pixels between the slice's first and last voxel scanline: nothing lies outside the box.
        let last = self.factorization.dims[1] - 1 - usize::from(fraction_v > 0.0);
        let first_row = placement.first[1].saturating_sub(band.first);
        let end_row = (placement.first[1] + last + 1).saturating_sub(band.first).min(band.height());
        let weights = Weights::new(fraction_u, fraction_v);
        let cue = self.cue.map(|cue| cue.slice(k as f64));
        let slices = &self.factorization.slices;
        let ahead = if self.factorization.reversed { k.wrapping_sub(1) } else { k + 1 };
        let has_ahead = slices.contains(&ahead);
        let farther = if self.factorization.reversed { k.wrapping_sub(FARTHER) } else { k + FARTHER };
        rows.next_slice();
        let mut below = None;
        for row in first_row..end_row {
            let v = band.first + row;
            let j = v - placement.first[1];
            if has_ahead {
                self.source.prefetch_place(j, farther);
            }
            let upper = match below {
                Some(upper) => upper,
                None => self.source.scanline(j, k),
            };
            let lower = if fraction_v > 0.0 { Some(self.source.scanline(j + 1, k)) } else { None };
            below = lower;
            let empty_lower = match &lower {
                Some(lower) => self.source.is_empty(lower),
                None => true,
            };
            if empty_lower && self.source.is_empty(&upper) {
                continue;
            }
            rows.enter(self.source, j, &upper, lower.as_ref());
            let mut scanline = band.scanline(row);
            self.find(spans, clipped, rows, &scanline, &placement, [v, k]);
            if V::CLASSIFIES && !spans.is_empty() {
                rows.classify(self.source, &upper, lower.as_ref(), spans);
                self.find(spans, clipped, rows, &scanline, &placement, [v, k]);
            }
            if spans.is_empty() {
                continue;
            }
            if has_ahead {
                self.source.prefetch(j, ahead);
            }
            rows.shade(self.source, &upper, lower.as_ref(), (spans, k), material);
            let cue = cue.map(|cue| cue.scanline(v));
            let at = Place { v, k, first_u: placement.first[0], cue, clipped };
            self.blend(&mut scanline, &at, rows, spans, &weights, material);
        }
    }

    /// Finds the pixels that touch a marked voxel, are not opaque and not clipped away.
    #[inline(always)]
    fn find(
        &self,
        spans: &mut Spans,
        clipped: &mut ClippedPixels,
        rows: &RowBuffers,
        scanline: &ScanlineMut<'_>,
        placement: &SlicePlacement,
        [v, k]: [usize; 2],
    ) {
        let (first_u, between) = (placement.first[0], placement.fraction[0] > 0.0);
        spans.find(rows, scanline.non_opaque, first_u, between);
        let f = self.factorization;
        if f.is_clipped() && !spans.is_empty() {
            clipped.find(f, v, f.interval(k), scanline.non_opaque);
            spans.find(rows, clipped.open(), first_u, between);
        }
    }

    /// Resamples the row buffers at the spans' pixels and blends behind what is there.
    #[inline(always)]
    fn blend(
        &self,
        scanline: &mut ScanlineMut<'_>,
        &Place { v, k, first_u, cue, clipped }: &Place<'_>,
        rows: &RowBuffers,
        spans: &Spans,
        weights: &Weights,
        material: SliceMaterial<'_, H, FACTORED>,
    ) {
        let finish = |sample| material.resampled(sample, 1.0);
        for (word, &bits) in spans.pixels().iter().enumerate() {
            let mut bits = bits;
            while bits != 0 {
                let (start, length) = first_run(bits);
                bits &= !run_mask(start, length);
                let i = word * WORD + start;
                let u = i + first_u;
                let (upper, lower) = rows.voxels(i, length + 1);
                let pixels = &mut scanline.pixels[u..u + length];
                let opaque = match (rows.has_lower(), cue) {
                    _ if self.factorization.is_clipped() && clipped.cuts(u, length) => {
                        let left = |u| self.left(u, v, k, clipped);
                        let has_lower = rows.has_lower();
                        let sample = |upper, lower| {
                            finish(if has_lower {
                                weights.sample::<true>(upper, lower)
                            } else {
                                weights.sample::<false>(upper, lower)
                            })
                        };
                        blend_cut(pixels, [upper, lower], sample, (cue, u), left, self.opaque)
                    }
                    (true, None) => {
                        blend_run::<true, false>(pixels, upper, lower, weights, (cue, u), finish, self.opaque)
                    }
                    (false, None) => {
                        blend_run::<false, false>(pixels, upper, lower, weights, (cue, u), finish, self.opaque)
                    }
                    (true, Some(_)) => {
                        blend_run::<true, true>(pixels, upper, lower, weights, (cue, u), finish, self.opaque)
                    }
                    (false, Some(_)) => {
                        blend_run::<false, true>(pixels, upper, lower, weights, (cue, u), finish, self.opaque)
                    }
                };
                if opaque != 0 {
                    clear_bits(scanline.non_opaque, u, opaque);
                }
            }
        }
    }
}

impl<L, V, H, const FACTORED: bool> Voxels<'_, L, V, H, FACTORED> {
    /// The share of slice `k` that clipping leaves of pixel (u, v), where that is not all.
    #[inline(never)]
    pub(super) fn left(&self, u: usize, v: usize, k: usize, clipped: &ClippedPixels) -> Option<f32> {
        if !clipped.cuts(u, 1) {
            return None;
        }
        let left = self.factorization.left(u, v, self.factorization.interval(k));
        Some(left.map(|[enter, leave]| leave - enter).sum())
    }
}

/// A scanline of pixels on a slice.
struct Place<'a> {
    v: usize,
    k: usize,
    /// The first pixel that lies on the slice.
    first_u: usize,
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

/// Blends consecutive pixels; gives the mask of those that became opaque.
#[inline(always)]
fn blend_run<const LOWER: bool, const CUED: bool>(
    pixels: &mut [Vec4],
    upper: &[Vec4],
    lower: &[Vec4],
    weights: &Weights,
    (cue, u): (Option<ScanlineCue<'_>>, usize),
    finish: impl Fn(Vec4) -> Vec4,
    opaque: f32,
) -> u64 {
    let mut done = 0;
    let voxels = upper.windows(2).zip(lower.windows(2));
    for (at, (pixel, (upper, lower))) in pixels.iter_mut().zip(voxels).enumerate() {
        let mut sample = finish(weights.sample::<LOWER>([upper[0], upper[1]], [lower[0], lower[1]]));
        if CUED && let Some(cue) = cue {
            sample = (sample * cue.at(u + at)).with_w(sample.w);
        }
        *pixel = over(*pixel, sample);
        done |= u64::from(pixel.w >= opaque) << at;
    }
    done
}

/// The same where clipping leaves a share of some pixels.
#[inline(never)]
fn blend_cut(
    pixels: &mut [Vec4],
    [upper, lower]: [&[Vec4]; 2],
    sample: impl Fn([Vec4; 2], [Vec4; 2]) -> Vec4,
    (cue, u): (Option<ScanlineCue<'_>>, usize),
    left: impl Fn(usize) -> Option<f32>,
    opaque: f32,
) -> u64 {
    let mut done = 0;
    let voxels = upper.windows(2).zip(lower.windows(2));
    for (at, (pixel, (upper, lower))) in pixels.iter_mut().zip(voxels).enumerate() {
        let whole = sample([upper[0], upper[1]], [lower[0], lower[1]]);
        let mut sample = cut(whole, left(u + at));
        if let Some(cue) = cue {
            sample = (sample * cue.at(u + at)).with_w(sample.w);
        }
        *pixel = over(*pixel, sample);
        done |= u64::from(pixel.w >= opaque) << at;
    }
    done
}
