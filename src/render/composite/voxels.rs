//! The kernel of single voxels: each slice's voxels, shaded and resampled, "over" what is in front.
//!
//! For a scanline of a slice:
//!
//! 1. *Which pixels?* A pixel needs work if it touches a drawn voxel and is not opaque itself. The runs of the two voxel scanlines
//!    that the pixels gather from are machine words, as the opaque pixels are, and are intersected with them (`touched.rs`);
//!    scanlines without a run are not even looked at.
//! 2. *Shade* the voxels those pixels touch into a row buffer, by aligned fours and each once: the lower scanline of
//!    one pixel row is the upper one of the next (`rows.rs`).
//! 3. *Resample and blend*, by aligned fours again: four weights that are constant over the slice, then "over", and an
//!    opaque pixel's bit is cleared.

use super::clipped::ClippedPixels;
use super::cue::{Cue, ScanlineCue};
use super::lattice::{Lattice, Unit};
use super::rows::RowBuffers;
use super::sources::VoxelSource;
use super::touched::{Open, Touched};
use super::{BAND_HEIGHT, CANCEL_STEP, Composite, WORD, run_mask};
use crate::render::factorization::Factorization;
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::material::{Shader, SliceShader};
use crate::render::pixel::{Pixel, one_by_one};
use crate::render::simd::shorts::Shorts;
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
pub struct Voxels<'a, L: Lattice, V, M> {
    pub lattice: L,
    pub source: V,
    pub factorization: &'a Factorization,
    /// Where slices lie, from the first one of the factorization's on.
    pub placements: Vec<L::Placement>,
    pub material: M,
    /// `None`: nothing fades.
    pub cue: Option<&'a Cue>,
    /// Accumulated opacity at which a pixel is done.
    pub opaque: f32,
    pub cancel: &'a Cancel,
}

/// A lattice over slices of single voxels.
pub trait VoxelLattice<P>: Lattice {
    /// Row buffers and masks of a thread.
    type Scratch: Send;

    /// Scratch for a part of a view.
    fn scratch(factorization: &Factorization) -> Self::Scratch;

    /// What a band's slices share. Called before the first.
    fn enter_band(factorization: &Factorization, band: &Band<'_, P>, scratch: &mut Self::Scratch);

    /// One slice into one band. Implementations are `#[inline(always)]`.
    fn slice<W: Shorts, V: VoxelSource, M: Shader<Slice: SliceShader<Pixel = P>>>(
        voxels: &Voxels<'_, Self, V, M>,
        band: &mut Band<'_, P>,
        k: usize,
        scratch: &mut Self::Scratch,
    );
}

impl<P: Pixel, L: VoxelLattice<P>, V: VoxelSource, M: Shader<Slice: SliceShader<Pixel = P>>> Composite
    for Voxels<'_, L, V, M>
{
    type Pixel = P;
    type Scratch = L::Scratch;

    fn scratch(&self, _: usize) -> Self::Scratch {
        L::scratch(self.factorization)
    }

    #[inline(always)]
    fn band<W: Shorts>(&self, band: &mut Band<'_, P>, scratch: &mut Self::Scratch) -> Result<(), RenderError> {
        L::enter_band(self.factorization, band, scratch);
        let slices = self.factorization.slices.clone();
        for step in 0..slices.len() {
            if step % CANCEL_STEP == 0 && self.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            let k = if self.factorization.reversed { slices.end - 1 - step } else { slices.start + step };
            L::slice::<W, V, M>(self, band, k, scratch);
        }
        Ok(())
    }
}

impl<P: Pixel> VoxelLattice<P> for Unit {
    type Scratch = (RowBuffers<P>, Touched, ClippedPixels);

    fn scratch(factorization: &Factorization) -> Self::Scratch {
        (RowBuffers::new(factorization.dims[0]), Touched::new(factorization.dims[0]), ClippedPixels::default())
    }

    #[inline(always)]
    fn enter_band(_: &Factorization, band: &Band<'_, P>, (_, _, clipped): &mut Self::Scratch) {
        clipped.enter_band(band);
    }

