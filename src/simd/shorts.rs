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

/// Entries along either side of a table of slabs, the last one twice: positions have eight bits before the point.
pub const SLAB_ENTRIES: usize = 257;

/// Bits of a position on the axis of a table of slabs behind the point.
pub const POSITION_BITS: u32 = 7;

/// Slabs by `front * SLAB_ENTRIES + back`: premultiplied colour and opacity.
pub type ShortSlabs = [Short; SLAB_ENTRIES * SLAB_ENTRIES];

/// Components of a [`Short`] that is a sample of what slabs are told by: a light and a position on the axis of a table of slabs. Before it is looked up on that
/// axis the latter is a scalar.
pub const FACTOR: usize = 0;
/// See [`FACTOR`].
pub const ADDEND: usize = 1;
/// See [`FACTOR`].
pub const POSITION: usize = 2;

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

    /// Samples of four voxels: their lights, and their scalars, which are a power of two for each code above a first one.
    fn voxels(codes: [u16; FOUR], lights: [ShortLight; FOUR], scalars: Scalars, out: &mut [Short; FOUR]);

    /// Between the five numbers around four pixels of the upper and of the lower scanline, `fractions` along them and down: `a + (b - a) f`, so that
    /// what lies between equal numbers is equal.
    fn between(rows: [&[Short; FOUR + 1]; 2], fractions: [i16; 2], out: &mut [Short; FOUR]);

    /// Puts positions in place of scalars.
    fn place(samples: &mut [Short; FOUR], positions: &Positions);

    /// Looks up the slabs between four samples in front and four behind: between the four entries around two positions, and with `LIT` lit by the mean of two
    /// lights. Blends them behind those pixels that are set in the lowest bits of `touched`. Gives the mask of those that are more opaque than
    /// `limit` then.
    fn blend_slabs<const LIT: bool>(
        table: &ShortSlabs,
        samples: [&[Short; FOUR]; 2],
        pixels: &mut [Short; FOUR],
        limit: i16,
        touched: u64,
    ) -> u64;
}

/// Scalars of fifteen bits by code.
#[derive(Clone, Copy, Debug)]
pub struct Scalars {
    /// The code of scalar 0.
    pub first_code: u16,
    /// From a code to the next there are so many scalars, as a power of two.
    pub shift: u32,
}

impl Scalars {
    /// The scalar of a code.
    #[inline(always)]
    pub fn of(self, code: u16) -> i16 {
        (code.wrapping_sub(self.first_code) << self.shift) as i16
    }
}

