//! Pixels of four 16-bit numbers, four at once: what voxels of a table are shaded, resampled and blended by.
//!
//! Numbers are fractions in units of 1 / [`UNIT`], and products are rounded to the nearest one. A register holds four
//! pixels, where it held two of 32 bits, and all of a step is one instruction for the four. The steps are told twice, as
//! those of [`wide`](super::wide) are: plainly, and in AVX2's own terms, with the same bits.

use super::masks::Masks;
use super::wide::Portable;

/// 1.
pub const UNIT: i16 = i16::MAX;

/// Red, green, blue and opacity, or what is made into them, in units of 1 / [`UNIT`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(8))]
pub struct Short(pub [i16; 4]);

/// Pixels of a register.
pub const FOUR: usize = 4;

/// A light's factor on a colour and its addend, which are at most twice [`UNIT`], in units of 2 / [`UNIT`].
pub type ShortLight = [i16; 2];

/// Weights of the voxel before a pixel and the one after it, of the upper and of the lower scanline.
#[derive(Clone, Copy, Debug)]
pub struct ShortWeights {
    pub upper: [i16; 2],
    pub lower: [i16; 2],
}

/// A way to take four pixels through a step. Implementations are `#[inline(always)]`.
pub trait Shorts: Masks {
    /// Resamples the five voxels around four pixels of the `upper` and, if it is asked for, of the `lower` scanline, and blends what
    /// comes of it behind those pixels that are set in the lowest bits of `touched`. Gives the mask of those that are more opaque than
    /// `limit` then.
    fn blend<const LOWER: bool>(
        pixels: &mut [Short; FOUR],
        rows: [&[Short; FOUR + 1]; 2],
        weights: &ShortWeights,
        limit: i16,
        touched: u64,
    ) -> u64;

    /// Lights premultiplied colours and opacities and leaves them where the lowest bits of `marked` are set; elsewhere is nothing. Those of
    /// which something is left are where they are to be or, if they are `PACKED`, one after the other.
    fn shade<const PACKED: bool>(entries: [Short; FOUR], lights: [ShortLight; FOUR], marked: u64) -> [Short; FOUR];
}

/// The product of two fractions.
#[inline(always)]
fn times(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16
}

impl Short {
    /// Nothing.
    pub const CLEAR: Self = Self([0; 4]);

    /// A part of it.
    #[inline(always)]
    pub fn times(self, part: i16) -> Self {
        Self(self.0.map(|component| times(component, part)))
    }

    /// The sum, at most 1.
    #[inline(always)]
    pub fn plus(self, other: Self) -> Self {
        let mut sum = self;
        for (sum, other) in sum.0.iter_mut().zip(other.0) {
            *sum = sum.saturating_add(other);
        }
        sum
    }

    /// Between two voxels of the upper and two of the lower scanline.
    #[inline(always)]
    pub fn resampled<const LOWER: bool>(weights: &ShortWeights, upper: [Self; 2], lower: [Self; 2]) -> Self {
        let above = upper[0].times(weights.upper[0]).plus(upper[1].times(weights.upper[1]));
        if LOWER { above.plus(lower[0].times(weights.lower[0]).plus(lower[1].times(weights.lower[1]))) } else { above }
    }

    /// Lit, at most as bright as it is opaque.
    #[inline(always)]
    pub fn lit(self, [factor, addend]: ShortLight) -> Self {
        let mut lit = self;
        let opacity = self.0[3];
        for component in &mut lit.0[..3] {
            let half = times(*component, factor).saturating_add(times(opacity, addend));
            *component = half.saturating_add(half).min(opacity);
        }
        lit
    }

    /// A sample behind it.
    #[inline(always)]
    pub fn over(self, sample: Self) -> Self {
        self.plus(sample.times(UNIT - self.0[3]))
    }
}

