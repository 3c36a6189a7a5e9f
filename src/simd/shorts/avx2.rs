//! The steps in AVX2's own terms.

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

/// What the plain [`over`](super::over) does.
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
                let before = _mm256_mulhrs_epi16(_mm256_loadu_si256(lower.cast()), _mm256_set1_epi16(weights.lower[0]));
                let after =
                    _mm256_mulhrs_epi16(_mm256_loadu_si256(lower.add(1).cast()), _mm256_set1_epi16(weights.lower[1]));
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
                0, 1, 0, 1, 0, 1, -1, -1, 4, 5, 4, 5, 4, 5, -1, -1, 8, 9, 8, 9, 8, 9, -1, -1, 12, 13, 12, 13, 12, 13,
                -1, -1,
            );
            let addend_of_each = _mm256_setr_epi8(
                2, 3, 2, 3, 2, 3, -1, -1, 6, 7, 6, 7, 6, 7, -1, -1, 10, 11, 10, 11, 10, 11, -1, -1, 14, 15, 14, 15, 14,
                15, -1, -1,
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
    fn darken(lights: [ShortLight; FOUR], in_shadow: [ShortLight; FOUR], lacking: [u8; FOUR]) -> [ShortLight; FOUR] {
        // SAFETY: whoever takes this way has found AVX2.
        unsafe {
            let [a, b, c, d]: [i32; FOUR] = bytemuck::cast(lights);
            let lights = _mm_setr_epi32(a, b, c, d);
            let [a, b, c, d]: [i32; FOUR] = bytemuck::cast(in_shadow);
            let in_shadow = _mm_setr_epi32(a, b, c, d);
            let lacking = _mm_cvtepu8_epi16(_mm_cvtsi32_si128(i32::from_le_bytes(lacking)));
            let lacking = _mm_unpacklo_epi16(lacking, lacking);
            let part = _mm_or_si128(_mm_slli_epi16::<7>(lacking), _mm_srli_epi16::<1>(lacking));
            let darkened = _mm_add_epi16(lights, _mm_mulhrs_epi16(_mm_sub_epi16(in_shadow, lights), part));
            let mut out = [[0; 2]; FOUR];
            _mm_storeu_si128(out.as_mut_ptr().cast(), darkened);
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
            let after = towards(_mm256_loadu_si256(upper.add(1).cast()), _mm256_loadu_si256(lower.add(1).cast()), down);
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
            let (front, back) = (_mm256_loadu_si256(front.as_ptr().cast()), _mm256_loadu_si256(back.as_ptr().cast()));
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
            let mut slabs = towards(_mm256_unpacklo_epi64(first, second), _mm256_unpackhi_epi64(first, second), part);
            if LIT {
                let light = _mm256_avg_epu16(front, back);
                let factor_of_each = _mm256_setr_epi8(
                    0, 1, 0, 1, 0, 1, -1, -1, 8, 9, 8, 9, 8, 9, -1, -1, 0, 1, 0, 1, 0, 1, -1, -1, 8, 9, 8, 9, 8, 9, -1,
                    -1,
                );
                let addend_of_each = _mm256_setr_epi8(
                    2, 3, 2, 3, 2, 3, -1, -1, 10, 11, 10, 11, 10, 11, -1, -1, 2, 3, 2, 3, 2, 3, -1, -1, 10, 11, 10, 11,
                    10, 11, -1, -1,
                );
                slabs =
                    lit(slabs, _mm256_shuffle_epi8(light, factor_of_each), _mm256_shuffle_epi8(light, addend_of_each));
            }
            over(pixels, slabs, limit, touched)
        }
    }
}
