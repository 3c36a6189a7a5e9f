//! What clipping leaves of a scanline's pixels between two slices: clip planes, balls and opaque geometry alike.

use std::ops::Range;

use super::{WORD, below};
use crate::render::factorization::Factorization;

/// Pixels of a scanline, 64 a word.
#[derive(Clone, Debug, Default)]
pub struct ClippedPixels {
    /// Those that are open and of which something is left.
    open: Vec<u64>,
    /// Those of them of which not all is left.
    cut: Vec<u64>,
}

impl ClippedPixels {
    /// Clips the pixels of scanline `v` that are set in `open`, between two slices in the order of the walk.
    /// False where none is left.
    #[inline(always)]
    pub fn find(&mut self, factorization: &Factorization, v: usize, slices: [f64; 2], open: &[u64]) -> bool {
        self.open.resize(open.len(), 0);
        self.cut.resize(open.len(), 0);
        let [some, whole] = factorization.clipped_pixels(v, slices);
        let positions = slices.map(|k| factorization.position(k) as f32);
        let mut any = 0;
        for (word, &open) in open.iter().enumerate() {
            let mut open = open & within(&some, word);
            let mut cut = 0;
            if open != 0 {
                cut = !within(&whole, word);
                if let Some(limits) = factorization.limits() {
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
