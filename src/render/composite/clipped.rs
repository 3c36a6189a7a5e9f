//! What clipping leaves of a scanline's pixels between two slices: clip planes, balls and opaque geometry alike.

use std::ops::Range;

use super::{WORD, below};
use crate::render::factorization::{Clipping, Factorization};
use crate::render::intermediate::Band;

/// Pixels of a scanline, 64 a word.
#[derive(Clone, Debug, Default)]
pub struct ClippedPixels {
    /// The first scanline of the band, and by scanline how far from the front it is known which rays have ended.
    first: usize,
    ended: Vec<Option<f32>>,
    clipping: Clipping,
    /// True where rays of the scanline end or begin between the slices.
    by_limits: bool,
    /// Those that are open and of which something is left.
    open: Vec<u64>,
    /// Those of them of which not all is left.
    cut: Vec<u64>,
    /// Pixels of which a hole may take something, and those of which it takes all.
    holes: Vec<[Range<usize>; 2]>,
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
        let clipping = factorization.clipping(vs, slices);
        self.clipping = clipping.unwrap_or_default();
        clipping.is_some()
    }

    /// For scanline `v`, one of those entered. Nothing is behind those of its rays that have ended: their pixels are not `open` any more.
    #[inline(always)]
    pub fn enter_scanline(&mut self, factorization: &Factorization, v: usize, slices: [f64; 2], open: &mut [u64]) {
        self.by_limits = false;
        if let Some(limits) = factorization.limits().filter(|_| self.clipping.by_limits) {
            let positions @ [first, _] = slices.map(|k| factorization.position(k) as f32);
            let ended = &mut self.ended[v - self.first];
            if limits.end_between(v, *ended, first) {
                for (word, open) in open.iter_mut().enumerate().filter(|(_, open)| **open != 0) {
                    *open &= !limits.ended(v, word, first);
                }
            }
            *ended = Some(first);
            self.by_limits = limits.tells_apart(v, positions);
        }
    }

    /// True where pixels of the scanline must be clipped ([`Self::find`]); else they are as they are.
    #[inline(always)]
    pub fn is_any(&self) -> bool {
        self.clipping.by_shapes() || self.by_limits
    }

    /// Clips the pixels of scanline `v`, the one entered, that are set in `open`. False where none is left.
    #[inline(always)]
    pub fn find(&mut self, factorization: &Factorization, v: usize, slices: [f64; 2], open: &[u64]) -> bool {
        self.open.resize(open.len(), 0);
        self.cut.resize(open.len(), 0);
        let Clipping { by_planes, holes, .. } = self.clipping;
        let everything = [0..usize::MAX, 0..usize::MAX];
        let [some, whole] = if by_planes { factorization.clipped_pixels(v, slices) } else { everything };
        self.holes.clear();
        factorization.hollow_pixels(v, slices, holes, |pixels| self.holes.push(pixels));
        let positions = slices.map(|k| factorization.position(k) as f32);
        let mut any = 0;
        for (word, &open) in open.iter().enumerate() {
            let mut open = open & within(&some, word);
            let mut cut = 0;
            if open != 0 {
                cut = !within(&whole, word);
                for [some, all] in &self.holes {
                    open &= !within(all, word);
                    cut |= within(some, word);
                }
                if let Some(limits) = factorization.limits().filter(|_| self.by_limits) {
                    let [some, whole] = limits.seen(v, word, positions);
                    open &= some;
                    cut |= !whole;
                }
            }
            self.open[word] = open;
            self.cut[word] = open & cut;
            any |= open;
        }
        any != 0
    }

    /// What is left, by word.
    #[inline(always)]
    pub fn open(&self) -> &[u64] {
        &self.open
    }

    /// True where not all is left of some open pixel.
    #[inline(always)]
    pub fn cuts_any(&self) -> bool {
        self.cut.iter().any(|&bits| bits != 0)
    }

    /// Open pixels of which not all is left, by word.
    #[inline(always)]
    pub fn cut(&self) -> &[u64] {
        &self.cut
    }

    /// True where not all is left of pixel `u`.
    #[inline(always)]
    pub fn is_cut(&self, u: usize) -> bool {
        self.cut[u / WORD] >> (u % WORD) & 1 == 1
    }

    /// True where not all is left of one of up to 64 pixels from `u` on.
    #[inline(always)]
    pub fn cuts(&self, u: usize, length: usize) -> bool {
        let (word, shift) = (u / WORD, u % WORD);
        let mut bits = self.cut[word] >> shift;
        if shift > 0 {
            bits |= self.cut.get(word + 1).copied().unwrap_or(0) << (WORD - shift);
        }
        bits & below(length, 0) != 0
    }
}

/// The bits of word `at` that stand for pixels of `range`.
#[inline(always)]
fn within(range: &Range<usize>, at: usize) -> u64 {
    below(range.end, at) & !below(range.start, at)
}
