//! The intermediate image: scanlines of premultiplied pixels, and which of them are opaque.
//!
//! The paper keeps with every opaque pixel a link to the next that is not, so that runs of opaque
//! pixels are skipped without looking at each (Lacroute and Levoy 1994, section 3.1, figure 4).
//! Here the links of a scanline are a bit mask: bit u is set while pixel u is not opaque. The next
//! non-opaque pixel is a count of trailing zeros away, marking a pixel opaque clears one bit in
//! place of updating the links before it, and, which links cannot do, a run of voxels is
//! intersected with 64 pixels in one instruction.
//!
//! A band of scanlines is composited in [pixels](Pixel) of its own that stay in the second-level cache, and
//! left to the warp as 16-bit fixed-point ones over the background already: what is behind
//! the volume is linear in its pixels, as the warp's filter is.

use std::ops::Range;

use glam::Vec4;
use rayon::prelude::*;

use super::Background;
use super::pixel::{BLOCK, Pixel, WORD, nearest};
use super::ranges::hull;
use super::spare::Spare;

/// So many pixels behind a scanline's last may be taken with it, where nothing is added to them.
const BESIDE: usize = WORD;

/// So many words behind those of a scanline's pixels are none's.
const MORE: usize = 5;

/// A pixel that the warp reads: red, green, blue and opacity, premultiplied, in units of 1 / [`ONE`].
pub type Fixed = [i16; 4];

/// 1.0 in a [`Fixed`] pixel: whole steps of 8 bits are whole numbers.
pub const ONE: i16 = 255 << ONE_SHIFT;

/// Bits of a [`Fixed`] pixel below a step of 8 bits.
pub const ONE_SHIFT: u32 = 7;

static SPARE_IMAGES: Spare<Fixed> = Spare::none();

/// An image in sheared space.
#[derive(Debug)]
pub struct IntermediateImage {
    size: [usize; 2],
    behind: Vec4,
    pixels: Vec<Fixed>,
    /// By scanline: no pixel outside this range has been drawn on.
    drawn: Vec<Range<usize>>,
}

impl Drop for IntermediateImage {
    fn drop(&mut self) {
        SPARE_IMAGES.give(std::mem::take(&mut self.pixels));
    }
}

/// Scanlines of an intermediate image that one job fills.
#[derive(Debug)]
pub struct Strip<'a> {
    first: usize,
    width: usize,
    behind: Vec4,
    pixels: &'a mut [Fixed],
    drawn: &'a mut [Range<usize>],
}

/// What bands are composited in, one after the other.
#[derive(Debug)]
pub struct BandBuffer<P: Pixel> {
    /// All clear but while a band is open.
    pixels: Vec<P>,
    /// By scanline, and [`MORE`] words: masks are read shifted, and several words at once.
    non_opaque: Vec<u64>,
    open: bool,
}

/// The scanlines of a [`Strip`] while they are composited.
#[derive(Debug)]
pub struct Band<'a, P> {
    /// The first scanline's v.
    pub first: usize,
    width: usize,
    pixels: &'a mut [P],
    words: usize,
    non_opaque: &'a mut [u64],
}

/// One scanline: pixels from u = 0, and the mask of those not opaque.
#[derive(Debug)]
pub struct ScanlineMut<'a, P> {
    pub pixels: &'a mut [P],
    pub non_opaque: &'a mut [u64],
}

impl IntermediateImage {
    /// An image of `size` pixels along u and v, to be filled strip by strip, over `behind`, a premultiplied pixel.
    pub fn new(size: [usize; 2], behind: Vec4) -> Self {
        let [width, height] = size;
        let mut pixels = SPARE_IMAGES.take();
        // What is read beside the last pixels has no weight.
        pixels.resize((width + 2) * (height + 2), [0; 4]);
        Self { size, behind, pixels, drawn: vec![0..0; height] }
    }

    /// An image that shows nothing.
    pub fn blank(size: [usize; 2]) -> Self {
        let mut image = Self::new(size, Vec4::ZERO);
        image.pixels.fill([0; 4]);
        image
    }

    /// Pixels along u and v.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// All pixels, u fastest, and at least a scanline and two pixels more.
    pub fn pixels(&self) -> &[Fixed] {
        &self.pixels
    }

