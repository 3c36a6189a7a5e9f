//! Which pixels of a scanline a slice has work for: those that touch a drawn voxel and are open.
//!
//! Open pixels are machine words, a bit for each (the paper's links to the next pixel that is not opaque), and so are the runs of
//! voxels. Shifted to where the voxels are, both are intersected four words at a time, whatever runs there are.

use std::ops::Range;

use super::{WORD, below};
use crate::render::simd::masks::{FOUR, Found, Masks, Over};

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
