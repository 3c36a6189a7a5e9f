//! Which pixels of a scanline a slab has work for.
//!
//! A pixel's ray passes a slab from a cell on the front slice to the same or a neighbouring cell on the back
//! one, and whatever lies between the two scalars it finds there lies within the ranges of those
//! two cells. So a slab's pixels are the union of two rows of cells, each shifted to where its slice
//! lies, less the pixels that are opaque: machine words with a bit for each pixel.

use std::ops::Range;

use super::{WORD, below, first_run, run_mask};
use crate::render::simd::masks::{Masks, fours};

/// Words that are taken at once.
const CHUNK: usize = 4;

/// So many words of no pixels are before the first and at least as many behind the last.
const BESIDE: usize = CHUNK;

/// Pixels of a scanline, 64 a word.
#[derive(Clone, Debug)]
pub struct Mask {
    /// In chunks, [`BESIDE`] included.
    words: Vec<u64>,
}

/// Words for so many bits, in chunks of [`CHUNK`], with the bits set.
pub fn first_bits(count: usize) -> Vec<u64> {
    (0..count.div_ceil(WORD).next_multiple_of(CHUNK)).map(|at| below(count, at)).collect()
}

/// [`CHUNK`] words, each continued by those before it, that many bits higher.
#[inline(always)]
fn raised(words: [u64; CHUNK], before: u64, shift: usize) -> [u64; CHUNK] {
    let lower = [before, words[0], words[1], words[2]];
    let mut raised = [0; CHUNK];
    for n in 0..CHUNK {
        raised[n] = words[n] << shift | lower[n] >> 1 >> (WORD - 1 - shift);
    }
    raised
}

impl Mask {
    /// No pixel of a scanline of `width`.
    pub fn new(width: usize) -> Self {
        Self { words: vec![0; (width / WORD + 1).next_multiple_of(CHUNK) + 2 * BESIDE] }
    }

    /// No pixel.
    #[inline(always)]
    pub fn clear(&mut self) {
        for words in self.words.as_chunks_mut::<CHUNK>().0 {
            *words = [0; CHUNK];
        }
    }

    /// Becomes the pixels over marked cells of two scanlines, of either of which there are as many as `within` has bits; cell 0 begins with the pixel
    /// given with it. Pixels beside the first or the last cell go with it: slices are continued by their borders. What follows a scanline does
    /// not count.
    #[inline(always)]
    fn set_cells(&mut self, scanlines: [(&[u64], usize); 2], within: &[u64], count: usize) {
        let within = within.as_chunks::<CHUNK>().0;
        self.clear();
        let last = count - 1;
        for (cells, first) in scanlines {
            let (word, shift) = (BESIDE + first / WORD, first % WORD);
            let mut before = 0;
            for (at, (within, cells)) in within.iter().zip(cells.as_chunks::<CHUNK>().0).enumerate() {
                let mut bits = [0; CHUNK];
                for n in 0..CHUNK {
                    bits[n] = cells[n] & within[n];
                }
                let Some(words) = self.words[word + at * CHUNK..].first_chunk_mut::<CHUNK>() else {
                    unreachable!("there are words beside a scanline's")
                };
                let raised = raised(bits, before, shift);
                before = bits[CHUNK - 1];
                for n in 0..CHUNK {
                    words[n] |= raised[n];
                }
            }
            self.words[word + within.len() * CHUNK] |= before >> 1 >> (WORD - 1 - shift);
            if cells[0] & 1 == 1 && first > 0 {
                self.words[BESIDE + (first - 1) / WORD] |= 1 << ((first - 1) % WORD);
            }
            if cells[last / WORD] >> (last % WORD) & 1 == 1 {
                self.words[BESIDE + (first + count) / WORD] |= 1 << ((first + count) % WORD);
            }
        }
    }

