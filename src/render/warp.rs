//! The 2D warp: intermediate image -> final image (Lacroute and Levoy 1994, section 3.1).
//!
//! A homogeneous map with a bilinear filter. Along a row of the final image the homogeneous position
//! advances by a constant, and what it has to satisfy to lie over the sheared slices are linear
//! inequalities, so the stretch of a row that does is found analytically; outside it there is only
//! background, and the volume's faces are not blurred into it.
//!
//! Positions are fixed-point numbers: the integer part addresses the four pixels, the fraction gives
//! the weights. Under parallel projection the map is affine and they are stepped by additions. In
//! perspective each is divided out anew, eight at a time, so that nothing accumulates, and taken
//! to fixed point by adding a number so large that the sum's mantissa ends where the fraction does.
//!
//! Where a picture has parts, each pixel is warped from the one that its ray belongs to.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec4};
use rayon::prelude::*;

use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::simd::{self, Kernel};
use super::{Background, Cancel, RenderError, image};

/// Fractional bits of a position: steps over a row of 2^15 pixels err by less than 2^-16 pixels.
const FRACTION_BITS: u32 = 32;

/// Added to a position below 2^18, leaves `FRACTION_BITS` of its fraction at the mantissa's end.
const TO_FIXED: f64 = 1.5 * (1u64 << (f64::MANTISSA_DIGITS - 1 - FRACTION_BITS)) as f64;

/// So far inside the slices' borders a row's pixels begin and end, pixels: what rounding leaves a hair outside
/// would be read below pixel 0.
const ROUNDING: f64 = 1e-6;

/// Rows that one job fills.
const BAND_HEIGHT: usize = 16;

/// Positions that are divided out at once.
const LANES: usize = 8;

/// A factorization and its composited slices.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    pub factorization: &'a Factorization,
    pub image: &'a IntermediateImage,
}

/// Fills `out`, rows of `width` pixels over `background`.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub fn warp(
    parts: &[Part<'_>],
    background: &Background,
    width: usize,
    out: &mut [u8],
    cancel: &Cancel,
) -> Result<(), RenderError> {
    let row_bytes = width * background.channels();
    out.par_chunks_mut(row_bytes * BAND_HEIGHT).enumerate().try_for_each(|(band, rows)| {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        simd::dispatch(Band { parts, background, width, first: band * BAND_HEIGHT, rows });
        Ok(())
    })
}

/// Rows of the final image from `first` on.
struct Band<'a> {
    parts: &'a [Part<'a>],
    background: &'a Background,
    width: usize,
    first: usize,
    rows: &'a mut [u8],
}

impl Kernel for Band<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let mut pixels = vec![Vec4::ZERO; self.width];
        let row_bytes = self.width * self.background.channels();
        for (row, out) in self.rows.chunks_exact_mut(row_bytes).enumerate() {
            let centre = DVec3::new(0.5, (self.first + row) as f64 + 0.5, 1.0);
            match self.parts {
                [part] => Row::new(part, centre, self.width).warp(part, &mut pixels),
                parts => several(parts, centre, &mut pixels),
            }
            image::write_row(&pixels, self.background, out);
        }
    }
}

