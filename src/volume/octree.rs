//! [`MinMaxOctree`]: ranges of scalar and gradient magnitude per block, built once per volume.
//!
//! Whether a block of voxels is transparent under a transfer function follows from the ranges of
//! the function's parameters in the block (Lacroute and Levoy 1994, section 3.3). The ranges do not
//! depend on the transfer function, so they are found once and asked many times.
//!
//! A leaf holds [`LEAF`]^3 cells, that is the voxels from its first to its last *inclusive*:
//! neighbours share a face of voxels. So a leaf bounds not only its voxels but every value
//! interpolated between them, and a ray segment inside one leaf needs one test (the overlapped
//! min-max blocks of Kye et al. 2005).

use rayon::prelude::*;

use super::gradient::{Code, GradientFrame, GradientRow};
use super::{Scalars, Volume};

/// Cells along a side of a leaf.
pub const LEAF: usize = 8;

/// What a block's voxels range over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Smallest and largest code.
    pub code: (u16, u16),
    /// Smallest and largest gradient magnitude, scalar units per mm.
    pub gradient: (f32, f32),
}

impl Range {
    const EMPTY: Self = Self { code: (u16::MAX, 0), gradient: (f32::INFINITY, 0.0) };

    fn union(self, other: Self) -> Self {
        Self {
            code: (self.code.0.min(other.code.0), self.code.1.max(other.code.1)),
            gradient: (self.gradient.0.min(other.gradient.0), self.gradient.1.max(other.gradient.1)),
        }
    }
}

/// One level: blocks along i, j, k and their ranges, `i` fastest.
#[derive(Clone, Debug, PartialEq)]
struct Level {
    dims: [usize; 3],
    ranges: Vec<Range>,
}

/// The octree as a pyramid of levels, leaves first; each level halves the one before.
#[derive(Clone, Debug, PartialEq)]
pub struct MinMaxOctree {
    levels: Vec<Level>,
}

impl MinMaxOctree {
    /// Finds the ranges of all blocks on the current rayon pool.
    pub fn build(volume: &Volume) -> Self {
        let mut levels = vec![match volume.scalars() {
            Scalars::U8(codes) => leaves(codes, volume),
            Scalars::U16(codes) => leaves(codes, volume),
        }];
        while levels[levels.len() - 1].ranges.len() > 1 {
            let parent = parents(&levels[levels.len() - 1]);
            levels.push(parent);
        }
        Self { levels }
    }

    /// Leaves along i, j, k.
    pub fn leaf_dims(&self) -> [usize; 3] {
        self.levels[0].dims
    }

    /// The range of a leaf, `i` fastest.
    #[inline(always)]
    pub fn leaf(&self, index: usize) -> &Range {
        &self.levels[0].ranges[index]
    }

    /// The range of everything.
    pub fn root(&self) -> Range {
        self.levels[self.levels.len() - 1].ranges[0]
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        self.levels.iter().map(|l| size_of_val(&l.ranges[..]) as u64).sum()
    }

    /// Asks `is_transparent` of blocks from the root down, of a child only where its parent was
    /// not, and gives one flag per leaf (`i` fastest): true where it may hold something to draw.
    pub fn occupied_leaves(&self, is_transparent: impl Fn(&Range) -> bool + Sync) -> Vec<bool> {
        let top = self.levels.len() - 1;
        let mut above = vec![!is_transparent(&self.levels[top].ranges[0])];
        let mut above_dims = [1; 3];
        for level in self.levels[..top].iter().rev() {
            let [nx, ny, _] = level.dims;
            let mut here = vec![false; level.ranges.len()];
            here.par_chunks_mut(nx * ny).enumerate().for_each(|(k, layer)| {
                for (at, flag) in layer.iter_mut().enumerate() {
                    let (i, j) = (at % nx, at / nx);
                    let parent = ((k / 2) * above_dims[1] + j / 2) * above_dims[0] + i / 2;
                    *flag = above[parent] && !is_transparent(&level.ranges[k * nx * ny + at]);
                }
            });
            (above, above_dims) = (here, level.dims);
        }
        above
    }
}

/// Blocks along an axis of `n` voxels.
pub const fn leaves_along(n: usize) -> usize {
    (n - 1).div_ceil(LEAF)
}

/// The leaf that voxel (or cell) `i` of `n` voxels belongs to.
pub const fn leaf_of(i: usize, n: usize) -> usize {
    let last = leaves_along(n) - 1;
    if i / LEAF < last { i / LEAF } else { last }
}

/// The range of every leaf: one job per layer of leaves.
fn leaves<T: Code>(codes: &[T], volume: &Volume) -> Level {
    let dims @ [nx, ny, nz] = volume.dims();
    let leaf_dims = dims.map(leaves_along);
    let [bx, by, bz] = leaf_dims;
    let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let mut ranges = vec![Range::EMPTY; bx * by * bz];
    ranges.par_chunks_mut(bx * by).enumerate().for_each_init(
        || (GradientRow::new(nx), vec![0f32; nx]),
        |(gradient, squared), (bk, layer)| {
            for k in bk * LEAF..=((bk + 1) * LEAF).min(nz - 1) {
                for j in 0..ny {
                    gradient.compute(codes, dims, &frame, j, k);
                    gradient.squared_magnitudes(squared);
                    let row = &codes[(k * ny + j) * nx..][..nx];
                    // A row on a shared face belongs to the leaves on both sides.
                    let second = leaf_of(j, ny);
                    let first = if j > 0 && j % LEAF == 0 { j / LEAF - 1 } else { second };
                    let along = row_ranges(row, squared, bx);
                    for (bi, range) in along.enumerate() {
                        for bj in first..=second {
                            let leaf = &mut layer[bj * bx + bi];
                            *leaf = leaf.union(range);
                        }
                    }
                }
            }
            for leaf in layer {
                leaf.gradient = (leaf.gradient.0.sqrt(), leaf.gradient.1.sqrt());
            }
        },
    );
    Level { dims: leaf_dims, ranges }
}

/// The ranges of a row's voxels by leaf, gradient magnitudes still squared.
fn row_ranges<T: Code>(row: &[T], squared: &[f32], leaves: usize) -> impl Iterator<Item = Range> {
    (0..leaves).map(move |b| {
        let span = b * LEAF..((b + 1) * LEAF + 1).min(row.len());
        let codes = &row[span.clone()];
        let (low, high) = codes.iter().fold((codes[0], codes[0]), |(l, h), &c| (l.min(c), h.max(c)));
        let gradients = &squared[span];
        let gradient = gradients.iter().fold((f32::INFINITY, 0f32), |(l, h), &g| (l.min(g), h.max(g)));
        Range { code: (low.into(), high.into()), gradient }
    })
}

/// The level above.
fn parents(level: &Level) -> Level {
    let dims = level.dims.map(|n| n.div_ceil(2));
    let mut ranges = vec![Range::EMPTY; dims.iter().product()];
    for (index, range) in level.ranges.iter().enumerate() {
        let [nx, ny, _] = level.dims;
        let (i, j, k) = (index % nx, index / nx % ny, index / (nx * ny));
        let parent = &mut ranges[((k / 2) * dims[1] + j / 2) * dims[0] + i / 2];
        *parent = parent.union(*range);
    }
    Level { dims, ranges }
}
