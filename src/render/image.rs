//! Premultiplied floating-point pixels -> 8-bit [`Image`].

use glam::Vec4;

use super::Background;

/// 8-bit pixels, row 0 on top, rows without padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    pub width: u32,
    pub height: u32,
    /// 3 (RGB) or 4 (RGBA, straight alpha).
    pub channels: u8,
    pub pixels: Vec<u8>,
}

impl Background {
    /// Bytes of a pixel over this background.
    pub const fn channels(&self) -> usize {
        match self {
            Self::Transparent => 4,
            Self::Opaque(_) => 3,
        }
    }
}

/// Writes a premultiplied pixel over an opaque background as RGB.
#[inline(always)]
pub(super) fn write_over(pixel: Vec4, background: Vec4, out: &mut [u8]) {
    let over = pixel + background * (1.0 - pixel.w);
    out.copy_from_slice(&to_bytes(over)[..3]);
}

/// Writes a premultiplied pixel as RGBA with straight alpha.
#[inline(always)]
pub(super) fn write_straight(pixel: Vec4, out: &mut [u8]) {
    let scale = if pixel.w > 0.0 { 1.0 / pixel.w } else { 0.0 };
    let straight = pixel * Vec4::new(scale, scale, scale, 1.0);
    out.copy_from_slice(&to_bytes(straight));
}

/// 0..=1 to the nearest of 0..=255. Adding 2^23 leaves the rounded integer in the low mantissa
/// bits, without the saturating casts that do not vectorize.
#[inline(always)]
fn to_bytes(color: Vec4) -> [u8; 4] {
    let scaled = color.clamp(Vec4::ZERO, Vec4::ONE) * 255.0 + Vec4::splat(8_388_608.0);
    scaled.to_array().map(|c| c.to_bits() as u8)
}

/// Writes a row of premultiplied pixels.
pub(super) fn write_row(pixels: &[Vec4], background: &Background, out: &mut [u8]) {
    match background {
        Background::Transparent => {
            for (pixel, out) in pixels.iter().zip(out.chunks_exact_mut(4)) {
                write_straight(*pixel, out);
            }
        }
        Background::Opaque([r, g, b]) => {
            let background = Vec4::new(*r, *g, *b, 0.0);
            for (pixel, out) in pixels.iter().zip(out.chunks_exact_mut(3)) {
                write_over(*pixel, background, out);
            }
        }
    }
}
