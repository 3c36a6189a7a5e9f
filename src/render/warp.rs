//! The 2D warp: intermediate image -> final image (Lacroute and Levoy 1994, section 3.1).
//!
//! A homogeneous map with a bilinear filter. Along a row of the final image the homogeneous position
//! advances by a constant, and what it has to satisfy to lie over the sheared slices are linear
//! inequalities, so the stretch of a row that does is found analytically; outside it there is only
//! background, and the volume's faces are not blurred into it.
//!
//! Positions are fixed-point numbers: the integer part addresses the four pixels, the fraction gives
//! the weights. Eight pixels of a row are placed at once. Under parallel projection the map is
//! affine: the eight lie at fixed distances from the first, and that is stepped by additions. In
//! perspective each is divided out anew, so that nothing accumulates, and taken to fixed point by
//! adding a number so large that the sum's mantissa ends where the fraction does. A pixel's left and
//! right neighbours are next to each other in memory: eight numbers, interpolated downwards at once.
//!
//! Where a picture has parts, each pixel is warped from the one that its ray belongs to.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec4};
use rayon::prelude::*;

use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::simd::{self, Kernel};
use super::{Background, Cancel, RenderError, image};

/// Fractional bits of a position that is stepped along a row: over 2^15 pixels it errs by less than
/// 2^-16 pixels.
const STEPPED_BITS: u32 = 32;

/// Fractional bits of a position that pixels are read at: its 32 bits reach as far as an intermediate image.
const FRACTION_BITS: u32 = 15;

/// Added to a position below 2^17, leaves `FRACTION_BITS` of its fraction at the mantissa's end.
const TO_FIXED: f64 = 1.5 * (1u64 << (f64::MANTISSA_DIGITS - 1 - FRACTION_BITS)) as f64;

/// So far inside the slices' borders a row's pixels begin and end, pixels: what rounding leaves a hair outside
/// would be read below pixel 0.
const ROUNDING: f64 = 1e-6;

/// Rows that one job fills.
const BAND_HEIGHT: usize = 16;

/// Pixels that are placed at once.
const LANES: usize = 8;

/// Numbers of two pixels, one after the other.
type Pair = [f32; 8];

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
        let channels = self.background.channels();
        let row_bytes = self.width * channels;
        let mut pixels = vec![Vec4::ZERO; self.width];
        let mut empty = vec![0; row_bytes];
        image::write_row(&pixels, self.background, &mut empty);
        for (row, out) in self.rows.chunks_exact_mut(row_bytes).enumerate() {
            let centre = DVec3::new(0.5, (self.first + row) as f64 + 0.5, 1.0);
            match self.parts {
                [part] => {
                    let row = Row::new(part, centre, self.width);
                    let Range { start, end } = row.inside;
                    row.sample(part, &mut pixels[start..end]);
                    out[..start * channels].copy_from_slice(&empty[..start * channels]);
                    image::write_row(&pixels[start..end], self.background, &mut out[start * channels..end * channels]);
                    out[end * channels..].copy_from_slice(&empty[end * channels..]);
                }
                parts => {
                    several(parts, centre, &mut pixels);
                    image::write_row(&pixels, self.background, out);
                }
            }
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
        let row = Row::new(part, centre, pixels.len());
        warped.fill(Vec4::ZERO);
        row.sample(part, &mut warped[row.inside.clone()]);
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
    /// The pixels that lie over the slices, but for transparent ones at either end.
    inside: Range<usize>,
    extent: [DVec2; 2],
}

impl Row {
    #[inline(always)]
    fn new(part: &Part<'_>, centre: DVec3, length: usize) -> Self {
        let sheared_from_image = part.factorization.sheared_from_image;
        let (start, step) = (sheared_from_image * centre, sheared_from_image.x_axis);
        let extent = part.factorization.extent;
        let over = inside(extent, start, step, length);
        let drawn = Self::drawn(part.image, start, step, &over);
        // A hair wider than where pixels that are drawn have an influence.
        let narrow = [extent[0].with_x(drawn.start as f64 - 1.01), extent[1].with_x(drawn.end as f64 + 0.01)];
        let drawn = if drawn.is_empty() { 0..0 } else { inside(narrow, start, step, length) };
        let (first, end) = (over.start.max(drawn.start), over.end.min(drawn.end));
        Self { start, step, inside: if first < end { first..end } else { 0..0 }, extent }
    }

    /// What is drawn of the scanlines under the pixels of `over`.
    #[inline(always)]
    fn drawn(image: &IntermediateImage, start: DVec3, step: DVec3, over: &Range<usize>) -> Range<usize> {
        if over.is_empty() {
            return 0..0;
        }
        let [a, b] = [over.start, over.end - 1].map(|x| {
            let at = start + step * x as f64;
            at.y / at.z
        });
        image.drawn((a.min(b) - 0.01).max(0.0) as usize, (a.max(b) + 1.01) as usize)
    }

