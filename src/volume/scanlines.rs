//! Unencoded scanlines for every principal axis.
//!
//! A frame walks scanlines perpendicular to the principal axis. The scanlines of the axes y and z run
//! along x, as volumes are stored; those of the axis x run along y and are read from a second copy
//! of the codes, for a walk along the first would touch another cache line with every voxel.

use rayon::prelude::*;

use super::gradient::Code;
use super::{Scalars, Volume};

/// A copy of a volume's codes with y running fastest, then x, then z.
pub(super) fn turned(volume: &Volume) -> Scalars {
    let [nx, ny, _] = volume.dims();
    match volume.scalars() {
        Scalars::U8(codes) => Scalars::U8(turn(codes, nx, ny)),
        Scalars::U16(codes) => Scalars::U16(turn(codes, nx, ny)),
    }
}

/// Swaps rows and columns of every plane, block by block, so that both sides stay in the cache.
fn turn<T: Code + Default>(codes: &[T], nx: usize, ny: usize) -> Vec<T> {
    const BLOCK: usize = 32;
    let mut turned = vec![T::default(); codes.len()];
    turned.par_chunks_mut(nx * ny).zip(codes.par_chunks(nx * ny)).for_each(|(turned, plane)| {
        for y0 in (0..ny).step_by(BLOCK) {
            for x0 in (0..nx).step_by(BLOCK) {
                for x in x0..(x0 + BLOCK).min(nx) {
                    for y in y0..(y0 + BLOCK).min(ny) {
                        turned[x * ny + y] = plane[y * nx + x];
                    }
                }
            }
        }
    });
    turned
}

/// The codes as one principal axis walks them; `i, j, k` are those of
/// [`Factorization`](crate::render::factorization::Factorization).
#[derive(Clone, Copy, Debug)]
pub struct Scanlines<'a, T> {
    codes: &'a [T],
    /// Voxels along i, j, k.
    dims: [usize; 3],
    axis: usize,
    /// Codes from a scanline to the next, and from a slice to the next.
    strides: [usize; 2],
}

/// The volume's axes that i, j, k stand for, by principal axis.
const AXES: [[usize; 3]; 3] = [[1, 2, 0], [0, 2, 1], [0, 1, 2]];

impl<'a, T> Scanlines<'a, T> {
    /// `codes` are those of the volume for the axes y and z, the turned ones for x.
    pub(super) fn new(codes: &'a [T], dims: [usize; 3], axis: usize) -> Self {
        let [nx, ny, _] = dims;
        let strides = match axis {
            0 => [nx * ny, ny],
            1 => [nx * ny, nx],
            _ => [nx, nx * ny],
        };
        Self { codes, dims: AXES[axis].map(|axis| dims[axis]), axis, strides }
    }

    /// Voxels along i, j, k.
    #[inline(always)]
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// The volume's axes (0: x, 1: y, 2: z) that i, j, k stand for.
    #[inline(always)]
    pub fn axes(&self) -> [usize; 3] {
        AXES[self.axis]
    }

    /// The voxels of scanline `j` of slice `k`.
    #[inline(always)]
    pub fn row(&self, j: usize, k: usize) -> &'a [T] {
        &self.codes[j * self.strides[0] + k * self.strides[1]..][..self.dims[0]]
    }
}

/// [`Scanlines`] of either type of code.
#[derive(Clone, Copy, Debug)]
pub enum AnyScanlines<'a> {
    U8(Scanlines<'a, u8>),
    U16(Scanlines<'a, u16>),
}
