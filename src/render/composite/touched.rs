//! Which pixels of a scanline a slice has work for: those that touch a drawn voxel and are open.
//!
//! Open pixels are machine words, a bit for each (the paper's links to the next pixel that is not opaque), and so are the runs of
//! voxels. Shifted to where the voxels are, both are intersected four words at a time, whatever runs there are.

use std::ops::Range;

use super::{WORD, below};
use crate::render::simd::masks::{FOUR, Found, Masks, Over, asked};

/// The pixels of a scanline that are neither opaque nor clipped away, and how they lie over one of voxels.
#[derive(Clone, Copy, Debug)]
pub struct Open<'a> {
    /// By pixel of the image, and some words more.
    pub words: &'a [u64],
    /// The pixel that lies on voxel 0 or, where pixels are between voxels, after it.
    pub first: usize,
    /// True where pixels are between voxels: each touches the one before it and the one after.
    pub between: bool,
}

/// Pixels of a scanline to work on, by the voxels that they lie on or after.
#[derive(Debug)]
pub struct Touched {
    words: Vec<u64>,
    /// Words in which there are any.
    range: Range<usize>,
    asked: Vec<u64>,
    /// Words of the scanline.
    of_voxels: usize,
    /// Those that lie on a slice, where pixels are on voxels and where they are between them.
    within: [Vec<u64>; 2],
}

impl Touched {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let of_voxels = length.div_ceil(WORD);
        let words = of_voxels.next_multiple_of(FOUR);
        let within = |pixels| (0..words).map(|at| below(pixels, at)).collect();
        Self {
            words: vec![0; words],
            range: 0..0,
            asked: vec![0; words],
            of_voxels,
            within: [within(length), within(length - 1)],
        }
    }

    /// Finds the open pixels that touch a marked voxel of one of two scanlines; false where there is none. Marks of a scanline go on past
    /// its last word: there are [`MORE`](crate::classify::rle::MORE) words.
    #[inline(always)]
    pub fn find<W: Masks>(&mut self, upper: &[u64], lower: &[u64], open: &Open<'_>) -> bool {
        let pixels = &open.words[open.first / WORD..];
        let over = Over { shift: (open.first % WORD) as u32, between: open.between };
        let within = if open.between { &self.within[1] } else { &self.within[0] };
        let found = Found { touched: &mut self.words, asked: &mut self.asked };
        let [from, to] = W::touch([upper, lower], pixels, over, within, found);
        self.range = from..to;
        to != 0
    }

    /// Those that are open still; false where none is.
    #[inline(always)]
    pub fn keep(&mut self, open: &Open<'_>) -> bool {
        let (pixels, shift) = (&open.words[open.first / WORD..], open.first % WORD);
        let (mut any, mut carry) = (0, 0);
        for word in self.range.clone() {
            let open = pixels[word] >> shift | pixels[word + 1] << 1 << (WORD - 1 - shift);
            let kept = self.words[word] & open;
            self.words[word] = kept;
            self.asked[word] = asked(kept) | carry;
            carry = kept >> (WORD - 1);
            any |= kept;
        }
        if let Some(asked) = self.asked.get_mut(self.range.end) {
            *asked = carry;
        }
        any != 0
    }

    /// By word, and which of the words there are any in.
    #[inline(always)]
    pub fn words(&self) -> (&[u64], Range<usize>) {
        (&self.words, self.range.clone())
    }

    /// The first bits of aligned fours of voxels that hold all that the pixels touch, by word, and which of the words there are any in.
    #[inline(always)]
    pub fn asked(&self) -> (&[u64], Range<usize>) {
        // The last pixel of a word touches the first voxel of the next.
        let Range { start, end } = self.range;
        (&self.asked, start..end + usize::from(self.words[end - 1] >> (WORD - 1) != 0 && end < self.of_voxels))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::simd::wide::Portable;

    proptest! {
        #[test]
        fn those_that_are_kept_are_found_among_fewer_open_ones(
            marks in prop::collection::vec(any::<u64>(), 5),
            sparse in prop::collection::vec(any::<u64>(), 5),
            open in prop::collection::vec(any::<u64>(), 8),
            fewer in prop::collection::vec(any::<u64>(), 8),
            first in 0usize..190,
            between: bool,
        ) {
            let marks: Vec<_> = marks.iter().zip(sparse).map(|(marks, sparse)| marks & sparse & sparse >> 13).collect();
            let fewer: Vec<_> = open.iter().zip(fewer).map(|(open, fewer)| open & fewer).collect();
            let [mut kept, mut found] = [(); 2].map(|()| Touched::new(4 * WORD));
            if !kept.find::<Portable>(&marks, &marks, &Open { words: &open, first, between }) {
                return Ok(());
            }
            let fewer = Open { words: &fewer, first, between };
            let any = found.find::<Portable>(&marks, &marks, &fewer);
            prop_assert_eq!(kept.keep(&fewer), any);
            prop_assert_eq!(&kept.words, &found.words);
            if any {
                let asked = |touched: &Touched| {
                    let (asked, words) = touched.asked();
                    words.map(|word| (word, asked[word])).filter(|(_, asked)| *asked != 0).collect::<Vec<_>>()
                };
                prop_assert_eq!(asked(&kept), asked(&found));
            }
        }
    }
}
