//! Row buffers: the two voxel scanlines that a row of pixels gathers from, shaded.
//!
//! A buffer is zero wherever no voxel was shaded into it, so that a pixel reads transparent voxels
//! without asking. Voxels are shaded when the first pixel needs them, and each only once while
//! its scanline is in a buffer.

use glam::Vec4;

use super::samples::BLOCK;
use super::sources::{ShadedRow, VoxelSource};
use super::spans::Spans;
use super::{WORD, run_mask};
use crate::render::material::{Light, SliceMaterial};

/// One voxel scanline.
#[derive(Debug)]
pub struct Row {
    /// The scanline's j, where one was entered.
    pub j: Option<usize>,
    /// Premultiplied colour and opacity by voxel; one more than the scanline has, always zero.
    pub voxels: Vec<Vec4>,
    /// Non-transparent voxels (or, until they are classified, those that may be), a bit each.
    pub marked: Vec<u64>,
    /// Voxels whose marks are known to be of drawn ones.
    classified: Vec<u64>,
    /// Voxels to shade.
    asked: Vec<u64>,
    /// Words that may hold shaded voxels, and which ones.
    shaded: Vec<u64>,
    empty: bool,
}

impl Row {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let words = length.div_ceil(WORD) + 1;
        Self {
            j: None,
            voxels: vec![Vec4::ZERO; words * WORD],
            marked: vec![0; words],
            classified: vec![0; words],
            asked: vec![0; words],
            shaded: vec![0; words],
            empty: true,
        }
    }

    /// Forgets what was there: zeros come back where voxels had been shaded.
    #[inline(always)]
    fn clear(&mut self) {
        if !self.empty {
            for (word, bits) in self.shaded.iter_mut().enumerate() {
                if *bits != 0 {
                    let (first, end) = (bits.trailing_zeros() as usize, WORD - bits.leading_zeros() as usize);
                    self.voxels[word * WORD + first..word * WORD + end].fill(Vec4::ZERO);
                    *bits = 0;
                }
            }
            self.marked.fill(0);
            self.classified.fill(0);
        }
        self.empty = true;
        self.j = None;
    }

    /// Becomes scanline `j`, with nothing shaded yet.
    #[inline(always)]
    pub fn enter<V: VoxelSource>(&mut self, source: V, j: usize, scanline: &V::Scanline) {
        self.clear();
        self.j = Some(j);
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
    pub fn shade<V: VoxelSource, H: Light, const FACTORED: bool>(
        &mut self,
        source: V,
        scanline: &V::Scanline,
        touched: &[u64],
        k: usize,
        material: SliceMaterial<'_, H, FACTORED>,
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
pub struct RowBuffers {
    upper: Row,
    lower: Row,
    has_lower: bool,
}

impl RowBuffers {
    /// Buffers for scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        Self { upper: Row::new(length), lower: Row::new(length), has_lower: false }
    }

    /// Scanlines of another slice follow: none of those in the buffers is meant any more.
    #[inline(always)]
    pub fn next_slice(&mut self) {
        self.upper.j = None;
        self.lower.j = None;
    }

    /// Enters scanline `j` and, where pixels lie between two scanlines, `j + 1`.
    #[inline(always)]
    pub fn enter<V: VoxelSource>(&mut self, source: V, j: usize, upper: &V::Scanline, lower: Option<&V::Scanline>) {
        if self.lower.j == Some(j) {
            std::mem::swap(&mut self.upper, &mut self.lower);
        } else {
            self.upper.enter(source, j, upper);
        }
        self.has_lower = lower.is_some();
        match lower {
            Some(lower) => self.lower.enter(source, j + 1, lower),
            None => self.lower.clear(),
        }
    }

    /// Takes back the marks of voxels that the spans' pixels touch and that are not drawn.
    #[inline(always)]
    pub fn classify<V: VoxelSource>(
        &mut self,
        source: V,
        upper: &V::Scanline,
        lower: Option<&V::Scanline>,
        spans: &Spans,
    ) {
        self.upper.classify(source, upper, spans.touched());
        if let Some(lower) = lower {
            self.lower.classify(source, lower, spans.touched());
        }
    }

    /// True where pixels lie between two scanlines.
    #[inline(always)]
    pub fn has_lower(&self) -> bool {
        self.has_lower
    }

    /// Non-transparent voxels of either scanline, by word.
    #[inline(always)]
    pub fn marked(&self, word: usize) -> u64 {
        self.upper.marked[word] | self.lower.marked[word]
    }

    /// Shades the voxels of slice `k` that the spans' pixels touch.
    #[inline(always)]
    pub fn shade<V: VoxelSource, H: Light, const FACTORED: bool>(
        &mut self,
        source: V,
        upper: &V::Scanline,
        lower: Option<&V::Scanline>,
        (spans, k): (&Spans, usize),
        material: SliceMaterial<'_, H, FACTORED>,
    ) {
        self.upper.shade(source, upper, spans.touched(), k, material);
        if let Some(lower) = lower {
            self.lower.shade(source, lower, spans.touched(), k, material);
        }
    }

    /// `length` voxels of both scanlines from voxel `i` on.
    #[inline(always)]
    pub fn voxels(&self, i: usize, length: usize) -> (&[Vec4], &[Vec4]) {
        (&self.upper.voxels[i..i + length], &self.lower.voxels[i..i + length])
    }
}