/// A row whose pixels belong to several parts (or to none).
#[inline(never)]
fn several(parts: &[Part<'_>], centre: DVec3, pixels: &mut [Vec4]) {
    let owners: Vec<Option<usize>> = (0..pixels.len())
        .map(|x| {
            let at = DVec2::new(centre.x + x as f64, centre.y);
            parts.iter().position(|part| part.factorization.owns(at))
        })
        .collect();
    pixels.fill(Vec4::ZERO);
    let mut warped = vec![Vec4::ZERO; pixels.len()];
    for (n, part) in parts.iter().enumerate() {
        if !owners.contains(&Some(n)) {
            continue;
        }
        Row::new(part, centre, pixels.len()).warp(part, &mut warped);
        for ((pixel, warped), _) in pixels.iter_mut().zip(&warped).zip(&owners).filter(|(_, owner)| **owner == Some(n))
        {
            *pixel = *warped;
        }
    }
}

/// Where a row of final pixels lies on an intermediate image.
struct Row {
    /// Homogeneous position of the first pixel, and what the next one adds.
    start: DVec3,
    step: DVec3,
    /// The pixels that lie over the slices.
    inside: Range<usize>,
    extent: [DVec2; 2],
}

impl Row {
    #[inline(always)]
    fn new(part: &Part<'_>, centre: DVec3, length: usize) -> Self {
        let sheared_from_image = part.factorization.sheared_from_image;
        let (start, step) = (sheared_from_image * centre, sheared_from_image.x_axis);
        let extent = part.factorization.extent;
        Self { start, step, inside: inside(extent, start, step, length), extent }
    }

    /// Samples the row; pixels that do not lie over the slices are transparent.
    #[inline(always)]
    fn warp(&self, part: &Part<'_>, pixels: &mut [Vec4]) {
        pixels[..self.inside.start].fill(Vec4::ZERO);
        pixels[self.inside.end..].fill(Vec4::ZERO);
        let pixels = &mut pixels[self.inside.clone()];
        if part.factorization.is_parallel() {
            self.affine(part.image, pixels);
        } else {
            self.projective(part.image, pixels);
        }
    }

    #[inline(always)]
    fn affine(&self, image: &IntermediateImage, pixels: &mut [Vec4]) {
        let first = self.start + self.step * self.inside.start as f64;
        let mut position = [first.x, first.y].map(fixed);
        let step = [self.step.x, self.step.y].map(fixed);
        for pixel in pixels {
            // Rounding may leave the row's ends a hair below 0.
            *pixel = sample(image, position.map(|p| p.max(0)));
            position = [position[0] + step[0], position[1] + step[1]];
        }
    }

    #[inline(always)]
    fn projective(&self, image: &IntermediateImage, pixels: &mut [Vec4]) {
        let [low, high] = self.extent;
        for (block, pixels) in pixels.chunks_mut(LANES).enumerate() {
            let first = (self.inside.start + block * LANES) as f64;
            let mut positions = [[0; 2]; LANES];
            for (lane, position) in positions.iter_mut().enumerate() {
                let x = first + lane as f64;
                let w = 1.0 / (self.start.z + x * self.step.z);
                let u = ((self.start.x + x * self.step.x) * w).max(low.x).min(high.x);
                let v = ((self.start.y + x * self.step.y) * w).max(low.y).min(high.y);
                *position = [u, v].map(|p| (p + TO_FIXED).to_bits() as i64 - TO_FIXED.to_bits() as i64);
            }
            for (pixel, position) in pixels.iter_mut().zip(positions) {
                *pixel = sample(image, position);
            }
        }
    }
}

/// The bilinearly interpolated pixel at a position.
#[inline(always)]
fn sample(image: &IntermediateImage, position: [i64; 2]) -> Vec4 {
    let (pixels, stride) = (image.pixels(), image.size()[0]);
    let [u, v] = position.map(|p| (p >> FRACTION_BITS) as usize);
    let [fu, fv] = position.map(fraction);
    let at = v * stride + u;
    let (upper, lower) = (&pixels[at..at + 2], &pixels[at + stride..at + stride + 2]);
    let above = upper[0] + (upper[1] - upper[0]) * fu;
    let below = lower[0] + (lower[1] - lower[0]) * fu;
    above + (below - above) * fv
}

/// The pixels of a row whose positions lie within `extent`.
#[inline(always)]
fn inside([lowest, highest]: [DVec2; 2], start: DVec3, step: DVec3, length: usize) -> Range<usize> {
    let above = |axis: usize| [start, step].map(|p| p[axis] - lowest[axis] * p.z);
    let below = |axis: usize| [start, step].map(|p| highest[axis] * p.z - p[axis]);
    let (mut low, mut high) = (0.0, length as f64 - 1.0);
    for [distance, rate] in [above(0), below(0), above(1), below(1), [start.z, step.z]] {
        if rate.abs() <= 1e-12 {
            if distance < 0.0 {
                return 0..0;
            }
        } else if rate > 0.0 {
            low = f64::max(low, -distance / rate + ROUNDING);
        } else {
            high = f64::min(high, -distance / rate - ROUNDING);
        }
    }
    let (low, high) = (low.ceil(), high.floor());
    if low > high { 0..0 } else { low as usize..high as usize + 1 }
}

fn fixed(position: f64) -> i64 {
    (position * (1u64 << FRACTION_BITS) as f64).round() as i64
}

/// The fraction of a position, 0..1, to 24 bits: all that an f32 holds.
#[inline(always)]
fn fraction(position: i64) -> f32 {
    const SCALE: f32 = 1.0 / (1u32 << 24) as f32;
    ((position as u32) >> 8) as i32 as f32 * SCALE
}
