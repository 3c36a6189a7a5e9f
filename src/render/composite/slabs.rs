//! The kernel of slabs: what lies between two slices, looked up by the scalars on both (Schulze et
//! al. 2003).
//!
//! For a scanline of pixels and a slab:
//!
//! 1. *Which pixels?* Those that pass a cell in which something may show and are not opaque
//!    (`mask.rs`).
//! 2. *Sample* the back slice at those pixels and at those of the next slab, which are found one slab ahead; the front slice's samples
//!    are the last slab's back ones and wait in a buffer slice (`samples.rs`). So a slice is read once.
//! 3. *Look up and blend*: the slab by its two scalars, lit by the mean light of both samples,
//!    its length and density corrected, "over".
//!
//! A slab that a clip plane cuts is that part of it: between two samples in its place, and as much shorter.
//!
//! n slices have n - 1 slabs between them, or several times as many where slices are interpolated
//! between slices. A slab that a side of the volume's box cuts counts where its middle is inside: half
//! a slab too many is as likely as half too few. Its sample outside is that of the box's border.
//!
//! The paper's two kinds of buffer slice are both here: two buffers the size of a slice, which change
//! places (SB), or one the size of the intermediate image, in which a pixel's back sample takes the
//! place of its front sample (IB). Of either a band has its own scanlines only.

use std::ops::Range;

use glam::Vec4;

use super::clipped::ClippedPixels;
use super::cue::{Cue, ScanlineCue, SliceCue};
use super::lattice::Lattice;
use super::mask::{Mask, Runs};
use super::occupied::Occupied;
use super::samples::{Position, Quads};
use super::{CANCEL_STEP, Composite, clear_bits};
use crate::classify::preintegration::Slabs;
use crate::render::factorization::Factorization;
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::pixel::Pixel;
use crate::render::simd::shorts::Shorts;
use crate::render::slab::{Correction, opacity_ratio};
use crate::render::{BufferSlice, Cancel, RenderError};

/// What the bands of a frame share.
#[derive(Debug)]
pub struct SlabComposite<'a, L, S, C> {
    pub lattice: L,
    pub factorization: &'a Factorization,
    pub voxels: &'a dyn Quads,
    pub occupied: Occupied<'a>,
    pub table: S,
    pub correction: C,
    /// `None`: nothing fades.
    pub cue: Option<&'a Cue>,
    /// Slabs from a slice of voxels to the next.
    pub steps: usize,
    pub buffer: BufferSlice,
    /// Accumulated opacity at which a pixel is done.
    pub opaque: f32,
    pub cancel: &'a Cancel,
}

/// Row buffers, masks and buffer slices of a thread.
#[derive(Debug)]
pub struct Scratch<R> {
    front: R,
    back: R,
    /// Lengths of the pixels' rays, in units of the view's; none where they have all the same.
    lengths: Vec<f32>,
    /// Those over which a slab is inside the volume.
    inside: Mask,
    pixels: Mask,
    /// Those over which the slab behind is.
    inside_ahead: Mask,
    clipped: ClippedPixels,
    fresh: Mask,
    kept: Vec<Kept>,
    buffer: Buffer,
}

/// What a slab left of a scanline for the one behind it.
#[derive(Clone, Debug)]
struct Kept {
    /// The slab that left it.
    slab: usize,
    /// Pixels with a sample in the buffer slice, if there are any.
    is_sampled: bool,
    sampled: Mask,
    /// Whether the slab behind has work, where that was asked, and for which of them, unless this one has made them opaque.
    found: Option<bool>,
    ahead: Mask,
}

/// Where a slab lies.
pub(super) struct Slab<'a, P> {
    number: usize,
    /// Slice of voxels below it, in the volume's order: the layer of cells that it is in.
    layer: usize,
    pub(super) front: Position<P>,
    pub(super) back: Position<P>,
    /// Its front and its back along k.
    pub(super) ends: [f64; 2],
    /// Its thickness: 1, but for the first one from an eye among the slices.
    pub(super) share: f32,
    /// Pixels along u and scanlines over which the middle is inside the volume.
    pub(super) pixels: Range<usize>,
    pub(super) scanlines: Range<usize>,
    /// Depth cueing in its middle.
    pub(super) cue: Option<SliceCue<'a>>,
}

