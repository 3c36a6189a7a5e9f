//! Slabs of floats: whatever a lattice, a table and a correction of opacities make of them.

use std::ops::Range;

use glam::Vec4;

use super::clear_bits;
use super::cue::ScanlineCue;
use super::lattice::Lattice;
use super::mask::{Mask, Runs};
use super::samples::{Position, Quads};
use super::slabs::{BufferRow, SlabScanline, SlabSource};
use crate::classify::preintegration::Slabs;
use crate::render::factorization::Factorization;
use crate::render::intermediate::ScanlineMut;
use crate::render::pixel::Pixel;
use crate::render::simd::shorts::Shorts;
use crate::render::slab::{Correction, opacity_ratio};

/// Voxels, and what slabs between them are looked up in. A sample is a position on the axis of the table, a factor on the colour, an addend and
/// a density.
#[derive(Clone, Copy, Debug)]
pub struct FloatSlabs<'a, S, C> {
    pub voxels: &'a dyn Quads,
    pub table: S,
    pub correction: C,
}

impl<L: Lattice, S: Slabs, C: Correction> SlabSource<L> for FloatSlabs<'_, S, C> {
    type Pixel = Vec4;
    type Sample = Vec4;
    type Rows = L::Rows;

    fn rows(&self, factorization: &Factorization) -> L::Rows {
        L::rows(factorization)
    }

    #[inline(always)]
    fn sample<W: Shorts, const SOME: bool>(
        &self,
        rows: &mut L::Rows,
        position: &Position<L::Placement>,
        at: (&Range<usize>, usize),
        mask: &Mask,
        out: (&mut [Vec4], isize),
    ) {
        L::sample(rows, self.voxels, self.table, position, at, mask, out);
    }

    #[inline(always)]
    fn blend<W: Shorts>(
        &self,
        scanline: &mut ScanlineMut<'_, Vec4>,
        at: &SlabScanline<'_, L::Placement>,
        pixels: &Mask,
        samples: &BufferRow<'_, Vec4>,
    ) {
        let &SlabScanline { slab, v, clipped, lengths, opaque, .. } = at;
        let lit = self.voxels.is_lit();
        let cue = slab.cue.map(|cue| cue.scanline(v));
        for (u, length) in Runs::new(pixels) {
            let [front, back] = samples.from(u);
            let run = Run {
                u,
                cue,
                pixels: &mut scanline.pixels[u..][..length],
                front: &front[..length],
                back: &back[..length],
                lengths: if L::LENGTHS { &lengths[u..][..length] } else { &[] },
                share: slab.share,
                opaque,
            };
            let opaque = match (lit, cue.is_some()) {
                _ if clipped.is_any() && clipped.cuts(u, length) => self.blend_cut::<L>(run, at),
                (false, false) => self.blend_run::<L, false, false>(run),
                (false, true) => self.blend_run::<L, false, true>(run),
                (true, false) => self.blend_run::<L, true, false>(run),
                (true, true) => self.blend_run::<L, true, true>(run),
            };
            if opaque != 0 {
                clear_bits(scanline.non_opaque, u, opaque);
            }
        }
    }

    #[inline(always)]
    fn slab(&self, front: Vec4, back: Vec4, length: f32, left: Option<impl Iterator<Item = [f32; 2]>>) -> Vec4 {
        let slab = |front, back| match self.voxels.is_lit() {
            true => self.between::<true>(front, back, length),
            false => self.between::<false>(front, back, length),
        };
        let Some(left) = left else { return slab(front, back) };
        left.fold(Vec4::ZERO, |before, [enter, leave]| {
            let slab = slab(front.lerp(back, enter), front.lerp(back, leave));
            before.over(slab * opacity_ratio(slab.w, leave - enter))
        })
    }
}

impl<S: Slabs, C: Correction> FloatSlabs<'_, S, C> {
    /// Blends consecutive pixels; gives the mask of those that became opaque.
    #[inline(always)]
    fn blend_run<L: Lattice, const LIT: bool, const CUED: bool>(&self, run: Run<'_>) -> u64 {
        let mut opaque = 0;
        let samples = run.front.iter().zip(run.back);
        for (at, (pixel, (front, back))) in run.pixels.iter_mut().zip(samples).enumerate() {
            let length = if L::LENGTHS { run.lengths[at] * run.share } else { 1.0 };
            let mut sample = self.between::<LIT>(*front, *back, length);
            if CUED && let Some(cue) = run.cue {
                sample = (sample * cue.at(run.u + at)).with_w(sample.w);
            }
            *pixel = pixel.over(sample);
            opaque |= u64::from(pixel.w >= run.opaque) << at;
        }
        opaque
    }

    /// Blends consecutive pixels, some of which clipping cuts.
    #[inline(never)]
    fn blend_cut<L: Lattice>(&self, run: Run<'_>, at: &SlabScanline<'_, L::Placement>) -> u64
    where
        Self: SlabSource<L, Pixel = Vec4, Sample = Vec4>,
    {
        let mut opaque = 0;
        let samples = run.front.iter().zip(run.back);
        for (n, (pixel, (front, back))) in run.pixels.iter_mut().zip(samples).enumerate() {
            let u = run.u + n;
            let length = if L::LENGTHS { run.lengths[n] * run.share } else { 1.0 };
            let left = at.clipped.is_cut(u).then(|| at.factorization.left(u, at.v, at.slab.ends));
            let mut sample = self.slab(*front, *back, length, left);
            if let Some(cue) = run.cue {
                sample = (sample * cue.at(u)).with_w(sample.w);
            }
            *pixel = pixel.over(sample);
            opaque |= u64::from(pixel.w >= run.opaque) << n;
        }
        opaque
    }

    /// Premultiplied colour and opacity between two samples, of a slab of so many times the view's length.
    #[inline(always)]
    fn between<const LIT: bool>(&self, front: Vec4, back: Vec4, length: f32) -> Vec4 {
        let mean = (front + back) * 0.5;
        let slab = self.correction.correct(self.table.slab(front.x, back.x), mean.w, length);
        if LIT { (slab * mean.y + Vec4::splat(mean.z * slab.w)).min(Vec4::splat(slab.w)).with_w(slab.w) } else { slab }
    }
}

/// Consecutive pixels and their samples.
struct Run<'a> {
    u: usize,
    cue: Option<ScanlineCue<'a>>,
    pixels: &'a mut [Vec4],
    front: &'a [Vec4],
    back: &'a [Vec4],
    lengths: &'a [f32],
    share: f32,
    /// Accumulated opacity at which a pixel is done.
    opaque: f32,
}
