//! A table of slabs by front and back scalar, and how it is read (Schulze et al. 2003).
//!
//! Reading is what the innermost loops do once a sample: two positions are taken apart, four entries
//! loaded and interpolated. What is interpolated is premultiplied colour and opacity. Optical depth would
//! be no better: between entries it bends as much, and needs an exponential.
//!
//! The table takes 16 bytes an entry, 1 MB for 256 x 256, but neighbouring samples read neighbouring
//! entries, and most slabs are nearly of one scalar: what a frame touches of it stays in the
//! second-level cache.

use std::cmp::Ordering;
use std::sync::Arc;

use glam::Vec4;
use rayon::prelude::*;

use super::fixed::{nearest, split};
use super::ranges::Ranges;
use super::{Form, SlabAxis, Slabs};
use crate::simd::wide::{LANES, Lanes, Wide};

/// A table of slabs of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabTable {
    axis: Arc<SlabAxis>,
    /// By `front * stride + back`; the last row and the last column are there twice, so that what
    /// lies on the last entry, or a hair beyond, can be read as if it lay before another.
    slabs: Vec<Vec4>,
    /// As narrow as it is, so that no index overflows.
    stride: u32,
    length: f32,
}

impl SlabTable {
    /// Integrates the slabs of `length` mm.
    pub(super) fn new(ranges: &Ranges, axis: Arc<SlabAxis>, form: Form, length: f32) -> Self {
        let entries = axis.entries();
        let slabs: Vec<_> = (0..entries)
            .into_par_iter()
            .map(|from| {
                let to_each = ranges.slabs(from, length).into_iter().flat_map(|eight| {
                    (0..LANES).map(move |n| eight.lane(n).map(|slab| form.slab(slab, eight.depth[n])))
                });
                to_each.collect::<Vec<_>>()
            })
            .collect();
        let stride = entries + 1;
        let mut table = vec![Vec4::ZERO; stride * (entries + 1)];
        table.par_chunks_mut(stride).enumerate().for_each(|(front, row)| {
            let front = front.min(entries - 1);
            for (back, slab) in row.iter_mut().enumerate() {
                let back = back.min(entries - 1);
                *slab = match back.cmp(&front) {
                    Ordering::Greater => slabs[front][back - front - 1][0],
                    Ordering::Less => slabs[back][front - back - 1][1],
                    Ordering::Equal => ranges.constant(front, length, form),
                };
            }
        });
        Self { axis, slabs: table, stride: stride as u32, length }
    }

    /// Scalar codes -> positions on the table's axis.
    #[inline(always)]
    pub fn axis(&self) -> &SlabAxis {
        &self.axis
    }

    /// The length of its slabs, mm.
    pub fn length(&self) -> f32 {
        self.length
    }

    /// Bytes in memory of a table of so many entries along an axis.
    pub(super) fn bytes(entries: usize) -> u64 {
        ((entries + 1) * (entries + 1) * size_of::<Vec4>()) as u64
    }

    /// The entry nearest to two positions on the axis.
    #[inline(always)]
    pub fn nearest(&self, front: f32, back: f32) -> Vec4 {
        self.slabs.get(nearest(front) * self.stride as usize + nearest(back)).copied().unwrap_or_default()
    }

    /// Interpolated between the four entries around two positions on the axis.
    #[inline(always)]
    pub fn bilinear(&self, front: f32, back: f32) -> Vec4 {
        let ((front, wf), (back, wb)) = (split(front), split(back));
        let near = front * self.stride as usize + back;
        let far = near + self.stride as usize;
        // Always there: positions are on the axis.
        let (Some(near), Some(far)) = (self.slabs.get(near..near + 2), self.slabs.get(far..far + 2)) else {
            return Vec4::ZERO;
        };
        let near = near[0] + (near[1] - near[0]) * wb;
        let far = far[0] + (far[1] - far[0]) * wb;
        near + (far - near) * wf
    }

    /// The same of eight, by component.
    #[inline(always)]
    fn bilinear_lanes<W: Wide>(&self, front: &Lanes, back: &Lanes) -> [Lanes; 4] {
        let (at, [wf, wb]) = W::entries([front, back], self.stride);
        W::bilinear_vectors(&self.slabs, self.stride as usize, &at, [&wb, &wf])
    }
}

/// The nearest entry.
#[derive(Clone, Copy, Debug)]
pub struct Nearest<'a>(pub &'a SlabTable);

impl Slabs for Nearest<'_> {
    #[inline(always)]
    fn coordinate(self, code: f32) -> f32 {
        self.0.axis.coordinate(code)
    }

    #[inline(always)]
    fn slab(self, front: f32, back: f32) -> Vec4 {
        self.0.nearest(front, back)
    }

    #[inline(always)]
    fn coordinates<W: Wide>(self, codes: &Lanes) -> Lanes {
        self.0.axis.coordinates::<W>(codes)
    }
}

/// Between four entries.
#[derive(Clone, Copy, Debug)]
pub struct Bilinear<'a>(pub &'a SlabTable);

impl Slabs for Bilinear<'_> {
    #[inline(always)]
    fn coordinate(self, code: f32) -> f32 {
        self.0.axis.coordinate(code)
    }

    #[inline(always)]
    fn slab(self, front: f32, back: f32) -> Vec4 {
        self.0.bilinear(front, back)
    }

    #[inline(always)]
    fn coordinates<W: Wide>(self, codes: &Lanes) -> Lanes {
        self.0.axis.coordinates::<W>(codes)
    }

    #[inline(always)]
    fn slabs<W: Wide>(self, front: &Lanes, back: &Lanes) -> [Lanes; 4] {
        self.0.bilinear_lanes::<W>(front, back)
    }
}