    /// Pixels along u outside of which scanlines `v` and `last_v` and those between show nothing but what is behind.
    #[inline(always)]
    pub fn drawn(&self, v: usize, last_v: usize) -> Range<usize> {
        let scanlines = &self.drawn[v.min(self.size[1])..(last_v + 1).min(self.size[1])];
        scanlines.iter().fold(0..0, |all, drawn| hull(&all, drawn))
    }

    /// How opaque pixel (u, v) is, 0..1; with an image of its own behind it, how opaque both are.
    pub fn opacity(&self, u: usize, v: usize) -> f32 {
        f32::from(self.pixels[v * self.size[0] + u][3]) / f32::from(ONE)
    }

    /// Writes pixels of scanline `v` as 8-bit ones over the background that they have been put over already.
    pub fn write(&self, v: usize, us: Range<usize>, background: &Background, out: &mut [u8]) {
        let pixels = &self.pixels[v * self.size[0]..][us];
        for (pixel, out) in pixels.iter().zip(out.chunks_exact_mut(background.channels())) {
            write_pixel(pixel, out);
        }
    }

    /// Puts an image of the same size behind this one; neither has anything behind it yet.
    pub fn put_behind(&mut self, back: &Self) {
        let [width, height] = self.size;
        let backs = back.pixels.par_chunks(width).zip(&back.drawn);
        let fronts = self.pixels[..width * height].par_chunks_mut(width).zip(&mut self.drawn);
        fronts.zip(backs).for_each(|((front, drawn), (back, behind))| {
            for (front, back) in front[behind.clone()].iter_mut().zip(&back[behind.clone()]) {
                put_pixel_behind(front, *back);
            }
            *drawn = hull(drawn, behind);
        });
    }

    /// Puts a premultiplied pixel behind every one of the image's.
    pub fn put_ground_behind(&mut self, behind: Vec4) {
        let ([width, height], ground) = (self.size, fixed(&[behind])[0]);
        self.behind = behind;
        self.pixels[..width * height]
            .par_chunks_mut(width)
            .for_each(|row| row.iter_mut().for_each(|pixel| put_pixel_behind(pixel, ground)));
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.pixels[..]) + size_of_val(&self.drawn[..])) as u64
    }

    /// The image in strips of `height` scanlines (the last may be shorter).
    pub fn strips(&mut self, height: usize) -> impl Iterator<Item = Strip<'_>> {
        let ([width, all], behind) = (self.size, self.behind);
        let pixels = self.pixels[..width * all].chunks_mut(width * height);
        let drawn = self.drawn.chunks_mut(height);
        pixels.zip(drawn).enumerate().map(move |(strip, (pixels, drawn))| Strip {
            first: strip * height,
            width,
            behind,
            pixels,
            drawn,
        })
    }
}

impl<P: Pixel> Default for BandBuffer<P> {
    /// Room for a band, whatever its size turns out to be.
    fn default() -> Self {
        Self { pixels: P::spare().take(), non_opaque: vec![], open: false }
    }
}

impl<P: Pixel> Drop for BandBuffer<P> {
    fn drop(&mut self) {
        if !self.open {
            P::spare().give(std::mem::take(&mut self.pixels));
        }
    }
}

impl Strip<'_> {
    /// The strip's scanlines, all transparent.
    #[inline(always)]
    pub fn open<'b, P: Pixel>(&self, buffer: &'b mut BandBuffer<P>) -> Band<'b, P> {
        let (width, count) = (self.width, self.drawn.len() * (self.width + BESIDE));
        if std::mem::replace(&mut buffer.open, true) {
            // A band was begun in it and not ended.
            buffer.pixels.fill(P::CLEAR);
        }
        if buffer.pixels.len() < count {
            buffer.pixels.resize(count, P::CLEAR);
        }
        let words = width.div_ceil(WORD) + MORE;
        buffer.non_opaque.resize(words * self.drawn.len(), 0);
        let (whole, rest) = (width / WORD, width % WORD);
        for words in buffer.non_opaque.chunks_exact_mut(words) {
            words[..whole].fill(u64::MAX);
            words[whole] = (1 << rest) - 1;
            words[whole + 1..].fill(0);
        }
        let (pixels, non_opaque) = (&mut buffer.pixels[..count], &mut buffer.non_opaque[..]);
        Band { first: self.first, width, pixels, words, non_opaque }
    }

    /// Takes over what was drawn in `buffer`, and leaves it as it was before.
    #[inline(always)]
    pub fn close<P: Pixel>(self, buffer: &mut BandBuffer<P>) {
        let ground = fixed(&[self.behind])[0];
        let scanlines = self.pixels.chunks_exact_mut(self.width).zip(self.drawn);
        let buffered = buffer.pixels.chunks_exact_mut(self.width + BESIDE);
        for ((fixed_pixels, drawn), pixels) in scanlines.zip(buffered) {
            let pixels = &mut pixels[..self.width];
            *drawn = measure(pixels);
            fixed_pixels[..drawn.start].fill(ground);
            fixed_pixels[drawn.end..].fill(ground);
            let (fixed_pixels, pixels) = (&mut fixed_pixels[drawn.clone()], &mut pixels[drawn.clone()]);
            let (fixed_blocks, blocks) = (fixed_pixels.chunks_mut(BLOCK), pixels.chunks_mut(BLOCK));
            for (fixed_pixels, pixels) in fixed_blocks.zip(blocks) {
                match <&[P; BLOCK]>::try_from(&*pixels) {
                    Ok(pixels) => fixed_pixels.copy_from_slice(&P::fixed(pixels, self.behind)),
                    Err(_) => {
                        for (out, pixel) in fixed_pixels.iter_mut().zip(&*pixels) {
                            *out = P::fixed(&[*pixel], self.behind)[0];
                        }
                    }
                }
                pixels.fill(P::CLEAR);
            }
        }
        buffer.open = false;
    }
}

