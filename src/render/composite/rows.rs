//! Row buffers: the two voxel scanlines that a row of pixels gathers from, shaded.
//!
//! Voxels are shaded by aligned fours when the first pixel needs one of them, and each only once while
//! its scanline is in a buffer; where none is drawn there are zeros. What was not asked for may be of another scanline.

use std::ops::Range;

use super::samples::BLOCK;
use super::sources::VoxelSource;
use super::{WORD, run_mask};
use crate::render::material::SliceShader;
use crate::render::pixel::Pixel;
use crate::render::simd::shorts::Shorts;

/// One voxel scanline.
#[derive(Debug)]
pub struct Row<P> {
    /// The scanline's j, where one was entered.
    pub j: Option<usize>,
    /// Premultiplied colour and opacity by voxel; a word more than the scanline has.
    pub voxels: Vec<P>,
    /// A copy, if it was asked for: of drawn voxels and, until they are classified, of those that may be.
    pub marked: Vec<u64>,
    /// Voxels whose marks are known to be right.
    classified: Vec<u64>,
    /// How many scanlines it has been. Of another nothing is there, and nothing has to be cleared.
    entered: u64,
    shaded: Vec<Shaded>,
}

/// Voxels of a word that are there.
#[derive(Clone, Copy, Debug)]
struct Shaded {
    /// When they were shaded: [`Row::entered`].
    entered: u64,
    /// The first bits of aligned fours.
    fours: u64,
}

impl<P: Pixel> Row<P> {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let words = length.div_ceil(WORD);
        Self {
            j: None,
            voxels: vec![P::CLEAR; (words + 1) * WORD],
            marked: vec![0; words],
            classified: vec![0; words],
            entered: 0,
            shaded: vec![Shaded { entered: 0, fours: 0 }; words],
        }
    }

    /// Becomes scanline `j`, with nothing shaded yet, unless it is. Gives whether it was another.
    #[inline(always)]
    pub fn enter(&mut self, j: usize) -> bool {
        let other = self.j != Some(j);
        if other {
            self.j = Some(j);
            self.entered += 1;
        }
        other
    }

    /// The same, with a copy of the marks, none of which is known to be right.
    #[inline(always)]
    pub fn enter_marked<V: VoxelSource>(&mut self, source: V, j: usize, scanline: &V::Scanline) {
        if self.enter(j) {
            let words = self.marked.len();
            self.marked.copy_from_slice(&source.marks(scanline)[..words]);
            self.classified.fill(0);
        }
    }

    /// Takes back the marks of voxels that are not drawn, in every aligned four whose first bit is `asked` for, by word.
    #[inline(always)]
    pub fn classify<V: VoxelSource>(&mut self, source: V, scanline: &V::Scanline, asked: (&[u64], Range<usize>)) {
        let (asked, range) = asked;
        for word in range.start..range.end.min(self.marked.len()) {
            let marked = &mut self.marked[word];
            let mut asked = *marked & (asked[word] * 0b1111) & !self.classified[word];
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

    /// Shades voxels of a word of slice `k`: every aligned four whose first bit is `asked` for and that is not there yet.
    #[inline(always)]
    pub fn shade<W: Shorts, V: VoxelSource, M: SliceShader<Pixel = P>>(
        &mut self,
        source: V,
        scanline: &V::Scanline,
        (word, asked): (usize, u64),
        k: usize,
        material: M,
    ) {
        let shaded = &mut self.shaded[word];
        let there = if shaded.entered == self.entered { shaded.fours } else { 0 };
        let missing = asked & !there;
        if missing != 0 {
            *shaded = Shaded { entered: self.entered, fours: there | missing };
            let marks = if V::CLASSIFIES { self.marked[word] } else { source.marks(scanline)[word] };
            let (out, _) = self.voxels.as_chunks_mut();
            source.shade::<W, M>(
                scanline,
                (word, marks),
                missing,
                &mut out[word],
                [self.j.unwrap_or_default(), k],
                material,
            );
        }
    }
}

/// The upper and the lower voxel scanline of a row of pixels.
#[derive(Debug)]
pub struct RowBuffers<P> {
    pub upper: Row<P>,
    pub lower: Row<P>,
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
}