impl Shorts for Portable {
    #[inline(always)]
    fn blend<const LOWER: bool>(
        pixels: &mut [Short; FOUR],
        [upper, lower]: [&[Short; FOUR + 1]; 2],
        weights: &ShortWeights,
        limit: i16,
        touched: u64,
    ) -> u64 {
        let mut opaque = 0;
        for (n, pixel) in pixels.iter_mut().enumerate() {
            if touched >> n & 1 == 1 {
                let sample = Short::resampled::<LOWER>(weights, [upper[n], upper[n + 1]], [lower[n], lower[n + 1]]);
                *pixel = pixel.over(sample);
            }
            opaque |= u64::from(pixel.0[3] > limit) << n;
        }
        opaque
    }

    #[inline(always)]
    fn shade<const PACKED: bool>(entries: [Short; FOUR], lights: [ShortLight; FOUR], marked: u64) -> [Short; FOUR] {
        let mut shaded = [Short::CLEAR; FOUR];
        let mut next = 0;
        for (n, shaded) in shaded.iter_mut().enumerate() {
            if marked >> n & 1 == 1 {
                let from = if PACKED { next } else { n };
                *shaded = entries[from].lit(lights[from]);
                next += 1;
            }
        }
        shaded
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::super::wide::Avx2;
    use super::*;

    /// What four bits tell of the lanes of four pixels.
    #[repr(C, align(64))]
    struct Lanes {
        /// All of each lane that is set.
        set: [u64; FOUR],
        /// From which lane, told by its 32-bit halves, one after the other comes to each that is set.
        spread: [u32; 2 * FOUR],
    }

    static LANES: [Lanes; 16] = {
        let mut lanes = [const { Lanes { set: [0; FOUR], spread: [0; 2 * FOUR] } }; 16];
        let mut bits = 0;
        while bits < 16 {
            let (mut n, mut next) = (0, 0);
            while n < FOUR {
                if bits >> n & 1 == 1 {
                    lanes[bits].set[n] = u64::MAX;
                    lanes[bits].spread[2 * n] = 2 * next;
                    lanes[bits].spread[2 * n + 1] = 2 * next + 1;
                    next += 1;
                }
                n += 1;
            }
            bits += 1;
        }
        lanes
    };

    // No closures below: they are functions of their own, which are compiled without AVX2.

    /// Each pixel's opacity in all of its components.
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn opacities(pixels: __m256i) -> __m256i {
        // SAFETY: as the caller promises.
        unsafe { _mm256_shufflehi_epi16::<0b11_11_11_11>(_mm256_shufflelo_epi16::<0b11_11_11_11>(pixels)) }
    }

    impl Shorts for Avx2 {
        #[inline(always)]
        fn blend<const LOWER: bool>(
            pixels: &mut [Short; FOUR],
            [upper, lower]: [&[Short; FOUR + 1]; 2],
            weights: &ShortWeights,
            limit: i16,
            touched: u64,
        ) -> u64 {
            // SAFETY: whoever takes this way has found AVX2. Four voxels are read from each row's first and second on, and four
            // pixels are read and written.
            unsafe {
                let (upper, lower) = (upper.as_ptr(), lower.as_ptr());
                let before = _mm256_mulhrs_epi16(_mm256_loadu_si256(upper.cast()), _mm256_set1_epi16(weights.upper[0]));
                let after =
                    _mm256_mulhrs_epi16(_mm256_loadu_si256(upper.add(1).cast()), _mm256_set1_epi16(weights.upper[1]));
                let mut sample = _mm256_adds_epi16(before, after);
                if LOWER {
                    let before =
                        _mm256_mulhrs_epi16(_mm256_loadu_si256(lower.cast()), _mm256_set1_epi16(weights.lower[0]));
                    let after = _mm256_mulhrs_epi16(
                        _mm256_loadu_si256(lower.add(1).cast()),
                        _mm256_set1_epi16(weights.lower[1]),
                    );
                    sample = _mm256_adds_epi16(sample, _mm256_adds_epi16(before, after));
                }
                let front = _mm256_loadu_si256(pixels.as_ptr().cast());
                let through = _mm256_sub_epi16(_mm256_set1_epi16(UNIT), opacities(front));
                let lanes = _mm256_loadu_si256(LANES[touched as usize % 16].set.as_ptr().cast());
                let behind = _mm256_and_si256(_mm256_mulhrs_epi16(sample, through), lanes);
                let blended = _mm256_adds_epi16(front, behind);
                _mm256_storeu_si256(pixels.as_mut_ptr().cast(), blended);
                // The opacity is the upper end of 64 bits.
                let opaque = _mm256_cmpgt_epi16(blended, _mm256_set1_epi16(limit));
                _mm256_movemask_pd(_mm256_castsi256_pd(opaque)) as u64
            }
        }

        #[inline(always)]
        fn shade<const PACKED: bool>(entries: [Short; FOUR], lights: [ShortLight; FOUR], marked: u64) -> [Short; FOUR] {
            // SAFETY: whoever takes this way has found AVX2. Tables have an entry for every four bits.
            unsafe {
                let [a, b, c, d]: [i64; FOUR] = bytemuck::cast(entries);
                let entries = _mm256_setr_epi64x(a, b, c, d);
                let [a, b, c, d]: [i32; FOUR] = bytemuck::cast(lights);
                let lights = _mm256_broadcastsi128_si256(_mm_setr_epi32(a, b, c, d));
                let factor_of_each = _mm256_setr_epi8(
                    0, 1, 0, 1, 0, 1, -1, -1, 4, 5, 4, 5, 4, 5, -1, -1, 8, 9, 8, 9, 8, 9, -1, -1, 12, 13, 12, 13, 12,
                    13, -1, -1,
                );
                let addend_of_each = _mm256_setr_epi8(
                    2, 3, 2, 3, 2, 3, -1, -1, 6, 7, 6, 7, 6, 7, -1, -1, 10, 11, 10, 11, 10, 11, -1, -1, 14, 15, 14, 15,
                    14, 15, -1, -1,
                );
                let opacity = opacities(entries);
                let factored = _mm256_mulhrs_epi16(entries, _mm256_shuffle_epi8(lights, factor_of_each));
                let added = _mm256_mulhrs_epi16(opacity, _mm256_shuffle_epi8(lights, addend_of_each));
                let half = _mm256_adds_epi16(factored, added);
                let lit = _mm256_min_epi16(_mm256_adds_epi16(half, half), opacity);
                let mut shaded = _mm256_blend_epi16::<0b1000_1000>(lit, opacity);
                let lanes = &LANES[marked as usize % 16];
                if PACKED {
                    let spread = _mm256_loadu_si256(lanes.spread.as_ptr().cast());
                    shaded = _mm256_permutevar8x32_epi32(shaded, spread);
                }
                let set = _mm256_loadu_si256(lanes.set.as_ptr().cast());
                let mut out = [Short::CLEAR; FOUR];
                _mm256_storeu_si256(out.as_mut_ptr().cast(), _mm256_and_si256(shaded, set));
                out
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::simd::{Kernel, dispatch};

    #[derive(Clone, Debug)]
    struct Steps {
        pixels: [Short; FOUR],
        rows: [[Short; FOUR + 1]; 2],
        weights: ShortWeights,
        limit: i16,
        touched: u64,
        lights: [ShortLight; FOUR],
    }

    /// What each step makes of it.
    fn results<W: Shorts>(steps: &Steps) -> Vec<(Vec<Short>, u64)> {
        let Steps { pixels, rows: [upper, lower], weights, limit, touched, lights } = steps;
        let rows = [upper, lower];
        let blend = |by: fn(&mut [Short; FOUR], _, &ShortWeights, i16, u64) -> u64| {
            let mut pixels = *pixels;
            let done = by(&mut pixels, rows, weights, *limit, *touched);
            (pixels.to_vec(), done)
        };
        let packed = W::shade::<true>(*pixels, *lights, *touched).to_vec();
        let in_place = W::shade::<false>(*pixels, *lights, *touched).to_vec();
        vec![blend(W::blend::<true>), blend(W::blend::<false>), (packed, 0), (in_place, 0)]
    }

    struct Both<'a>(&'a Steps);

    impl Kernel for Both<'_> {
        type Output = [Vec<(Vec<Short>, u64)>; 2];

        fn run(self) -> Self::Output {
            [(); 2].map(|()| results::<Portable>(self.0))
        }

        #[cfg(target_arch = "x86_64")]
        fn run_avx2(self) -> Self::Output {
            [results::<Portable>(self.0), results::<super::super::wide::Avx2>(self.0)]
        }
    }

    fn pixel() -> impl Strategy<Value = Short> {
        prop::array::uniform4(0..=UNIT).prop_map(Short)
    }

    prop_compose! {
        fn steps()(
            pixels in prop::array::uniform4(pixel()), upper in prop::array::uniform5(pixel()), lower in prop::array::uniform5(pixel()),
            weights in prop::array::uniform4(0..=UNIT), limit in -1..UNIT, touched: u64,
            lights in prop::array::uniform4(prop::array::uniform2(0..=UNIT)),
        ) -> Steps {
            let weights = ShortWeights { upper: [weights[0], weights[1]], lower: [weights[2], weights[3]] };
            Steps { pixels, rows: [upper, lower], weights, limit, touched, lights }
        }
    }

    proptest! {
        #[test]
        fn wide_registers_give_the_same_bits(steps in steps()) {
            let [portable, wide] = dispatch(Both(&steps));
            prop_assert_eq!(portable, wide);
        }

        /// In floating point, to a few units.
        #[test]
        fn shading_is_a_factor_and_an_addend_below_the_opacity(mut entry in pixel(), light in prop::array::uniform2(0..=UNIT)) {
            let unit = f32::from(UNIT);
            let opacity = entry.0[3];
            entry.0 = entry.0.map(|component| component.min(opacity));
            let Short(shaded) = entry.lit(light);
            prop_assert_eq!(shaded[3], opacity);
            let [factor, addend] = light.map(|number| 2.0 * f32::from(number) / unit);
            for (component, lit) in entry.0.into_iter().zip(shaded).take(3) {
                let expected = (f32::from(component) * factor + f32::from(opacity) * addend).min(opacity.into());
                prop_assert!((f32::from(lit) - expected).abs() <= 5.0, "{:?}: {} {}", entry, lit, expected);
            }
        }

        /// One after the other.
        #[test]
        fn shaded_voxels_come_to_where_they_are_marked(steps in steps()) {
            let mut next = 0;
            let packed = Portable::shade::<true>(steps.pixels, steps.lights, steps.touched);
            let in_place = Portable::shade::<false>(steps.pixels, steps.lights, steps.touched);
            for (n, (shaded, in_place)) in packed.into_iter().zip(in_place).enumerate() {
                let is_marked = steps.touched >> n & 1 == 1;
                prop_assert_eq!(shaded, if is_marked { steps.pixels[next].lit(steps.lights[next]) } else { Short::CLEAR });
                prop_assert_eq!(in_place, if is_marked { steps.pixels[n].lit(steps.lights[n]) } else { Short::CLEAR });
                next += usize::from(is_marked);
            }
        }

        /// In floating point, to a few units; what is not touched stays as it is.
        #[test]
        fn blending_is_over(steps in steps()) {
            let Steps { pixels, rows: [upper, lower], weights, limit, touched, .. } = &steps;
            let unit = f32::from(UNIT);
            let mut blended = *pixels;
            let done = Portable::blend::<true>(&mut blended, [upper, lower], weights, *limit, *touched);
            for n in 0..FOUR {
                let before = pixels[n].0;
                prop_assert_eq!(done >> n & 1 == 1, blended[n].0[3] > *limit);
                for c in 0..4 {
                    let around = [(upper[n], weights.upper[0]), (upper[n + 1], weights.upper[1]), (lower[n], weights.lower[0]),
                        (lower[n + 1], weights.lower[1])];
                    let sample: f32 = around.iter().map(|(voxel, weight)| f32::from(voxel.0[c]) * f32::from(*weight) / unit).sum();
                    let behind = sample.min(unit) * (unit - f32::from(before[3])) / unit;
                    let expected = if touched >> n & 1 == 0 { before[c].into() } else { (f32::from(before[c]) + behind).min(unit) };
                    prop_assert!((f32::from(blended[n].0[c]) - expected).abs() <= 5.0, "{} {}", blended[n].0[c], expected);
                }
            }
        }
    }
}
