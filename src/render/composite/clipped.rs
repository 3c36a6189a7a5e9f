//! What clipping leaves of a scanline's pixels between two slices: clip planes, balls and opaque geometry alike.

use std::ops::Range;

use super::mask::Mask;
use super::{BAND_HEIGHT, WORD, below};
use crate::render::factorization::{Clipping, Factorization, SlicePlane, Spans};
use crate::render::intermediate::Band;
use crate::render::ranges::hull;
use crate::render::simd::masks::Masks;

/// What clips the scanlines of a band between two slices.
#[derive(Clone, Debug, Default)]
struct Between {
    clipping: Clipping,
    /// The slices, and where they are, from the front.
    slices: [SlicePlane; 2],
    positions: [f32; 2],
    /// The first of the scanlines, and whether it is known what shapes make of them.
    first: usize,
    is_told: bool,
    /// Pixels of them of which clip planes and balls leave something, and those of which they leave all.
    left: [Spans<BAND_HEIGHT>; 2],
    /// Pixels of which a hole may take something, and those of which it takes all.
    holes: Vec<[Spans<BAND_HEIGHT>; 2]>,
}

/// Pixels of a scanline, 64 a word.
#[derive(Clone, Debug, Default)]
pub struct ClippedPixels {
    /// The first scanline of the band.
    first: usize,
    /// By scanline how far from the front it is known of all words which rays have ended.
    ended: Vec<Option<f32>>,
    /// The slab that was entered, and the one behind it, where that was; which of them is in front.
    slabs: [Between; 2],
    front: usize,
    /// True where shapes may take something of the scanline.
    by_shapes: bool,
    /// True where rays of it end or begin between the slices.
    by_limits: bool,
    /// True where rays of the scanline have ended since that was known.
    have_ended: bool,
    /// Of the words that were asked for: those that are open and of which something is left.
    open: Vec<u64>,
    /// Those of them of which not all is left, and whether there are any.
    cut: Vec<u64>,
    cuts_any: bool,
    /// The words of the scanline that are asked for.
    asked: Range<usize>,
    /// Of the scanline: pixels of which something and those of which all is left by clip planes and balls, and what holes take.
    within: [Range<usize>; 2],
    taken: Vec<[Range<usize>; 2]>,
}

impl Between {
    /// Enters some scanlines between two slices; false where nothing of them is left.
    #[inline(always)]
    fn enter(&mut self, factorization: &Factorization, vs: Range<usize>, slices: [f64; 2]) -> bool {
        let first = vs.start;
        let clipping = factorization.clipping(vs, slices);
        self.clipping = clipping.unwrap_or_default();
        self.slices = factorization.slice_planes(slices);
        (self.first, self.is_told) = (first, false);
        self.positions = slices.map(|k| factorization.position(k) as f32);
        clipping.is_some()
    }

    /// Finds what clip planes and balls leave of the scanlines, and what holes take.
    #[inline(always)]
    fn tell(&mut self, factorization: &Factorization) {
        if std::mem::replace(&mut self.is_told, true) {
            return;
        }
        let Clipping { by_planes, holes, .. } = self.clipping;
        self.holes.clear();
        factorization.hollow_pixels(self.first, &self.slices, holes, |spans| self.holes.push(spans));
        self.left = match by_planes {
            Some(planes) => factorization.clipped_pixels(self.first, &self.slices, planes),
            None => [Spans::ALL; 2],
        };
    }
}

impl ClippedPixels {
    /// For a band of scanlines, none of whose rays has ended yet.
    #[inline(always)]
    pub fn enter_band<P>(&mut self, band: &Band<'_, P>) {
        self.first = band.first;
        self.ended.clear();
        self.ended.resize(band.height(), None);
    }

    /// For some scanlines between two slices in the order of the walk; false where nothing of them is left.
    #[inline(always)]
    pub fn enter(&mut self, factorization: &Factorization, vs: Range<usize>, slices: [f64; 2]) -> bool {
        self.slabs[self.front].enter(factorization, vs, slices)
    }

    /// For some scanlines between the two slices behind those; false where nothing of them is left.
    #[inline(always)]
    pub fn enter_ahead(&mut self, factorization: &Factorization, vs: Range<usize>, slices: [f64; 2]) -> bool {
        self.slabs[1 - self.front].enter(factorization, vs, slices)
    }

    /// What was entered ahead is what is entered.
    #[inline(always)]
    pub fn advance(&mut self) {
        self.front = 1 - self.front;
    }

    /// Keeps the pixels of scanline `v`, one of those entered ahead, that are set in `open` and of which shapes leave something there; false where
    /// none is left.
    #[inline(always)]
    pub fn keep_ahead(&mut self, factorization: &Factorization, v: usize, open: &[u64], pixels: &mut Mask) -> bool {
        let ahead = &mut self.slabs[1 - self.front];
        if !ahead.clipping.by_shapes() {
            return true;
        }
        ahead.tell(factorization);
        let (row, width) = (v - ahead.first, factorization.size[0]);
        for [_, all] in &ahead.holes {
            pixels.remove(all.pixels(row, width));
        }
        let [some, _] = &ahead.left;
        pixels.keep(open, &some.pixels(row, width))
    }

