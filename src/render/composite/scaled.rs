//! Resampling of scaled slices: several voxel scanlines to one of pixels, with weights that differ from
//! pixel to pixel.
//!
//! The filter is separable: the voxel scanlines under a scanline of pixels are added up, weighted, to
//! one, and pixels gather from that. The weights along u are the same for every scanline of a slice
//! and tabulated once for all those of a band.

use std::ops::Range;

use glam::Vec4;

use super::WORD;
use super::footprint::Footprint;
use super::mask::{Mask, Runs};
use super::samples::{Position, Quads, Row, RowBuffer, lerp};
use crate::classify::preintegration::Slabs;

/// First voxels and weights of a slice's pixels along u.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    /// What is tabulated.
    footprint: Option<Footprint>,
    taps: usize,
    start: usize,
    first: Vec<u32>,
    weights: Vec<f32>,
}

impl Columns {
    /// Tabulates the pixels `us` of a slice, unless they are.
    #[inline(always)]
    pub fn fill(&mut self, footprint: &Footprint, us: &Range<usize>) {
        let end = self.start + self.first.len();
        if self.footprint.as_ref() == Some(footprint) && self.start <= us.start && us.end <= end {
            return;
        }
        self.footprint = Some(*footprint);
        self.taps = footprint.taps();
        self.start = us.start;
        self.first.clear();
        self.weights.clear();
        self.first.reserve(us.len());
        self.weights.reserve(us.len() * self.taps);
        for u in us.clone() {
            let first = footprint.first(u);
            self.first.push(first as u32);
            for i in first..first + self.taps {
                self.weights.push(footprint.weight(u, i));
            }
        }
    }

    /// The voxels under the pixels `us`.
    #[inline(always)]
    pub fn under(&self, us: &Range<usize>) -> Range<usize> {
        let [from, to] = [us.start, us.end - 1].map(|u| self.first[u - self.start] as usize);
        from..to + self.taps
    }

    /// Pixels from `u` on, gathered from `voxels`, the first of which is voxel `base`.
    #[inline(always)]
    pub fn gather(&self, u: usize, voxels: &[Vec4], base: usize, out: &mut [Vec4]) {
        match self.taps {
            2 => self.gather_taps::<2>(u, voxels, base, out),
            3 => self.gather_taps::<3>(u, voxels, base, out),
            _ => self.gather_any(u, voxels, base, out),
        }
    }

    #[inline(always)]
    fn gather_taps<const TAPS: usize>(&self, u: usize, voxels: &[Vec4], base: usize, out: &mut [Vec4]) {
        let (first, weights) = (&self.first[u - self.start..], &self.weights[(u - self.start) * TAPS..]);
        for ((out, first), weights) in out.iter_mut().zip(first).zip(weights.chunks_exact(TAPS)) {
            let voxels = &voxels[*first as usize - base..][..TAPS];
            let mut sum = voxels[0] * weights[0];
            for tap in 1..TAPS {
                sum += voxels[tap] * weights[tap];
            }
            *out = sum;
        }
    }

    #[inline(never)]
    fn gather_any(&self, u: usize, voxels: &[Vec4], base: usize, out: &mut [Vec4]) {
        for (n, out) in out.iter_mut().enumerate() {
            let at = u - self.start + n;
            let weights = &self.weights[at * self.taps..][..self.taps];
            *out = weighted(&voxels[self.first[at] as usize - base..][..self.taps], weights);
        }
    }
}

/// The voxel scanlines of a slice that a scanline of pixels is made of: as many as there are taps, scanline
/// j always in the same place.
#[derive(Debug)]
struct Ring {
    rows: Vec<Row>,
    k: usize,
}

impl Ring {
    /// Makes room for `taps` scanlines of `length` voxels of slice `k`.
    #[inline(always)]
    fn enter(&mut self, taps: usize, length: usize, k: usize) {
        if self.k != k || self.rows.len() < taps {
            self.k = k;
            self.rows.resize_with(self.rows.len().max(taps), || Row::new(length));
            self.rows.iter_mut().for_each(|row| row.j = None);
        }
    }

