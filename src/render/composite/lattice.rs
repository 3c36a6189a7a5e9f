//! How the pixels of a scanline lie over slices: what tells the kernel of a parallel view from that of a
//! perspective one.
//!
//! Under parallel projection pixels lie as far apart as voxels ([`Unit`]): one offset and four
//! weights serve all of a slice, and a row of cells becomes a row of pixels by a shift. In
//! perspective slices are scaled ([`Scaled`]): each pixel has weights of its own, and so has each ray
//! its length between two slices. The kernel is compiled for either.

use std::fmt::Debug;
use std::ops::Range;

use glam::Vec4;

use super::footprint::Footprint;
use super::mask::Mask;
use super::occupied::Occupied;
use super::samples::{Position, Quads, SampleRows};
use super::scaled::ScaledRows;
use super::{WORD, first_run, run_mask};
use crate::classify::preintegration::Slabs;
use crate::render::factorization::{Factorization, SlicePlacement};
use crate::render::ranges::hull;
use crate::render::simd::prefetch_at;
use crate::render::simd::shorts::Shorts;

/// A way for pixels to lie over slices.
pub trait Lattice: Copy + Debug + Send + Sync + 'static {
    /// Where a slice lies.
    type Placement: Copy + Debug + Send + Sync;
    /// Row buffers for the voxels of a slice.
    type Rows: Debug + Send;
    /// True where rays differ in length.
    const LENGTHS: bool;

    /// The slice at `k`, which may be between two slices of voxels.
    fn placement(factorization: &Factorization, k: f64) -> Self::Placement;

    /// The pixels along u and the scanlines whose centres lie on a slice.
    fn inside(factorization: &Factorization, placement: &Self::Placement) -> [Range<usize>; 2];

    /// Row buffers for `factorization`.
    fn rows(factorization: &Factorization) -> Self::Rows;

    /// Samples that a buffer slice has in a scanline.
    fn buffer_length(factorization: &Factorization) -> usize;

    /// The pixel of a buffer slice's first sample.
    fn buffer_base(placement: &Self::Placement) -> isize;

    /// Makes `pixels` those of scanline `v` whose rays pass a marked cell of a `layer` between the slices
    /// at `ends`, or perhaps a neighbour of it, and which are set in both masks of `open`. False where there is none; what `pixels` are then means
    /// nothing.
    fn mark<W: Shorts>(
        factorization: &Factorization,
        occupied: &Occupied<'_>,
        layer: usize,
        ends: [&Self::Placement; 2],
        v: usize,
        open: (&[u64], &Mask),
        pixels: &mut Mask,
    ) -> bool;

    /// Samples the pixels of `mask` on a scanline: `at` has pixels that they are some of, and the scanline's
    /// v. Pixel u goes to `out.0[u - out.1]`.
    fn sample<S: Slabs>(
        rows: &mut Self::Rows,
        voxels: &dyn Quads,
        table: S,
        position: &Position<Self::Placement>,
        at: (&Range<usize>, usize),
        mask: &Mask,
        out: (&mut [Vec4], isize),
    );
}

/// Pixels as far apart as voxels.
#[derive(Clone, Copy, Debug)]
pub struct Unit;

impl Lattice for Unit {
    type Placement = SlicePlacement;
    type Rows = SampleRows;
    const LENGTHS: bool = false;

    fn placement(factorization: &Factorization, k: f64) -> SlicePlacement {
        factorization.placement(k)
    }

    fn inside(factorization: &Factorization, placement: &SlicePlacement) -> [Range<usize>; 2] {
        [0, 1].map(|axis| {
            let voxels = factorization.dims[axis] - usize::from(placement.fraction[axis] > 0.0);
            placement.first[axis]..placement.first[axis] + voxels
        })
    }

    fn rows(factorization: &Factorization) -> SampleRows {
        SampleRows::new(factorization.dims[0])
    }

    /// A slice is continued by a sample before its first one.
    fn buffer_length(factorization: &Factorization) -> usize {
        factorization.dims[0] + 1
    }

    #[inline(always)]
    fn buffer_base(placement: &SlicePlacement) -> isize {
        placement.first[0] as isize - 1
    }

