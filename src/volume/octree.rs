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
//!
//! Ranges of scalar are found when a volume is loaded, in one pass over its codes. Those of gradient
//! magnitude take ten times as long, and only transfer functions with a gradient opacity ask for them: the
//! first that does has them found ([`PreparedVolume::gradient_octree`](super::PreparedVolume::gradient_octree)).

use std::ops::RangeInclusive;

use rayon::prelude::*;

use super::Volume;
use super::gradient::{BLOCK, Code, GradientFrame, Gradients, magnitudes};
use super::scanlines::{AnyScanlines, Scanlines};
use crate::simd::{self, Kernel};

/// Cells along a side of a leaf.
pub const LEAF: usize = 8;

/// What a block's voxels range over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Smallest and largest code.
    pub code: (u16, u16),
    /// Smallest and largest gradient magnitude, scalar units per mm; from 0 to infinity where nobody has
    /// looked.
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
    /// Finds the ranges of scalar on the current rayon pool; gradients may be anything. `scanlines` are those
    /// of the z axis.
    pub(super) fn of_scalars(scanlines: AnyScanlines<'_>) -> Self {
        Self::above(match scanlines {
            AnyScanlines::U8(scanlines) => code_ranges(scanlines),
            AnyScanlines::U16(scanlines) => code_ranges(scanlines),
        })
    }

    /// Adds the ranges of gradient magnitude.
    pub(super) fn with_gradients(&self, volume: &Volume, scanlines: AnyScanlines<'_>) -> Self {
        let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
        let mut leaves = self.levels[0].clone();
        match scanlines {
            AnyScanlines::U8(of) => gradient_ranges(Gradients::new(of, &frame), volume.dims(), &mut leaves),
            AnyScanlines::U16(of) => gradient_ranges(Gradients::new(of, &frame), volume.dims(), &mut leaves),
        }
        Self::above(leaves)
    }

    /// The levels above the leaves.
    fn above(leaves: Level) -> Self {
        let mut levels = vec![leaves];
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

/// The voxels of leaf `b` along an axis of `n` voxels.
fn voxels(b: usize, n: usize) -> RangeInclusive<usize> {
    b * LEAF..=((b + 1) * LEAF).min(n - 1)
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

/// The codes' ranges of every leaf: one job for each layer of leaves.
///
/// The rows of a leaf row are joined voxel by voxel, which is one instruction for many voxels; only what
/// is left, one row for 81, is searched along.
fn code_ranges<T: Code>(scanlines: Scanlines<'_, T>) -> Level {
    let dims = scanlines.dims().map(leaves_along);
    let mut ranges = vec![Range::EMPTY; dims.iter().product()];
    ranges.par_chunks_mut(dims[0] * dims[1]).enumerate().for_each(|(bk, layer)| {
        simd::dispatch(CodeLayer { scanlines, bk, layer });
    });
    Level { dims, ranges }
}

/// A layer of leaves, whose ranges of codes are wanted.
struct CodeLayer<'a, T> {
    scanlines: Scanlines<'a, T>,
    bk: usize,
    layer: &'a mut [Range],
}

impl<T: Code> Kernel for CodeLayer<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [nx, ny, nz] = self.scanlines.dims();
        let (mut low, mut high) = (vec![T::MAX; nx], vec![T::default(); nx]);
        for (bj, leaves) in self.layer.chunks_exact_mut(leaves_along(nx)).enumerate() {
            low.fill(T::MAX);
            high.fill(T::default());
            for k in voxels(self.bk, nz) {
                for j in voxels(bj, ny) {
                    let row = self.scanlines.row(j, k);
                    for ((low, high), &code) in low.iter_mut().zip(&mut high).zip(row) {
                        *low = code.min(*low);
                        *high = code.max(*high);
                    }
                }
            }
            for (bi, leaf) in leaves.iter_mut().enumerate() {
                let along = voxels(bi, nx);
                let lowest = low[along.clone()].iter().fold(T::MAX, |a, &b| a.min(b));
                let highest = high[along].iter().fold(T::default(), |a, &b| a.max(b));
                *leaf = Range { code: (lowest.into(), highest.into()), gradient: (0.0, f32::INFINITY) };
            }
        }
    }
}

/// The gradient magnitudes' ranges of every leaf, put into `leaves`.
fn gradient_ranges<T: Code>(gradients: Gradients<'_, T>, dims: [usize; 3], leaves: &mut Level) {
    let [bx, by, _] = leaves.dims;
    leaves.ranges.par_chunks_mut(bx * by).enumerate().for_each(|(bk, layer)| {
        simd::dispatch(GradientLayer { gradients, dims, bk, layer });
    });
}

/// A layer of leaves, whose ranges of gradient magnitude are wanted.
struct GradientLayer<'a, T> {
    gradients: Gradients<'a, T>,
    dims: [usize; 3],
    bk: usize,
    layer: &'a mut [Range],
}

