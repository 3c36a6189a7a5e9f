//! The kernel of slabs: what lies between two slices, looked up by the scalars on both (Schulze et
//! al. 2003).
//!
//! The walk is here; how samples are made and what slabs are looked up in is its [`SlabSource`]: floats (`float_slabs.rs`) or, where these will do,
//! 16-bit fractions (`short_slabs.rs`).
//!
//! For a scanline of pixels and a slab:
//!
//! 1. *Which pixels?* Those that pass a cell in which something may show and are not opaque
//!    (`mask.rs`).
//! 2. *Sample* the back slice at those pixels and at those of the next slab, which are found one slab ahead; the front slice's samples
//!    are the last slab's back ones and wait in a buffer slice. So a slice is read once.
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

use std::fmt::Debug;
use std::ops::Range;

use super::clipped::ClippedPixels;
use super::cue::{Cue, SliceCue};
use super::lattice::Lattice;
use super::mask::{Mask, Runs};
use super::occupied::Occupied;
use super::samples::Position;
use super::{CANCEL_STEP, Composite, WORD};
use crate::render::factorization::Factorization;
use crate::render::intermediate::{Band, ScanlineMut};
use crate::render::pixel::Pixel;
use crate::render::ranges::hull;
use crate::render::simd::shorts::Shorts;
use crate::render::{BufferSlice, Cancel, RenderError};

/// So many samples before a scanline's first and behind its last may be made and looked up with them, where nothing is drawn.
const BESIDE: usize = WORD;

/// What slabs are told by.
pub trait SlabSource<L: Lattice>: Send + Sync {
    /// What bands are composited in.
    type Pixel: Pixel;
    /// What slices are sampled into.
    type Sample: Copy + Debug + Default + Send;
    /// Row buffers for the voxels of a slice.
    type Rows: Debug + Send;

    /// Row buffers for `factorization`.
    fn rows(&self, factorization: &Factorization) -> Self::Rows;

    /// Samples the pixels of `mask` on a scanline: `at` has pixels that they are some of, and the scanline's
    /// v. Pixel u goes to `out.0[u - out.1]`. What is there for pixels beside them stays if they are `SOME` of those that have samples.
    /// Implementations are `#[inline(always)]`, as are those of `blend`.
    fn sample<W: Shorts, const SOME: bool>(
        &self,
        rows: &mut Self::Rows,
        position: &Position<L::Placement>,
        at: (&Range<usize>, usize),
        mask: &Mask,
        out: (&mut [Self::Sample], isize),
    );

    /// Looks up the slabs of `pixels`, and blends them behind what is there. Pixels that become opaque are no longer open.
    fn blend<W: Shorts>(
        &self,
        scanline: &mut ScanlineMut<'_, Self::Pixel>,
        at: &SlabScanline<'_, L::Placement>,
        pixels: &Mask,
        samples: &BufferRow<'_, Self::Sample>,
    );

    /// What a slab of `length` times the view's shows between two samples, of which these pieces are left (`None`: all).
    fn slab(
        &self,
        front: Self::Sample,
        back: Self::Sample,
        length: f32,
        left: Option<impl Iterator<Item = [f32; 2]>>,
    ) -> Self::Pixel;
}

/// A scanline of a slab.
pub struct SlabScanline<'a, P> {
    pub factorization: &'a Factorization,
    pub slab: &'a Slab<'a, P>,
    pub v: usize,
    /// Where the view clips.
    pub clipped: &'a ClippedPixels,
    /// Lengths of the pixels' rays, in units of the view's; none where they have all the same.
    pub lengths: &'a [f32],
    /// Accumulated opacity at which a pixel is done.
    pub opaque: f32,
}

/// What the bands of a frame share.
#[derive(Debug)]
pub struct SlabComposite<'a, L: Lattice, Q> {
    pub lattice: L,
    pub source: Q,
    pub factorization: &'a Factorization,
    pub occupied: Occupied<'a>,
    /// Front to back.
    pub slabs: Vec<Slab<'a, L::Placement>>,
    pub buffer: BufferSlice,
    /// Accumulated opacity at which a pixel is done.
    pub opaque: f32,
    pub cancel: &'a Cancel,
}

/// Row buffers, masks and buffer slices of a thread.
#[derive(Debug)]
pub struct Scratch<R, S> {
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
    /// Where clipping was asked about the slab that comes next: whether anything of it is left.
    is_left: Option<bool>,
    fresh: Mask,
    kept: Vec<Kept>,
    buffer: Buffer<S>,
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
#[derive(Debug)]
pub struct Slab<'a, P> {
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

impl<L: Lattice, Q: SlabSource<L>> Composite for SlabComposite<'_, L, Q> {
    type Pixel = Q::Pixel;
    type Scratch = Scratch<Q::Rows, Q::Sample>;