/// Positions on the axis of a table by scalar of fifteen bits.
pub type Positions = [i16; 1 << 15];

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

    /// A part of the way to another.
    #[inline(always)]
    pub fn towards(self, other: Self, part: i16) -> Self {
        let mut between = self;
        for (a, b) in between.0.iter_mut().zip(other.0) {
            *a += times(b - *a, part);
        }
        between
    }

    /// Between two of the upper and two of the lower scanline: first down, then along.
    #[inline(always)]
    pub fn between(upper: [Self; 2], lower: [Self; 2], [along, down]: [i16; 2]) -> Self {
        upper[0].towards(lower[0], down).towards(upper[1].towards(lower[1], down), along)
    }

    /// With the position in place of the scalar.
    #[inline(always)]
    pub fn placed(mut self, positions: &Positions) -> Self {
        self.0[POSITION] = positions[self.0[POSITION] as usize % positions.len()];
        self
    }

    /// The slab between this sample and the one behind it.
    #[inline(always)]
    pub fn slab<const LIT: bool>(self, table: &ShortSlabs, back: Self) -> Self {
        let position = |sample: Self| {
            let position = sample.0[POSITION] as u16;
            let below = (1 << POSITION_BITS) - 1;
            (
                usize::from(position >> POSITION_BITS) % (SLAB_ENTRIES - 1),
                ((position & below) << (15 - POSITION_BITS)) as i16,
            )
        };
        let ((front_entry, front_part), (back_entry, back_part)) = (position(self), position(back));
        let at = front_entry * SLAB_ENTRIES + back_entry;
        let near = table[at].towards(table[at + SLAB_ENTRIES], front_part);
        let far = table[at + 1].towards(table[at + SLAB_ENTRIES + 1], front_part);
        let slab = near.towards(far, back_part);
        if LIT {
            slab.lit([FACTOR, ADDEND].map(|n| ((i32::from(self.0[n]) + i32::from(back.0[n]) + 1) >> 1) as i16))
        } else {
            slab
        }
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
        let mut samples = [Short::CLEAR; FOUR];
        for (n, sample) in samples.iter_mut().enumerate() {
            *sample = Short::resampled::<LOWER>(weights, [upper[n], upper[n + 1]], [lower[n], lower[n + 1]]);
        }
        over(pixels, samples, limit, touched)
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

    #[inline(always)]
    fn voxels(codes: [u16; FOUR], lights: [ShortLight; FOUR], scalars: Scalars, out: &mut [Short; FOUR]) {
        for n in 0..FOUR {
            let [factor, addend] = lights[n];
            out[n] = Short([factor, addend, scalars.of(codes[n]), 0]);
        }
    }

    #[inline(always)]
    fn between([upper, lower]: [&[Short; FOUR + 1]; 2], fractions: [i16; 2], out: &mut [Short; FOUR]) {
        for (n, out) in out.iter_mut().enumerate() {
            *out = Short::between([upper[n], upper[n + 1]], [lower[n], lower[n + 1]], fractions);
        }
    }

    #[inline(always)]
    fn place(samples: &mut [Short; FOUR], positions: &Positions) {
        for sample in samples {
            *sample = sample.placed(positions);
        }
    }

    #[inline(always)]
    fn blend_slabs<const LIT: bool>(
        table: &ShortSlabs,
        [front, back]: [&[Short; FOUR]; 2],
        pixels: &mut [Short; FOUR],
        limit: i16,
        touched: u64,
    ) -> u64 {
        let mut slabs = [Short::CLEAR; FOUR];
        for n in 0..FOUR {
            slabs[n] = front[n].slab::<LIT>(table, back[n]);
        }
        over(pixels, slabs, limit, touched)
    }
}

