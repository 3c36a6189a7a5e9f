//! Resampling of scaled slices: several voxel scanlines to one of pixels, with weights that differ from
//! pixel to pixel.
//!
//! The filter is separable: the voxel scanlines under a scanline of pixels are added up, weighted, to
//! one, and pixels gather from that. The weights along u are the same for every scanline of a slice
//! and tabulated once for all those of a band.

use std::ops::Range;

use glam::Vec4;

use super::footprint::Footprint;

/// First voxels and weights of a slice's pixels along u.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    taps: usize,
    start: usize,
    first: Vec<u32>,
    weights: Vec<f32>,
}

impl Columns {
    /// Tabulates the pixels `us` of a slice.
    #[inline(always)]
    pub fn fill(&mut self, footprint: &Footprint, us: &Range<usize>) {
        self.taps = footprint.taps();
        self.start = us.start;
        self.first.clear();
        self.weights.clear();
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
