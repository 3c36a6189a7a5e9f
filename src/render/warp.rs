//! The 2D warp: intermediate image -> final image (Lacroute and Levoy 1994, section 3.1).
//!
//! An affine map with a bilinear filter. Along a row of the final image the position in the
//! intermediate image advances by a constant, so it is stepped in fixed point: the integer part
//! addresses the four pixels, the fraction gives the weights. The stretch of a row that lies over
//! the sheared slices is found analytically; outside it there is only background, and the volume's
//! faces are not blurred into it.

use std::ops::Range;

use glam::{DVec2, Vec4};
use rayon::prelude::*;

use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::{Background, Cancel, RenderError, image};

/// Fractional bits of a position: steps over a row of 2^15 pixels err by less than 2^-16 pixels.
const FRACTION_BITS: u32 = 32;

/// Rows that one job fills.
const BAND_HEIGHT: usize = 16;

/// Fills `out`, rows of `width` pixels over `background`.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub fn warp(
    intermediate: &IntermediateImage,
    factorization: &Factorization,
    background: &Background,
    width: usize,
    out: &mut [u8],
    cancel: &Cancel,
) -> Result<(), RenderError> {
    let row_bytes = width * background.channels();
    let sheared_from_image = factorization.sheared_from_image;
    out.par_chunks_mut(row_bytes * BAND_HEIGHT).enumerate().try_for_each(|(band, rows)| {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let mut pixels = vec![Vec4::ZERO; width];
        for (row, out) in rows.chunks_exact_mut(row_bytes).enumerate() {
            let centre = DVec2::new(0.5, (band * BAND_HEIGHT + row) as f64 + 0.5);
            let start = sheared_from_image.transform_point2(centre);
            let step = sheared_from_image.matrix2.x_axis;
            let inside = inside(factorization.extent(), start, step, width);
            warp_row(intermediate, start, step, inside, &mut pixels);
            image::write_row(&pixels, background, out);
        }
        Ok(())
    })
}

/// Samples the pixels `inside` of a row that starts at `start` and advances by `step` intermediate
/// pixels; the others are transparent.
fn warp_row(intermediate: &IntermediateImage, start: DVec2, step: DVec2, inside: Range<usize>, row: &mut [Vec4]) {
    row[..inside.start].fill(Vec4::ZERO);
    row[inside.end..].fill(Vec4::ZERO);
    let (pixels, stride) = (intermediate.pixels(), intermediate.size()[0]);
    let first = start + step * inside.start as f64;
    let mut position = [fixed(first.x), fixed(first.y)];
    let step = [fixed(step.x), fixed(step.y)];
    for out in &mut row[inside] {
        // Rounding may leave the row's ends a hair below 0.
        let [u, v] = position.map(|p| (p.max(0) >> FRACTION_BITS) as usize);
        let [fu, fv] = position.map(fraction);
        let at = v * stride + u;
        let (upper, lower) = (&pixels[at..at + 2], &pixels[at + stride..at + stride + 2]);
        let above = upper[0] + (upper[1] - upper[0]) * fu;
        let below = lower[0] + (lower[1] - lower[0]) * fu;
        *out = above + (below - above) * fv;
        position = [position[0] + step[0], position[1] + step[1]];
    }
}

/// The pixels of a row whose positions lie from 0 to `extent`.
fn inside(extent: DVec2, start: DVec2, step: DVec2, length: usize) -> Range<usize> {
    let (mut low, mut high) = (0.0, length as f64 - 1.0);
    for axis in 0..2 {
        if step[axis].abs() > 1e-12 {
            let ends = [-start[axis] / step[axis], (extent[axis] - start[axis]) / step[axis]];
            low = f64::max(low, ends[0].min(ends[1]));
            high = f64::min(high, ends[0].max(ends[1]));
        } else if !(0.0..=extent[axis]).contains(&start[axis]) {
            return 0..0;
        }
    }
    // What rounding leaves a hair outside would be read below pixel 0.
    let (low, high) = ((low + 1e-6).ceil(), (high - 1e-6).floor());
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
