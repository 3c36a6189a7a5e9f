//! Eight pixels of the final image at once: bilinear interpolation in fixed point.

#[cfg(target_arch = "x86_64")]
use crate::render::intermediate::Fixed;
use crate::render::intermediate::{IntermediateImage, ONE, ONE_SHIFT};

/// Pixels that are placed at once.
pub const LANES: usize = 8;

/// Fractional bits of a position: its 32 bits reach as far as an intermediate image.
pub const FRACTION_BITS: u32 = 15;

/// Bits of a weight. The four of a pixel add up to 2^14.
const WEIGHT_BITS: u32 = 14;

/// Positions along u and v.
pub type Positions = [[i32; LANES]; 2];

/// A way to write the pixels at eight positions.
pub trait Lanes {
    /// Bytes of a pixel.
    const CHANNELS: usize;

    /// Writes as many pixels as `out` has room for, from lane `first` on. Positions may be anywhere from 0 on;
    /// those outside of the image give some pixel of it. Implementations are `#[inline(always)]`.
    fn write(image: &IntermediateImage, positions: Positions, first: usize, out: &mut [u8]);

    /// Writes all eight. Implementations are `#[inline(always)]`.
    fn write_all(image: &IntermediateImage, positions: Positions, out: &mut [u8]);
}

/// A way to interpolate eight pixels to red, green and blue.
pub trait Bytes {
    /// Implementations are `#[inline(always)]`.
    fn bytes(image: &IntermediateImage, positions: Positions) -> [u8; 3 * LANES];
}

/// Pixels over an opaque background: red, green, blue.
pub struct Rgb<B>(B);

/// Straight alpha.
pub struct Rgba;

/// In plain code.
pub struct Portable;

/// In AVX2's own terms: two pixels a register. Only for code that is compiled for it.
#[cfg(target_arch = "x86_64")]
pub struct Avx2;

impl<B: Bytes> Lanes for Rgb<B> {
    const CHANNELS: usize = 3;

    #[inline(always)]
    fn write(image: &IntermediateImage, positions: Positions, first: usize, out: &mut [u8]) {
        out.copy_from_slice(&B::bytes(image, positions)[first * 3..][..out.len()]);
    }

    #[inline(always)]
    fn write_all(image: &IntermediateImage, positions: Positions, out: &mut [u8]) {
        *out.first_chunk_mut().expect("room for eight") = B::bytes(image, positions);
    }
}

impl Lanes for Rgba {
    const CHANNELS: usize = 4;

    #[inline(always)]
    fn write(image: &IntermediateImage, positions: Positions, first: usize, out: &mut [u8]) {
        let placed = Placed::new(image, positions);
        for (out, lane) in out.chunks_exact_mut(4).zip(first..LANES) {
            let sum = placed.sum(image, lane).map(|sum| sum as f32 * (1.0 / (1 << WEIGHT_BITS) as f32));
            let alpha = sum[3];
            let scale = if alpha > 0.0 { 255.0 / alpha } else { 0.0 };
            let [r, g, b] = [sum[0], sum[1], sum[2]].map(|color| (color * scale).min(255.0));
            let bytes = [r, g, b, alpha * (255.0 / f32::from(ONE))].map(|c| (c + 8_388_608.0).to_bits() as u8);
            out.copy_from_slice(&bytes);
        }
    }

    #[inline(always)]
    fn write_all(image: &IntermediateImage, positions: Positions, out: &mut [u8]) {
        Self::write(image, positions, 0, out);
    }
}

impl Bytes for Portable {
    #[inline(always)]
    fn bytes(image: &IntermediateImage, positions: Positions) -> [u8; 3 * LANES] {
        let placed = Placed::new(image, positions);
        let mut bytes = [0; 3 * LANES];
        for (lane, out) in bytes.chunks_exact_mut(3).enumerate() {
            let sum = placed.sum(image, lane);
            for (out, sum) in out.iter_mut().zip(sum) {
                *out = ((sum + ROUND) >> SHIFT) as u8;
            }
        }
        bytes
    }
}

