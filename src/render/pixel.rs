//! What a band is composited in.
//!
//! Premultiplied colour and opacity, as four floats or as four 16-bit fractions (`Short`). The latter are half as large and are
//! blended four at once, but too coarse for a medium of which a slice shows next to nothing; they serve where all that a frame does
//! is to look voxels up, to resample and to blend them. Whatever else computes with colours has floats.

use std::fmt::Debug;

use glam::Vec4;

use super::intermediate::{Fixed, ONE, fixed};
use super::simd::shorts::{FOUR, Short, ShortWeights, Shorts, UNIT};
use super::spare::Spare;

/// Pixels of a mask word.
pub const WORD: usize = 64;

/// Pixels that are taken together where they are measured and converted.
pub const BLOCK: usize = 8;

/// Premultiplied colour and opacity, of a pixel or of a voxel.
pub trait Pixel: Copy + Debug + PartialEq + Send + Sync + 'static {
    /// Nothing.
    const CLEAR: Self;

    /// Bilinear weights of the four voxels around a pixel, the same for all of a slice.
    type Weights: Copy + Debug;

    /// How opaque a pixel is that is done.
    type Limit: Copy + Debug;

    /// The weights where pixels lie so far behind the voxels before them, along u and v.
    fn weights(fractions: [f32; 2]) -> Self::Weights;

    /// The limit that is reached at an accumulated opacity.
    fn limit(opacity: f32) -> Self::Limit;

    /// Between two voxels of the upper and two of the lower scanline.
    fn resample<const LOWER: bool>(weights: &Self::Weights, upper: [Self; 2], lower: [Self; 2]) -> Self;

    /// With a sample behind it.
    fn over(self, sample: Self) -> Self;

    /// True where a pixel is done.
    fn is_opaque(self, limit: Self::Limit) -> bool;

    /// Opacity, 0..=1.
    fn opacity(self) -> f32;

    /// Colour and opacity times a factor.
    fn times(self, factor: f32) -> Self;

    /// Colour times a factor.
    fn faded(self, factor: f32) -> Self;

    /// Resamples the voxels of two rows at those pixels that are set in `touched`, and blends them: a word of pixels, each between the
    /// rows' voxels of the same number and the one after. Gives the mask of those of them (or some beside them) that are done.
    fn blend<W: Shorts, const LOWER: bool>(
        pixels: &mut [Self; WORD],
        rows: [&[Self; WORD + 1]; 2],
        weights: &Self::Weights,
        limit: Self::Limit,
        touched: u64,
    ) -> u64;

    /// True where none of the pixels shows anything.
    fn are_clear(pixels: &[Self]) -> bool;

    /// What the warp reads of pixels over one that is behind them.
    fn fixed<const N: usize>(pixels: &[Self; N], behind: Vec4) -> [Fixed; N];

    /// Memory of bands that is not needed any more.
    fn spare() -> &'static Spare<Self>;
}

/// [`Pixel::Weights`] of floats.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    upper: [f32; 2],
    lower: [f32; 2],
}

impl Pixel for Vec4 {
    const CLEAR: Self = Self::ZERO;
    type Weights = Weights;
    type Limit = f32;

    #[inline(always)]
    fn weights([u, v]: [f32; 2]) -> Weights {
        let along = [1.0 - u, u];
        Weights { upper: along.map(|w| w * (1.0 - v)), lower: along.map(|w| w * v) }
    }

    #[inline(always)]
    fn limit(opacity: f32) -> f32 {
        opacity
    }

    #[inline(always)]
    fn resample<const LOWER: bool>(weights: &Weights, upper: [Self; 2], lower: [Self; 2]) -> Self {
        let above = upper[0] * weights.upper[0] + upper[1] * weights.upper[1];
        if LOWER { above + (lower[0] * weights.lower[0] + lower[1] * weights.lower[1]) } else { above }
    }

    #[inline(always)]
    fn over(self, sample: Self) -> Self {
        self + sample * (1.0 - self.w)
    }

    #[inline(always)]
    fn is_opaque(self, limit: f32) -> bool {
        self.cmpge(Self::splat(limit)).bitmask() >> 3 == 1
    }

    #[inline(always)]
    fn opacity(self) -> f32 {
        self.w
    }

    #[inline(always)]
    fn times(self, factor: f32) -> Self {
        self * factor
    }

    #[inline(always)]
    fn faded(self, factor: f32) -> Self {
        (self * factor).with_w(self.w)
    }

    #[inline(always)]
    fn blend<W: Shorts, const LOWER: bool>(
        pixels: &mut [Self; WORD],
        rows: [&[Self; WORD + 1]; 2],
        weights: &Weights,
        limit: f32,
        touched: u64,
    ) -> u64 {
        one_by_one::<Self, LOWER>(pixels, rows, weights, limit, touched, |_, sample| sample)
    }

    #[inline(always)]
    fn are_clear(pixels: &[Self]) -> bool {
        pixels.iter().flat_map(Self::to_array).fold(0, |bits, component| bits | component.to_bits()) == 0
    }

    #[inline(always)]
    fn fixed<const N: usize>(pixels: &[Self; N], behind: Vec4) -> [Fixed; N] {
        let mut over = *pixels;
        for pixel in &mut over {
            *pixel = pixel.over(behind);
        }
        fixed(&over)
    }