    #[inline(always)]
    fn slice<W: Shorts, V: VoxelSource, M: Shader<Slice: SliceShader<Pixel = P>>>(
        voxels: &Voxels<'_, Self, V, M>,
        band: &mut Band<'_, P>,
        k: usize,
        scratch: &mut Self::Scratch,
    ) {
        // A kernel of its own for what is neither clipped nor faded: what that would take is not in its way.
        if !M::Slice::PAINTED && voxels.cue.is_none() && !voxels.factorization.is_clipped() {
            voxels.slice::<W, false>(band, k, scratch);
        } else {
            voxels.slice::<W, true>(band, k, scratch);
        }
    }
}

impl<P: Pixel, V: VoxelSource, M: Shader<Slice: SliceShader<Pixel = P>>> Voxels<'_, Unit, V, M> {
    /// One slice into one band; with `CARE` pixels may be clipped, faded or what they show may be more than a sum.
    #[inline(always)]
    fn slice<W: Shorts, const CARE: bool>(
        &self,
        band: &mut Band<'_, P>,
        k: usize,
        (rows, touched, clipped): &mut (RowBuffers<P>, Touched, ClippedPixels),
    ) {
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
        if CARE && !clipped.enter(f, start_v..end_v, slices) {
            return;
        }
        let material = self.material.slice(f.share(k));
        let weights = P::weights([fraction_u, fraction_v]);
        let cue = self.cue.map(|cue| cue.slice(k as f64));
        let ahead = slices_ahead(f, k);
        let next = ahead.map_or(k, |[next, _]| next);
        rows.next_slice();
        let mut below = None;
        while under != 0 {
            let at = under.trailing_zeros() as usize;
            under &= under - 1;
            let (v, j) = (start_v + at, start_j + at);
            if let Some([_, farther]) = ahead {
                self.source.prefetch_place(j, farther);
            }
            let mut scanline = band.scanline_and_more(v - band.first);
            let upper = match below {
                Some((at, scanline)) if at == j => scanline,
                _ => self.source.scanline(j, k),
            };
            let lower = if has_lower { Some(self.source.scanline(j + 1, k)) } else { None };
            below = lower.map(|lower| (j + 1, lower));
            let (above, beneath) = (upper, lower.unwrap_or(upper));
            let marks = (self.source.marks(&above), self.source.marks(&beneath));
            let lies = Open { words: &[], first: first_u, between: fraction_u > 0.0 };
            if !touched.find::<W>(marks.0, marks.1, &Open { words: scanline.non_opaque, ..lies }) {
                continue;
            }
            let asked = || {
                let (first, (_, words)) = (first_u / WORD, touched.words());
                first + words.start..first + words.end + 1
            };
            if CARE && clipped.enter_scanline(f, v, asked) {
                let takes = clipped.find::<W>(f, v, scanline.non_opaque);
                if takes && !touched.keep(&Open { words: clipped.open(), ..lies }) {
                    continue;
                }
            }
            rows.go_on(j);
            let RowBuffers { upper, lower } = rows;
            upper.enter(j);
            if has_lower {
                lower.enter(j + 1);
            }
            let (asked, words) = touched.asked();
            let above = (&above, self.source.ahead(j, next));
            let beneath = (&beneath, self.source.ahead(j + usize::from(has_lower), next));
            for word in words {
                let asked = (word, asked[word]);
                upper.shade::<W, _, _>(self.source, above, asked, k, material);
                if has_lower {
                    lower.shade::<W, _, _>(self.source, beneath, asked, k, material);
                }
            }
            let cue = cue.map(|cue| cue.scanline(v));
            let at = Place { v, k, cue, clipped };
            let around = Around { rows: [&upper.voxels, &lower.voxels], first_u, weights };
            if has_lower {
                self.blend::<W, true, CARE>(&mut scanline, &at, &around, touched, material);
            } else {
                self.blend::<W, false, CARE>(&mut scanline, &at, &around, touched, material);
            }
        }
    }

    /// Resamples the row buffers at the touched pixels and blends behind what is there. Pixels that become opaque are no longer open.
    #[inline(always)]
    fn blend<W: Shorts, const LOWER: bool, const CARE: bool>(
        &self,
        scanline: &mut ScanlineMut<'_, P>,
        at: &Place<'_>,
        &Around { rows: [upper, lower], first_u, weights }: &Around<'_, P>,
        touched: &Touched,
        material: M::Slice,
    ) {
        let limit = P::limit(self.opaque);
        let (words, shift) = (&mut scanline.non_opaque[first_u / WORD..], first_u % WORD);
        let pixels = &mut scanline.pixels[first_u..];
        let (touched, range) = touched.words();
        for word in range {
            let bits = touched[word];
            if bits == 0 {
                continue;
            }
            let first = word * WORD;
            let (Some(pixels), Some(upper), Some(lower)) = (
                pixels[first..].first_chunk_mut::<WORD>(),
                upper[first..].first_chunk::<{ WORD + 1 }>(),
                lower[first..].first_chunk::<{ WORD + 1 }>(),
            ) else {
                unreachable!("rows and scanlines go on for a word")
            };
            let done = if CARE {
                let around = ([upper, lower], &weights, limit, first_u + first);
                self.blend_with_care::<W, LOWER>(pixels, at, around, bits, material)
            } else {
                P::blend::<W, LOWER>(pixels, [upper, lower], &weights, limit, bits)
            };
            words[word] &= !(done << shift);
            words[word + 1] &= !(done >> 1 >> (WORD - 1 - shift));
        }
    }

    /// A word's where more may be to be done than to blend.
    #[inline(always)]
    fn blend_with_care<W: Shorts, const LOWER: bool>(
        &self,
        pixels: &mut [P; WORD],
        &Place { v, k, cue, clipped }: &Place<'_>,
        (rows, weights, limit, first): ([&[P; WORD + 1]; 2], &P::Weights, P::Limit, usize),
        touched: u64,
        material: M::Slice,
    ) -> u64 {
        let is_cut = clipped.is_any() && clipped.cuts_any();
        let finish = |n: usize, sample: P| {
            let (u, mut sample) = (first + n, material.resampled(sample, 1.0));
            if is_cut {
                sample = cut(sample, self.left(u, v, k, clipped));
            }
            match cue {
                Some(cue) => sample.faded(cue.at(u)),
                None => sample,
            }
        };
        let cut = if is_cut { clipped.cut_from(first) } else { 0 };
        let by_itself = touched & if cue.is_some() || M::Slice::PAINTED { u64::MAX } else { cut };
        let mut done = P::blend::<W, LOWER>(pixels, rows, weights, limit, touched & !by_itself);
        if by_itself != 0 {
            done |= one_by_one::<P, LOWER>(pixels, rows, weights, limit, by_itself, finish);
        }
        done
    }
}

impl<L: Lattice, V, M> Voxels<'_, L, V, M> {
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
pub(super) fn cut<P: Pixel>(sample: P, left: Option<f32>) -> P {
    match left {
        None => sample,
        Some(left) if left > 0.0 => sample.times(opacity_ratio(sample.opacity(), left)),
        Some(_) => P::CLEAR,
    }
}

/// The voxels around the pixels of a scanline.
struct Around<'a, P: Pixel> {
    /// Upper and lower.
    rows: [&'a [P]; 2],
    /// The pixel on voxel 0 or after it.
    first_u: usize,
    weights: P::Weights,
}
