//! Row buffers: the two voxel scanlines that a row of pixels gathers from, shaded.
//!
//! Voxels are shaded by aligned fours when the first pixel needs one of them, and each only once while
//! its scanline is in a buffer; where none is drawn there are zeros. What was not asked for may be of another scanline.

use super::WORD;
use super::sources::VoxelSource;
use crate::render::material::{SliceShader, VoxelWord};
use crate::render::pixel::Pixel;
use crate::render::simd::shorts::Shorts;

/// One voxel scanline.
#[derive(Debug)]
pub struct Row<P> {
    /// The scanline's j, where one was entered.
    pub j: Option<usize>,
    /// Premultiplied colour and opacity by voxel; a word more than the scanline has.
    pub voxels: Vec<P>,
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
            entered: 0,
            shaded: vec![Shaded { entered: 0, fours: 0 }; words],
        }
    }

    /// Becomes scanline `j`, with nothing shaded yet, unless it is.
    #[inline(always)]
    pub fn enter(&mut self, j: usize) {
        if self.j != Some(j) {
            self.j = Some(j);
            self.entered += 1;
        }
    }

    /// Shades voxels of a word of slice `k`: every aligned four whose first bit is `asked` for and that is not there yet.
    #[inline(always)]
    pub fn shade<W: Shorts, V: VoxelSource, M: SliceShader<Pixel = P>>(
        &mut self,
        source: V,
        (scanline, ahead): (&V::Scanline, V::Ahead),
        (word, asked): (usize, u64),
        k: usize,
        material: M,
    ) {
        let shaded = &mut self.shaded[word];
        let there = if shaded.entered == self.entered { shaded.fours } else { 0 };
        let missing = asked & !there;
        if missing != 0 {
            *shaded = Shaded { entered: self.entered, fours: there | missing };
            let (out, _) = self.voxels.as_chunks_mut();
            let at = [word * WORD, self.j.unwrap_or_default(), k];
            let of_word =
                VoxelWord { marks: source.marks(scanline)[word], voxels: source.word(scanline, word, ahead), at };
            material.word::<W, V>(&source, &of_word, missing, &mut out[word]);
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