    fn spare() -> &'static Spare<Self> {
        static SPARE: Spare<Vec4> = Spare::none();
        &SPARE
    }
}

impl Pixel for Short {
    const CLEAR: Self = Self::CLEAR;
    type Weights = ShortWeights;
    /// The greatest opacity of pixels that are not done.
    type Limit = i16;

    #[inline(always)]
    fn weights(fractions: [f32; 2]) -> ShortWeights {
        let Weights { upper, lower } = Vec4::weights(fractions);
        ShortWeights { upper: upper.map(short), lower: lower.map(short) }
    }

    #[inline(always)]
    fn limit(opacity: f32) -> i16 {
        (opacity * f32::from(UNIT)).ceil() as i16 - 1
    }

    #[inline(always)]
    fn resample<const LOWER: bool>(weights: &ShortWeights, upper: [Self; 2], lower: [Self; 2]) -> Self {
        Self::resampled::<LOWER>(weights, upper, lower)
    }

    #[inline(always)]
    fn over(self, sample: Self) -> Self {
        self.over(sample)
    }

    #[inline(always)]
    fn is_opaque(self, limit: i16) -> bool {
        self.0[3] > limit
    }

    #[inline(always)]
    fn opacity(self) -> f32 {
        f32::from(self.0[3]) / f32::from(UNIT)
    }

    #[inline(always)]
    fn times(self, factor: f32) -> Self {
        Self(self.0.map(|component| nearest(f32::from(component) * factor)))
    }

    #[inline(always)]
    fn faded(self, factor: f32) -> Self {
        let [r, g, b, _] = Pixel::times(self, factor).0;
        Self([r, g, b, self.0[3]])
    }

    #[inline(always)]
    fn blend<W: Shorts, const LOWER: bool>(
        pixels: &mut [Self; WORD],
        [upper, lower]: [&[Self; WORD + 1]; 2],
        weights: &ShortWeights,
        limit: i16,
        touched: u64,
    ) -> u64 {
        let (mut left, mut done) = (touched, 0);
        while left != 0 {
            let at = first_four(left);
            left &= !(0b1111 << at);
            let (Some(pixels), Some(upper), Some(lower)) =
                (pixels[at..].first_chunk_mut::<FOUR>(), upper[at..].first_chunk(), lower[at..].first_chunk())
            else {
                unreachable!("a four ends in its word")
            };
            done |= W::blend::<LOWER>(pixels, [upper, lower], weights, limit, touched >> at) << at;
        }
        done
    }

    #[inline(always)]
    fn are_clear(pixels: &[Self]) -> bool {
        pixels.iter().fold(0, |bits, pixel| bits | bytemuck::cast::<Self, u64>(*pixel)) == 0
    }

    #[inline(always)]
    fn fixed<const N: usize>(pixels: &[Self; N], behind: Vec4) -> [Fixed; N] {
        // From 32767ths to 32640ths.
        const RATIO: i32 = (ONE as i32 * 32768 + UNIT as i32 / 2) / UNIT as i32;
        let times = |a: i16, b: i32| ((i32::from(a) * b + (1 << 14)) >> 15) as i16;
        let behind = fixed(&[behind])[0];
        let mut out = [[0; 4]; N];
        for (out, Short(pixel)) in out.iter_mut().zip(pixels) {
            for n in 0..4 {
                let left = behind[n] - times(behind[n], pixel[3].into());
                out[n] = (times(pixel[n], RATIO) + left).min(ONE);
            }
        }
        out
    }

    fn spare() -> &'static Spare<Self> {
        static SPARE: Spare<Short> = Spare::none();
        &SPARE
    }
}

/// A fraction in units of 1 / `UNIT`.
#[inline(always)]
pub fn short(fraction: f32) -> i16 {
    nearest(fraction.clamp(0.0, 1.0) * f32::from(UNIT))
}

/// The nearest integer. Adding 1.5 * 2^23 leaves it in the low mantissa bits.
#[inline(always)]
pub fn nearest(number: f32) -> i16 {
    (number + 12_582_912.0).to_bits() as i16
}

/// Where the first aligned four of bits begins in which any is set; one is.
#[inline(always)]
pub fn first_four(bits: u64) -> usize {
    const LAST: usize = WORD - FOUR;
    bits.trailing_zeros() as usize & LAST
}

/// [`Pixel::blend`], a pixel at a time. `finish` makes what is blended of a sample at one of the word's pixels.
#[inline(always)]
pub fn one_by_one<P: Pixel, const LOWER: bool>(
    pixels: &mut [P; WORD],
    [upper, lower]: [&[P; WORD + 1]; 2],
    weights: &P::Weights,
    limit: P::Limit,
    mut touched: u64,
    finish: impl Fn(usize, P) -> P,
) -> u64 {
    let mut done = 0;
    while touched != 0 {
        let at = touched.trailing_zeros() as usize % WORD;
        touched &= touched - 1;
        let lower = if LOWER { [lower[at], lower[at + 1]] } else { [P::CLEAR; 2] };
        let sample = P::resample::<LOWER>(weights, [upper[at], upper[at + 1]], lower);
        let pixel = pixels[at].over(finish(at, sample));
        pixels[at] = pixel;
        done |= u64::from(pixel.is_opaque(limit)) << at;
    }
    done
}
