//! The voxels that a tile's rays pass between two slices.
//!
//! Neighbouring rays pass the same few cells: at usual magnifications a tile of 8 x 8 pixels lies over
//! some 5 x 5 of them, and each of its slabs would read eight voxels for its scalars and thirty-two
//! for its gradient. So the codes around a layer of cells are converted to floats once for all
//! rays of the tile, with a voxel more on every side for the differences and the volume's border
//! continued there, and what lies between the two slices is interpolated for whole slices: a slice
//! between slices (Sweeney and Mueller 2002), and its gradients. Interpolation is linear, so that
//! bilinear samples of an interpolated slice are the trilinear ones of the volume, and the
//! differences of an interpolated slice the interpolated central differences of the optical
//! model. All of it stays in the first-level cache.

use glam::Vec4;

use super::packet::{IN_SLICE, Packet};
use crate::simd::numbers::Numbers;
use crate::simd::prefetch;
use crate::simd::wide::{CellRow, Indices, LANES, Lanes, Wide};
use crate::volume::gradient::Code;
use crate::volume::scanlines::Scanlines;

/// Cells of one layer, by their first and last along `i` and `j`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cells {
    pub first: [usize; 2],
    pub last: [usize; 2],
}

impl Cells {
    /// The cells of volume `dims` that a packet's rays touch between two slice positions.
    #[inline(always)]
    pub fn touched(packet: &Packet, span: [f32; 2], dims: [usize; 3]) -> Self {
        let [i, j] = IN_SLICE[packet.axis];
        let [first_i, last_i] = packet.bounds(0, span, dims[i] - 1);
        let [first_j, last_j] = packet.bounds(1, span, dims[j] - 1);
        Self { first: [first_i, first_j], last: [last_i, last_j] }
    }

    /// A rectangle that holds both.
    #[inline(always)]
    pub fn with(self, other: Self) -> Self {
        let [a, b] = [self, other];
        Self {
            first: [a.first[0].min(b.first[0]), a.first[1].min(b.first[1])],
            last: [a.last[0].max(b.last[0]), a.last[1].max(b.last[1])],
        }
    }

    /// How many.
    #[inline(always)]
    pub fn count(&self) -> usize {
        (self.last[0] - self.first[0] + 1) * (self.last[1] - self.first[1] + 1)
    }
}

/// Where a packet's rays meet a slice of a patch: the first of four voxels, and fractions.
#[derive(Clone, Copy, Debug)]
pub struct Places {
    index: Indices,
    fractions: [Lanes; 2],
}

/// Which slice of a patch to sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Slice {
    Near,
    /// The one that was [interpolated](Patch::interpolate).
    Between,
    Far,
}

/// A layer's voxels, from one before its cells to one after them along both axes, `i` fastest.
#[derive(Clone, Debug, Default)]
pub struct Patch {
    /// The first cell's index along `i` and `j`.
    first: [usize; 2],
    /// Voxels of a row that are there, and as many as it has room for: a multiple of the lanes.
    width: usize,
    stride: usize,
    rows: usize,
    /// The slices before the layer, at its two sides and behind it, in order of travel.
    slices: [Vec<f32>; 4],
    between: Vec<f32>,
    /// Another one, of which `gradients` are.
    middle: Vec<f32>,
    /// Differences along `i`, `j` and the order of travel of the voxels of a slice between the sides.
    gradients: Vec<Vec4>,
    /// The fraction that `gradients` are of.
    differentiated: Option<f32>,
}

