//! Row buffers: the two voxel scanlines that a row of pixels gathers from, shaded.
//!
//! A buffer is zero wherever no voxel was shaded into it, so that a pixel reads transparent voxels
//! without asking. Voxels are shaded when the first pixel needs them, and each only once while
//! its scanline is in a buffer.

use glam::Vec4;

use super::spans::Spans;
use crate::classify::rle::{Scanline, WORD};
use crate::render::material::SliceMaterial;

/// One voxel scanline.
#[derive(Debug)]
struct Row {
    /// The scanline's j, where one was entered.
    j: Option<usize>,
    /// Premultiplied colour and opacity by voxel; one more than the scanline has, always zero.
    voxels: Vec<Vec4>,
    /// Non-transparent voxels, a bit each.
    marked: Vec<u64>,
    /// Words that may hold shaded voxels, and which ones.
    shaded: Vec<u64>,
    empty: bool,
}

impl Row {
    fn new(length: usize) -> Self {
        let words = length.div_ceil(WORD) + 1;
        Self {
            j: None,
            voxels: vec![Vec4::ZERO; words * WORD],
            marked: vec![0; words],
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
        }
        self.empty = true;
        self.j = None;
    }

    #[inline(always)]
    fn enter(&mut self, j: usize, scanline: &Scanline<'_>) {
        self.clear();
        self.j = Some(j);
        self.empty = scanline.voxels.is_empty();
        self.marked[..scanline.marked.len()].copy_from_slice(scanline.marked);
    }

    /// Shades what `touched` asks for of the scanline's runs: per run the stretch from the first to
    /// the last voxel that is asked for and not there yet.
    #[inline(always)]
    fn shade<const LIT: bool, const FACTORED: bool>(
        &mut self,
        scanline: &Scanline<'_>,
        touched: &[u64],
        material: SliceMaterial<'_, LIT, FACTORED>,
    ) {
        let mut before = 0;
        for (word, &marked) in scanline.marked.iter().enumerate() {
            let mut asked = touched[word] & marked & !self.shaded[word];
            while asked != 0 {
                // The rest of the run that the next voxel asked for lies in.
                let start = asked.trailing_zeros() as usize;
                let within = super::run_mask(start, (marked >> start).trailing_ones() as usize);
                let end = WORD - (asked & within).leading_zeros() as usize;
                let stored = before + (marked & !(u64::MAX << start)).count_ones() as usize;
                let stored = stored..stored + end - start;
                let out = &mut self.voxels[word * WORD + start..word * WORD + end];
                if FACTORED {
                    let voxels = scanline.voxels[stored.clone()].iter().zip(&scanline.factors[stored]);
                    for (out, (voxel, factor)) in out.iter_mut().zip(voxels) {
                        *out = material.color(*voxel, *factor);
                    }
                } else {
                    for (out, voxel) in out.iter_mut().zip(&scanline.voxels[stored]) {
                        *out = material.color(*voxel, u8::MAX);
                    }
                }
                self.shaded[word] |= super::run_mask(start, end - start);
                asked &= !within;
            }
            before += marked.count_ones() as usize;
        }
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
    pub fn enter(&mut self, j: usize, upper: &Scanline<'_>, lower: Option<&Scanline<'_>>) {
        if self.lower.j == Some(j) {
            std::mem::swap(&mut self.upper, &mut self.lower);
        } else {
            self.upper.enter(j, upper);
        }
        self.has_lower = lower.is_some();
        match lower {
            Some(lower) => self.lower.enter(j + 1, lower),
            None => self.lower.clear(),
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

    /// Shades the voxels that the spans' pixels touch.
    #[inline(always)]
    pub fn shade<const LIT: bool, const FACTORED: bool>(
        &mut self,
        upper: &Scanline<'_>,
        lower: Option<&Scanline<'_>>,
        spans: &Spans,
        material: SliceMaterial<'_, LIT, FACTORED>,
    ) {
        self.upper.shade(upper, spans.touched(), material);
        if let Some(lower) = lower {
            self.lower.shade(lower, spans.touched(), material);
        }
    }

    /// `length` voxels of both scanlines from voxel `i` on.
    #[inline(always)]
    pub fn voxels(&self, i: usize, length: usize) -> (&[Vec4], &[Vec4]) {
        (&self.upper.voxels[i..i + length], &self.lower.voxels[i..i + length])
    }
}
