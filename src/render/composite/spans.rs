//! Which pixels of a scanline a slice has work for.
//!
//! Every reason not to work on a pixel is a mask over the voxel scanline, 64 voxels a word, in which
//! bit i stands for the pixel between voxels i and i + 1: transparent voxels, opaque pixels, what
//! clip planes cut away. What is left is their intersection.

use super::rows::RowBuffers;
use crate::classify::rle::WORD;

/// The pixels to work on, and the voxels that they touch.
#[derive(Debug)]
pub struct Spans {
    /// Voxels in a scanline.
    length: usize,
    pixels: Vec<u64>,
    touched: Vec<u64>,
    empty: bool,
}

impl Spans {
    /// For scanlines of `length` voxels.
    pub fn new(length: usize) -> Self {
        let words = length.div_ceil(WORD);
        Self { length, pixels: vec![0; words], touched: vec![0; words + 1], empty: true }
    }

    /// Pixels that touch a marked voxel and are open: not opaque, not clipped away. Pixel `first_u` lies on voxel 0 or, where
    /// pixels are `between` voxels, after it.
    #[inline(always)]
    pub fn find(&mut self, rows: &RowBuffers, open: &[u64], first_u: usize, between: bool) {
        let (word_u, shift) = (first_u / WORD, first_u % WORD);
        let open_word = |word: usize| open.get(word_u + word).copied().unwrap_or(0);
        let mut any = 0;
        for (word, pixels) in self.pixels.iter_mut().enumerate() {
            let marked = rows.marked(word);
            let near = if between { marked | marked >> 1 | rows.marked(word + 1) << (WORD - 1) } else { marked };
            let mut open = open_word(word) >> shift;
            if shift > 0 {
                open |= open_word(word + 1) << (WORD - shift);
            }
            *pixels = near & open;
            any |= *pixels;
        }
        self.empty = any == 0;
        if !self.empty {
            self.finish(between);
        }
    }

    /// All pixels that lie within the scanline's voxels.
    #[cfg(test)]
    fn all(&mut self, between: bool) {
        self.pixels.fill(u64::MAX);
        self.empty = false;
        self.finish(between);
    }

    /// Leaves out pixels past the last voxel, and finds the voxels that are touched.
    #[inline(always)]
    fn finish(&mut self, between: bool) {
        // Between the last voxel and nothing there is no pixel.
        let valid = self.length - usize::from(between);
        let last = self.pixels.len() - 1;
        let in_last = valid - (last * WORD).min(valid);
        if in_last < WORD {
            self.pixels[last] &= (1 << in_last) - 1;
        }
        let mut carry = 0;
        for (touched, &pixels) in self.touched.iter_mut().zip(&self.pixels) {
            *touched = if between { pixels | pixels << 1 | carry } else { pixels };
            carry = pixels >> (WORD - 1);
        }
        self.touched[last + 1] = if between { carry } else { 0 };
    }

    /// True where there is no work.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.empty
    }

    /// Pixels to work on, by word of the voxel scanline.
    #[inline(always)]
    pub fn pixels(&self) -> &[u64] {
        &self.pixels
    }

    /// Voxels that those pixels touch, by word.
    #[inline(always)]
    pub fn touched(&self) -> &[u64] {
        &self.touched
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scanline_of_65_voxels_has_a_pixel_after_each_but_the_last() {
        let mut spans = Spans::new(65);
        spans.all(true);
        assert_eq!(spans.pixels, [u64::MAX, 0]);
        assert_eq!(spans.touched[..2], [u64::MAX, 1]);
    }
}