/// Blends samples behind those pixels that are touched; gives which are opaque.
#[inline(always)]
fn over(pixels: &mut [Short; FOUR], samples: [Short; FOUR], limit: i16, touched: u64) -> u64 {
    let mut opaque = 0;
    for (n, (pixel, sample)) in pixels.iter_mut().zip(samples).enumerate() {
        if touched >> n & 1 == 1 {
            *pixel = pixel.over(sample);
        }
        opaque |= u64::from(pixel.0[3] > limit) << n;
    }
    opaque
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

    /// `a + (b - a) part`.
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn towards(a: __m256i, b: __m256i, part: __m256i) -> __m256i {
        // SAFETY: as the caller promises.
        unsafe { _mm256_add_epi16(a, _mm256_mulhrs_epi16(_mm256_sub_epi16(b, a), part)) }
    }

    /// Premultiplied colours lit, where each component has a factor and an addend (those of opacities do not count).
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn lit(pixels: __m256i, factors: __m256i, addends: __m256i) -> __m256i {
        // SAFETY: as the caller promises.
        unsafe {
            let opacity = opacities(pixels);
            let half = _mm256_adds_epi16(_mm256_mulhrs_epi16(pixels, factors), _mm256_mulhrs_epi16(opacity, addends));
            let lit = _mm256_min_epi16(_mm256_adds_epi16(half, half), opacity);
            _mm256_blend_epi16::<0b1000_1000>(lit, opacity)
        }
    }

    /// Blends samples behind pixels: [`Shorts::over`].
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn over(pixels: &mut [Short; FOUR], samples: __m256i, limit: i16, touched: u64) -> u64 {
        // SAFETY: as the caller promises. Four pixels are read and written, and a table has an entry for every four bits.
        unsafe {
            let front = _mm256_loadu_si256(pixels.as_ptr().cast());
            let through = _mm256_sub_epi16(_mm256_set1_epi16(UNIT), opacities(front));
            let lanes = _mm256_loadu_si256(LANES[touched as usize % 16].set.as_ptr().cast());
            let behind = _mm256_and_si256(_mm256_mulhrs_epi16(samples, through), lanes);
            let blended = _mm256_adds_epi16(front, behind);
            _mm256_storeu_si256(pixels.as_mut_ptr().cast(), blended);
            // The opacity is the upper end of 64 bits.
            let opaque = _mm256_cmpgt_epi16(blended, _mm256_set1_epi16(limit));
            _mm256_movemask_pd(_mm256_castsi256_pd(opaque)) as u64
        }
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
            // SAFETY: whoever takes this way has found AVX2. Four voxels are read from each row's first and second on.
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
                over(pixels, sample, limit, touched)
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
                let [factors, addends] =
                    [_mm256_shuffle_epi8(lights, factor_of_each), _mm256_shuffle_epi8(lights, addend_of_each)];
                let mut shaded = lit(entries, factors, addends);
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

        #[inline(always)]
        fn voxels(codes: [u16; FOUR], lights: [ShortLight; FOUR], scalars: Scalars, out: &mut [Short; FOUR]) {
            const _: () = assert!(POSITION == 2 && FACTOR == 0 && ADDEND == 1);
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let codes = _mm_cvtsi64_si128(bytemuck::cast(codes));
                let above = _mm_sub_epi16(codes, _mm_set1_epi16(scalars.first_code as i16));
                let scalars = _mm_cvtepu16_epi32(_mm_sll_epi16(above, _mm_cvtsi32_si128(scalars.shift as i32)));
                let [a, b, c, d]: [i32; FOUR] = bytemuck::cast(lights);
                let lights = _mm_setr_epi32(a, b, c, d);
                let out = out.as_mut_ptr();
                _mm_storeu_si128(out.cast(), _mm_unpacklo_epi32(lights, scalars));
                _mm_storeu_si128(out.add(2).cast(), _mm_unpackhi_epi32(lights, scalars));
            }
        }

        #[inline(always)]
        fn place(samples: &mut [Short; FOUR], positions: &Positions) {
            const _: () = assert!(POSITION == 2);
            // SAFETY: whoever takes this way has found AVX2. There is a position for any fifteen bits.
            unsafe {
                let all = _mm256_loadu_si256(samples.as_ptr().cast());
                let scalars = _mm256_and_si256(_mm256_srli_epi64::<32>(all), _mm256_set1_epi64x(0x7fff));
                let (lower, upper) = (_mm256_castsi256_si128(scalars), _mm256_extracti128_si256::<1>(scalars));
                let positions = positions.as_ptr();
                let [a, b, c, d] = [
                    i64::from(*positions.add(_mm_cvtsi128_si64(lower) as usize)),
                    i64::from(*positions.add(_mm_extract_epi64::<1>(lower) as usize)),
                    i64::from(*positions.add(_mm_cvtsi128_si64(upper) as usize)),
                    i64::from(*positions.add(_mm_extract_epi64::<1>(upper) as usize)),
                ];
                let placed = _mm256_slli_epi64::<32>(_mm256_setr_epi64x(a, b, c, d));
                _mm256_storeu_si256(samples.as_mut_ptr().cast(), _mm256_blend_epi16::<0b0100_0100>(all, placed));
            }
        }

        #[inline(always)]
        fn between([upper, lower]: [&[Short; FOUR + 1]; 2], [along, down]: [i16; 2], out: &mut [Short; FOUR]) {
            // SAFETY: whoever takes this way has found AVX2. Four are read from each row's first and second on.
            unsafe {
                let (upper, lower) = (upper.as_ptr(), lower.as_ptr());
                let [along, down] = [_mm256_set1_epi16(along), _mm256_set1_epi16(down)];
                let before = towards(_mm256_loadu_si256(upper.cast()), _mm256_loadu_si256(lower.cast()), down);
                let after =
                    towards(_mm256_loadu_si256(upper.add(1).cast()), _mm256_loadu_si256(lower.add(1).cast()), down);
                _mm256_storeu_si256(out.as_mut_ptr().cast(), towards(before, after, along));
            }
        }

        #[inline(always)]
        fn blend_slabs<const LIT: bool>(
            table: &ShortSlabs,
            [front, back]: [&[Short; FOUR]; 2],
            pixels: &mut [Short; FOUR],
            limit: i16,
            touched: u64,
        ) -> u64 {
            const STRIDE: i64 = SLAB_ENTRIES as i64;
            const _: () = assert!(STRIDE == 257 && POSITION == 2 && POSITION_BITS == 7 && FACTOR == 0 && ADDEND == 1);
            // SAFETY: whoever takes this way has found AVX2. Of a position's sixteen bits eight are an entry, so that an entry and the
            // one after it are there in the row of either.
            unsafe {
                let (front, back) =
                    (_mm256_loadu_si256(front.as_ptr().cast()), _mm256_loadu_si256(back.as_ptr().cast()));
                let entry = _mm256_set1_epi64x(255);
                let [rows, columns] = [
                    _mm256_and_si256(_mm256_srli_epi64::<{ 32 + POSITION_BITS as i32 }>(front), entry),
                    _mm256_and_si256(_mm256_srli_epi64::<{ 32 + POSITION_BITS as i32 }>(back), entry),
                ];
                let at = _mm256_add_epi64(_mm256_add_epi64(rows, columns), _mm256_slli_epi64::<8>(rows));
                let (lower, upper) = (_mm256_castsi256_si128(at), _mm256_extracti128_si256::<1>(at));
                let slabs = table.as_ptr();
                let [a, b, c, d] = [
                    slabs.add(_mm_cvtsi128_si64(lower) as usize),
                    slabs.add(_mm_extract_epi64::<1>(lower) as usize),
                    slabs.add(_mm_cvtsi128_si64(upper) as usize),
                    slabs.add(_mm_extract_epi64::<1>(upper) as usize),
                ];
                // An entry and the next one of two slabs: the first and the third, the second and the fourth.
                let first = _mm256_loadu2_m128i(c.cast(), a.cast());
                let second = _mm256_loadu2_m128i(d.cast(), b.cast());
                let first_far = _mm256_loadu2_m128i(c.add(SLAB_ENTRIES).cast(), a.add(SLAB_ENTRIES).cast());
                let second_far = _mm256_loadu2_m128i(d.add(SLAB_ENTRIES).cast(), b.add(SLAB_ENTRIES).cast());
                // What of a position is behind the point becomes the upper end of fifteen bits.
                let fraction = _mm256_set1_epi16(UNIT);
                let of_first = _mm256_set1_epi16(0x04_80);
                let of_second = _mm256_set1_epi16(0x0c_80);
                let of_each = _mm256_setr_epi64x(
                    0x0480_0480_0480_0480,
                    0x0c80_0c80_0c80_0c80,
                    0x0480_0480_0480_0480,
                    0x0c80_0c80_0c80_0c80,
                );
                let first_part = _mm256_and_si256(_mm256_shuffle_epi8(front, of_first), fraction);
                let second_part = _mm256_and_si256(_mm256_shuffle_epi8(front, of_second), fraction);
                let part = _mm256_and_si256(_mm256_shuffle_epi8(back, of_each), fraction);
                let first = towards(first, first_far, first_part);
                let second = towards(second, second_far, second_part);
                let mut slabs =
                    towards(_mm256_unpacklo_epi64(first, second), _mm256_unpackhi_epi64(first, second), part);
                if LIT {
                    let light = _mm256_avg_epu16(front, back);
                    let factor_of_each = _mm256_setr_epi8(
                        0, 1, 0, 1, 0, 1, -1, -1, 8, 9, 8, 9, 8, 9, -1, -1, 0, 1, 0, 1, 0, 1, -1, -1, 8, 9, 8, 9, 8, 9,
                        -1, -1,
                    );
                    let addend_of_each = _mm256_setr_epi8(
                        2, 3, 2, 3, 2, 3, -1, -1, 10, 11, 10, 11, 10, 11, -1, -1, 2, 3, 2, 3, 2, 3, -1, -1, 10, 11, 10,
                        11, 10, 11, -1, -1,
                    );
                    slabs = lit(
                        slabs,
                        _mm256_shuffle_epi8(light, factor_of_each),
                        _mm256_shuffle_epi8(light, addend_of_each),
                    );
                }
                over(pixels, slabs, limit, touched)
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

    /// Any slabs.
    fn table() -> &'static ShortSlabs {
        static TABLE: std::sync::LazyLock<Box<ShortSlabs>> = std::sync::LazyLock::new(|| {
            let number = |n: u64| (n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 49) as i16;
            let slabs: Vec<Short> = (0..(SLAB_ENTRIES * SLAB_ENTRIES) as u64)
                .map(|n| Short([0, 1, 2, 3].map(|c| number(4 * n + c))))
                .collect();
            slabs.try_into().expect("as many as there are entries")
        });
        &TABLE
    }

    /// Any positions.
    fn positions() -> &'static Positions {
        static POSITIONS: std::sync::LazyLock<Box<Positions>> = std::sync::LazyLock::new(|| {
            let positions: Vec<i16> = (0..1 << 15).map(|n: i32| (n * 7919 % 32749) as i16).collect();
            positions.try_into().expect("as many as there are scalars")
        });
        &POSITIONS
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
        let mut between = [Short::CLEAR; FOUR];
        W::between(rows, weights.upper, &mut between);
        let mut placed = between;
        W::place(&mut placed, positions());
        let mut voxels = *pixels;
        let scalars = Scalars { first_code: lights[0][0] as u16, shift: touched.trailing_zeros() % 8 };
        W::voxels([0, 1, 2, 3].map(|n| lights[n][1] as u16), *lights, scalars, &mut voxels);
        let samples = rows.map(|row| row.first_chunk().expect("five numbers"));
        let (mut lit, mut unlit) = (*pixels, *pixels);
        let done = [
            W::blend_slabs::<true>(table(), samples, &mut lit, *limit, *touched),
            W::blend_slabs::<false>(table(), samples, &mut unlit, *limit, *touched),
        ];
        let looked_up = [(between, 0), (placed, 0), (voxels, 0), (lit, done[0]), (unlit, done[1])];
        let looked_up = looked_up.map(|(samples, done)| (samples.to_vec(), done));
        [blend(W::blend::<true>), blend(W::blend::<false>), (packed, 0), (in_place, 0)]
            .into_iter()
            .chain(looked_up)
            .collect()
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

        /// In floating point, to a few units; and of equal numbers it is theirs, whatever the fractions.
        #[test]
        fn what_is_between_is_interpolated(steps in steps(), same in pixel()) {
            let Steps { rows: [upper, lower], weights, .. } = &steps;
            let fractions = weights.upper;
            let unit = 32768.0;
            let [along, down] = fractions.map(|fraction| f32::from(fraction) / unit);
            let mut between = [Short::CLEAR; FOUR];
            Portable::between([&[same; FOUR + 1]; 2], fractions, &mut between);
            prop_assert_eq!(between, [same; FOUR]);
            Portable::between([upper, lower], fractions, &mut between);
            for (n, got) in between.into_iter().enumerate() {
                for c in 0..4 {
                    let number = |row: &[Short; FOUR + 1], n: usize| f32::from(row[n].0[c]);
                    let column = |n: usize| number(upper, n) + (number(lower, n) - number(upper, n)) * down;
                    let expected = column(n) + (column(n + 1) - column(n)) * along;
                    prop_assert!((f32::from(got.0[c]) - expected).abs() <= 1.5, "{} {}", got.0[c], expected);
                }
            }
        }

        /// In floating point, to a few units.
        #[test]
        fn slabs_are_between_four_entries(front in pixel(), back in pixel()) {
            let [(row, front_part), (column, back_part)] = [front, back].map(|sample| {
                let position = sample.0[POSITION] as usize;
                (position / 128, (position % 128) as f32 / 128.0)
            });
            let got = front.slab::<false>(table(), back);
            for c in 0..4 {
                let entry = |row: usize, column: usize| f32::from(table()[row * SLAB_ENTRIES + column].0[c]);
                let across = |column: usize| entry(row, column) * (1.0 - front_part) + entry(row + 1, column) * front_part;
                let expected = across(column) * (1.0 - back_part) + across(column + 1) * back_part;
                prop_assert!((f32::from(got.0[c]) - expected).abs() <= 1.5, "{} {}", got.0[c], expected);
            }
            let mean = [FACTOR, ADDEND].map(|n| (front.0[n] as u16 + back.0[n] as u16).div_ceil(2) as i16);
            prop_assert_eq!(front.slab::<true>(table(), back), got.lit(mean));
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
