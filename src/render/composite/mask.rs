//! Which pixels of a scanline a slab has work for.
//!
//! A pixel's ray passes a slab from a cell on the front slice to the same or a neighbouring cell on the back
//! one, and whatever lies between the two scalars it finds there lies within the ranges of those
//! two cells. So a slab's pixels are the union of two rows of cells, each shifted to where its slice
//! lies, less the pixels that are opaque: machine words with a bit for each pixel.

use std::ops::Range;

use super::{WORD, below, first_run, run_mask};

/// Pixels of a scanline, 64 a word.
#[derive(Clone, Debug)]
pub struct Mask {
    words: Vec<u64>,
}

impl Mask {
    /// No pixel of a scanline of `width`.
    pub fn new(width: usize) -> Self {
        Self { words: vec![0; width.div_ceil(WORD) + 1] }
    }

    /// No pixel.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.words.fill(0);
    }

    /// Adds the pixels over marked cells, of which there are `count`, cell 0 beginning with pixel
    /// `first`. Pixels beside the first or the last cell go with it: slices are continued by their borders.
    #[inline(always)]
    pub fn add_cells(&mut self, cells: &[u64], count: usize, first: usize) {
        let (word, shift) = (first / WORD, first % WORD);
        for (at, &bits) in cells.iter().enumerate() {
            self.words[word + at] |= bits << shift;
            if shift > 0 {
                self.words[word + at + 1] |= bits >> (WORD - shift);
            }
        }
        let last = count - 1;
        if cells[0] & 1 == 1 && first > 0 {
            self.words[(first - 1) / WORD] |= 1 << ((first - 1) % WORD);
        }
        if cells[last / WORD] >> (last % WORD) & 1 == 1 {
            self.words[(first + count) / WORD] |= 1 << ((first + count) % WORD);
        }
    }

    /// Adds the pixels of `range`, as far as the scanline goes.
    #[inline(always)]
    pub fn add(&mut self, range: Range<usize>) {
        let end = range.end.min((self.words.len() - 1) * WORD);
        for at in range.start / WORD..end.div_ceil(WORD) {
            self.words[at] |= below(end, at) & !below(range.start, at);
        }
    }

    /// Keeps the pixels of `range` that are set in `open`. False where none is left.
    #[inline(always)]
    pub fn keep(&mut self, open: &[u64], range: &Range<usize>) -> bool {
        let mut any = 0;
        for (at, (word, open)) in self.words.iter_mut().zip(open).enumerate() {
            *word &= open & below(range.end, at) & !below(range.start, at);
            any |= *word;
        }
        any != 0
    }

    /// Keeps the pixels that are set in `open` and in `inside`. False where none is left.
    #[inline(always)]
    pub fn keep_within(&mut self, open: &[u64], inside: &Self) -> bool {
        let mut any = 0;
        for ((word, open), inside) in self.words.iter_mut().zip(open).zip(&inside.words) {
            *word &= open & inside;
            any |= *word;
        }
        any != 0
    }

    /// The words, pixel 0 first.
    #[inline(always)]
    pub fn words(&self) -> &[u64] {
        &self.words
    }

    /// Becomes the pixels of `all` that are not in `without`. False where there is none.
    #[inline(always)]
    pub fn difference(&mut self, all: &Self, without: &Self) -> bool {
        let mut any = 0;
        for ((word, all), without) in self.words.iter_mut().zip(&all.words).zip(&without.words) {
            *word = all & !without;
            any |= *word;
        }
        any != 0
    }

    /// Becomes the pixels of both.
    #[inline(always)]
    pub fn union(&mut self, one: &Self, other: &Self) {
        for ((word, one), other) in self.words.iter_mut().zip(&one.words).zip(&other.words) {
            *word = one | other;
        }
    }

    /// Becomes `other`.
    #[inline(always)]
    pub fn copy_from(&mut self, other: &Self) {
        self.words.copy_from_slice(&other.words);
    }
}

/// The runs of set bits in a mask's words, split where words end: first pixel and length (1..=64).
#[derive(Clone, Debug)]
pub struct Runs<'a> {
    words: &'a [u64],
    at: usize,
    bits: u64,
}

impl<'a> Runs<'a> {
    #[inline(always)]
    pub fn new(mask: &'a Mask) -> Self {
        Self { words: &mask.words, at: 0, bits: mask.words[0] }
    }
}

impl Iterator for Runs<'_> {
    type Item = (usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, usize)> {
        while self.bits == 0 {
            self.at += 1;
            self.bits = *self.words.get(self.at)?;
        }
        let (start, length) = first_run(self.bits);
        self.bits &= !run_mask(start, length);
        Some((self.at * WORD + start, length))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_shifted_to_their_pixels_and_continued_by_their_borders() {
        for (count, first) in [(63usize, 0), (63, 1), (64, 5), (70, 64), (130, 63), (1, 0), (1, 7)] {
            for marked in [0, count / 2, count - 1] {
                let mut cells = vec![0; count.div_ceil(WORD)];
                cells[marked / WORD] |= 1 << (marked % WORD);
                let mut mask = Mask::new(first + count + 2);
                mask.add_cells(&cells, count, first);
                mask.keep(&[u64::MAX; 8], &(0..first + count + 1));
                let pixels: Vec<usize> = Runs::new(&mask).flat_map(|(u, length)| u..u + length).collect();
                let mut expected = vec![marked + first];
                if marked == 0 && first > 0 {
                    expected.insert(0, first - 1);
                }
                if marked == count - 1 {
                    expected.push(first + count);
                }
                assert_eq!(pixels, expected, "{count} cells from {first}, {marked} marked");
            }
        }
    }

    #[test]
    fn keeping_leaves_the_open_pixels_of_the_range() {
        let mut mask = Mask::new(150);
        mask.add_cells(&[u64::MAX; 2], 128, 10);
        assert!(mask.keep(&[u64::MAX, !2, u64::MAX, u64::MAX], &(20..80)));
        let runs: Vec<_> = Runs::new(&mask).collect();
        assert_eq!(runs, [(20, 44), (64, 1), (66, 14)]);
        assert!(!mask.clone().keep(&[u64::MAX; 4], &(90..90)));
        let mut inside = Mask::new(150);
        inside.add(50..64);
        assert!(mask.keep_within(&[!(1 << 60); 4], &inside));
        assert_eq!(Runs::new(&mask).collect::<Vec<_>>(), [(50, 10), (61, 3)]);
        assert!(!mask.keep_within(&[u64::MAX; 4], &Mask::new(150)));
    }
}