    fn scratch(&self, height: usize) -> Self::Scratch {
        let [width, _] = self.factorization.size;
        Scratch {
            front: self.source.rows(self.factorization),
            back: self.source.rows(self.factorization),
            lengths: vec![],
            inside: Mask::new(width),
            pixels: Mask::new(width),
            inside_ahead: Mask::new(width),
            clipped: ClippedPixels::default(),
            is_left: None,
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
    fn band<W: Shorts>(&self, band: &mut Band<'_, Q::Pixel>, scratch: &mut Self::Scratch) -> Result<(), RenderError> {
        for kept in &mut scratch.kept {
            (kept.is_sampled, kept.found) = (false, None);
        }
        scratch.clipped.enter_band(band);
        scratch.is_left = None;
        if L::LENGTHS {
            self.factorization.relative_lengths(band.first..band.first + band.height(), &mut scratch.lengths);
        }
        for (at, slab) in self.slabs.iter().enumerate() {
            if at % CANCEL_STEP == 0 && self.cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            self.slab::<W>(band, slab, self.slabs.get(at + 1), scratch);
            scratch.buffer.next_slab();
        }
        Ok(())
    }
}

impl<'a, P> Slab<'a, P> {
    /// The slabs along a ray, front to back, so many `steps` of them from a slice of voxels to the next.
    pub fn all<L: Lattice<Placement = P>>(f: &Factorization, steps: usize, cue: Option<&'a Cue>) -> Vec<Self> {
        let slabs = (f.start * steps as f64) as usize..f.layers() * steps;
        slabs.map(|number| Self::new::<L>(f, number, steps, cue)).collect()
    }

    fn new<L: Lattice<Placement = P>>(f: &Factorization, number: usize, steps: usize, cue: Option<&'a Cue>) -> Self {
        let [from, to] = [number, number + 1].map(|n| (n as f64 / steps as f64).max(f.start));
        let middle = f.along((from + to) / 2.0);
        let ends = [from, to].map(|at| f.along(at));
        let [pixels, scanlines] = L::inside(f, &L::placement(f, middle));
        let layer = number / steps;
        Self {
            number,
            layer: if f.reversed { f.front - 1 - layer } else { f.front + layer },
            front: Position::new::<L>(f, from),
            back: Position::new::<L>(f, to),
            ends,
            share: ((to - from) * steps as f64) as f32,
            pixels,
            scanlines,
            cue: cue.map(|cue| cue.slice(middle)),
        }
    }
}

impl<L: Lattice, Q: SlabSource<L>> SlabComposite<'_, L, Q> {
    /// One slab into one band.
    ///
    /// Its back is sampled at the pixels of the `next` slab too. (Where rays have not begun, its pixels are found when it
    /// is its turn, and those that are new are sampled at its front; so are those of the first slab.)
    #[inline(always)]
    fn slab<W: Shorts>(
        &self,
        band: &mut Band<'_, Q::Pixel>,
        slab: &Slab<'_, L::Placement>,
        next: Option<&Slab<'_, L::Placement>>,
        scratch: &mut Scratch<Q::Rows, Q::Sample>,
    ) {
        let f = self.factorization;
        let rows = band.first..band.first + band.height();
        let of_band = |scanlines: &Range<usize>| scanlines.start.max(rows.start)..scanlines.end.min(rows.end);
        let vs = of_band(&slab.scanlines);
        let shown = match scratch.is_left.take() {
            Some(is_left) => {
                scratch.clipped.advance();
                is_left
            }
            None => !vs.is_empty() && scratch.clipped.enter(f, vs.clone(), slab.ends),
        };
        let vs = if shown { vs } else { 0..0 };
        let next = next.map(|next| (next, of_band(&next.scanlines))).filter(|(next, vs)| {
            scratch.is_left = (!vs.is_empty()).then(|| scratch.clipped.enter_ahead(f, vs.clone(), next.ends));
            scratch.is_left == Some(true)
        });
        let begins = f.position(slab.ends[1]) as f32;
        let have_begun = |v| f.limits().is_none_or(|limits| limits.have_begun(v, begins));
        let (mut all, mut us) = (vs.clone(), slab.pixels.clone());
        scratch.inside.clear();
        scratch.inside.add(us.clone());
        scratch.inside_ahead.clear();
        if let Some((next, vs)) = &next {
            scratch.inside_ahead.add(next.pixels.clone());
            (all, us) = (hull(&all, vs), hull(&us, &next.pixels));
        }
        for v in all {
            let row = v - band.first;
            let mut scanline = band.scanline_and_more(row);
            let Scratch { front, back, lengths, inside, pixels, inside_ahead, clipped, fresh, kept, buffer, .. } =
                &mut *scratch;
            let Kept { slab: left_by, is_sampled, sampled, found, ahead } = &mut kept[row];
            let known = std::mem::replace(left_by, slab.number) + 1 == slab.number;
            let any = vs.contains(&v) && {
                let any = match found.filter(|_| known) {
                    None => self.mark::<W>(slab, v, &scanline, inside, pixels),
                    Some(any) => {
                        pixels.copy_from(ahead);
                        any && pixels.keep_within(scanline.non_opaque, inside)
                    }
                };
                // And clipping leaves something of them.
                any && (!clipped.enter_scanline(f, v, || pixels.filled())
                    || !clipped.find::<W>(f, v, scanline.non_opaque)
                    || pixels.keep(clipped.open(), &(0..usize::MAX)))
            };
            let next = next.as_ref().filter(|(_, vs)| vs.contains(&v) && have_begun(v));
            *found = next.map(|(next, _)| {
                self.mark::<W>(next, v, &scanline, inside_ahead, ahead)
                    && clipped.keep_ahead(f, v, scanline.non_opaque, ahead)
            });
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
                    self.source.sample::<W, true>(front, &slab.front, (&slab.pixels, v), fresh, out);
                }
            }
            match (any, any_ahead) {
                (true, true) => sampled.union(pixels, ahead),
                (true, false) => sampled.copy_from(pixels),
                (false, _) => sampled.copy_from(ahead),
            }
            let out = (&mut *samples.back, samples.back_base);
            self.source.sample::<W, false>(back, &slab.back, (&us, v), sampled, out);
            if any {
                let lengths = if L::LENGTHS { &lengths[row * f.size[0]..] } else { &[] };
                let at = SlabScanline { factorization: f, slab, v, clipped, lengths, opaque: self.opaque };
                self.source.blend::<W>(&mut scanline, &at, pixels, &samples);
            }
            samples.keep(sampled);
        }
    }

    /// Finds the pixels of scanline `v` to work on, as if nothing were clipped; false where there is none.
    #[inline(always)]
    fn mark<W: Shorts>(
        &self,
        slab: &Slab<'_, L::Placement>,
        v: usize,
        scanline: &ScanlineMut<'_, Q::Pixel>,
        inside: &Mask,
        pixels: &mut Mask,
    ) -> bool {
        let ends = [&slab.front.placement, &slab.back.placement];
        L::mark::<W>(self.factorization, &self.occupied, slab.layer, ends, v, (scanline.non_opaque, inside), pixels)
    }
}