    /// The same where of the pixels those are kept that are set in `open` and in `inside`. False where none is left; what it is then means nothing.
    #[inline(always)]
    pub fn set_cells_within<W: Masks>(
        &mut self,
        scanlines: [(&[u64], usize); 2],
        within: &[u64],
        count: usize,
        open: &[u64],
        inside: &Self,
    ) -> bool {
        let [word, other] = scanlines.map(|(_, first)| first / WORD);
        let at = BESIDE + word;
        if word != other {
            // Seldom.
            self.set_cells(scanlines, within, count);
            return self.keep_within(open, inside);
        }
        self.clear();
        let is_open = [&open[word..], &inside.words[at..]];
        let raised = scanlines.map(|(cells, first)| (cells, (first % WORD) as u32));
        let mut any = W::over_cells(raised, within, is_open, &mut self.words[at..]);
        let (top, last) = (within.len(), count - 1);
        for (cells, first) in scanlines {
            // What is raised above the last word.
            let more = (cells[top - 1] & within[top - 1]) >> 1 >> (WORD - 1 - first % WORD);
            if more != 0 {
                let kept = more & open[word + top] & inside.words[at + top];
                self.words[at + top] |= kept;
                any |= kept != 0;
            }
            if cells[0] & 1 == 1 && first > 0 {
                any |= self.add_if(first - 1, open, inside);
            }
            if cells[last / WORD] >> (last % WORD) & 1 == 1 {
                any |= self.add_if(first + count, open, inside);
            }
        }
        any
    }

    /// Adds a pixel that is set in `open` and in `inside`, and tells whether it is.
    #[inline(always)]
    fn add_if(&mut self, pixel: usize, open: &[u64], inside: &Self) -> bool {
        let (word, bit) = (pixel / WORD, 1 << (pixel % WORD));
        let kept = bit & open[word] & inside.words[BESIDE + word];
        self.words[BESIDE + word] |= kept;
        kept != 0
    }

    /// Adds the pixels of `range`, as far as the scanline goes.
    #[inline(always)]
    pub fn add(&mut self, range: Range<usize>) {
        let end = range.end.min((self.words.len() - 2 * BESIDE) * WORD);
        for at in range.start / WORD..end.div_ceil(WORD) {
            self.words[BESIDE + at] |= below(end, at) & !below(range.start, at);
        }
    }

    /// Removes the pixels of `range`, which is within the scanline.
    #[inline(always)]
    pub fn remove(&mut self, range: Range<usize>) {
        for at in range.start / WORD..range.end.div_ceil(WORD) {
            self.words[BESIDE + at] &= !below(range.end, at) | below(range.start, at);
        }
    }

    /// Keeps the pixels of `range` that are set in `open`, which has a word more. False where none is left.
    #[inline(always)]
    pub fn keep(&mut self, open: &[u64], range: &Range<usize>) -> bool {
        let mut any = 0;
        for (at, (word, open)) in self.words[BESIDE..].iter_mut().zip(open).enumerate() {
            *word &= open & below(range.end, at) & !below(range.start, at);
            any |= *word;
        }
        any != 0
    }

    /// Keeps the pixels that are set in `open` and in `inside`. False where none is left. (`open` has words for whole chunks.)
    #[inline(always)]
    pub fn keep_within(&mut self, open: &[u64], inside: &Self) -> bool {
        let mut any = [0; CHUNK];
        let (words, _) = self.words[BESIDE..].as_chunks_mut::<CHUNK>();
        let (inside, _) = inside.words[BESIDE..].as_chunks::<CHUNK>();
        for ((words, open), inside) in words.iter_mut().zip(open.as_chunks::<CHUNK>().0).zip(inside) {
            for n in 0..CHUNK {
                words[n] &= open[n] & inside[n];
                any[n] |= words[n];
            }
        }
        any[0] | any[1] | any[2] | any[3] != 0
    }

