//! What a packet need not look at: layers of cells in which nothing shows.
//!
//! A layer lies between two slices. The cells that eight rays touch within it are a rectangle of a
//! few; whether any of them shows something is a few bits of the runs of cells, or, as long as there
//! are none, a few flags of the octree's leaves. A leaf is [`LEAF`] layers deep, so where leaves are
//! transparent throughout, the packet goes on at the next leaf.

use super::packet::{IN_SLICE, Packet};
use crate::classify::marks::{AxisMarks, WORD};
use crate::classify::{Classification, Encodings};
use crate::simd::wide::{LANES, Wide};
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
        let cells = encodings.and_then(Encodings::cells).map(|cells| [0, 1, 2].map(|axis| cells.for_axis(axis).marks));
        Self { leaves: Some(classification.occupied()), cells, ..Self::nothing(dims) }
    }

    /// Nothing is skipped.
    pub fn nothing(dims: [usize; 3]) -> Self {
        let counts = dims.map(leaves_along);
        Self { dims, leaf_strides: [1, counts[0], counts[0] * counts[1]], leaves: None, cells: None }
    }

    /// The first layer from `layer` on (and before `end`) in which something may show.
    #[inline(always)]
    pub fn next_layer<W: Wide>(&self, packet: &Packet, mut layer: usize, end: usize) -> usize {
        let Some(leaves) = self.leaves else { return layer };
        // In the midst of a leaf, its cells are asked at once.
        let mut asked = self.cells.is_some() && layer > 0 && self.leaf_end(packet, layer - 1) > layer;
        while layer < end {
            let leaf_end = self.leaf_end(packet, layer).min(end);
            if !std::mem::take(&mut asked) {
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
            }
            let Some(cells) = &self.cells else { return layer };
            while layer < leaf_end {
                // Of several layers at once: to ask the runs of cells takes less than to know where.
                let [i, j] = IN_SLICE[packet.axis];
                let [firsts, lasts] = packet.bounds_of_layers::<W::Numbers>(0, layer, self.dims[i] - 1);
                let [tops, bottoms] = packet.bounds_of_layers::<W::Numbers>(1, layer, self.dims[j] - 1);
                for n in 0..LANES.min(leaf_end - layer) {
                    let columns = [firsts[n] as u32 as usize, lasts[n] as u32 as usize];
                    let rows = [tops[n] as u32 as usize, bottoms[n] as u32 as usize];
                    if any_marked(&cells[packet.axis], self.stored(packet, layer + n), columns, rows) {
                        return layer + n;
                    }
                }
                layer = leaf_end.min(layer + LANES);
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
}

/// True where one of these cells of layer `k`, the last ones included, is marked.
#[inline(always)]
fn any_marked(cells: &AxisMarks<'_>, k: usize, [first, last]: [usize; 2], [top, bottom]: [usize; 2]) -> bool {
    let (first_word, last_word) = (first / WORD, last / WORD);
    let from = u64::MAX << (first % WORD);
    let to = u64::MAX >> (WORD - 1 - last % WORD);
    let mut marked = 0;
    for row in top..=bottom {
        let words = cells.scanline(row, k);
        if first_word == last_word {
            marked |= words[first_word] & from & to;
        } else {
            marked |= words[first_word] & from | words[last_word] & to;
            for word in &words[first_word + 1..last_word] {
                marked |= word;
            }
        }
    }
    marked != 0
}
