//! What a packet need not look at: layers of cells in which nothing shows.
//!
//! A layer lies between two slices. The cells that eight rays touch within it are a rectangle of a
//! few; whether any of them shows something is a few bits of the runs of cells, or, as long as there
//! are none, a few flags of the octree's leaves. A leaf is [`LEAF`] layers deep, so where leaves are
//! transparent throughout, the packet goes on at the next leaf.

use super::packet::{IN_SLICE, Packet};
use crate::classify::marks::{AxisMarks, WORD};
use crate::classify::{Classification, Encodings};
use crate::volume::octree::{LEAF, leaf_of, leaves_along};

/// Where something may show.
#[derive(Clone, Copy, Debug)]
pub struct Skip<'a> {
    dims: [usize; 3],
    /// Leaves from one to the next along an axis.
    leaf_strides: [usize; 3],
    /// Flags of leaves; `None`: nothing is skipped.
    leaves: Option<&'a [bool]>,
    cells: Option<[AxisMarks<'a>; 3]>,
}

/// Leaves that a packet touches: a rectangle of them.
#[derive(Clone, Copy, Debug)]
pub struct Leaves {
    first: usize,
    /// Along `i` and `j`.
    pub counts: [usize; 2],
    steps: [usize; 2],
}

impl Leaves {
    /// The index of a leaf in the octree.
    #[inline(always)]
    pub fn at(&self, i: usize, j: usize) -> usize {
        self.first + i * self.steps[0] + j * self.steps[1]
    }
}

impl<'a> Skip<'a> {
    /// By leaves and, where they are there, by runs of cells of a volume of `dims` voxels.
    pub fn new(dims: [usize; 3], classification: &'a Classification, encodings: Option<&'a Encodings>) -> Self {
        let cells = encodings.and_then(Encodings::cells).map(|cells| [0, 1, 2].map(|axis| cells.for_axis(axis)));
        Self { leaves: Some(classification.occupied()), cells, ..Self::nothing(dims) }
    }

    /// Nothing is skipped.
    pub fn nothing(dims: [usize; 3]) -> Self {
        let counts = dims.map(leaves_along);
        Self { dims, leaf_strides: [1, counts[0], counts[0] * counts[1]], leaves: None, cells: None }
    }

    /// The first layer from `layer` on (and before `end`) in which something may show.
    #[inline(always)]
    pub fn next_layer(&self, packet: &Packet, mut layer: usize, end: usize) -> usize {
        let Some(leaves) = self.leaves else { return layer };
        while layer < end {
            let leaf_end = self.leaf_end(packet, layer).min(end);
            let touched = self.leaves(packet, layer, leaf_end);
            let mut shows = false;
            for j in 0..touched.counts[1] {
                for i in 0..touched.counts[0] {
                    shows |= leaves[touched.at(i, j)];
                }
            }
            if !shows {
                layer = leaf_end;
                continue;
            }
            let Some(cells) = &self.cells else { return layer };
            while layer < leaf_end {
                if self.layer_shows(&cells[packet.axis], packet, layer) {
                    return layer;
                }
                layer += 1;
            }
        }
        end
    }

    /// The layer of the volume's own order.
    #[inline(always)]
    fn stored(&self, packet: &Packet, layer: usize) -> usize {
        if packet.reversed { self.dims[packet.axis] - 2 - layer } else { layer }
    }

    /// Where the leaf that `layer` is in ends, in the order of travel.
    #[inline(always)]
    pub fn leaf_end(&self, packet: &Packet, layer: usize) -> usize {
        let n = self.dims[packet.axis];
        let stored = self.stored(packet, layer);
        let leaf = leaf_of(stored, n);
        if packet.reversed {
            layer + (stored - leaf * LEAF) + 1
        } else if leaf + 1 == leaves_along(n) {
            n - 1
        } else {
            (leaf + 1) * LEAF
        }
    }

    /// The leaves that the packet touches from `layer` to `end`, which are within one: the first, and how
    /// many along `i` and `j`, with the steps between them.
    #[inline(always)]
    pub fn leaves(&self, packet: &Packet, layer: usize, end: usize) -> Leaves {
        let [i, j] = IN_SLICE[packet.axis];
        let span = [layer as f32, end as f32];
        let (ni, nj) = (self.dims[i], self.dims[j]);
        let [first_i, last_i] = packet.bounds(0, span, ni - 1);
        let [first_j, last_j] = packet.bounds(1, span, nj - 1);
        let (li, lj) = (leaf_of(first_i, ni), leaf_of(first_j, nj));
        let slice = leaf_of(self.stored(packet, layer), self.dims[packet.axis]) * self.leaf_strides[packet.axis];
        let steps = [self.leaf_strides[i], self.leaf_strides[j]];
        Leaves {
            first: slice + li * steps[0] + lj * steps[1],
            counts: [leaf_of(last_i, ni) - li + 1, leaf_of(last_j, nj) - lj + 1],
            steps,
        }
    }

    /// True where a cell that the packet touches in `layer` is marked.
    #[inline(always)]
    fn layer_shows(&self, cells: &AxisMarks<'_>, packet: &Packet, layer: usize) -> bool {
        let [i, j] = IN_SLICE[packet.axis];
        let span = [layer as f32, (layer + 1) as f32];
        let [first, last] = packet.bounds(0, span, self.dims[i] - 1);
        let [top, bottom] = packet.bounds(1, span, self.dims[j] - 1);
        let k = self.stored(packet, layer);
        let (first_word, last_word) = (first / WORD, last / WORD);
        let from = u64::MAX << (first % WORD);
        let to = u64::MAX >> (WORD - 1 - last % WORD);
        let mut shows = 0;
        for row in top..=bottom {
            let words = cells.scanline(row, k);
            if first_word == last_word {
                shows |= words[first_word] & from & to;
            } else {
                shows |= words[first_word] & from | words[last_word] & to;
                for word in &words[first_word + 1..last_word] {
                    shows |= word;
                }
            }
        }
        shows != 0
    }
}
