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

use glam::{Mat4, Vec4};

use super::packet::{IN_SLICE, LANES, Lanes, Packet};
use super::{least, most};
use crate::volume::gradient::Code;
use crate::volume::scanlines::Scanlines;

/// Added to a number of 0 to 2^22, rounds it to an integer, tie to even, and leaves that in the lowest bits.
const INTEGER: f32 = 8_388_608.0;

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
    index: [u32; LANES],
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
    /// Voxels of a row: a multiple of the lanes.
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
    }

    /// Makes the slice `fraction` of the way from the near one to the far one.
    #[inline(always)]
    pub fn interpolate(&mut self, fraction: f32) {
        let length = self.stride * self.rows + LANES;
        lerp([&self.slices[1], &self.slices[2]], fraction, length, &mut self.between);
    }

    /// Makes the differences of the slice `fraction` of the way.
    #[inline(always)]
    pub fn differentiate(&mut self, fraction: f32) {
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
            let at = |slice: &[f32], from: usize| lanes(slice, from);
            let (left, right) = (at(middle, n), at(middle, n + 2));
            let (above, below) = (at(middle, n + 1 - stride), at(middle, n + 1 + stride));
            let (a, b, c, d) = (at(before, n + 1), at(near, n + 1), at(far, n + 1), at(behind, n + 1));
            let mut differences = [[0.0; LANES]; 3];
            for lane in 0..LANES {
                differences[0][lane] = right[lane] - left[lane];
                differences[1][lane] = below[lane] - above[lane];
                let (front, back) = (c[lane] - a[lane], d[lane] - b[lane]);
                differences[2][lane] = front + (back - front) * fraction;
            }
            let [x, y, z] = differences;
            let out = &mut self.gradients[n..n + LANES];
            let voxels = columns(&[x, y, z, [0.0; LANES]]);
            out.copy_from_slice(&voxels);
        }
    }

    /// Where the packet meets the slice at slice position `t` of the layer that touches `cells`.
    #[inline(always)]
    pub fn places(&self, packet: &Packet, cells: &Cells, t: f32) -> Places {
        let (mut whole, mut fractions) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
        for n in 0..2 {
            let origin = self.first[n] as f32;
            let (low, high) = (cells.first[n] as f32, (cells.last[n] + 1) as f32);
            let last = (cells.last[n] - self.first[n]) as f32;
            let at = packet.at(n, t);
            for lane in 0..LANES {
                // Rounding may leave a ray a hair outside of the cells.
                let at = least(most(at[lane], low), high) - origin;
                let cell = least((most(at - 0.5, 0.0) + INTEGER) - INTEGER, last);
                whole[n][lane] = cell;
                fractions[n][lane] = at - cell;
            }
        }
        let stride = self.stride as f32;
        let mut index = [0; LANES];
        for lane in 0..LANES {
            let at = (whole[1][lane] * stride + whole[0][lane]) + INTEGER;
            index[lane] = at.to_bits() & 0x7f_ffff;
        }
        Places { index, fractions }
    }

    /// Scalars where a packet meets a slice.
    #[inline(always)]
    pub fn scalars(&self, slice: Slice, places: &Places) -> Lanes {
        let slice: &[f32] = match slice {
            Slice::Near => &self.slices[1],
            Slice::Between => &self.between,
            Slice::Far => &self.slices[2],
        };
        let mut voxels = [[0.0; LANES]; 4];
        for lane in 0..LANES {
            // The first cell's first voxel has one before it along either axis.
            let upper = places.index[lane] as usize + self.stride + 1;
            let lower = upper + self.stride;
            // Always there: places are within the patch.
            if lower + 1 >= slice.len() {
                return [0.0; LANES];
            }
            [voxels[0][lane], voxels[1][lane]] = [slice[upper], slice[upper + 1]];
            [voxels[2][lane], voxels[3][lane]] = [slice[lower], slice[lower + 1]];
        }
        let mut scalars = [0.0; LANES];
        for lane in 0..LANES {
            let [fi, fj] = [places.fractions[0][lane], places.fractions[1][lane]];
            let near = voxels[0][lane] + (voxels[1][lane] - voxels[0][lane]) * fi;
            let far = voxels[2][lane] + (voxels[3][lane] - voxels[2][lane]) * fi;
            scalars[lane] = near + (far - near) * fj;
        }
        scalars
    }

    /// Twice the central differences along `i`, `j` and the order of travel where a packet meets the slice
    /// that was [differentiated](Self::differentiate).
    #[inline(always)]
    pub fn gradients(&self, places: &Places) -> [Lanes; 3] {
        let mut gradients = [Vec4::ZERO; LANES];
        for lane in 0..LANES {
            let upper = places.index[lane] as usize + self.stride;
            let lower = upper + self.stride;
            if lower + 1 >= self.gradients.len() {
                return [[0.0; LANES]; 3];
            }
            let [fi, fj] = [places.fractions[0][lane], places.fractions[1][lane]];
            let (a, b) = (self.gradients[upper], self.gradients[upper + 1]);
            let (c, d) = (self.gradients[lower], self.gradients[lower + 1]);
            let near = a + (b - a) * fi;
            let far = c + (d - c) * fi;
            gradients[lane] = near + (far - near) * fj;
        }
        let [x, y, z, _] = rows(&gradients);
        [x, y, z]
    }
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
fn lanes(slice: &[f32], from: usize) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&slice[from..from + LANES]);
    lanes
}

/// Codes to floats; both of one length, a multiple of the lanes.
#[inline(always)]
fn convert<T: Code>(codes: &[T], out: &mut [f32]) {
    for (out, codes) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(codes.as_chunks::<LANES>().0) {
        for lane in 0..LANES {
            out[lane] = codes[lane].as_f32();
        }
    }
}

/// By component -> by lane.
#[inline(always)]
pub fn columns(rows: &[Lanes; 4]) -> [Vec4; LANES] {
    let mut columns = [Vec4::ZERO; LANES];
    for half in 0..2 {
        let four = |row: &Lanes| Vec4::new(row[4 * half], row[4 * half + 1], row[4 * half + 2], row[4 * half + 3]);
        let turned = Mat4::from_cols(four(&rows[0]), four(&rows[1]), four(&rows[2]), four(&rows[3])).transpose();
        columns[4 * half] = turned.x_axis;
        columns[4 * half + 1] = turned.y_axis;
        columns[4 * half + 2] = turned.z_axis;
        columns[4 * half + 3] = turned.w_axis;
    }
    columns
}

/// By lane -> by component.
#[inline(always)]
pub fn rows(columns: &[Vec4; LANES]) -> [Lanes; 4] {
    let mut rows = [[0.0; LANES]; 4];
    for half in 0..2 {
        let [a, b, c, d] = [0, 1, 2, 3].map(|n| columns[4 * half + n]);
        let turned = Mat4::from_cols(a, b, c, d).transpose();
        let turned = [turned.x_axis, turned.y_axis, turned.z_axis, turned.w_axis];
        for n in 0..4 {
            rows[n][4 * half..4 * half + 4].copy_from_slice(&turned[n].to_array());
        }
    }
    rows
}