    /// Tells which aligned fours of voxels lie beside the pixels, the first bit of each, if voxel 0 lies before pixel `first` and each is followed by another; there are
    /// as many as `within` has bits.
    #[inline(always)]
    pub fn around(&self, first: usize, within: &[u64], asked: &mut [u64]) {
        let bit = BESIDE * WORD + first;
        let windows = [bit - 1, bit].map(|bit| (&self.words[bit / WORD..], bit % WORD));
        let chunks = asked.as_chunks_mut::<CHUNK>().0.iter_mut().zip(within.as_chunks::<CHUNK>().0);
        for (at, (asked, within)) in chunks.enumerate() {
            let mut around = [0; CHUNK];
            for (words, shift) in windows {
                let (Some(low), Some(high)) =
                    (words[at * CHUNK..].first_chunk::<CHUNK>(), words[at * CHUNK + 1..].first_chunk::<CHUNK>())
                else {
                    unreachable!("there are words beside a scanline's")
                };
                for n in 0..CHUNK {
                    around[n] |= low[n] >> shift | high[n] << 1 << (WORD - 1 - shift);
                }
            }
            for n in 0..CHUNK {
                asked[n] = fours(around[n] & within[n]);
            }
        }
    }

    /// The words that pixels are in.
    #[inline(always)]
    pub fn filled(&self) -> Range<usize> {
        let words = self.words();
        let first = words.iter().position(|word| *word != 0).unwrap_or(words.len());
        first..words.iter().rposition(|word| *word != 0).map_or(first, |last| last + 1)
    }

    /// The words, pixel 0 first.
    #[inline(always)]
    pub fn words(&self) -> &[u64] {
        &self.words[BESIDE..self.words.len() - BESIDE]
    }

    /// Becomes the pixels of `all` that are not in `without`. False where there is none.
    #[inline(always)]
    pub fn difference(&mut self, all: &Self, without: &Self) -> bool {
        let mut any = [0; CHUNK];
        self.combine::<true>(all, without);
        for words in self.words.as_chunks::<CHUNK>().0 {
            for n in 0..CHUNK {
                any[n] |= words[n];
            }
        }
        any[0] | any[1] | any[2] | any[3] != 0
    }

    /// Becomes the pixels of both.
    #[inline(always)]
    pub fn union(&mut self, one: &Self, other: &Self) {
        self.combine::<false>(one, other);
    }

    #[inline(always)]
    fn combine<const WITHOUT: bool>(&mut self, one: &Self, other: &Self) {
        let (one, other) = (one.words.as_chunks::<CHUNK>().0, other.words.as_chunks::<CHUNK>().0);
        for ((words, one), other) in self.words.as_chunks_mut::<CHUNK>().0.iter_mut().zip(one).zip(other) {
            for n in 0..CHUNK {
                words[n] = if WITHOUT { one[n] & !other[n] } else { one[n] | other[n] };
            }
        }
    }

