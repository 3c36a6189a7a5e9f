//! A table of slabs by front and back scalar, and how it is read.
//!
use std::cmp::Ordering;
use std::sync::Arc;

use glam::Vec4;
use rayon::prelude::*;

use super::ranges::Ranges;
use super::{Form, SlabAxis};

/// A table of slabs of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabTable {
    axis: Arc<SlabAxis>,
    /// By `front * stride + back`; a row and a column more than there are entries, so that what
    /// lies on the last entry can be read as if it lay before another.
    slabs: Vec<Vec4>,
    stride: usize,
}

/// Added to a position, rounds it to 2^-10 and leaves it as an integer in the lowest bits: between
/// 2^13 and 2^14 neighbouring floats are 2^-10 apart.
const FIXED: f32 = 12288.0;
const FRACTION_BITS: u32 = 10;

/// A position's entry and fraction.
#[inline(always)]
fn split(position: f32) -> (usize, f32) {
    let fixed = (position + FIXED).to_bits().wrapping_sub(FIXED.to_bits());
    let fraction = fixed & ((1 << FRACTION_BITS) - 1);
    ((fixed >> FRACTION_BITS) as usize, fraction as i32 as f32 * (1.0 / (1 << FRACTION_BITS) as f32))
}

/// The last entry at or before a position, as [`split`] rounds it.
pub(super) fn entry_before(position: f32) -> usize {
    split(position).0
}

/// The first entry at or after a position, as [`split`] rounds it.
pub(super) fn entry_after(position: f32) -> usize {
    let (entry, fraction) = split(position);
    entry + usize::from(fraction > 0.0)
}

impl SlabTable {
    /// Integrates the slabs of `length` mm.
    pub(super) fn new(ranges: &Ranges, axis: Arc<SlabAxis>, form: Form, length: f32) -> Self {
        let entries = axis.entries();
        let slabs: Vec<_> = (0..entries).into_par_iter().map(|from| ranges.slabs(from, length, form)).collect();
        let stride = entries + 1;
        let mut table = vec![Vec4::ZERO; stride * (entries + 1)];
        table[..stride * entries].par_chunks_mut(stride).enumerate().for_each(|(front, row)| {
            for (back, slab) in row[..entries].iter_mut().enumerate() {
                *slab = match back.cmp(&front) {
                    Ordering::Greater => slabs[front][back - front - 1][0],
                    Ordering::Less => slabs[back][front - back - 1][1],
                    Ordering::Equal => ranges.constant(front, length, form),
                };
            }
        });
        Self { axis, slabs: table, stride }
    }

    /// Scalar codes -> positions on the table's axis.
    #[inline(always)]
    pub fn axis(&self) -> &SlabAxis {
        &self.axis
    }

    /// Bytes in memory of a table of so many entries along an axis.
    pub(super) fn bytes(entries: usize) -> u64 {
        ((entries + 1) * (entries + 1) * size_of::<Vec4>()) as u64
    }

    /// The entry nearest to two positions on the axis.
    #[inline(always)]
    pub fn nearest(&self, front: f32, back: f32) -> Vec4 {
        let ((front, near), (back, far)) = (split(front), split(back));
        self.slabs[(front + usize::from(near >= 0.5)) * self.stride + back + usize::from(far >= 0.5)]
    }

    /// Interpolated between the four entries around two positions on the axis.
    #[inline(always)]
    pub fn bilinear(&self, front: f32, back: f32) -> Vec4 {
        let ((front, wf), (back, wb)) = (split(front), split(back));
        let four = &self.slabs[front * self.stride + back..][..self.stride + 2];
        let near = four[0] + (four[1] - four[0]) * wb;
        let far = four[self.stride] + (four[self.stride + 1] - four[self.stride]) * wb;
        near + (far - near) * wf
    }
}