/// From weighted sums to steps of 8 bits.
const SHIFT: u32 = WEIGHT_BITS + ONE_SHIFT;
const ROUND: i32 = 1 << (SHIFT - 1);

/// Where the upper left one of the four pixels around each position is, and their weights.
struct Placed {
    at: [u32; LANES],
    /// Upper left and right, lower left and right.
    weights: [[i32; LANES]; 4],
}

impl Placed {
    #[inline(always)]
    fn new(image: &IntermediateImage, [us, vs]: Positions) -> Self {
        let stride = image.size()[0] as i32;
        let last = last(image);
        let (mut at, mut weights) = ([0; LANES], [[0; LANES]; 4]);
        for lane in 0..LANES {
            let (u, v) = (us[lane] >> FRACTION_BITS, vs[lane] >> FRACTION_BITS);
            at[lane] = (v.wrapping_mul(stride).wrapping_add(u) as u32).min(last);
            let [u, v] = [us, vs].map(|positions| positions[lane] & ((1 << FRACTION_BITS) - 1));
            let both = (u * v) >> (2 * FRACTION_BITS - WEIGHT_BITS);
            let [u, v] = [u, v].map(|fraction| fraction >> (FRACTION_BITS - WEIGHT_BITS));
            weights[0][lane] = (1 << WEIGHT_BITS) - u - v + both;
            weights[1][lane] = u - both;
            weights[2][lane] = v - both;
            weights[3][lane] = both;
        }
        Self { at, weights }
    }

    /// The weighted sum of a lane's four pixels.
    #[inline(always)]
    fn sum(&self, image: &IntermediateImage, lane: usize) -> [i32; 4] {
        let stride = image.size()[0];
        // From the upper two pixels to the lower two: one look at the bounds for all.
        let around = &image.pixels()[self.at[lane] as usize..][..stride + 2];
        let four = [around[0], around[1], around[stride], around[stride + 1]];
        let mut sum = [0; 4];
        for (pixel, weights) in four.iter().zip(&self.weights) {
            for (sum, component) in sum.iter_mut().zip(pixel) {
                *sum += i32::from(*component) * weights[lane];
            }
        }
        sum
    }
}

/// The last pixel that has neighbours at its right and below.
#[inline(always)]
fn last(image: &IntermediateImage) -> u32 {
    (image.pixels().len() - image.size()[0] - 2) as u32
}