    /// Becomes `other`.
    #[inline(always)]
    pub fn copy_from(&mut self, other: &Self) {
        let from = other.words.as_chunks::<CHUNK>().0;
        for (words, from) in self.words.as_chunks_mut::<CHUNK>().0.iter_mut().zip(from) {
            *words = *from;
        }
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
        let words = mask.words();
        Self { words, at: 0, bits: words[0] }
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
    use crate::render::simd::wide::Portable;

    fn pixels(mask: &Mask) -> Vec<usize> {
        Runs::new(mask).flat_map(|(u, length)| u..u + length).collect()
    }

    #[test]
    fn cells_are_shifted_to_their_pixels_and_continued_by_their_borders() {
        for (count, firsts) in
            [(63usize, [0, 1]), (63, [1, 0]), (64, [5, 5]), (70, [64, 63]), (130, [63, 64]), (1, [0, 0]), (1, [7, 8])]
        {
            for marked in [0, count / 2, count - 1] {
                // What follows a scanline does not count.
                let mut cells = vec![u64::MAX; count.div_ceil(WORD) + CHUNK];
                cells[..count.div_ceil(WORD)].fill(0);
                if count % WORD > 0 {
                    cells[count / WORD] = u64::MAX << (count % WORD);
                }
                let none = cells.clone();
                cells[marked / WORD] |= 1 << (marked % WORD);
                let within = first_bits(count);
                let mut mask = Mask::new(firsts[0].max(firsts[1]) + count + 2);
                let mut expected = vec![];
                for first in firsts {
                    expected.push(marked + first);
                    if marked == 0 && first > 0 {
                        expected.push(first - 1);
                    }
                    if marked == count - 1 {
                        expected.push(first + count);
                    }
                }
                expected.sort_unstable();
                expected.dedup();
                mask.set_cells(firsts.map(|first| (&cells[..], first)), &within, count);
                assert_eq!(pixels(&mask), expected, "{count} cells from {firsts:?}, {marked} marked");
                mask.set_cells(firsts.map(|first| (&none[..], first)), &within, count);
                assert!(pixels(&mask).is_empty());
                mask.set_cells([(&none, firsts[0]), (&cells, firsts[1])], &within, count);
                assert!(pixels(&mask).contains(&(marked + firsts[1])));
                let mut inside = Mask::new(firsts[0].max(firsts[1]) + count + 2);
                for open in [u64::MAX, 0x5555_5555_5555_5555] {
                    for kept in [0..usize::MAX, 3..firsts[0] + count] {
                        inside.clear();
                        inside.add(kept.clone());
                        let expected: Vec<_> = expected
                            .iter()
                            .copied()
                            .filter(|u| open >> (u % WORD) & 1 == 1 && kept.contains(u))
                            .collect();
                        let scanlines = firsts.map(|first| (&cells[..], first));
                        let any = mask.set_cells_within::<Portable>(scanlines, &within, count, &[open; 12], &inside);
                        assert_eq!(any, !expected.is_empty());
                        assert!(!any || pixels(&mask) == expected, "{count} cells from {firsts:?}, {marked} marked");
                    }
                }
            }
        }
    }

    #[test]
    fn pixels_lie_between_two_voxels_of_fours() {
        for first in [0, 1, 5, 63, 64, 70] {
            let within = first_bits(130);
            for pixel in (first.max(1) - 1..first + 130).step_by(3) {
                let mut mask = Mask::new(260);
                mask.add(pixel..pixel + 1);
                let mut asked = vec![u64::MAX; within.len()];
                mask.around(first, &within, &mut asked);
                let asked: Vec<usize> = (0..130).filter(|&at| asked[at / WORD] >> (at % WORD) & 1 == 1).collect();
                let voxels = (pixel..pixel + 2).filter_map(|at| at.checked_sub(first)).filter(|&at| at < 130);
                let mut expected: Vec<usize> = voxels.map(|at| at / 4 * 4).collect();
                expected.dedup();
                assert_eq!(asked, expected, "pixel {pixel}, voxel 0 at {first}");
            }
        }
    }

    #[test]
    fn keeping_leaves_the_open_pixels_of_the_range() {
        let mut mask = Mask::new(150);
        mask.add(10..138);
        assert!(mask.keep(&[u64::MAX, !2, u64::MAX, u64::MAX], &(20..80)));
        let runs: Vec<_> = Runs::new(&mask).collect();
        assert_eq!(runs, [(20, 44), (64, 1), (66, 14)]);
        assert!(!mask.clone().keep(&[u64::MAX; 4], &(90..90)));
        let mut others = mask.clone();
        others.remove(30..67);
        assert_eq!(Runs::new(&others).collect::<Vec<_>>(), [(20, 10), (67, 13)]);
        others.remove(70..70);
        assert_eq!(Runs::new(&others).collect::<Vec<_>>(), [(20, 10), (67, 13)]);
        others.remove(0..150);
        assert_eq!(Runs::new(&others).next(), None);
        let mut inside = Mask::new(150);
        inside.add(50..64);
        assert!(mask.keep_within(&[!(1 << 60); 4], &inside));
        assert_eq!(Runs::new(&mask).collect::<Vec<_>>(), [(50, 10), (61, 3)]);
        assert!(!mask.keep_within(&[u64::MAX; 4], &Mask::new(150)));
    }

    #[test]
    fn masks_are_sets() {
        let [mut one, mut other, mut both] = [0; 3].map(|_| Mask::new(300));
        one.add(10..200);
        other.add(100..290);
        both.union(&one, &other);
        assert_eq!(pixels(&both), (10..290).collect::<Vec<_>>());
        assert!(both.difference(&one, &other));
        assert_eq!(pixels(&both), (10..100).collect::<Vec<_>>());
        assert!(!both.difference(&one, &one));
        both.copy_from(&other);
        assert!(!both.difference(&both.clone(), &other));
    }
}
