//! Premultiplied floating-point pixels -> 8-bit [`Image`].

use glam::Vec4;
use rayon::prelude::*;

use super::Background;
use super::spare::Spare;
use super::warp::Warp;

static SPARE_PIXELS: Spare<u8> = Spare::none();

/// 8-bit pixels, row 0 on top, rows without padding.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    pub width: u32,
    pub height: u32,
    /// 3 (RGB) or 4 (RGBA, straight alpha).
    pub channels: u8,
    pub pixels: Vec<u8>,
    /// Of an intermediate image: what is left to be done. `None`: nothing, it is the final one.
    pub warp: Option<Warp>,
}

impl Drop for Image {
    fn drop(&mut self) {
        SPARE_PIXELS.give(std::mem::take(&mut self.pixels));
    }
}

/// Memory for an image's pixels, all of which are still to be written: another image's may be in it.
pub(super) fn unwritten(bytes: usize) -> Vec<u8> {
    let mut pixels = SPARE_PIXELS.take();
    pixels.resize(bytes, 0);
    pixels
}

impl Image {
    /// This picture, which has straight alpha, over one of the same size.
    ///
    /// # Panics
    /// Where they are not such pictures.
    pub fn over(&self, behind: &Self) -> Self {
        assert_eq!((self.width, self.height, self.channels), (behind.width, behind.height, 4));
        let mut over = behind.clone();
        if behind.channels == 4 {
            for (out, pixel) in over.pixels.chunks_exact_mut(4).zip(self.pixels.chunks_exact(4)) {
                let (front, back) = (u32::from(pixel[3]), u32::from(out[3]) * (255 - u32::from(pixel[3])));
                // In units of 1 / 255^2; nothing over nothing is black.
                let alpha = (255 * front + back).max(1);
                for (out, color) in out[..3].iter_mut().zip(pixel) {
                    *out = ((u32::from(*color) * 255 * front + u32::from(*out) * back + alpha / 2) / alpha) as u8;
                }
                out[3] = ((255 * front + back + 127) / 255) as u8;
            }
            return over;
        }
        for (out, pixel) in over.pixels.chunks_exact_mut(3).zip(self.pixels.chunks_exact(4)) {
            let alpha = u32::from(pixel[3]);
            for (out, color) in out.iter_mut().zip(pixel) {
                *out = ((u32::from(*color) * alpha + u32::from(*out) * (255 - alpha) + 127) / 255) as u8;
            }
        }
        over
    }
}

impl Background {
    /// What is behind the volume, premultiplied.
    pub fn behind(&self) -> Vec4 {
        match self {
            Self::Transparent => Vec4::ZERO,
            Self::Opaque([r, g, b]) => Vec4::new(*r, *g, *b, 1.0),
        }
    }

    /// Bytes of a pixel over this background.
    pub const fn channels(&self) -> usize {
        match self {
            Self::Transparent => 4,
            Self::Opaque(_) => 3,
        }
    }
}

/// A premultiplied pixel over an opaque background: RGB, and a byte without meaning.
#[inline(always)]
fn over(pixel: Vec4, background: Vec4) -> [u8; 4] {
    to_bytes(pixel + background * (1.0 - pixel.w))
}

/// The same of four.
#[inline(always)]
fn four_over(pixels: &[Vec4; 4], background: Vec4) -> [u8; 16] {
    let mut words = [0; 16];
    for n in 0..4 {
        let scaled = scale(pixels[n] + background * (1.0 - pixels[n].w)).to_array();
        for channel in 0..4 {
            words[n * 4 + channel] = scaled[channel].to_bits();
        }
    }
    let mut bytes = [0; 16];
    for n in 0..16 {
        bytes[n] = words[n] as u8;
    }
    bytes
}

/// A premultiplied pixel as RGBA with straight alpha.
#[inline(always)]
fn straight(pixel: Vec4) -> [u8; 4] {
    let scale = if pixel.w > 0.0 { 1.0 / pixel.w } else { 0.0 };
    to_bytes(pixel * Vec4::new(scale, scale, scale, 1.0))
}

/// 0..=1 to the nearest of 0..=255. Adding 2^23 leaves the rounded integer in the low mantissa
/// bits, without the saturating casts that do not vectorize.
#[inline(always)]
fn to_bytes(color: Vec4) -> [u8; 4] {
    scale(color).to_array().map(|c| c.to_bits() as u8)
}

#[inline(always)]
fn scale(color: Vec4) -> Vec4 {
    color.clamp(Vec4::ZERO, Vec4::ONE) * 255.0 + Vec4::splat(8_388_608.0)
}

/// An image of premultiplied pixels.
pub(super) fn write(pixels: &[Vec4], background: &Background, width: u32, height: u32) -> Image {
    let channels = background.channels();
    let mut bytes = unwritten(pixels.len() * channels);
    let rows = bytes.par_chunks_mut(width as usize * channels).zip(pixels.par_chunks(width as usize));
    rows.for_each(|(out, row)| write_row(row, background, out));
    Image { width, height, channels: channels as u8, pixels: bytes, warp: None }
}

/// Writes a row of premultiplied pixels.
#[inline(always)]
fn write_row(pixels: &[Vec4], background: &Background, out: &mut [u8]) {
    match background {
        Background::Transparent => {
            for (pixel, out) in pixels.iter().zip(out.chunks_exact_mut(4)) {
                out.copy_from_slice(&straight(*pixel));
            }
        }
        Background::Opaque([r, g, b]) => {
            let background = Vec4::new(*r, *g, *b, 0.0);
            let mut first = 0;
            // Whole words: a pixel's fourth byte is the next one's first, which is written after it.
            while first + 4 < pixels.len() {
                let four: &[Vec4; 4] = pixels[first..].first_chunk().expect("four pixels");
                let bytes = four_over(four, background);
                let out: &mut [u8; 13] = out[first * 3..].first_chunk_mut().expect("room for more than four");
                for n in 0..4 {
                    out[n * 3..n * 3 + 4].copy_from_slice(&bytes[n * 4..n * 4 + 4]);
                }
                first += 4;
            }
            for (pixel, out) in pixels[first..].iter().zip(out[first * 3..].chunks_exact_mut(3)) {
                out.copy_from_slice(&over(*pixel, background)[..3]);
            }
        }
    }
}