impl<L: Lattice, S: Slabs, C: Correction> Composite for SlabComposite<'_, L, S, C> {
    type Pixel = Vec4;
    type Scratch = Scratch<L::Rows>;

    fn scratch(&self, height: usize) -> Self::Scratch {
        let [width, _] = self.factorization.size;
        Scratch {
            front: L::rows(self.factorization),
            back: L::rows(self.factorization),
            lengths: vec![],
            inside: Mask::new(width),
            pixels: Mask::new(width),
            inside_ahead: Mask::new(width),
            clipped: ClippedPixels::default(),
            fresh: Mask::new(width),
            kept: vec![
                Kept {
                    slab: 0,
                    is_sampled: false,
                    sampled: Mask::new(width),
                    found: None,
                    ahead: Mask::new(width)
                };
                height
            ],
            buffer: Buffer::new(self.buffer, L::buffer_length(self.factorization), width, height),
        }
    }

    #[inline(always)]
    fn band<W: Shorts>(&self, band: &mut Band<'_, Vec4>, scratch: &mut Self::Scratch) -> Result<(), RenderError> {
        for kept in &mut scratch.kept {
            (kept.is_sampled, kept.found) = (false, None);
        }
        scratch.clipped.enter_band(band);
        if L::LENGTHS {
            self.factorization.relative_lengths(band.first..band.first + band.height(), &mut scratch.lengths);
        }
        let slabs = self.slabs();
        let mut placed = slabs.clone().next().map(|number| self.place(number));
        while let Some(slab) = placed {
            let number = slab.number;
            if number % CANCEL_STEP == 0 && self.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            placed = Some(number + 1).filter(|next| slabs.contains(next)).map(|next| self.place(next));
            self.slab(band, &slab, placed.as_ref(), scratch);
            scratch.buffer.next_slab();
        }
        Ok(())
    }
}

