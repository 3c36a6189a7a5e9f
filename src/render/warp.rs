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
//! adding a number so large that the sum's mantissa ends where the fraction does.
//!
//! Pixels are fixed-point numbers too, 16 bits a component, and weights have 14: the four products of a
//! component are two instructions' work, and nothing but the result is rounded. There is no table of
//! transparent pixels' colours to care for: the intermediate image is over the background already.
//!
//! Where a picture has parts, each pixel is warped from the one that its ray belongs to.

mod lanes;
mod torn;

use std::ops::Range;

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use self::lanes::{FRACTION_BITS, LANES, Lanes, Portable, Rgb, Rgba};
use super::bands;
use super::depth::InverseWarp;
use super::factorization::Factorization;
use super::intermediate::{IntermediateImage, write_pixel};
use super::simd::{self, Kernel};
use super::{Background, Cancel, Image, RenderError, image};

/// Fractional bits of a position that is stepped along a row: over 2^15 pixels it errs by less than
/// 2^-16 pixels.
const STEPPED_BITS: u32 = 32;

/// Added to a position below 2^17, leaves `FRACTION_BITS` of its fraction at the mantissa's end.
const TO_FIXED: f64 = 1.5 * (1u64 << (f64::MANTISSA_DIGITS - 1 - FRACTION_BITS)) as f64;

/// So far inside the slices' borders a row's pixels begin and end, pixels: what rounding leaves a hair outside
/// would be read below pixel 0.
const ROUNDING: f64 = 1e-6;

/// Rows that one job fills.
const BAND_HEIGHT: usize = 16;

/// A factorization and its composited slices.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    pub factorization: &'a Factorization,
    pub image: &'a IntermediateImage,
    /// What ends its rays, if there is a depth buffer.
    pub depth: Option<&'a InverseWarp<'a>>,
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
    let height = out.len() / row_bytes;
    let fill = || {
        bands::middle_first(out.chunks_mut(row_bytes * BAND_HEIGHT).enumerate()).try_for_each(|(band, rows)| {
            if cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            simd::dispatch(Band { parts, background, width, first: band * BAND_HEIGHT, rows });
            Ok(())
        })
    };
    let (filled, mended) = rayon::join(fill, || torn::mended(parts, [width, height]));
    filled?;
    for ([x, y], pixel) in mended {
        write_pixel(&pixel, &mut out[y * row_bytes + x * background.channels()..][..background.channels()]);
    }
    Ok(())
}

/// What is left to be done to an intermediate image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Homogeneous pixel coordinates; the centre of an image's first pixel is at (0.5, 0.5). Beyond the centres of the
    /// intermediate image's outermost pixels there is only background.
    pub image_from_intermediate: DMat3,
}

/// An intermediate image, as far as a final one of `size` pixels shows more than background of it. `None` where that is nothing, or
/// an image with more pixels or a longer side than the final one.
pub fn unwarped(part: &Part<'_>, background: &Background, size: [usize; 2]) -> Option<Image> {
    let [us, vs] = part.seen(size);
    let (width, height) = (us.len(), vs.len());
    if us.is_empty() || vs.is_empty() || width * height > size[0] * size[1] || width.max(height) > size[0].max(size[1])
    {
        return None;
    }
    let channels = background.channels();
    let mut pixels = image::unwritten(width * height * channels);
    pixels.par_chunks_exact_mut(width * channels).zip(vs.clone()).for_each(|(out, v)| {
        part.image.write(v, us.clone(), background, out);
    });
    let corner = DVec2::new(us.start as f64, vs.start as f64);
    let sheared_from_intermediate = DMat3::from_translation(corner - 0.5);
    let image_from_intermediate = part.factorization.sheared_from_image.inverse() * sheared_from_intermediate;
    let warp = Some(Warp { image_from_intermediate });
    Some(Image { width: width as u32, height: height as u32, channels: channels as u8, pixels, warp })
}

impl Part<'_> {
    /// The pixels along u and v that a final image of `size` pixels reads and that show more than background, and one more around
    /// these, where there is one.
    fn seen(&self, [width, height]: [usize; 2]) -> [Range<usize>; 2] {
        let [mut low, mut high] = self.factorization.extent;
        if self.factorization.is_parallel() {
            let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(x, y)| {
                let corner = DVec3::new(x * width as f64, y * height as f64, 1.0);
                (self.factorization.sheared_from_image * corner).truncate()
            });
            low = low.max(corners.into_iter().fold(DVec2::INFINITY, DVec2::min));
            high = high.min(corners.into_iter().fold(DVec2::NEG_INFINITY, DVec2::max));
        }
        if low.x > high.x || low.y > high.y {
            return [0..0, 0..0];
        }
        let read = |axis: usize| low[axis] as usize..(high[axis] as usize + 2).min(self.image.size()[axis]);
        let (us, vs) = (read(0), read(1));
        let shows = |v: &usize| !self.image.drawn(*v, *v).is_empty();
        let (Some(first), Some(last)) = (vs.clone().find(shows), vs.clone().rfind(shows)) else { return [0..0, 0..0] };
        let wider = |drawn: Range<usize>, read: Range<usize>| {
            drawn.start.saturating_sub(1).max(read.start)..(drawn.end + 1).min(read.end)
        };
        [wider(self.image.drawn(first, last), us), wider(first..last + 1, vs)]
    }
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
        match self.background {
            Background::Opaque(_) => self.fill::<Rgb<Portable>>(),
            Background::Transparent => self.fill::<Rgba>(),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) {
        match self.background {
            Background::Opaque(_) => self.fill::<Rgb<lanes::Avx2>>(),
            Background::Transparent => self.fill::<Rgba>(),
        }
    }
}