    #[inline(always)]
    fn mark<W: Shorts>(
        factorization: &Factorization,
        occupied: &Occupied<'_>,
        layer: usize,
        ends: [&SlicePlacement; 2],
        v: usize,
        (open, inside): (&[u64], &Mask),
        pixels: &mut Mask,
    ) -> bool {
        let [ni, nj, nk] = factorization.dims;
        let [j_front, j_back] =
            ends.map(|SlicePlacement { first, .. }| (v + 1).saturating_sub(first[1] + 1).min(nj - 2));
        let scanlines = [(j_front, ends[0]), (j_back, ends[1])];
        let next = if factorization.reversed { layer.checked_sub(2) } else { Some(layer + 2).filter(|&l| l + 1 < nk) };
        if let Some(next) = next.filter(|&next| occupied.holds(j_back, next)) {
            prefetch_at(occupied.scanline_and_more(j_back, next), 0);
        }
        if !occupied.holds(j_front, layer) && !occupied.holds(j_back, layer) {
            return false;
        }
        let scanlines = scanlines.map(|(j, end)| (occupied.scanline_and_more(j, layer), end.first[0]));
        pixels.set_cells_within::<W>(scanlines, occupied.within(), ni - 1, open, inside)
    }

    #[inline(always)]
    fn sample<S: Slabs>(
        rows: &mut SampleRows,
        voxels: &dyn Quads,
        table: S,
        position: &Position<SlicePlacement>,
        (_, v): (&Range<usize>, usize),
        mask: &Mask,
        out: (&mut [Vec4], isize),
    ) {
        rows.sample(voxels, table, position, v, mask, out);
    }
}

/// Slices scaled by what the pixels' footprints tell.
#[derive(Clone, Copy, Debug)]
pub struct Scaled;

impl Lattice for Scaled {
    /// Along u and along v.
    type Placement = [Footprint; 2];
    type Rows = ScaledRows;
    const LENGTHS: bool = true;

    fn placement(factorization: &Factorization, k: f64) -> [Footprint; 2] {
        let lattice = factorization.lattice(k);
        [0, 1].map(|axis| Footprint::new(&lattice, axis, factorization.dims[axis]))
    }

    fn inside(factorization: &Factorization, placement: &[Footprint; 2]) -> [Range<usize>; 2] {
        [0, 1].map(|axis| placement[axis].inside(factorization.size[axis]))
    }

    fn rows(factorization: &Factorization) -> ScaledRows {
        ScaledRows::new(factorization.dims[0])
    }

    fn buffer_length(factorization: &Factorization) -> usize {
        factorization.size[0]
    }

    #[inline(always)]
    fn buffer_base(_: &[Footprint; 2]) -> isize {
        0
    }

    /// The cells of a ray are those from the voxels that it is sampled from on one slice to those on the
    /// other, along either axis.
    #[inline(always)]
    fn mark<W: Shorts>(
        factorization: &Factorization,
        occupied: &Occupied<'_>,
        layer: usize,
        ends: [&[Footprint; 2]; 2],
        v: usize,
        (open, inside): (&[u64], &Mask),
        pixels: &mut Mask,
    ) -> bool {
        let [ni, nj, _] = factorization.dims;
        let [front, back] = ends.map(|[_, along_v]| along_v.under(&(v..v + 1)));
        let first = front.start.min(back.start).min(nj - 2);
        let end = front.end.max(back.end) - 1;
        if (first..end.max(first + 1)).all(|j| !occupied.holds(j, layer)) {
            return false;
        }
        let [front, back] = ends.map(|[along_u, _]| along_u);
        pixels.clear();
        for word in 0..(ni - 1).div_ceil(WORD) {
            let mut cells = 0;
            for j in first..end.max(first + 1) {
                cells |= occupied.scanline(j, layer)[word];
            }
            while cells != 0 {
                let (start, length) = first_run(cells);
                cells &= !run_mask(start, length);
                // From the middle of the run's first cell to that of its last; at the slice's border, from afar.
                let (from, to) = (word * WORD + start, word * WORD + start + length);
                let low = if from == 0 { f64::NEG_INFINITY } else { from as f64 + 0.5 };
                let high = if to >= ni - 1 { f64::INFINITY } else { to as f64 - 0.5 };
                let (front, back) = (front.touching(low, high), back.touching(low, high));
                pixels.add(hull(&front, &back));
            }
        }
        pixels.keep_within(open, inside)
    }

    #[inline(always)]
    fn sample<S: Slabs>(
        rows: &mut ScaledRows,
        voxels: &dyn Quads,
        table: S,
        position: &Position<[Footprint; 2]>,
        at: (&Range<usize>, usize),
        mask: &Mask,
        out: (&mut [Vec4], isize),
    ) {
        rows.sample(voxels, table, position, at, mask, out);
    }
}