impl<L: Lattice, S: Slabs, C: Correction> SlabComposite<'_, L, S, C> {
    /// The slabs along a ray, front to back.
    pub(super) fn slabs(&self) -> Range<usize> {
        let f = self.factorization;
        (f.start * self.steps as f64) as usize..f.layers() * self.steps
    }

    pub(super) fn place(&self, number: usize) -> Slab<'_, L::Placement> {
        let f = self.factorization;
        let [from, to] = [number, number + 1].map(|n| (n as f64 / self.steps as f64).max(f.start));
        let middle = f.along((from + to) / 2.0);
        let ends = [from, to].map(|at| f.along(at));
        let [pixels, scanlines] = L::inside(f, &L::placement(f, middle));
        let layer = number / self.steps;
        Slab {
            number,
            layer: if f.reversed { f.front - 1 - layer } else { f.front + layer },
            front: Position::new::<L>(f, from),
            back: Position::new::<L>(f, to),
            ends,
            share: ((to - from) * self.steps as f64) as f32,
            pixels,
            scanlines,
            cue: self.cue.map(|cue| cue.slice(middle)),
        }
    }

    /// One slab into one band.
    ///
    /// Its back is sampled at the pixels of the `next` slab too. (Where shapes clip that, or rays have not begun, its pixels are found when it
    /// is its turn, and those that are new are sampled at its front; so are those of the first slab.)
    #[inline(always)]
    fn slab(
        &self,
        band: &mut Band<'_, Vec4>,
        slab: &Slab<'_, L::Placement>,
        next: Option<&Slab<'_, L::Placement>>,
        scratch: &mut Scratch<L::Rows>,
    ) {
        let f = self.factorization;
        let rows = band.first..band.first + band.height();
        let of_band = |scanlines: &Range<usize>| scanlines.start.max(rows.start)..scanlines.end.min(rows.end);
        let vs = of_band(&slab.scanlines);
        let shown = !vs.is_empty() && scratch.clipped.enter(f, vs.clone(), slab.ends);
        // Empty where it is not, and of no influence on the hull with other scanlines.
        let vs = if shown { vs } else { rows.end..rows.start };
        let next = next.map(|next| (next, of_band(&next.scanlines))).filter(|(next, vs)| {
            !vs.is_empty() && f.clipping(vs.clone(), next.ends).is_some_and(|clipping| !clipping.by_shapes())
        });
        let begins = f.position(slab.ends[1]) as f32;
        let have_begun = |v| f.limits().is_none_or(|limits| limits.have_begun(v, begins));
        let (mut all, mut us) = (vs.clone(), slab.pixels.clone());
        scratch.inside.clear();
        scratch.inside.add(us.clone());
        scratch.inside_ahead.clear();
        if let Some((next, vs)) = &next {
            scratch.inside_ahead.add(next.pixels.clone());
            all = all.start.min(vs.start)..all.end.max(vs.end);
            us = us.start.min(next.pixels.start)..us.end.max(next.pixels.end);
        }
        for v in all {
            let row = v - band.first;
            let mut scanline = band.scanline(row);
            let Scratch { front, back, lengths, inside, pixels, inside_ahead, clipped, fresh, kept, buffer } =
                &mut *scratch;
            let Kept { slab: left_by, is_sampled, sampled, found, ahead } = &mut kept[row];
            let known = std::mem::replace(left_by, slab.number) + 1 == slab.number;
            let any = vs.contains(&v) && {
                clipped.enter_scanline(f, v, slab.ends);
                let any = match found.filter(|_| known) {
                    None => self.mark(slab, v, &scanline, inside, pixels),
                    Some(any) => {
                        pixels.copy_from(ahead);
                        any && pixels.keep_within(scanline.non_opaque, inside)
                    }
                };
                // And clipping leaves something of them.
                any && (!clipped.is_any()
                    || clipped.find(f, v, slab.ends, scanline.non_opaque)
                        && pixels.keep(clipped.open(), &(0..usize::MAX)))
            };
            let next = next.as_ref().filter(|(_, vs)| vs.contains(&v) && have_begun(v));
            *found = next.map(|(next, _)| self.mark(next, v, &scanline, inside_ahead, ahead));
            let any_ahead = *found == Some(true);
            let was_sampled = std::mem::replace(is_sampled, any || any_ahead) && known;
            if !*is_sampled {
                continue;
            }
            let samples = buffer.row(row, [&slab.front, &slab.back].map(|p| L::buffer_base(&p.placement)));
            if any {
                let missing = if was_sampled {
                    fresh.difference(pixels, sampled)
                } else {
                    fresh.copy_from(pixels);
                    true
                };
                if missing {
                    let out = (&mut *samples.front, samples.front_base);
                    L::sample(front, self.voxels, self.table, &slab.front, (&slab.pixels, v), fresh, out);
                }
            }
            match (any, any_ahead) {
                (true, true) => sampled.union(pixels, ahead),
                (true, false) => sampled.copy_from(pixels),
                (false, _) => sampled.copy_from(ahead),
            }
            let out = (&mut *samples.back, samples.back_base);
            L::sample(back, self.voxels, self.table, &slab.back, (&us, v), sampled, out);
            if any {
                let lengths = if L::LENGTHS { &lengths[row * f.size[0]..] } else { &[] };
                self.blend(&mut scanline, (v, clipped), slab, pixels, &samples, lengths);
            }
            samples.keep(sampled);
        }
    }

    /// Finds the pixels of scanline `v` to work on, as if nothing were clipped; false where there is none.
    #[inline(always)]
    fn mark(
        &self,
        slab: &Slab<'_, L::Placement>,
        v: usize,
        scanline: &ScanlineMut<'_, Vec4>,
        inside: &Mask,
        pixels: &mut Mask,
    ) -> bool {
        let ends = [&slab.front.placement, &slab.back.placement];
        L::mark(self.factorization, &self.occupied, slab.layer, ends, v, pixels)
            && pixels.keep_within(scanline.non_opaque, inside)
    }

    /// Looks slabs up and blends them behind what is there.
    #[inline(always)]
    fn blend(
        &self,
        scanline: &mut ScanlineMut<'_, Vec4>,
        (v, clipped): (usize, &ClippedPixels),
        slab: &Slab<'_, L::Placement>,
        pixels: &Mask,
        samples: &BufferRow<'_>,
        lengths: &[f32],
    ) {
        let lit = self.voxels.is_lit();
        let cue = slab.cue.map(|cue| cue.scanline(v));
        for (u, length) in Runs::new(pixels) {
            let run = Run {
                u,
                cue,
                pixels: &mut scanline.pixels[u..][..length],
                front: &samples.front[(u as isize - samples.front_base) as usize..][..length],
                back: &samples.back[(u as isize - samples.back_base) as usize..][..length],
                lengths: if L::LENGTHS { &lengths[u..][..length] } else { &[] },
                share: slab.share,
            };
            let opaque = match (lit, cue.is_some()) {
                _ if clipped.is_any() && clipped.cuts(u, length) => self.blend_cut(run, v, slab, clipped),
                (false, false) => self.blend_run::<false, false>(run),
                (false, true) => self.blend_run::<false, true>(run),
                (true, false) => self.blend_run::<true, false>(run),
                (true, true) => self.blend_run::<true, true>(run),
            };
            if opaque != 0 {
                clear_bits(scanline.non_opaque, u, opaque);
            }
        }
    }

    /// Blends consecutive pixels; gives the mask of those that became opaque.
    #[inline(always)]
    fn blend_run<const LIT: bool, const CUED: bool>(&self, run: Run<'_>) -> u64 {
        let mut opaque = 0;
        let samples = run.front.iter().zip(run.back);
        for (at, (pixel, (front, back))) in run.pixels.iter_mut().zip(samples).enumerate() {
            let length = if L::LENGTHS { run.lengths[at] * run.share } else { 1.0 };
            let mut sample = self.sample::<LIT>(*front, *back, length);
            if CUED && let Some(cue) = run.cue {
                sample = (sample * cue.at(run.u + at)).with_w(sample.w);
            }
            *pixel = pixel.over(sample);
            opaque |= u64::from(pixel.w >= self.opaque) << at;
        }
        opaque
    }

    /// Blends consecutive pixels, some of which clipping cuts.
    #[inline(never)]
    fn blend_cut(&self, run: Run<'_>, v: usize, slab: &Slab<'_, L::Placement>, clipped: &ClippedPixels) -> u64 {
        let mut opaque = 0;
        let samples = run.front.iter().zip(run.back);
        for (at, (pixel, (front, back))) in run.pixels.iter_mut().zip(samples).enumerate() {
            let u = run.u + at;
            let length = if L::LENGTHS { run.lengths[at] * run.share } else { 1.0 };
            let left = clipped.is_cut(u).then(|| self.factorization.left(u, v, slab.ends));
            let mut sample = self.cut_sample(*front, *back, length, left);
            if let Some(cue) = run.cue {
                sample = (sample * cue.at(u)).with_w(sample.w);
            }
            *pixel = pixel.over(sample);
            opaque |= u64::from(pixel.w >= self.opaque) << at;
        }
        opaque
    }

    /// The sample of a slab of which these pieces are left (`None`: all).
    pub(super) fn cut_sample(
        &self,
        front: Vec4,
        back: Vec4,
        length: f32,
        left: Option<impl Iterator<Item = [f32; 2]>>,
    ) -> Vec4 {
        let sample = |front, back| match self.voxels.is_lit() {
            true => self.sample::<true>(front, back, length),
            false => self.sample::<false>(front, back, length),
        };
        let Some(left) = left else { return sample(front, back) };
        left.fold(Vec4::ZERO, |before, [enter, leave]| {
            let slab = sample(front.lerp(back, enter), front.lerp(back, leave));
            before.over(slab * opacity_ratio(slab.w, leave - enter))
        })
    }

    /// Premultiplied colour and opacity between two samples, of a slab of so many times the view's length.
    #[inline(always)]
    pub(super) fn sample<const LIT: bool>(&self, front: Vec4, back: Vec4, length: f32) -> Vec4 {
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
}