/// Writes a pixel as an 8-bit one, with straight alpha where there is room for it.
pub fn write_pixel(pixel: &Fixed, out: &mut [u8]) {
    // Straight alpha: rounded once.
    let whole = if out.len() == 4 { i32::from(pixel[3].max(1)) } else { i32::from(ONE) };
    for (component, out) in pixel.iter().zip(&mut out[..3]) {
        *out = ((i32::from(*component) * 255 + whole / 2) / whole).min(255) as u8;
    }
    if let Some(alpha) = out.get_mut(3) {
        *alpha = ((pixel[3] + (1 << (ONE_SHIFT - 1))) >> ONE_SHIFT) as u8;
    }
}

/// Puts a pixel behind another. Depth cueing can make a colour brighter than its opacity; neither is above 1.
#[inline(always)]
fn put_pixel_behind(front: &mut Fixed, back: Fixed) {
    const WHOLE: i32 = ONE as i32;
    let through = WHOLE - i32::from(front[3]);
    for (front, back) in front.iter_mut().zip(back) {
        *front = (i32::from(*front) + (i32::from(back) * through + WHOLE / 2) / WHOLE).min(WHOLE) as i16;
    }
}

/// Where pixels have been drawn on, to a block.
#[inline(always)]
fn measure<P: Pixel>(pixels: &[P]) -> Range<usize> {
    let drawn = |block: &[P]| !P::are_clear(block);
    let blocks = || pixels.chunks(BLOCK);
    let Some(first) = blocks().position(drawn) else { return 0..0 };
    let last = blocks().rposition(drawn).unwrap_or(first);
    first * BLOCK..((last + 1) * BLOCK).min(pixels.len())
}

/// To the nearest fixed-point numbers.
#[inline(always)]
pub(super) fn fixed<const N: usize>(pixels: &[Vec4; N]) -> [Fixed; N] {
    let mut fixed = [[0; 4]; N];
    for (fixed, pixel) in fixed.iter_mut().zip(pixels) {
        let scaled = pixel.clamp(Vec4::ZERO, Vec4::ONE) * f32::from(ONE);
        *fixed = scaled.to_array().map(nearest);
    }
    fixed
}

impl<P> Band<'_, P> {
    /// Number of scanlines.
    pub fn height(&self) -> usize {
        self.pixels.len() / (self.width + BESIDE)
    }

    /// Scanline `row` of the band.
    #[inline(always)]
    pub fn scanline(&mut self, row: usize) -> ScanlineMut<'_, P> {
        let width = self.width;
        self.scanline_of(row, width)
    }

    /// The same and a word of pixels beside its end, to which nothing may be added.
    #[inline(always)]
    pub fn scanline_and_more(&mut self, row: usize) -> ScanlineMut<'_, P> {
        let width = self.width + BESIDE;
        self.scanline_of(row, width)
    }

    #[inline(always)]
    fn scanline_of(&mut self, row: usize, count: usize) -> ScanlineMut<'_, P> {
        ScanlineMut {
            pixels: &mut self.pixels[row * (self.width + BESIDE)..][..count],
            non_opaque: &mut self.non_opaque[row * self.words..][..self.words],
        }
    }
}
