//! The intermediate image: scanlines of premultiplied pixels, and which of them are opaque.
//!
//! The paper keeps with every opaque pixel a link to the next that is not, so that runs of opaque
//! pixels are skipped without looking at each (Lacroute and Levoy 1994, section 3.1, figure 4).
//! Here the links of a scanline are a bit mask: bit u is set while pixel u is not opaque. The next
//! non-opaque pixel is a count of trailing zeros away, marking a pixel opaque clears one bit in
//! place of updating the links before it, and, which links cannot do, a run of voxels is
//! intersected with 64 pixels in one instruction.

use glam::Vec4;
use rayon::prelude::*;

/// Pixels of a mask word.
const WORD: usize = 64;

/// An image in sheared space.
#[derive(Clone, Debug, Default)]
pub struct IntermediateImage {
    size: [usize; 2],
    pixels: Vec<Vec4>,
    /// Words of `non_opaque` per scanline: one more than its pixels need, so that a shifted mask
    /// can be read across the end.
    words: usize,
    non_opaque: Vec<u64>,
}

/// Scanlines of an intermediate image that one job fills.
#[derive(Debug)]
pub struct Band<'a> {
    /// The first scanline's v.
    pub first: usize,
    width: usize,
    pixels: &'a mut [Vec4],
    words: usize,
    non_opaque: &'a mut [u64],
}

/// One scanline: pixels from u = 0, and the mask of those not opaque.
#[derive(Debug)]
pub struct ScanlineMut<'a> {
    pub pixels: &'a mut [Vec4],
    pub non_opaque: &'a mut [u64],
}

impl IntermediateImage {
    /// A transparent image of `size` pixels along u and v.
    pub fn new(size: [usize; 2]) -> Self {
        let [width, height] = size;
        let words = width.div_ceil(WORD) + 1;
        let mut row = vec![0; words];
        for u in 0..width {
            row[u / WORD] |= 1 << (u % WORD);
        }
        Self { size, pixels: vec![Vec4::ZERO; (width + 2) * (height + 2)], words, non_opaque: row.repeat(height) }
    }

    /// Pixels along u and v.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// All pixels, u fastest.
    pub fn pixels(&self) -> &[Vec4] {
        &self.pixels
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.pixels[..]) + size_of_val(&self.non_opaque[..])) as u64
    }

    /// The image in bands of `height` scanlines (the last may be shorter).
    pub fn bands(&mut self, height: usize) -> impl IndexedParallelIterator<Item = Band<'_>> {
        let (width, words) = (self.size[0], self.words);
        let pixels = self.pixels.par_chunks_mut(width * height);
        let masks = self.non_opaque.par_chunks_mut(words * height);
        pixels.zip(masks).enumerate().map(move |(band, (pixels, non_opaque))| Band {
            first: band * height,
            width,
            pixels,
            words,
            non_opaque,
        })
    }
}

impl Band<'_> {
    /// Number of scanlines.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Scanline `row` of the band.
    #[inline(always)]
    pub fn scanline(&mut self, row: usize) -> ScanlineMut<'_> {
        ScanlineMut {
            pixels: &mut self.pixels[row * self.width..][..self.width],
            non_opaque: &mut self.non_opaque[row * self.words..][..self.words],
        }
    }
}