    /// Samples the pixels inside.
    #[inline(always)]
    fn sample(&self, part: &Part<'_>, pixels: &mut [Vec4]) {
        if part.factorization.is_parallel() {
            self.affine(part.image, pixels);
        } else {
            self.projective(part.image, pixels);
        }
    }

    /// Blocks begin at multiples of their length, wherever the row does: a pixel's position depends on
    /// nothing but its place in the row.
    #[inline(always)]
    fn affine(&self, image: &IntermediateImage, pixels: &mut [Vec4]) {
        let Range { start, end } = self.inside;
        let first = start / LANES * LANES;
        let [du, dv] = [self.step.x, self.step.y].map(stepped);
        let (mut u, mut v) = (stepped(self.start.x) + du * first as i64, stepped(self.start.y) + dv * first as i64);
        let (mut along_u, mut along_v) = ([0; LANES], [0; LANES]);
        for lane in 0..LANES {
            along_u[lane] = shortened(du * lane as i64);
            along_v[lane] = shortened(dv * lane as i64);
        }
        for x in (first..end).step_by(LANES) {
            let (first_u, first_v) = (shortened(u), shortened(v));
            let (mut us, mut vs) = ([0; LANES], [0; LANES]);
            for lane in 0..LANES {
                // Rounding may leave the row's ends a hair below 0; lanes beyond them may be anywhere.
                us[lane] = first_u.wrapping_add(along_u[lane]).max(0);
                vs[lane] = first_v.wrapping_add(along_v[lane]).max(0);
            }
            let (from, to) = (x.max(start), (x + LANES).min(end));
            sample(image, [us, vs], from - x, &mut pixels[from - start..to - start]);
            (u, v) = (u + du * LANES as i64, v + dv * LANES as i64);
        }
    }

    #[inline(always)]
    fn projective(&self, image: &IntermediateImage, pixels: &mut [Vec4]) {
        let [low, high] = self.extent;
        for (block, pixels) in pixels.chunks_mut(LANES).enumerate() {
            let first = (self.inside.start + block * LANES) as f64;
            let (mut us, mut vs) = ([0; LANES], [0; LANES]);
            for lane in 0..LANES {
                let x = first + lane as f64;
                let w = 1.0 / (self.start.z + x * self.step.z);
                let u = ((self.start.x + x * self.step.x) * w).max(low.x).min(high.x);
                let v = ((self.start.y + x * self.step.y) * w).max(low.y).min(high.y);
                us[lane] = (u + TO_FIXED).to_bits() as i32;
                vs[lane] = (v + TO_FIXED).to_bits() as i32;
            }
            sample(image, [us, vs], 0, pixels);
        }
    }
}

/// The bilinearly interpolated pixels at some positions, from lane `first` on.
#[inline(always)]
fn sample(image: &IntermediateImage, [us, vs]: [[i32; LANES]; 2], first: usize, out: &mut [Vec4]) {
    const SCALE: f32 = 1.0 / (1 << FRACTION_BITS) as f32;
    let stride = image.size()[0];
    let span = stride * 4 + 8;
    let numbers: &[f32] = bytemuck::cast_slice(image.pixels());
    let (mut at, mut fractions_u, mut fractions_v) = ([0; LANES], [0.0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        let (u, v) = (us[lane] >> FRACTION_BITS, vs[lane] >> FRACTION_BITS);
        at[lane] = v.wrapping_mul(stride as i32).wrapping_add(u) as u32;
        fractions_u[lane] = (us[lane] & ((1 << FRACTION_BITS) - 1)) as f32 * SCALE;
        fractions_v[lane] = (vs[lane] & ((1 << FRACTION_BITS) - 1)) as f32 * SCALE;
    }
    for (out, lane) in out.iter_mut().zip(first..LANES) {
        // From the upper two pixels to the lower two: one look at the bounds for all.
        let around = &numbers[at[lane] as usize * 4..][..span];
        let upper: &Pair = around.first_chunk().expect("eight numbers");
        let lower: &Pair = around.last_chunk().expect("eight numbers");
        let mut pair = [0.0; 8];
        for n in 0..8 {
            pair[n] = upper[n] + (lower[n] - upper[n]) * fractions_v[lane];
        }
        let [left, right] = [Vec4::from_slice(&pair[..4]), Vec4::from_slice(&pair[4..])];
        *out = left + (right - left) * fractions_u[lane];
    }
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

/// A position to be stepped.
#[inline(always)]
fn stepped(position: f64) -> i64 {
    (position * (1u64 << STEPPED_BITS) as f64).round() as i64
}

/// A stepped position, to be read at.
#[inline(always)]
fn shortened(stepped: i64) -> i32 {
    (stepped >> (STEPPED_BITS - FRACTION_BITS)) as i32
}
