//! What clipping leaves of a scanline's pixels between two slices: clip planes, balls and opaque geometry alike.

use std::ops::Range;

use super::{WORD, below};
use crate::render::factorization::{Clipping, Factorization};

/// Pixels of a scanline, 64 a word.
#[derive(Clone, Debug, Default)]
pub struct ClippedPixels {
    clipping: Clipping,
    /// Those that are open and of which something is left.
    open: Vec<u64>,
    /// Those of them of which not all is left.
    cut: Vec<u64>,
    /// Pixels of which a hole may take something, and those of which it takes all.
    holes: Vec<[Range<usize>; 2]>,
}

impl ClippedPixels {
    /// For some scanlines between two slices in the order of the walk; false where nothing of them is left.
    #[inline(always)]
    pub fn enter(&mut self, factorization: &Factorization, vs: Range<usize>, slices: [f64; 2]) -> bool {
        let clipping = factorization.clipping(vs, slices);
        self.clipping = clipping.unwrap_or_default();
        clipping.is_some()
    }

    /// True where pixels of them must be clipped ([`Self::find`]); else they are as they are.
    #[inline(always)]
    pub fn is_any(&self) -> bool {
        self.clipping.is_any()
    }

    /// Clips the pixels of scanline `v`, one of those entered, that are set in `open`. False where none is left.
    #[inline(always)]
    pub fn find(&mut self, factorization: &Factorization, v: usize, slices: [f64; 2], open: &[u64]) -> bool {
        self.open.resize(open.len(), 0);
        self.cut.resize(open.len(), 0);
        let Clipping { by_planes, holes, by_limits } = self.clipping;
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
                if let Some(limits) = factorization.limits().filter(|_| by_limits) {
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
