//! Where the kernel of voxels gets them from: run-length encoded, or unencoded and classified as they
//! are drawn.
//!
//! Both give the same voxels, the first without looking at transparent ones (Lacroute and Levoy 1994,
//! section 3.1), the second without having been prepared for the transfer function (section 3.3): it marks all
//! of a leaf's voxels where the leaf may hold something to draw, and asks each that a pixel touches
//! whether it is transparent. Frames of either are the same bit for bit, so that one stands in for the other
//! as long as there is no encoding ("switch modes").

use glam::Vec4;

use super::WORD;
use super::occupied::LeafRows;
use super::run_mask;
use super::samples::{BLOCK, VoxelRows};
use crate::classify::CodeTables;
use crate::classify::rle::{AxisEncoding, Scanline, Voxel};
use crate::render::material::{Light, SliceMaterial};
use crate::volume::gradient::Code;

/// Voxels by scanline.
pub trait VoxelSource: Copy + Send + Sync {
    /// A scanline, found.
    type Scanline: Copy;

    /// True where marked voxels may turn out to be transparent when [`Self::classify`] is asked.
    const CLASSIFIES: bool;

    /// Scanline `j` of slice `k`.
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline;

    /// True where nothing would be marked.
    fn is_empty(&self, scanline: &Self::Scanline) -> bool;

    /// Sets the bits of voxels that may be drawn.
    fn mark(&self, scanline: &Self::Scanline, marked: &mut [u64]);

    /// Which of the eight voxels of a block are drawn, a bit each.
    fn classify(&self, scanline: &Self::Scanline, block: usize) -> u64;

    /// Shades the voxels that are `asked` for and not `shaded` yet (or some more) into a row of them, which
    /// is zero elsewhere. Voxels that are not drawn come out as zero.
    fn shade<H: Light, const FACTORED: bool>(
        &self,
        scanline: &Self::Scanline,
        asked: &[u64],
        row: ShadedRow<'_>,
        material: SliceMaterial<'_, H, FACTORED>,
    );

    /// Voxel (i, j, k) and its gradient opacity (255 = 1), the plain way; `None` where it is not drawn.
    fn voxel(&self, at: [usize; 3]) -> Option<(Voxel, u8)>;
}

/// A scanline's shaded voxels.
#[derive(Debug)]
pub struct ShadedRow<'a> {
    /// Premultiplied colour and opacity by voxel.
    pub voxels: &'a mut [Vec4],
    /// Voxels that are there.
    pub shaded: &'a mut [u64],
    /// The scanline's j and k.
    pub at: [usize; 2],
}

impl<'a> VoxelSource for AxisEncoding<'a> {
    type Scanline = Scanline<'a>;
    const CLASSIFIES: bool = false;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Scanline<'a> {
        AxisEncoding::scanline(self, j, k)
    }

    #[inline(always)]
    fn is_empty(&self, scanline: &Scanline<'a>) -> bool {
        scanline.voxels.is_empty()
    }

    #[inline(always)]
    fn mark(&self, scanline: &Scanline<'a>, marked: &mut [u64]) {
        for (marked, encoded) in marked.iter_mut().zip(scanline.marked) {
            *marked |= encoded;
        }
    }

    #[inline(always)]
    fn classify(&self, _: &Scanline<'a>, _: usize) -> u64 {
        u64::MAX
    }

    /// Per run the stretch from the first to the last voxel that is asked for and not there yet.
    #[inline(always)]
    fn shade<H: Light, const FACTORED: bool>(
        &self,
        scanline: &Scanline<'a>,
        asked: &[u64],
        row: ShadedRow<'_>,
        material: SliceMaterial<'_, H, FACTORED>,
    ) {
        let mut before = 0;
        let [j, k] = row.at;
        for (word, &marked) in scanline.marked.iter().enumerate() {
            let mut missing = asked[word] & marked & !row.shaded[word];
            while missing != 0 {
                let first = missing.trailing_zeros() as usize;
                let run = run_mask(first, (marked >> first).trailing_ones() as usize);
                let end = WORD - (missing & run).leading_zeros() as usize;
                missing &= !run;
                let place = before + (marked & !(u64::MAX << first)).count_ones() as usize;
                let stored = place..place + end - first;
                let factors = if FACTORED { &scanline.factors[stored.clone()] } else { &[] };
                let (out, i) = (&mut row.voxels[word * WORD + first..word * WORD + end], word * WORD + first);
                material.colors(&scanline.voxels[stored], factors, [i, j, k], out);
                row.shaded[word] |= run_mask(first, end - first);
            }
            before += marked.count_ones() as usize;
        }
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let scanline = AxisEncoding::scanline(self, j, k);
        let place = scanline.place_of(i)?;
        Some((scanline.voxels[place], scanline.factors.get(place).copied().unwrap_or(u8::MAX)))
    }
}

