//! Runs of cells: where a slab between two slices may show something.
//!
//! A slab's two scalars are interpolated from the corners of the cells that its ray passes, so what
//! pre-integration can skip is told by cells, not by voxels: a cell shows something if any scalar
//! between the smallest and the largest of its eight corners does. (Runs of voxels dilated by one
//! would do, but are wider: transfer functions that show thin ranges leave most of such a hull
//! empty.) A run is what it is for voxels, a stretch of a scanline; here there is nothing to store
//! for each cell, the scalars being read from the volume, and the runs of 64 cells are kept as the
//! bits of a word.
//!
//! Scanlines are stored in the two orders of [`super::rle`].

use rayon::prelude::*;

use crate::volume::gradient::Code;
use crate::volume::octree::leaf_of;
use crate::volume::{PreparedVolume, Scalars};

/// Cells of a scanline that a word spans.
pub const WORD: usize = 64;

/// A bit for every cell: set where something may show.
#[derive(Clone, Debug, PartialEq)]
pub struct CellRuns {
    /// Cells along x, y, z: one fewer than voxels.
    pub(super) dims: [usize; 3],
    /// Scanlines along x: row (y, z) at `(z * cells_y + y) * words(cells_x)`.
    pub(super) along_x: Vec<u64>,
    /// Scanlines along y: row (x, z) at `(z * cells_x + x) * words(cells_y)`.
    pub(super) along_y: Vec<u64>,
}

/// Words that a scanline of so many cells takes.
pub const fn words(cells: usize) -> usize {
    cells.div_ceil(WORD)
}

/// The runs that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisCells<'a> {
    bits: &'a [u64],
    words: usize,
    /// Words from a scanline to the next, and from a slice to the next.
    strides: [usize; 2],
}

impl<'a> AxisCells<'a> {
    /// The cells between scanlines `j` and `j + 1` of slices `k` and `k + 1`: bit i of the words is
    /// the cell between voxels i and i + 1.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> &'a [u64] {
        &self.bits[j * self.strides[0] + k * self.strides[1]..][..self.words]
    }
}

impl CellRuns {
    /// Marks the cells between whose corners `visible` (a flag for each code) has a set flag.
    /// `occupied` has a flag for each leaf of the volume's octree: false only where no cell of the
    /// leaf is to be marked.
    pub fn encode(prepared: &PreparedVolume, visible: &[bool], occupied: &[bool]) -> Self {
        match prepared.volume().scalars() {
            Scalars::U8(codes) => encode(codes, prepared, visible, occupied),
            Scalars::U16(codes) => encode(codes, prepared, visible, occupied),
        }
    }

    /// What the runs of a volume of so many voxels take in memory, both orders.
    pub(super) fn bytes_of(dims: [usize; 3]) -> u64 {
        let [cx, cy, cz] = dims.map(|n| n - 1);
        (cz * (cy * words(cx) + cx * words(cy)) * size_of::<u64>()) as u64
    }

    /// The runs for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisCells<'_> {
        let [nx, ny, _] = self.dims;
        match axis {
            0 => AxisCells { bits: &self.along_y, words: words(ny), strides: [nx * words(ny), words(ny)] },
            1 => AxisCells { bits: &self.along_x, words: words(nx), strides: [ny * words(nx), words(nx)] },
            _ => AxisCells { bits: &self.along_x, words: words(nx), strides: [words(nx), ny * words(nx)] },
        }
    }

    /// Share of the cells that are marked, 0..=1.
    pub fn nontransparent_share(&self) -> f64 {
        let marked: u64 = self.along_x.iter().map(|word| u64::from(word.count_ones())).sum();
        marked as f64 / self.dims.iter().product::<usize>() as f64
    }

    /// Bytes in memory, both orders.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.along_x[..]) + size_of_val(&self.along_y[..])) as u64
    }
}

fn encode<T: Code>(codes: &[T], prepared: &PreparedVolume, visible: &[bool], occupied: &[bool]) -> CellRuns {
    let [nx, ny, _] = prepared.volume().dims();
    let dims @ [cx, cy, cz] = prepared.volume().dims().map(|n| n - 1);
    let [lx, ly, _] = prepared.octree().leaf_dims();
    // The first visible code at or after each code: a range holds one if that is within it.
    let mut next = vec![u32::MAX; visible.len()];
    let mut first = u32::MAX;
    for (code, &visible) in visible.iter().enumerate().rev() {
        first = if visible { code as u32 } else { first };
        next[code] = first;
    }
    let mut along_x = vec![0; cz * cy * words(cx)];
    let mut along_y = vec![0; cz * cx * words(cy)];
    let planes = along_x.par_chunks_mut(cy * words(cx)).zip(along_y.par_chunks_mut(cx * words(cy)));
    planes.enumerate().for_each(|(z, (plane_x, plane_y))| {
        for y in 0..cy {
            let leaves = &occupied[(leaf_of(z, cz + 1) * ly + leaf_of(y, cy + 1)) * lx..][..lx];
            for x in (0..cx).filter(|&x| leaves[leaf_of(x, cx + 1)]) {
                let at = (z * ny + y) * nx + x;
                let corners = [0, nx, nx * ny, nx * ny + nx].map(|row| [codes[at + row], codes[at + row + 1]]);
                let (mut low, mut high) = (corners[0][0], corners[0][0]);
                for corner in corners.into_iter().flatten() {
                    (low, high) = (low.min(corner), high.max(corner));
                }
                let (low, high): (u16, u16) = (low.into(), high.into());
                if next[usize::from(low)] <= u32::from(high) {
                    plane_x[y * words(cx) + x / WORD] |= 1 << (x % WORD);
                    plane_y[x * words(cy) + y / WORD] |= 1 << (y % WORD);
                }
            }
        }
    });
    CellRuns { dims, along_x, along_y }
}