impl Patch {
    /// The `cells` of the layer from slice `t` to the next, in order of travel along `axis`.
    #[inline(always)]
    pub fn enter<T: Code>(
        &mut self,
        scanlines: &Scanlines<'_, T>,
        [ni, nj, nk]: [usize; 3],
        cells: Cells,
        t: usize,
        reversed: bool,
    ) {
        // A voxel more than cells, and one before and one after them.
        let width = cells.last[0] - cells.first[0] + 4;
        self.first = cells.first;
        self.width = width;
        self.stride = width.next_multiple_of(LANES);
        self.rows = cells.last[1] - cells.first[1] + 4;
        self.differentiated = None;
        // Shifted reads of the last row go on behind it.
        let length = self.stride * self.rows + LANES;
        for n in 0..4 {
            let k = (t + n).saturating_sub(1).min(nk - 1);
            let k = if reversed { nk - 1 - k } else { k };
            let slice = &mut self.slices[n];
            if slice.len() < length {
                slice.resize(length, 0.0);
            }
            for row in 0..self.rows {
                let j = (cells.first[1] + row).saturating_sub(1).min(nj - 1);
                let codes = scanlines.row(j, k);
                let out = &mut slice[row * self.stride..][..self.stride];
                let from = cells.first[0].wrapping_sub(1);
                if from <= ni && from + self.stride <= ni {
                    convert(&codes[from..from + self.stride], out);
                } else {
                    for n in 0..width {
                        out[n] = codes[(cells.first[0] + n).saturating_sub(1).min(ni - 1)].as_f32();
                    }
                }
            }
        }
        // Three of the four slices are the next layer's as well; here is the other one.
        let k = t + 3;
        if k < nk {
            let k = if reversed { nk - 1 - k } else { k };
            for row in 0..self.rows {
                let j = (cells.first[1] + row).saturating_sub(1).min(nj - 1);
                prefetch(&scanlines.row(j, k)[cells.first[0]..=cells.last[0]]);
            }
        }
    }

    /// What the voxels of the layer's cells at its near (0) or far side (1) are, in the order of [`Self::vectors`]: row by row, told by the
    /// index of its first along `i` and `j` and by their codes.
    #[inline(always)]
    pub fn paint(&self, side: usize, out: &mut Vec<Vec4>, row_of: impl Fn([usize; 2], &[f32], &mut [Vec4])) {
        let length = self.stride * self.rows;
        if out.len() != length {
            out.resize(length, Vec4::ZERO);
        }
        for row in 1..self.rows - 1 {
            let codes = &self.slices[1 + side][row * self.stride..][1..self.width - 1];
            let out = &mut out[row * self.stride..][1..self.width - 1];
            row_of([self.first[0], self.first[1] + row - 1], codes, out);
        }
    }

    /// Where a packet meets a slice of [painted](Self::paint) voxels, by component.
    #[inline(always)]
    pub fn vectors<W: Wide>(&self, voxels: &[Vec4], places: &Places) -> [Lanes; 4] {
        let [along, across] = &places.fractions;
        let Some(voxels) = voxels.get(self.stride + 1..) else { return [[0.0; LANES]; 4] };
        W::bilinear_vectors(voxels, self.stride, &places.index, [along, across])
    }

    /// Makes the slice `fraction` of the way from the near one to the far one.
    #[inline(always)]
    pub fn interpolate(&mut self, fraction: f32) {
        let length = self.stride * self.rows + LANES;
        lerp([&self.slices[1], &self.slices[2]], fraction, length, &mut self.between);
    }

    /// Makes the differences of the slice `fraction` of the way.
    #[inline(always)]
    pub fn differentiate<W: Wide>(&mut self, fraction: f32) {
        if self.differentiated == Some(fraction) {
            return;
        }
        self.differentiated = Some(fraction);
        let (stride, length) = (self.stride, self.stride * self.rows + LANES);
        if self.gradients.len() < length {
            self.gradients.resize(length, Vec4::ZERO);
        }
        lerp([&self.slices[1], &self.slices[2]], fraction, length, &mut self.middle);
        let middle = &self.middle[..length];
        let [before, near, far, behind] = [0, 1, 2, 3].map(|n| &self.slices[n][..length]);
        // Of the voxel n + 1: a row has one before the first cell's.
        for n in (stride..stride * (self.rows - 1)).step_by(LANES) {
            let along = numbers::<W>(middle, n + 2) - numbers::<W>(middle, n);
            let across = numbers::<W>(middle, n + 1 + stride) - numbers::<W>(middle, n + 1 - stride);
            let front = numbers::<W>(far, n + 1) - numbers::<W>(before, n + 1);
            let back = numbers::<W>(behind, n + 1) - numbers::<W>(near, n + 1);
            let through = front + (back - front) * W::Numbers::all(fraction);
            let differences = [along.store(), across.store(), through.store(), [0.0; LANES]];
            self.gradients[n..n + LANES].copy_from_slice(&W::columns(&differences));
        }
    }