/// Unencoded scanlines, and what octree and summed-area table say of their leaves.
#[derive(Clone, Copy, Debug)]
pub struct Unencoded<'a, T> {
    pub voxels: VoxelRows<'a, T>,
    pub leaves: &'a LeafRows,
    pub tables: &'a CodeTables,
}

impl<T: Code> Unencoded<'_, T> {
    /// The gradient opacity of a voxel, 0 where it is not drawn.
    #[inline(always)]
    fn factor(&self, code: u16, at: [usize; 3]) -> u8 {
        let tau = self.tables.extinction[usize::from(code)];
        if tau > 0.0 {
            let factor = self.voxels.gradient_factor(at);
            if self.tables.is_visible(tau, factor) { factor } else { 0 }
        } else {
            0
        }
    }
}

impl<'a, T: Code> VoxelSource for Unencoded<'a, T> {
    /// j, k, and the leaves that it passes.
    type Scanline = (usize, usize, &'a [u64]);
    const CLASSIFIES: bool = true;

    #[inline(always)]
    fn scanline(&self, j: usize, k: usize) -> Self::Scanline {
        (j, k, self.leaves.scanline(j, k))
    }

    #[inline(always)]
    fn is_empty(&self, (.., leaves): &Self::Scanline) -> bool {
        leaves.iter().all(|&bits| bits == 0)
    }

    #[inline(always)]
    fn mark(&self, (.., leaves): &Self::Scanline, marked: &mut [u64]) {
        for (marked, leaves) in marked.iter_mut().zip(*leaves) {
            *marked |= leaves;
        }
    }

    #[inline(always)]
    fn classify(&self, &(j, k, _): &Self::Scanline, block: usize) -> u64 {
        let first = block * BLOCK;
        let codes = self.voxels.codes(j, k, first);
        let mut drawn = 0;
        for (n, code) in codes.into_iter().enumerate() {
            drawn |= u64::from(self.tables.extinction[usize::from(code)] > 0.0) << n;
        }
        if self.voxels.has_gradient_opacity() {
            let mut asked = drawn;
            while asked != 0 {
                let n = asked.trailing_zeros() as usize;
                asked &= asked - 1;
                if self.factor(codes[n % BLOCK], [first + n, j, k]) == 0 {
                    drawn &= !(1 << n);
                }
            }
        }
        drawn
    }

    /// Block by block.
    #[inline(always)]
    fn shade<H: Light, const FACTORED: bool>(
        &self,
        &(j, k, _): &Self::Scanline,
        asked: &[u64],
        row: ShadedRow<'_>,
        material: SliceMaterial<'_, H, FACTORED>,
    ) {
        for (word, (asked, shaded)) in asked.iter().zip(row.shaded).enumerate() {
            let mut missing = asked & !*shaded;
            while missing != 0 {
                let block = missing.trailing_zeros() as usize / BLOCK;
                let mask = run_mask(block * BLOCK, BLOCK);
                missing &= !mask;
                *shaded |= mask;
                let first = word * WORD + block * BLOCK;
                let codes = self.voxels.codes(j, k, first);
                let normals = if H::LIT { self.voxels.normals(j, k, first) } else { [0; BLOCK] };
                let [scales, addends] = material.light(&normals, [first, j, k]);
                let out = &mut row.voxels[first..first + BLOCK];
                for n in 0..BLOCK {
                    let factor = if FACTORED { self.factor(codes[n], [first + n, j, k]) } else { u8::MAX };
                    out[n] = material.color(codes[n], factor, [scales[n], addends[n]]);
                }
            }
        }
    }

    fn voxel(&self, [i, j, k]: [usize; 3]) -> Option<(Voxel, u8)> {
        let code = self.voxels.codes(j, k, i)[0];
        let tau = self.tables.extinction[usize::from(code)];
        let factor = if self.voxels.has_gradient_opacity() { self.voxels.gradient_factor([i, j, k]) } else { u8::MAX };
        let drawn = self.tables.is_visible(tau, factor);
        drawn.then(|| (Voxel { code, normal: self.voxels.normals(j, k, i)[0] }, factor))
    }
}