impl Band<'_> {
    #[inline(always)]
    fn fill<L: Lanes>(self) {
        let row_bytes = self.width * L::CHANNELS;
        let behind = self.background.behind().to_array().map(|component| (component * 255.0).round() as u8);
        let empty = behind[..L::CHANNELS].repeat(self.width);
        let mut warped = vec![0; if self.parts.len() > 1 { row_bytes } else { 0 }];
        for (row, out) in self.rows.chunks_exact_mut(row_bytes).enumerate() {
            let centre = DVec3::new(0.5, (self.first + row) as f64 + 0.5, 1.0);
            match self.parts {
                [part] => Row::new(part, centre, self.width).warp::<L>(part, &empty, out),
                parts => {
                    out.copy_from_slice(&empty);
                    let owners: Vec<Option<usize>> = (0..self.width)
                        .map(|x| {
                            let at = DVec2::new(centre.x + x as f64, centre.y);
                            parts.iter().position(|part| part.factorization.owns(at))
                        })
                        .collect();
                    for (n, part) in parts.iter().enumerate().filter(|(n, _)| owners.contains(&Some(*n))) {
                        Row::new(part, centre, self.width).warp::<L>(part, &empty, &mut warped);
                        let pixels = out.chunks_exact_mut(L::CHANNELS).zip(warped.chunks_exact(L::CHANNELS));
                        for ((out, warped), _) in pixels.zip(&owners).filter(|(_, owner)| **owner == Some(n)) {
                            out.copy_from_slice(warped);
                        }
                    }
                }
            }
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

    /// Writes the whole row, `empty` where it is not inside.
    #[inline(always)]
    fn warp<L: Lanes>(&self, part: &Part<'_>, empty: &[u8], out: &mut [u8]) {
        let (start, end) = (self.inside.start * L::CHANNELS, self.inside.end * L::CHANNELS);
        out[..start].copy_from_slice(&empty[..start]);
        out[end..].copy_from_slice(&empty[end..]);
        if part.factorization.is_parallel() {
            self.affine::<L>(part.image, &mut out[start..end]);
        } else {
            self.projective::<L>(part.image, &mut out[start..end]);
        }
    }

    /// Blocks begin at multiples of their length, wherever the row does: a pixel's position depends on
    /// nothing but its place in the row.
    #[inline(always)]
    fn affine<L: Lanes>(&self, image: &IntermediateImage, out: &mut [u8]) {
        let Range { start, end } = self.inside;
        let [du, dv] = [self.step.x, self.step.y].map(stepped);
        let (start_u, start_v) = (stepped(self.start.x), stepped(self.start.y));
        let (along_u, along_v) = (along(du), along(dv));
        let block = |u: i64, v: i64| {
            let (first_u, first_v) = (shortened(u), shortened(v));
            let (mut us, mut vs) = ([0; LANES], [0; LANES]);
            for lane in 0..LANES {
                // Rounding may leave the row's ends a hair below 0; lanes beyond them may be anywhere.
                us[lane] = first_u.wrapping_add(along_u[lane]).max(0);
                vs[lane] = first_v.wrapping_add(along_v[lane]).max(0);
            }
            [us, vs]
        };
        // Whole blocks, which go from registers to where they belong, and what is left of the first and the last one.
        let (whole, whole_end) = (start.next_multiple_of(LANES), end / LANES * LANES);
        let parts = if whole > whole_end { [start..end, 0..0] } else { [start..whole, whole_end..end] };
        for part in parts.into_iter().filter(|part| !part.is_empty()) {
            let x = part.start / LANES * LANES;
            let positions = block(start_u + du * x as i64, start_v + dv * x as i64);
            let out = &mut out[(part.start - start) * L::CHANNELS..(part.end - start) * L::CHANNELS];
            L::write(image, positions, part.start - x, out);
        }
        if whole < whole_end {
            let (mut u, mut v) = (start_u + du * whole as i64, start_v + dv * whole as i64);
            let out = &mut out[(whole - start) * L::CHANNELS..(whole_end - start) * L::CHANNELS];
            for out in out.chunks_exact_mut(LANES * L::CHANNELS) {
                L::write_all(image, block(u, v), out);
                (u, v) = (u + du * LANES as i64, v + dv * LANES as i64);
            }
        }
    }

    #[inline(always)]
    fn projective<L: Lanes>(&self, image: &IntermediateImage, out: &mut [u8]) {
        let [low, high] = self.extent;
        for (block, out) in out.chunks_mut(LANES * L::CHANNELS).enumerate() {
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
            L::write(image, [us, vs], 0, out);
        }
    }
}

/// The pixels of a row whose homogeneous positions, `start` and each a `step` on, lie within `extent`.
#[inline(always)]
pub fn inside([lowest, highest]: [DVec2; 2], start: DVec3, step: DVec3, length: usize) -> Range<usize> {
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

/// How far a block's positions are from its first, by lane. In memory: the loop would take apart what it sees made.
#[inline(never)]
fn along(step: i64) -> [i32; LANES] {
    std::array::from_fn(|lane| shortened(step * lane as i64))
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