/// The buffer slice, or rather a band's part of it.
#[derive(Debug)]
struct Buffer {
    kind: BufferSlice,
    /// SB: two slices. IB: the scanlines of the image, and one of back samples.
    slices: [Vec<Vec4>; 2],
    /// Samples in a scanline.
    length: usize,
    /// SB: which of the slices is in front.
    front: usize,
}

/// A scanline of front samples and one of back samples: pixel u is at `u - base`.
struct BufferRow<'a> {
    front: &'a mut [Vec4],
    front_base: isize,
    back: &'a mut [Vec4],
    back_base: isize,
    in_place: bool,
}

impl Buffer {
    fn new(kind: BufferSlice, slice: usize, width: usize, height: usize) -> Self {
        let (length, rows) = match kind {
            BufferSlice::Slice => (slice, [height, height]),
            BufferSlice::Image => (width, [height, 1]),
        };
        Self { kind, slices: rows.map(|rows| vec![Vec4::ZERO; rows * length]), length, front: 0 }
    }

    /// The scanlines of a band's row.
    #[inline(always)]
    fn row(&mut self, row: usize, [front_base, back_base]: [isize; 2]) -> BufferRow<'_> {
        let [first, second] = &mut self.slices;
        let at = row * self.length;
        match self.kind {
            BufferSlice::Image => BufferRow {
                front: &mut first[at..][..self.length],
                front_base: 0,
                back: second,
                back_base: 0,
                in_place: true,
            },
            BufferSlice::Slice => {
                let (front, back) = if self.front == 0 { (first, second) } else { (second, first) };
                BufferRow {
                    front: &mut front[at..][..self.length],
                    front_base,
                    back: &mut back[at..][..self.length],
                    back_base,
                    in_place: false,
                }
            }
        }
    }

    /// What was behind is in front.
    #[inline(always)]
    fn next_slab(&mut self) {
        self.front = 1 - self.front;
    }
}

impl BufferRow<'_> {
    /// Leaves the back samples of `pixels` where the next slab looks for its front ones.
    #[inline(always)]
    fn keep(self, pixels: &Mask) {
        if self.in_place {
            for (u, length) in Runs::new(pixels) {
                self.front[u..][..length].copy_from_slice(&self.back[u..][..length]);
            }
        }
    }
}