impl<T: Code> Kernel for GradientLayer<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [nx, ny, nz] = self.dims;
        // Smallest and largest of a leaf row, by voxel along x.
        let mut along: Vec<[[f32; BLOCK]; 2]> = vec![];
        for (bj, leaves) in self.layer.chunks_exact_mut(leaves_along(nx)).enumerate() {
            along.clear();
            along.resize(nx.div_ceil(BLOCK), [[f32::INFINITY; BLOCK], [0.0; BLOCK]]);
            for k in voxels(self.bk, nz) {
                for j in voxels(bj, ny) {
                    for (block, [low, high]) in along.iter_mut().enumerate() {
                        let magnitudes = magnitudes(&self.gradients.block::<BLOCK>(j, k, block * BLOCK));
                        for n in 0..BLOCK {
                            low[n] = magnitudes[n].min(low[n]);
                            high[n] = magnitudes[n].max(high[n]);
                        }
                    }
                }
            }
            for (bi, leaf) in leaves.iter_mut().enumerate() {
                let of = |range: (f32, f32), i: usize| {
                    let [low, high] = &along[i / BLOCK];
                    (range.0.min(low[i % BLOCK]), range.1.max(high[i % BLOCK]))
                };
                leaf.gradient = voxels(bi, nx).fold((f32::INFINITY, 0.0), of);
            }
        }
    }
}

/// The level above.
fn parents(level: &Level) -> Level {
    let dims = level.dims.map(|n| n.div_ceil(2));
    let mut ranges = vec![Range::EMPTY; dims.iter().product()];
    let [nx, ny, _] = level.dims;
    for (row, children) in level.ranges.chunks_exact(nx).enumerate() {
        let (j, k) = (row % ny, row / ny);
        let parents = &mut ranges[((k / 2) * dims[1] + j / 2) * dims[0]..][..dims[0]];
        for (parent, pair) in parents.iter_mut().zip(children.chunks(2)) {
            *parent = pair.iter().fold(*parent, |range, child| range.union(*child));
        }
    }
    Level { dims, ranges }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::volume::gradient::gradient_at;
    use crate::volume::{ImportReport, Placement, PreparedVolume, ScalarType, Scalars};

    /// The range of a box of voxels, one by one.
    fn plain(volume: &Volume, at: [RangeInclusive<usize>; 3]) -> Range {
        let [nx, ny, _] = volume.dims();
        let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
        let [is, js, ks] = at;
        let mut range = Range::EMPTY;
        for k in ks {
            for j in js.clone() {
                for i in is.clone() {
                    let code = volume.scalars().code((k * ny + j) * nx + i);
                    let gradient = gradient_at(volume, &frame, [i, j, k]).length() as f32;
                    range = range.union(Range { code: (code, code), gradient: (gradient, gradient) });
                }
            }
        }
        range
    }

    #[test]
    fn a_leaf_ranges_over_its_voxels_from_the_first_to_the_last_inclusive() {
        for dims in [[2, 2, 2], [9, 8, 10], [17, 33, 7], [66, 20, 25]] {
            let codes = (0..dims.iter().product::<usize>() as u32).map(|at| (at + 1).wrapping_mul(2_654_435_761) >> 16);
            let wide = Scalars::U16(codes.clone().map(|code| code as u16).collect());
            let narrow = Scalars::U8(codes.map(|code| code as u8).collect());
            for scalars in [wide, narrow] {
                let placement = Placement::from_spacing(DVec3::new(1.0, 0.5, 2.0));
                let report = ImportReport::plain("test", ScalarType::U16);
                let volume = Volume::new(dims, placement, scalars, (0.5, 0.0), report).unwrap();
                check(&PreparedVolume::build(volume));
            }
        }
    }

    fn check(prepared: &PreparedVolume) {
        let (volume, dims) = (prepared.volume(), prepared.volume().dims());
        let (codes, both) = (prepared.octree(), prepared.gradient_octree());
        let [bx, by, bz] = codes.leaf_dims();
        for index in 0..bx * by * bz {
            let block = [index % bx, index / bx % by, index / (bx * by)];
            let expected = plain(volume, [0, 1, 2].map(|axis| voxels(block[axis], dims[axis])));
            assert_eq!(codes.leaf(index).code, expected.code, "{block:?} of {dims:?}");
            assert_eq!(both.leaf(index).code, expected.code, "{block:?} of {dims:?}");
            let found = both.leaf(index).gradient;
            let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * b;
            assert!(near(found.0, expected.gradient.0) && near(found.1, expected.gradient.1), "{block:?} of {dims:?}");
        }
        let all = plain(volume, dims.map(|n| 0..=n - 1));
        assert_eq!(codes.root().code, all.code);
        assert!((both.root().gradient.1 - all.gradient.1).abs() <= 1e-5 * all.gradient.1);
    }
}