/// The buffer slice, or rather a band's part of it.
#[derive(Debug)]
struct Buffer<S> {
    kind: BufferSlice,
    /// SB: two slices. IB: the scanlines of the image, and one of back samples.
    slices: [Vec<S>; 2],
    /// Samples in a scanline, with [`BESIDE`] before and behind.
    length: usize,
    /// SB: which of the slices is in front.
    front: usize,
}

/// A scanline of front samples and one of back samples: pixel u is at `u - base`.
#[derive(Debug)]
pub struct BufferRow<'a, S> {
    front: &'a mut [S],
    front_base: isize,
    back: &'a mut [S],
    back_base: isize,
    in_place: bool,
}

impl<S: Copy + Default> Buffer<S> {
    fn new(kind: BufferSlice, slice: usize, width: usize, height: usize) -> Self {
        let (length, rows) = match kind {
            BufferSlice::Slice => (slice, [height, height]),
            BufferSlice::Image => (width, [height, 1]),
        };
        let length = length + 2 * BESIDE;
        Self { kind, slices: rows.map(|rows| vec![S::default(); rows * length]), length, front: 0 }
    }

    /// The scanlines of a band's row.
    #[inline(always)]
    fn row(&mut self, row: usize, bases: [isize; 2]) -> BufferRow<'_, S> {
        const BEFORE: isize = BESIDE as isize;
        let [front_base, back_base] = bases.map(|base| base - BEFORE);
        let [first, second] = &mut self.slices;
        let at = row * self.length;
        match self.kind {
            BufferSlice::Image => BufferRow {
                front: &mut first[at..][..self.length],
                front_base: -BEFORE,
                back: second,
                back_base: -BEFORE,
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

impl<S: Copy> BufferRow<'_, S> {
    /// Front and back samples from pixel `u` on.
    #[inline(always)]
    pub fn from(&self, u: usize) -> [&[S]; 2] {
        let [front, back] = [self.front_base, self.back_base].map(|base| (u as isize - base) as usize);
        [&self.front[front..], &self.back[back..]]
    }

    /// Leaves the back samples of `pixels` where the next slab looks for its front ones.
    #[inline(always)]
    fn keep(self, pixels: &Mask) {
        if self.in_place {
            for (u, length) in Runs::new(pixels) {
                let at = (u as isize - self.front_base) as usize;
                self.front[at..][..length].copy_from_slice(&self.back[at..][..length]);
            }
        }
    }
}
