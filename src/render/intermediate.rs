//! The intermediate image: scanlines of premultiplied pixels, and which of them are opaque.
//!
//! The paper keeps with every opaque pixel a link to the next that is not, so that runs of opaque
//! pixels are skipped without looking at each (Lacroute and Levoy 1994, section 3.1, figure 4).
//! Here the links of a scanline are a bit mask: bit u is set while pixel u is not opaque. The next
//! non-opaque pixel is a count of trailing zeros away, marking a pixel opaque clears one bit in
//! place of updating the links before it, and, which links cannot do, a run of voxels is
//! intersected with 64 pixels in one instruction.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use glam::Vec4;
use rayon::prelude::*;

/// Pixels of a mask word.
const WORD: usize = 64;

/// Pixels of images that are not needed any more. Memory that the system gives anew costs a fault
/// for every page, which together took as long as a warp.
static SPARE: Mutex<Vec<Vec<Vec4>>> = Mutex::new(vec![]);

/// So many images are kept at most, of so many pixels.
const SPARE_IMAGES: usize = 4;
const SPARE_PIXELS: usize = 1 << 20;

/// An image in sheared space.
#[derive(Debug)]
pub struct IntermediateImage {
    size: [usize; 2],
    pixels: Vec<Vec4>,
    /// Words of `non_opaque` per scanline: one more than its pixels need, so that a shifted mask
    /// can be read across the end.
    words: usize,
    non_opaque: Vec<u64>,
    /// By scanline: no pixel outside this range has been drawn on.
    drawn: Vec<Range<usize>>,
}

impl Drop for IntermediateImage {
    /// Leaves the pixels to the next frame.
    fn drop(&mut self) {
        let pixels = std::mem::take(&mut self.pixels);
        let mut spare = SPARE.lock().unwrap_or_else(PoisonError::into_inner);
        if pixels.capacity() <= SPARE_PIXELS && spare.len() < SPARE_IMAGES {
            spare.push(pixels);
        }
    }
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
    drawn: &'a mut [Range<usize>],
}

/// One scanline: pixels from u = 0, and the mask of those not opaque.
#[derive(Debug)]
pub struct ScanlineMut<'a> {
    pub pixels: &'a mut [Vec4],
    pub non_opaque: &'a mut [u64],
}

impl IntermediateImage {
    /// An image of `size` pixels along u and v, to be cleared band by band.
    pub fn new(size: [usize; 2]) -> Self {
        let [width, height] = size;
        let words = width.div_ceil(WORD) + 1;
        let mut pixels = SPARE.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
        pixels.resize((width + 2) * (height + 2), Vec4::ZERO);
        // What is read beside the last pixels has no weight, but must be numbers.
        pixels[width * height..].fill(Vec4::ZERO);
        Self { size, pixels, words, non_opaque: vec![0; words * height], drawn: vec![0..width; height] }
    }

    /// Pixels along u and v.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// All pixels, u fastest.
    pub fn pixels(&self) -> &[Vec4] {
        &self.pixels
    }

    /// Pixels along u outside of which scanlines `v` and `last_v` and those between are transparent.
    #[inline(always)]
    pub fn drawn(&self, v: usize, last_v: usize) -> Range<usize> {
        let mut drawn = self.size[0]..0;
        for scanline in v.min(self.size[1])..(last_v + 1).min(self.size[1]) {
            let Range { start, end } = self.drawn[scanline];
            drawn = drawn.start.min(start)..drawn.end.max(end);
        }
        drawn
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.pixels[..]) + size_of_val(&self.non_opaque[..]) + size_of_val(&self.drawn[..])) as u64
    }

    /// The image in bands of `height` scanlines (the last may be shorter).
    pub fn bands(&mut self, height: usize) -> impl IndexedParallelIterator<Item = Band<'_>> {
        let (width, words) = (self.size[0], self.words);
        let pixels = self.pixels.par_chunks_mut(width * height);
        let masks = self.non_opaque.par_chunks_mut(words * height);
        let drawn = self.drawn.par_chunks_mut(height);
        pixels.zip(masks).zip(drawn).enumerate().map(move |(band, ((pixels, non_opaque), drawn))| Band {
            first: band * height,
            width,
            pixels,
            words,
            non_opaque,
            drawn,
        })
    }
}

impl Band<'_> {
    /// Number of scanlines.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// Makes all pixels transparent.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.pixels.fill(Vec4::ZERO);
        let (whole, rest) = (self.width / WORD, self.width % WORD);
        for words in self.non_opaque.chunks_exact_mut(self.words) {
            words.fill(0);
            words[..whole].fill(u64::MAX);
            words[whole] = (1 << rest) - 1;
        }
    }

    /// Looks what has been drawn on, while it is near: the warp leaves out the rest.
    #[inline(always)]
    pub fn measure(&mut self) {
        for (pixels, drawn) in self.pixels.chunks_exact(self.width).zip(&mut *self.drawn) {
            let mut end = self.width;
            while end > 0 && pixels[end - 1] == Vec4::ZERO {
                end -= 1;
            }
            let mut start = 0;
            while start < end && pixels[start] == Vec4::ZERO {
                start += 1;
            }
            *drawn = start..end;
        }
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