    /// For scanline `v`, one of those entered; true where pixels of the words `asked` for must be clipped ([`Self::find`]), else they are as they
    /// are.
    #[inline(always)]
    pub fn enter_scanline(
        &mut self,
        factorization: &Factorization,
        v: usize,
        asked: impl FnOnce() -> Range<usize>,
    ) -> bool {
        let Between { clipping, positions, .. } = &self.slabs[self.front];
        (self.by_shapes, self.by_limits, self.have_ended) = (clipping.by_shapes(), false, false);
        if let Some(limits) = factorization.limits().filter(|_| clipping.by_limits) {
            self.by_limits = limits.tells_apart(v, *positions);
            self.have_ended = limits.end_between(v, self.ended[v - self.first], positions[0]);
        }
        if self.is_any() {
            self.asked = asked();
            self.by_shapes = self.by_shapes && self.shapes_take(factorization, v);
        }
        self.is_any()
    }

    /// True where pixels of the scanline must be clipped.
    #[inline(always)]
    pub fn is_any(&self) -> bool {
        self.by_shapes || self.by_limits || self.have_ended
    }

    /// Clips the pixels of scanline `v`, the one entered, that are set in `open`; false where all of them are left. Nothing is behind those whose
    /// rays have ended: they are not set any more. What it tells of words beside those asked for means nothing.
    #[inline(always)]
    pub fn find<W: Masks>(&mut self, factorization: &Factorization, v: usize, open: &mut [u64]) -> bool {
        let limits = factorization.limits().filter(|_| self.by_limits || self.have_ended);
        let positions = self.slabs[self.front].positions;
        if self.open.len() != open.len() {
            self.open.resize(open.len(), 0);
            self.cut.resize(open.len(), 0);
        }
        let mut told = self.asked.clone();
        if let Some(limits) = limits.filter(|_| !self.by_limits) {
            // The last rays have ended: that is told once for all.
            self.ended[v - self.first] = Some(positions[0]);
            told = hull(&told, &limits.told_apart(v));
        }
        let (mut taken, mut any_cut) = (0, 0);
        for word in told.start..told.end.min(open.len()) {
            let was = open[word];
            let (mut left, mut cut) = (was, 0);
            if was != 0 {
                if let Some(limits) = limits {
                    let seen = limits.seen::<W>(v, word, positions);
                    open[word] &= !seen.ended;
                    left &= seen.some;
                    cut = !seen.whole;
                }
                if self.by_shapes {
                    let [some, whole] = &self.within;
                    left &= within(some, word);
                    cut |= !within(whole, word);
                    for [some, all] in &self.taken {
                        left &= !within(all, word);
                        cut |= within(some, word);
                    }
                }
            }
            self.open[word] = left;
            self.cut[word] = left & cut;
            taken |= was & !left;
            any_cut |= left & cut;
        }
        (self.have_ended, self.cuts_any) = (false, any_cut != 0);
        taken != 0
    }

    /// Finds what clip planes and balls leave of scanline `v`, and what holes take; false where these take nothing of the words asked for.
    #[inline(always)]
    fn shapes_take(&mut self, factorization: &Factorization, v: usize) -> bool {
        let slab = &mut self.slabs[self.front];
        slab.tell(factorization);
        let (row, width) = (v - slab.first, factorization.size[0]);
        let asked = self.asked.start * WORD..(self.asked.end * WORD).min(width);
        self.taken.clear();
        for [some, all] in &slab.holes {
            let some = some.pixels(row, width);
            if some.start < asked.end && asked.start < some.end {
                self.taken.push([some, all.pixels(row, width)]);
            }
        }
        let [some, whole] = &slab.left;
        self.within = [some.pixels(row, width), whole.pixels(row, width)];
        let [_, whole] = &self.within;
        !self.taken.is_empty() || whole.start > asked.start || whole.end < asked.end
    }

    /// What is left, by word.
    #[inline(always)]
    pub fn open(&self) -> &[u64] {
        &self.open
    }

    /// True where not all is left of some open pixel.
    #[inline(always)]
    pub fn cuts_any(&self) -> bool {
        self.cuts_any
    }

    /// Open pixels of which not all is left, 64 from `u` on.
    #[inline(always)]
    pub fn cut_from(&self, u: usize) -> u64 {
        let (word, shift) = (u / WORD, u % WORD);
        let next = self.cut.get(word + 1).copied().unwrap_or(0);
        self.cut[word] >> shift | next << 1 << (WORD - 1 - shift)
    }

    /// True where not all is left of pixel `u`.
    #[inline(always)]
    pub fn is_cut(&self, u: usize) -> bool {
        self.cut[u / WORD] >> (u % WORD) & 1 == 1
    }

    /// True where not all is left of one of up to 64 pixels from `u` on.
    #[inline(always)]
    pub fn cuts(&self, u: usize, length: usize) -> bool {
        self.cut_from(u) & below(length, 0) != 0
    }
}

/// The bits of word `at` that stand for pixels of `range`.
#[inline(always)]
fn within(range: &Range<usize>, at: usize) -> u64 {
    below(range.end, at) & !below(range.start, at)
}
