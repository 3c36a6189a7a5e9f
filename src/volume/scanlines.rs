//! Unencoded scanlines for every principal axis.
//!
//! A frame walks scanlines perpendicular to the principal axis. The scanlines of the axes y and z run
//! along x, as volumes are stored; those of the axis x run along y and are read from a second copy
//! of the codes, for a walk along the first would touch another cache line with every voxel.

use std::ops::Range;

use rayon::prelude::*;

use super::gradient::Code;
use super::{Scalars, Volume};
use crate::simd::{self, Kernel};

/// A copy of a volume's codes with y running fastest, then x, then z.
pub(super) fn turned(volume: &Volume) -> Scalars {
    let [nx, ny, _] = volume.dims();
    match volume.scalars() {
        Scalars::U8(codes) => Scalars::U8(turn(codes, nx, ny)),
        Scalars::U16(codes) => Scalars::U16(turn(codes, nx, ny)),
    }
}

/// Rows of codes that are turned at once.
const ROWS: usize = 8;
/// Machine words of codes that are turned at once, side by side.
const LANES: usize = 4;

/// Swaps rows and columns of every plane of `nx` columns and `ny` rows.
pub fn turn<T: Code>(codes: &[T], nx: usize, ny: usize) -> Vec<T> {
    let mut turned = vec![T::default(); codes.len()];
    turned.par_chunks_mut(nx * ny).zip(codes.par_chunks(nx * ny)).for_each(|(turned, plane)| {
        simd::dispatch(Turn { plane, turned, nx, ny });
    });
    turned
}

/// A plane to be turned.
struct Turn<'a, T> {
    plane: &'a [T],
    turned: &'a mut [T],
    nx: usize,
    ny: usize,
}

impl<T: Code> Kernel for Turn<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let columns = LANES * Self::PER_WORD;
        let (wide, high) = (self.nx / columns * columns, self.ny / ROWS * ROWS);
        // A strip of columns is written while its part of the plane is in the cache.
        for x in (0..wide).step_by(columns) {
            for y in (0..high).step_by(ROWS) {
                self.words(x, y);
            }
        }
        self.one_by_one(0..self.nx, high..self.ny);
        self.one_by_one(wide..self.nx, 0..high);
    }
}

impl<T: Code> Turn<'_, T> {
    /// Codes in a machine word.
    const PER_WORD: usize = size_of::<u64>() / size_of::<T>();

    /// The square of [`Self::PER_WORD`] codes a side in each of the words from column `x` on of rows `y..y +
    /// ROWS`: halves are swapped between words, then quarters, then eighths.
    #[inline(always)]
    fn words(&mut self, x: usize, y: usize) {
        let side = Self::PER_WORD;
        let mut words = [[0; LANES]; ROWS];
        for (row, words) in words.iter_mut().enumerate() {
            let codes = &self.plane[(y + row) * self.nx + x..][..LANES * side];
            for (word, codes) in words.iter_mut().zip(codes.chunks_exact(side)) {
                *word = u64::from_le(bytemuck::pod_read_unaligned(bytemuck::cast_slice(codes)));
            }
        }
        for square in words.chunks_exact_mut(side) {
            swap(square, side / 2, 32, 0x0000_0000_ffff_ffff);
            swap(square, side / 4, 16, 0x0000_ffff_0000_ffff);
            if side == ROWS {
                swap(square, 1, 8, 0x00ff_00ff_00ff_00ff);
            }
        }
        for (row, words) in words.iter().enumerate() {
            let (square, column) = (row / side, row % side);
            for (lane, word) in words.iter().enumerate() {
                let at = (x + lane * side + column) * self.ny + y + square * side;
                let codes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.turned[at..at + side]);
                codes.copy_from_slice(&word.to_le_bytes());
            }
        }
    }

    /// What is left at the ends.
    fn one_by_one(&mut self, columns: Range<usize>, rows: Range<usize>) {
        for x in columns {
            for y in rows.clone() {
                self.turned[x * self.ny + y] = self.plane[y * self.nx + x];
            }
        }
    }
}

/// Swaps the upper `shift` bits of every `2 * shift` with the lower ones of the word `distance` below.
#[inline(always)]
fn swap(words: &mut [[u64; LANES]], distance: usize, shift: u32, mask: u64) {
    for pair in words.chunks_exact_mut(2 * distance) {
        let (upper, lower) = pair.split_at_mut(distance);
        for (upper, lower) in upper.iter_mut().zip(lower) {
            for lane in 0..LANES {
                let swap = (upper[lane] >> shift ^ lower[lane]) & mask;
                lower[lane] ^= swap;
                upper[lane] ^= swap << shift;
            }
        }
    }
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

    /// Four voxels of a scanline from (i, j, k) on, its last one repeated past its end.
    #[inline(always)]
    pub fn four(&self, [i, j, k]: [usize; 3]) -> [T; 4]
    where
        T: Copy,
    {
        four_of(self.row(j, k), i)
    }

    /// How many scanlines are stored before scanline `j` of slice `k`.
    pub fn place(&self, j: usize, k: usize) -> usize {
        (j * self.strides[0] + k * self.strides[1]) / self.dims[0]
    }
}

/// Four voxels of a scanline, its last one repeated past its end.
#[inline(always)]
pub fn four_of<T: Copy>(row: &[T], first: usize) -> [T; 4] {
    match row.get(first..).and_then(<[T]>::first_chunk) {
        Some(four) => *four,
        None => at_the_end(row, first),
    }
}

/// The same where fewer than four are left. On its own, so that the usual four are loaded as one.
#[cold]
#[inline(never)]
fn at_the_end<T: Copy>(row: &[T], first: usize) -> [T; 4] {
    [0, 1, 2, 3].map(|n| row[(first + n).min(row.len() - 1)])
}

/// [`Scanlines`] of either type of code.
#[derive(Clone, Copy, Debug)]
pub enum AnyScanlines<'a> {
    U8(Scanlines<'a, u8>),
    U16(Scanlines<'a, u16>),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check<T: Code + std::fmt::Debug>([nx, ny, nz]: [usize; 3]) {
        let codes: Vec<T> =
            (1..=(nx * ny * nz) as u32).map(|n| T::from_code((n.wrapping_mul(2_654_435_761) >> 16) as u16)).collect();
        let turned = turn(&codes, nx, ny);
        for (at, code) in codes.iter().enumerate() {
            let (x, y, z) = (at % nx, at / nx % ny, at / (nx * ny));
            assert_eq!(turned[(z * nx + x) * ny + y], *code, "{x} {y} {z} of {nx} x {ny} x {nz}");
        }
    }

    #[test]
    fn turning_swaps_rows_and_columns_of_any_size() {
        for dims in [[2, 2, 2], [32, 8, 2], [16, 8, 1], [33, 9, 2], [64, 64, 1], [71, 130, 3], [15, 40, 2], [100, 7, 2]]
        {
            check::<u8>(dims);
            check::<u16>(dims);
        }
    }
}