    /// Where the packet meets the slice at slice position `t` of the layer that touches `cells`.
    #[inline(always)]
    pub fn places<W: Wide>(&self, packet: &Packet, cells: &Cells, t: f32) -> Places {
        let (columns, rows) = (self.within(cells, 0), self.within(cells, 1));
        let [column, along] = W::cells(&packet.at(0, t), &columns);
        let [row, across] = W::cells(&packet.at(1, t), &rows);
        Places { index: W::indices(&row, &column, number(self.stride)), fractions: [along, across] }
    }

    /// The cells that a packet touches along `i` (0) or `j` (1), as places are told. Rounding may leave a ray a hair outside.
    #[inline(always)]
    fn within(&self, cells: &Cells, n: usize) -> CellRow {
        CellRow {
            low: number(cells.first[n]),
            high: number(cells.last[n] + 1),
            origin: number(self.first[n]),
            last: number(cells.last[n] - self.first[n]),
        }
    }

    /// Scalars where a packet meets a slice.
    #[inline(always)]
    pub fn scalars<W: Wide>(&self, slice: Slice, places: &Places) -> Lanes {
        let slice: &[f32] = match slice {
            Slice::Near => &self.slices[1],
            Slice::Between => &self.between,
            Slice::Far => &self.slices[2],
        };
        let [along, across] = &places.fractions;
        // The first cell's first voxel has one before it along either axis.
        let Some(voxels) = slice.get(self.stride + 1..) else { return [0.0; LANES] };
        W::bilinear(voxels, self.stride, &places.index, [along, across])
    }

    /// Twice the central differences along `i`, `j` and the order of travel where a packet meets the slice
    /// that was [differentiated](Self::differentiate).
    #[inline(always)]
    pub fn gradients<W: Wide>(&self, places: &Places) -> [Lanes; 3] {
        let [along, across] = &places.fractions;
        let Some(gradients) = self.gradients.get(self.stride..) else { return [[0.0; LANES]; 3] };
        let [x, y, z, _] = W::bilinear_vectors(gradients, self.stride, &places.index, [along, across]);
        [x, y, z]
    }
}

/// A count, which is small.
#[inline(always)]
fn number(count: usize) -> f32 {
    count as u32 as f32
}

/// `length` numbers a `fraction` of the way, in the first of `out`.
#[inline(always)]
fn lerp([near, far]: [&[f32]; 2], fraction: f32, length: usize, out: &mut Vec<f32>) {
    if out.len() < length {
        out.resize(length, 0.0);
    }
    let out = out[..length].as_chunks_mut::<LANES>().0;
    let [near, far] = [near, far].map(|slice| slice[..length].as_chunks::<LANES>().0);
    for ((out, near), far) in out.iter_mut().zip(near).zip(far) {
        for lane in 0..LANES {
            out[lane] = near[lane] + (far[lane] - near[lane]) * fraction;
        }
    }
}

/// Numbers from `from` on.
#[inline(always)]
fn numbers<W: Wide>(slice: &[f32], from: usize) -> W::Numbers {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&slice[from..from + LANES]);
    W::Numbers::load(&lanes)
}

/// Codes to floats; both of one length, a multiple of the lanes.
#[inline(always)]
fn convert<T: Code>(codes: &[T], out: &mut [f32]) {
    for (out, codes) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(codes.as_chunks::<LANES>().0) {
        // Written at once: one by one, each might be a code that is still to be read.
        let mut numbers = [0.0; LANES];
        for lane in 0..LANES {
            numbers[lane] = codes[lane].as_f32();
        }
        *out = numbers;
    }
}
