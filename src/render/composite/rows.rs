//! Row buffers: the two voxel scanlines that a row of pixels gathers from, shaded.
//!
//! A buffer is zero wherever no voxel was shaded into it, so that a pixel reads transparent voxels
//! without asking. Voxels are shaded when the first pixel needs them, and each only once while
//! its scanline is in a buffer.

use super::samples::BLOCK;
use super::sources::{ShadedRow, VoxelSource};
use super::{WORD, run_mask};
use crate::render::material::SliceShader;
use crate::render::pixel::Pixel;

/// One voxel scanline.
#[derive(Debug)]
pub struct Row<P> {
    /// The scanline's j, where one was entered.
    pub j: Option<usize>,
    /// Premultiplied colour and opacity by voxel; one more than the scanline has, always zero.
    pub voxels: Vec<P>,
    /// Non-transparent voxels (or, until they are classified, those that may be), a bit each.
    pub marked: Vec<u64>,
    /// Voxels whose marks are known to be of drawn ones.
    pub classified: Vec<u64>,
    /// Voxels to shade.
    asked: Vec<u64>,
    /// Voxels that are there.
    pub shaded: Vec<u64>,
    empty: bool,
}

impl<P: Pixel> Row<P> {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let words = length.div_ceil(WORD) + 1;
        Self {
            j: None,
            voxels: vec![P::CLEAR; words * WORD],
            marked: vec![0; words],
            classified: vec![0; words],
            asked: vec![0; words],
            shaded: vec![0; words],
            empty: true,
        }
    }

    /// Forgets what was there, for scanline `j`: zeros come back where voxels had been shaded.
    #[inline(always)]
    fn make_room(&mut self, j: usize) {
        for (word, bits) in self.shaded.iter_mut().enumerate() {
            if *bits != 0 {
                let (first, end) = (bits.trailing_zeros() as usize, WORD - bits.leading_zeros() as usize);
                self.voxels[word * WORD + first..word * WORD + end].fill(P::CLEAR);
                *bits = 0;
            }
        }
        self.j = Some(j);
    }

    /// Becomes scanline `j`, with nothing shaded yet, unless it is. True where it was another.
    #[inline(always)]
    pub fn enter(&mut self, j: usize) -> bool {
        let other = self.j != Some(j);
        if other {
            self.make_room(j);
        }
        other
    }

    /// Becomes scanline `j`, marked, with nothing shaded yet.
    #[inline(always)]
    pub fn enter_marked<V: VoxelSource>(&mut self, source: V, j: usize, scanline: &V::Scanline) {
        self.make_room(j);
        if !self.empty {
            self.marked.fill(0);
            self.classified.fill(0);
        }
        self.empty = source.is_empty(scanline);
        if !self.empty {
            source.mark(scanline, &mut self.marked);
        }
    }

    /// Takes back the marks of `touched` voxels that are not drawn.
    #[inline(always)]
    pub fn classify<V: VoxelSource>(&mut self, source: V, scanline: &V::Scanline, touched: &[u64]) {
        for (word, (marked, touched)) in self.marked.iter_mut().zip(touched).enumerate() {
            let mut asked = *marked & touched & !self.classified[word];
            while asked != 0 {
                let block = asked.trailing_zeros() as usize / BLOCK;
                let mask = run_mask(block * BLOCK, BLOCK);
                asked &= !mask;
                self.classified[word] |= mask;
                let drawn = source.classify(scanline, word * WORD / BLOCK + block);
                *marked &= !mask | drawn << (block * BLOCK);
            }
        }
    }

    /// Shades the marked ones of `touched` voxels of slice `k` that are not there yet.
    #[inline(always)]
    pub fn shade<V: VoxelSource, M: SliceShader<Pixel = P>>(
        &mut self,
        source: V,
        scanline: &V::Scanline,
        touched: &[u64],
        k: usize,
        material: M,
    ) {
        for ((asked, marked), touched) in self.asked.iter_mut().zip(&self.marked).zip(touched) {
            *asked = marked & touched;
        }
        let at = [self.j.unwrap_or_default(), k];
        let row = ShadedRow { voxels: &mut self.voxels, shaded: &mut self.shaded, at };
        source.shade(scanline, &self.asked, row, material);
    }
}

/// The upper and the lower voxel scanline of a row of pixels.
#[derive(Debug)]
pub struct RowBuffers<P> {
    upper: Row<P>,
    lower: Row<P>,
}

impl<P: Pixel> RowBuffers<P> {
    /// Buffers for scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        Self { upper: Row::new(length), lower: Row::new(length) }
    }

    /// Scanlines of another slice follow: none of those in the buffers is meant any more.
    #[inline(always)]
    pub fn next_slice(&mut self) {
        self.upper.j = None;
        self.lower.j = None;
    }

    /// Goes on to scanlines `j` and `j + 1`.
    #[inline(always)]
    pub fn go_on(&mut self, j: usize) {
        if self.lower.j == Some(j) {
            std::mem::swap(&mut self.upper, &mut self.lower);
        }
    }

    /// The upper scanline's buffer. What it holds may be of another scanline until it is [entered](Row::enter).
    #[inline(always)]
    pub fn upper(&mut self) -> &mut Row<P> {
        &mut self.upper
    }

    /// The lower one's.
    #[inline(always)]
    pub fn lower(&mut self) -> &mut Row<P> {
        &mut self.lower
    }

    /// The voxels of scanline `j` and, where pixels lie between two scanlines, `j + 1`.
    #[inline(always)]
    pub fn voxels(&mut self, j: usize, has_lower: bool) -> [&[P]; 2] {
        self.upper.enter(j);
        if has_lower {
            self.lower.enter(j + 1);
        }
        [&self.upper.voxels, &self.lower.voxels]
    }
}