#[cfg(target_arch = "x86_64")]
impl Bytes for Avx2 {
    #[inline(always)]
    fn bytes(image: &IntermediateImage, [us, vs]: Positions) -> [u8; 3 * LANES] {
        use std::arch::x86_64::*;

        const { assert!(size_of::<Fixed>() == 8 && FRACTION_BITS == 15 && WEIGHT_BITS == 14) }
        let stride = image.size()[0];
        let last = last(image);
        let pixels = image.pixels().as_ptr();
        // SAFETY: whoever takes this way has found AVX2. Pixels are read at `at` and at `at + stride`, two each,
        // and `at` is at most `last`, which has a scanline and two pixels from itself on.
        unsafe {
            let (us, vs): (__m256i, __m256i) = (bytemuck::cast(us), bytemuck::cast(vs));
            let rows = _mm256_mullo_epi32(_mm256_srai_epi32::<15>(vs), _mm256_set1_epi32(stride as i32));
            let at = _mm256_add_epi32(rows, _mm256_srai_epi32::<15>(us));
            let at: [u32; LANES] = bytemuck::cast(_mm256_min_epu32(at, _mm256_set1_epi32(last as i32)));

            // Weights of the upper and the lower pixel in the halves of 32 bits, on the left and on the right.
            let fraction = _mm256_set1_epi32((1 << 15) - 1);
            let (u, v) = (_mm256_and_si256(us, fraction), _mm256_and_si256(vs, fraction));
            let both = _mm256_mulhi_epu16(u, v);
            let (u, v) = (_mm256_srli_epi32::<1>(u), _mm256_srli_epi32::<1>(v));
            let upper_right = _mm256_sub_epi32(u, both);
            let lower_left = _mm256_sub_epi32(v, both);
            let upper_left = _mm256_sub_epi32(_mm256_sub_epi32(_mm256_set1_epi32(1 << 14), u), lower_left);
            let left = _mm256_or_si256(upper_left, _mm256_slli_epi32::<16>(lower_left));
            let right = _mm256_or_si256(upper_right, _mm256_slli_epi32::<16>(both));

            /// The sums of pixels `$lane` and `$lane + 4`.
            macro_rules! pair {
                ($lane:literal) => {{
                    let (low, high) = (pixels.add(at[$lane] as usize), pixels.add(at[$lane + 4] as usize));
                    let upper = _mm256_loadu2_m128i(high.cast(), low.cast());
                    let lower = _mm256_loadu2_m128i(high.add(stride).cast(), low.add(stride).cast());
                    let on_left = _mm256_shuffle_epi32::<{ $lane * 0b01_01_01_01 }>(left);
                    let on_right = _mm256_shuffle_epi32::<{ $lane * 0b01_01_01_01 }>(right);
                    let sum = _mm256_add_epi32(
                        _mm256_madd_epi16(_mm256_unpacklo_epi16(upper, lower), on_left),
                        _mm256_madd_epi16(_mm256_unpackhi_epi16(upper, lower), on_right),
                    );
                    _mm256_srai_epi32::<{ SHIFT as i32 }>(_mm256_add_epi32(sum, _mm256_set1_epi32(ROUND)))
                }};
            }
            let first = _mm256_packs_epi32(pair!(0), pair!(1));
            let second = _mm256_packs_epi32(pair!(2), pair!(3));
            let bytes = _mm256_packus_epi16(first, second);
            // Every fourth byte is left out: twelve of each half, moved together.
            let rgb = _mm256_setr_epi8(
                0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1, 0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1,
                -1, -1,
            );
            let together = _mm256_setr_epi32(0, 1, 2, 4, 5, 6, 3, 7);
            let bytes = _mm256_permutevar8x32_epi32(_mm256_shuffle_epi8(bytes, rgb), together);
            let bytes: [u8; 32] = bytemuck::cast(bytes);
            *bytes.first_chunk().expect("24 of 32")
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec4;
    use proptest::prelude::*;

    use super::*;
    use crate::render::intermediate::BandBuffer;
    use crate::render::simd::{Kernel, dispatch};

    /// An image of pixels of noise.
    fn noise() -> IntermediateImage {
        let mut image = IntermediateImage::new([37, 29], Vec4::new(0.2, 0.5, 1.0, 1.0));
        image.strips(1).for_each(|strip| {
            let mut buffer = BandBuffer::<Vec4>::default();
            let mut band = strip.open(&mut buffer);
            let mut state = band.first as u32;
            for pixel in band.scanline(0).pixels {
                let mut number = || {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 8) as f32 / (1 << 24) as f32
                };
                let alpha = number();
                *pixel = Vec4::new(number() * alpha, number() * alpha, number() * alpha, alpha);
            }
            strip.close(&mut buffer);
        });
        image
    }

    struct Both<'a>(&'a IntermediateImage, Positions);

    impl Kernel for Both<'_> {
        type Output = [[u8; 3 * LANES]; 2];

        fn run(self) -> Self::Output {
            [Portable::bytes(self.0, self.1); 2]
        }

        #[cfg(target_arch = "x86_64")]
        fn run_avx2(self) -> Self::Output {
            [Portable::bytes(self.0, self.1), Avx2::bytes(self.0, self.1)]
        }
    }

    proptest! {
        #[test]
        fn wide_registers_give_the_same_bytes(
            us in any::<[i32; LANES]>(),
            vs in any::<[i32; LANES]>(),
            inside in any::<bool>(),
        ) {
            let image = noise();
            let within = |positions: [i32; LANES], size: i32| {
                positions.map(|at| if inside { at.rem_euclid(size << FRACTION_BITS) } else { at.max(0) })
            };
            let [portable, wide] = dispatch(Both(&image, [within(us, 36), within(vs, 28)]));
            prop_assert_eq!(portable, wide);
        }
    }
}
