//! Where a cell may show something, as words of a scanline: from the runs of cells, or, where there are
//! none yet, from what octree and summed-area table say of the leaves.
//!
//! A leaf's answer serves all scanlines that pass through it, so the flags of a row of leaves become
//! words once and adjacent scanlines share them (Lacroute and Levoy 1994, section 3.3).

use super::mask::first_bits;
use crate::classify::marks::{MORE, WORD, words};
use crate::classify::visible::AxisVisible;
use crate::classify::{Classification, Encodings};
use crate::render::factorization::Factorization;
use crate::volume::octree::{LEAF, leaf_of, leaves_along};

/// A bit for every cell of a scanline: clear only where nothing shows.
#[derive(Clone, Debug)]
pub struct Occupied<'a> {
    marks: Marks<'a>,
    /// As many bits as a scanline has cells.
    within: Vec<u64>,
}

/// Where the bits come from.
#[derive(Clone, Debug)]
enum Marks<'a> {
    Cells(AxisVisible<'a>),
    Leaves(LeafRows),
}

impl<'a> Occupied<'a> {
    /// By runs of cells where they are there, else by leaves.
    pub fn new(
        classification: &'a Classification,
        encodings: Option<&'a Encodings>,
        factorization: &Factorization,
    ) -> Self {
        let marks = match encodings.and_then(Encodings::cells) {
            Some(cells) => Marks::Cells(cells.for_axis(factorization.principal_axis)),
            None => Marks::Leaves(LeafRows::new(classification.occupied(), factorization)),
        };
        Self { marks, within: first_bits(factorization.dims[0] - 1) }
    }

    /// The cells from voxel scanline `j` to `j + 1` and from slice `k` to `k + 1`, i ascending.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> &[u64] {
        match &self.marks {
            Marks::Cells(cells) => cells.marks.scanline(j, k),
            Marks::Leaves(leaves) => leaves.scanline(j, k),
        }
    }

    /// The same and what follows, at least three words.
    #[inline(always)]
    pub fn scanline_and_more(&self, j: usize, k: usize) -> &[u64] {
        match &self.marks {
            Marks::Cells(cells) => cells.marks.scanline_and_more(j, k),
            Marks::Leaves(leaves) => leaves.scanline_and_more(j, k),
        }
    }

    /// Whether one of [`Self::scanline`]'s cells is marked.
    #[inline(always)]
    pub fn holds(&self, j: usize, k: usize) -> bool {
        match &self.marks {
            Marks::Cells(cells) => cells.shown.holds(j, k),
            Marks::Leaves(leaves) => leaves.holds(j, k),
        }
    }

    /// As many bits as a scanline has cells, in whole chunks of a mask's words.
    #[inline(always)]
    pub fn within(&self) -> &[u64] {
        &self.within
    }
}

/// The leaves' flags, a bit for each voxel (or cell) of a scanline, by rows of leaves.
#[derive(Clone, Debug)]
pub struct LeafRows {
    bits: Vec<u64>,
    words: usize,
    /// By row of leaves, whether any of them is occupied.
    holding: Vec<bool>,
    /// Rows of leaves in a slice of leaves.
    rows: usize,
    /// Voxels along j and k.
    dims: [usize; 2],
}

impl LeafRows {
    /// From a flag for each leaf of the octree, x fastest.
    pub fn new(occupied: &[bool], factorization: &Factorization) -> Self {
        let [ni, nj, nk] = factorization.dims;
        let strides = factorization.strides(factorization.dims.map(leaves_along));
        let (rows, words) = (leaves_along(nj), words(ni));
        let count = rows * leaves_along(nk) * words;
        let (mut bits, mut holding) = (vec![0; count + MORE], vec![]);
        for (row, bits) in bits[..count].chunks_exact_mut(words).enumerate() {
            let first = row % rows * strides[1] + row / rows * strides[2];
            let last = leaves_along(ni) - 1;
            for leaf in (0..=last).filter(|leaf| occupied[first + leaf * strides[0]]) {
                // Eight voxels; the last leaf has the scanline's last voxel besides.
                bits[leaf * LEAF / WORD] |= 0xff << (leaf * LEAF % WORD);
                if leaf == last {
                    bits[(ni - 1) / WORD] |= 1 << ((ni - 1) % WORD);
                }
            }
            holding.push(bits.iter().any(|word| *word != 0));
        }
        Self { bits, words, holding, rows, dims: [nj, nk] }
    }

    /// The voxels (or cells) of scanline `j` of slice `k`. Bits past the scanline's end may be set.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> &[u64] {
        &self.scanline_and_more(j, k)[..self.words]
    }

    /// The same and what follows, at least [`MORE`] words.
    #[inline(always)]
    fn scanline_and_more(&self, j: usize, k: usize) -> &[u64] {
        &self.bits[self.row(j, k) * self.words..]
    }

    /// Whether one of [`Self::scanline`]'s bits is set.
    #[inline(always)]
    fn holds(&self, j: usize, k: usize) -> bool {
        self.holding[self.row(j, k)]
    }

    /// The row of leaves that scanline `j` of slice `k` passes.
    #[inline(always)]
    fn row(&self, j: usize, k: usize) -> usize {
        leaf_of(k, self.dims[1]) * self.rows + leaf_of(j, self.dims[0])
    }
}
