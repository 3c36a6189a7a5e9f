//! The 2D warp: intermediate image -> final image (Lacroute and Levoy 1994, section 3.1).
//!
//! An affine map with a bilinear filter. Along a row of the final image the position in the
//! intermediate image advances by a constant, so it is stepped in fixed point: the integer part
//! addresses the four pixels, the fraction gives the weights. The stretch of a row that lies inside
//! the intermediate image is found analytically; outside it there is only background.

use std::ops::Range;

use glam::{DAffine2, DVec2, Vec4};
use rayon::prelude::*;

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
    sheared_from_image: DAffine2,
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
        let mut pixels = vec![Vec4::ZERO; width];
        for (row, out) in rows.chunks_exact_mut(row_bytes).enumerate() {
            let centre = DVec2::new(0.5, (band * BAND_HEIGHT + row) as f64 + 0.5);
            let start = sheared_from_image.transform_point2(centre);
            warp_row(intermediate, start, sheared_from_image.matrix2.x_axis, &mut pixels);
            image::write_row(&pixels, background, out);
        }
        Ok(())
    })
}

/// Samples a row that starts at `start` and advances by `step` intermediate pixels.
fn warp_row(intermediate: &IntermediateImage, start: DVec2, step: DVec2, row: &mut [Vec4]) {
    let inside = inside(intermediate.size(), start, step, row.len());
    row[..inside.start].fill(Vec4::ZERO);
    row[inside.end..].fill(Vec4::ZERO);
    let (pixels, stride) = (intermediate.bordered_pixels(), intermediate.stride());
    // The border moves pixel (0, 0) to (1, 1), and keeps positions above zero.
    let first = start + step * inside.start as f64 + DVec2::ONE;
    let mut position = [fixed(first.x), fixed(first.y)];
    let step = [fixed(step.x), fixed(step.y)];
    for out in &mut row[inside] {
        let [u, v] = position.map(|p| (p >> FRACTION_BITS) as usize);
        let [fu, fv] = position.map(|p| fraction(p));
        let at = v * stride + u;
        let (upper, lower) = (&pixels[at..at + 2], &pixels[at + stride..at + stride + 2]);
        let above = upper[0] + (upper[1] - upper[0]) * fu;
        let below = lower[0] + (lower[1] - lower[0]) * fu;
        *out = above + (below - above) * fv;
        position = [position[0] + step[0], position[1] + step[1]];
    }
}

/// The pixels of a row whose positions lie less than a pixel outside the intermediate image, where
/// the filter still reaches it.
fn inside(size: [usize; 2], start: DVec2, step: DVec2, length: usize) -> Range<usize> {
    let (mut low, mut high) = (0.0, length as f64 - 1.0);
    for axis in 0..2 {
        // A little less than a pixel: rounding must not step over the border.
        let (first, last) = (-1.0 + 1e-6, size[axis] as f64 - 1e-6);
        if step[axis].abs() > 1e-12 {
            let ends = [(first - start[axis]) / step[axis], (last - start[axis]) / step[axis]];
            low = f64::max(low, ends[0].min(ends[1]));
            high = f64::min(high, ends[0].max(ends[1]));
        } else if start[axis] < first || start[axis] > last {
            return 0..0;
        }
    }
    if low > high { 0..0 } else { low.ceil() as usize..high.floor() as usize + 1 }
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