    /// Adds up voxels `us` of the scanlines from `first` on, `weights` of each.
    #[inline(always)]
    fn add_up(&mut self, voxels: &dyn Quads, first: usize, weights: &[f32], hull: &Range<usize>, sum: &mut [Vec4]) {
        let mut empty = true;
        for (j, &weight) in (first..).zip(weights).filter(|(_, weight)| **weight > 0.0) {
            let place = j % self.rows.len();
            let row = &mut self.rows[place];
            if row.j != Some(j) {
                row.enter(j);
            }
            row.fetch(voxels, j, self.k, hull.start, hull.end - 1);
            // Voxel i of a row is at i + 1.
            add(sum, &row.voxels[hull.start + 1..hull.end + 1], weight, empty);
            empty = false;
        }
    }
}

/// Row buffers for scaled slices of samples.
#[derive(Debug)]
pub struct ScaledRows {
    length: usize,
    near: Ring,
    far: Ring,
    columns: Columns,
    weights: Vec<f32>,
    sum: Vec<Vec4>,
}

impl ScaledRows {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let ring = || Ring { rows: vec![], k: usize::MAX };
        Self {
            length,
            near: ring(),
            far: ring(),
            columns: Columns::default(),
            weights: vec![],
            sum: vec![Vec4::ZERO; length],
        }
    }

    /// Samples the pixels of `mask`, which are some of `us`, on scanline `v`. Pixel u goes to `out[u - base]`.
    #[inline(always)]
    pub fn sample<S: Slabs>(
        &mut self,
        voxels: &dyn Quads,
        table: S,
        position: &Position<[Footprint; 2]>,
        (us, v): (&Range<usize>, usize),
        mask: &Mask,
        (out, base): (&mut [Vec4], isize),
    ) {
        let [along_u, along_v] = &position.placement;
        self.columns.fill(along_u, us);
        let (first, taps) = (along_v.first(v), along_v.taps());
        self.weights.clear();
        self.weights.extend((first..first + taps).map(|j| along_v.weight(v, j)));
        self.near.enter(taps, self.length, position.near);
        if let Some((k, _)) = position.far {
            self.far.enter(taps, self.length, k);
        }
        for (u, length) in Runs::new(mask) {
            let hull = self.columns.under(&(u..u + length));
            let out = &mut out[(u as isize - base) as usize..][..length];
            let sum = &mut self.sum[..hull.len()];
            self.near.add_up(voxels, first, &self.weights, &hull, sum);
            self.columns.gather(u, sum, hull.start, out);
            if let Some((_, part)) = position.far {
                let mut beyond = [Vec4::ZERO; WORD];
                self.far.add_up(voxels, first, &self.weights, &hull, sum);
                self.columns.gather(u, sum, hull.start, &mut beyond[..length]);
                for (near, far) in out.iter_mut().zip(beyond) {
                    *near = lerp(*near, far, part);
                }
            }
            for sample in out {
                *sample = sample.with_x(table.coordinate(sample.x));
            }
        }
    }
}

/// The weighted sum of voxels, from the first on.
#[inline(always)]
pub fn weighted(voxels: &[Vec4], weights: &[f32]) -> Vec4 {
    let mut sum = voxels[0] * weights[0];
    for (voxel, weight) in voxels[1..].iter().zip(&weights[1..]) {
        sum += *voxel * *weight;
    }
    sum
}

/// Adds a voxel scanline to those added up so far; `first` where there are none.
#[inline(always)]
pub fn add(sum: &mut [Vec4], voxels: &[Vec4], weight: f32, first: bool) {
    if first {
        for (sum, voxel) in sum.iter_mut().zip(voxels) {
            *sum = *voxel * weight;
        }
    } else {
        for (sum, voxel) in sum.iter_mut().zip(voxels) {
            *sum += *voxel * weight;
        }
    }
}
