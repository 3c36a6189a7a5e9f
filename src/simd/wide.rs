//! Eight numbers at once, for what the compiler would take one by one: reads from eight places, and all that leads to them.
//!
//! A loop over an array of eight becomes one instruction a step, as long as nothing in it reads where another number points to.
//! There the compiler goes lane by lane, from the places' computation to what is made of what was read, and so it does where a
//! number decides which of two is kept. So these few steps are told twice: plainly, and in AVX2's own terms; of a kernel's two
//! entries each takes its own. Both give the same bits.

use glam::{Mat4, Vec4};

use super::numbers::{Array, Numbers};

/// Numbers of a 256-bit register.
pub const LANES: usize = 8;

/// A number for each lane.
pub type Lanes = [f32; LANES];

/// Where lanes read.
pub type Indices = [u32; LANES];

/// Added to a number of 0 to 2^22, rounds it to an integer, tie to even, and leaves that in the lowest bits.
pub const INTEGER: f32 = 8_388_608.0;

/// What lies in the lowest bits of such a sum.
pub const MANTISSA: u32 = 0x7f_ffff;

/// Added to a position, rounds it to 2^-10 and leaves it as an integer in the lowest bits: between
/// 2^13 and 2^14 neighbouring floats are 2^-10 apart.
pub const FIXED: f32 = 12288.0;
pub const FRACTION_BITS: u32 = 10;

/// Cells side by side, in which positions lie.
#[derive(Clone, Copy, Debug)]
pub struct CellRow {
    /// Positions are kept from `low` to `high`.
    pub low: f32,
    pub high: f32,
    /// The position at which cell 0 begins.
    pub origin: f32,
    /// The last cell.
    pub last: f32,
}

/// A way to take eight lanes through a step. Where an index leads beyond the values, all lanes are 0. Implementations are
/// `#[inline(always)]`.
pub trait Wide {
    /// What they are computed with.
    type Numbers: Numbers<Memory = Lanes>;

    /// The cell of each position, and how far it is from its beginning to its end, 0..=1; of two cells that meet there,
    /// either.
    fn cells(at: &Lanes, row: &CellRow) -> [Lanes; 2];

    /// `row * stride + column`, of whole numbers below 2^22, as is what comes of them.
    fn indices(row: &Lanes, column: &Lanes, stride: f32) -> Indices;

    /// Entries and fractions of positions on the two axes of a table, from 0 up to 4095, rounded to 2^-10 of an entry: the
    /// first one counts rows of `stride` entries.
    fn entries(at: [&Lanes; 2], stride: u32) -> (Indices, [Lanes; 2]);

    /// Between `values[at]` and the next one.
    fn linear(values: &[f32], at: &Indices, fraction: &Lanes) -> Lanes;

    /// Between `values[at]`, the next one, and the two that are `stride` further, by how far along the first and along the
    /// second.
    fn bilinear(values: &[f32], stride: usize, at: &Indices, fractions: [&Lanes; 2]) -> Lanes;

    /// The same of vectors, by component.
    fn bilinear_vectors(values: &[Vec4], stride: usize, at: &Indices, fractions: [&Lanes; 2]) -> [Lanes; 4];

    /// Those of `these` where a number is below `limit`, else 0.
    fn keep_below(numbers: &Lanes, limit: f32, these: &Lanes) -> Lanes;

    /// By component -> by lane.
    fn columns(rows: &[Lanes; 4]) -> [Vec4; LANES];
}

/// In plain code.
#[derive(Clone, Copy, Debug)]
pub struct Portable;

/// In AVX2's own terms. Only for code that is compiled for it.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy, Debug)]
pub struct Avx2;

/// The lesser of two numbers: one instruction, where [`f32::min`] has to look for what is no number.
#[inline(always)]
pub fn least<T: PartialOrd>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// The greater of two.
#[inline(always)]
pub fn most<T: PartialOrd>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// By lane -> by component.
#[inline(always)]
pub fn rows(columns: &[Vec4; LANES]) -> [Lanes; 4] {
    let mut rows = [[0.0; LANES]; 4];
    for half in 0..2 {
        let at = 4 * half;
        let turned = Mat4::from_cols(columns[at], columns[at + 1], columns[at + 2], columns[at + 3]).transpose();
        rows[0][at..at + 4].copy_from_slice(&turned.x_axis.to_array());
        rows[1][at..at + 4].copy_from_slice(&turned.y_axis.to_array());
        rows[2][at..at + 4].copy_from_slice(&turned.z_axis.to_array());
        rows[3][at..at + 4].copy_from_slice(&turned.w_axis.to_array());
    }
    rows
}

impl Wide for Portable {
    type Numbers = Array<LANES>;

    #[inline(always)]
    fn cells(at: &Lanes, &CellRow { low, high, origin, last }: &CellRow) -> [Lanes; 2] {
        let [mut whole, mut fractions] = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            let at = least(most(at[lane], low), high) - origin;
            let cell = least((most(at - 0.5, 0.0) + INTEGER) - INTEGER, last);
            whole[lane] = cell;
            fractions[lane] = at - cell;
        }
        [whole, fractions]
    }

    #[inline(always)]
    fn indices(row: &Lanes, column: &Lanes, stride: f32) -> Indices {
        let mut index = [0; LANES];
        for lane in 0..LANES {
            index[lane] = ((row[lane] * stride + column[lane]) + INTEGER).to_bits() & MANTISSA;
        }
        index
    }

    #[inline(always)]
    fn entries([row, column]: [&Lanes; 2], stride: u32) -> (Indices, [Lanes; 2]) {
        let (mut index, mut fractions) = ([0; LANES], [[0.0; LANES]; 2]);
        for lane in 0..LANES {
            let [row, column] = [row[lane], column[lane]].map(split);
            index[lane] = row.0.wrapping_mul(stride).wrapping_add(column.0);
            [fractions[0][lane], fractions[1][lane]] = [row.1, column.1];
        }
        (index, fractions)
    }

    #[inline(always)]
    fn linear(values: &[f32], at: &Indices, fraction: &Lanes) -> Lanes {
        let mut between = [0.0; LANES];
        if !reaches(values.len(), 2, at) {
            return between;
        }
        for lane in 0..LANES {
            let at = at[lane] as usize;
            between[lane] = values[at] + (values[at + 1] - values[at]) * fraction[lane];
        }
        between
    }

    #[inline(always)]
    fn bilinear(values: &[f32], stride: usize, at: &Indices, [along, across]: [&Lanes; 2]) -> Lanes {
        let mut between = [0.0; LANES];
        if !reaches(values.len(), stride + 2, at) {
            return between;
        }
        for lane in 0..LANES {
            let (near, far) = (at[lane] as usize, at[lane] as usize + stride);
            let near = values[near] + (values[near + 1] - values[near]) * along[lane];
            let far = values[far] + (values[far + 1] - values[far]) * along[lane];
            between[lane] = near + (far - near) * across[lane];
        }
        between
    }

    #[inline(always)]
    fn bilinear_vectors(values: &[Vec4], stride: usize, at: &Indices, [along, across]: [&Lanes; 2]) -> [Lanes; 4] {
        let mut between = [Vec4::ZERO; LANES];
        if reaches(values.len(), stride + 2, at) {
            for lane in 0..LANES {
                let (near, far) = (at[lane] as usize, at[lane] as usize + stride);
                let near = values[near] + (values[near + 1] - values[near]) * along[lane];
                let far = values[far] + (values[far + 1] - values[far]) * along[lane];
                between[lane] = near + (far - near) * across[lane];
            }
        }
        rows(&between)
    }

    #[inline(always)]
    fn keep_below(numbers: &Lanes, limit: f32, these: &Lanes) -> Lanes {
        let mut kept = *these;
        for lane in 0..LANES {
            kept[lane] = if numbers[lane] < limit { these[lane] } else { 0.0 };
        }
        kept
    }

    #[inline(always)]
    fn columns(rows: &[Lanes; 4]) -> [Vec4; LANES] {
        let mut columns = [Vec4::ZERO; LANES];
        for (lane, column) in columns.iter_mut().enumerate() {
            *column = Vec4::new(rows[0][lane], rows[1][lane], rows[2][lane], rows[3][lane]);
        }
        columns
    }
}

/// Entry and fraction of a position from 0 up to 4095, rounded to 2^-10 of an entry.
#[inline(always)]
pub fn split(position: f32) -> (u32, f32) {
    let fixed = (position + FIXED).to_bits().wrapping_sub(FIXED.to_bits());
    let fraction = fixed & ((1 << FRACTION_BITS) - 1);
    (fixed >> FRACTION_BITS, fraction as i32 as f32 * (1.0 / (1 << FRACTION_BITS) as f32))
}

/// True where `count` values from each index on are among `length`.
#[inline(always)]
fn reaches(length: usize, count: usize, at: &Indices) -> bool {
    at.iter().all(|&at| at as usize + count <= length)
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;
    use crate::simd::numbers::Eight;

    // No closures below: they are functions of their own, which are compiled without AVX2.

    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn put(lanes: &Lanes) -> __m256 {
        // SAFETY: as the caller promises; eight numbers are there.
        unsafe { _mm256_loadu_ps(lanes.as_ptr()) }
    }

    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn get(register: __m256) -> Lanes {
        let mut lanes = [0.0; LANES];
        // SAFETY: as the caller promises; there is room for eight numbers.
        unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), register) };
        lanes
    }

    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn put_indices(indices: &Indices) -> __m256i {
        // SAFETY: as the caller promises; eight indices are there.
        unsafe { _mm256_loadu_si256(indices.as_ptr().cast()) }
    }

    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn get_indices(register: __m256i) -> Indices {
        let mut indices = [0; LANES];
        // SAFETY: as the caller promises; there is room for eight indices.
        unsafe { _mm256_storeu_si256(indices.as_mut_ptr().cast(), register) };
        indices
    }

    /// As [`reaches`]; at least one value is asked for.
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn all_reach(length: usize, count: usize, at: __m256i) -> bool {
        if length < count || length > i32::MAX as usize {
            return false;
        }
        // SAFETY: as the caller promises.
        unsafe {
            let last = _mm256_set1_epi32((length - count) as i32);
            let within = _mm256_cmpeq_epi32(_mm256_max_epu32(at, last), last);
            _mm256_movemask_epi8(within) == -1
        }
    }

    /// As [`split`].
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn split_lanes(at: &Lanes) -> (__m256i, __m256) {
        // SAFETY: as the caller promises.
        unsafe {
            let at = _mm256_castps_si256(_mm256_add_ps(put(at), _mm256_set1_ps(FIXED)));
            let fixed = _mm256_sub_epi32(at, _mm256_set1_epi32(FIXED.to_bits() as i32));
            let fraction = _mm256_and_si256(fixed, _mm256_set1_epi32((1 << FRACTION_BITS) - 1));
            let scale = _mm256_set1_ps(1.0 / (1 << FRACTION_BITS) as f32);
            let entry = _mm256_srli_epi32::<{ FRACTION_BITS as i32 }>(fixed);
            (entry, _mm256_mul_ps(_mm256_cvtepi32_ps(fraction), scale))
        }
    }

    /// `a + (b - a) * fraction`
    ///
    /// # Safety
    /// AVX2 must be there.
    #[inline(always)]
    unsafe fn lerp([a, b]: [__m256; 2], fraction: __m256) -> __m256 {
        // SAFETY: as the caller promises.
        unsafe { _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), fraction)) }
    }

    /// Two values from each of two places on.
    ///
    /// # Safety
    /// They must be there.
    #[inline(always)]
    unsafe fn two(values: *const f32, at: &Indices, lane: usize) -> __m128d {
        // SAFETY: as the caller promises.
        unsafe {
            let first = _mm_load_sd(values.add(at[lane] as usize).cast());
            _mm_loadh_pd(first, values.add(at[lane + 1] as usize).cast())
        }
    }

    /// The values at eight places, and those that follow them.
    ///
    /// # Safety
    /// AVX2 must be there, and two values from each place on.
    #[inline(always)]
    unsafe fn pairs(values: *const f32, at: &Indices) -> [__m256; 2] {
        // SAFETY: as the caller promises.
        unsafe {
            let first = _mm256_castpd_ps(_mm256_set_m128d(two(values, at, 4), two(values, at, 0)));
            let second = _mm256_castpd_ps(_mm256_set_m128d(two(values, at, 6), two(values, at, 2)));
            [_mm256_shuffle_ps::<0b10_00_10_00>(first, second), _mm256_shuffle_ps::<0b11_01_11_01>(first, second)]
        }
    }

    /// The vectors so far ahead of two places, in the halves of a register.
    ///
    /// # Safety
    /// They must be there.
    #[inline(always)]
    unsafe fn both(low: *const f32, high: *const f32, ahead: usize) -> __m256 {
        // SAFETY: as the caller promises.
        unsafe { _mm256_set_m128(_mm_loadu_ps(high.add(4 * ahead)), _mm_loadu_ps(low.add(4 * ahead))) }
    }

    /// What lies between four vectors each of lanes n and n + 4, in the halves of a register.
    ///
    /// # Safety
    /// AVX2 must be there, and two vectors from each place and from `stride` after it on.
    #[inline(always)]
    unsafe fn between_vectors(values: &[Vec4], stride: usize, at: &Indices, fractions: [&Lanes; 2]) -> [__m256; 4] {
        const { assert!(size_of::<Vec4>() == 16) }
        let values: *const f32 = values.as_ptr().cast();
        // SAFETY: as the caller promises.
        unsafe {
            let [along, across] = [put(fractions[0]), put(fractions[1])];

            /// What lanes `$lane` and `$lane + 4` have.
            macro_rules! pair {
                ($lane:literal) => {{
                    let low = values.add(4 * at[$lane] as usize);
                    let high = values.add(4 * at[$lane + 4] as usize);
                    let along = _mm256_permute_ps::<{ $lane * 0b01_01_01_01 }>(along);
                    let across = _mm256_permute_ps::<{ $lane * 0b01_01_01_01 }>(across);
                    let near = lerp([both(low, high, 0), both(low, high, 1)], along);
                    let far = lerp([both(low, high, stride), both(low, high, stride + 1)], along);
                    lerp([near, far], across)
                }};
            }
            [pair!(0), pair!(1), pair!(2), pair!(3)]
        }
    }

    /// The vectors of lanes n and n + 4, which are in the halves of a register, in order.
    ///
    /// # Safety
    /// AVX must be there.
    #[inline(always)]
    unsafe fn halves(pairs: [__m256; 4]) -> [Vec4; LANES] {
        let mut columns = [Vec4::ZERO; LANES];
        // SAFETY: as the caller promises; there is room for eight vectors.
        unsafe {
            let out: *mut f32 = columns.as_mut_ptr().cast();
            _mm_storeu_ps(out, _mm256_castps256_ps128(pairs[0]));
            _mm_storeu_ps(out.add(4), _mm256_castps256_ps128(pairs[1]));
            _mm_storeu_ps(out.add(8), _mm256_castps256_ps128(pairs[2]));
            _mm_storeu_ps(out.add(12), _mm256_castps256_ps128(pairs[3]));
            _mm_storeu_ps(out.add(16), _mm256_extractf128_ps::<1>(pairs[0]));
            _mm_storeu_ps(out.add(20), _mm256_extractf128_ps::<1>(pairs[1]));
            _mm_storeu_ps(out.add(24), _mm256_extractf128_ps::<1>(pairs[2]));
            _mm_storeu_ps(out.add(28), _mm256_extractf128_ps::<1>(pairs[3]));
        }
        columns
    }

    impl Wide for Avx2 {
        type Numbers = Eight;

        #[inline(always)]
        fn cells(at: &Lanes, &CellRow { low, high, origin, last }: &CellRow) -> [Lanes; 2] {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let at = _mm256_min_ps(_mm256_max_ps(put(at), _mm256_set1_ps(low)), _mm256_set1_ps(high));
                let at = _mm256_sub_ps(at, _mm256_set1_ps(origin));
                let cell = _mm256_max_ps(_mm256_sub_ps(at, _mm256_set1_ps(0.5)), _mm256_setzero_ps());
                let integer = _mm256_set1_ps(INTEGER);
                let cell = _mm256_sub_ps(_mm256_add_ps(cell, integer), integer);
                let cell = _mm256_min_ps(cell, _mm256_set1_ps(last));
                [get(cell), get(_mm256_sub_ps(at, cell))]
            }
        }

        #[inline(always)]
        fn indices(row: &Lanes, column: &Lanes, stride: f32) -> Indices {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let at = _mm256_add_ps(_mm256_mul_ps(put(row), _mm256_set1_ps(stride)), put(column));
                let at = _mm256_castps_si256(_mm256_add_ps(at, _mm256_set1_ps(INTEGER)));
                get_indices(_mm256_and_si256(at, _mm256_set1_epi32(MANTISSA as i32)))
            }
        }

        #[inline(always)]
        fn entries([row, column]: [&Lanes; 2], stride: u32) -> (Indices, [Lanes; 2]) {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let (row, column) = (split_lanes(row), split_lanes(column));
                let at = _mm256_mullo_epi32(row.0, _mm256_set1_epi32(stride as i32));
                (get_indices(_mm256_add_epi32(at, column.0)), [get(row.1), get(column.1)])
            }
        }

        #[inline(always)]
        fn linear(values: &[f32], at: &Indices, fraction: &Lanes) -> Lanes {
            // SAFETY: whoever takes this way has found AVX2; all places have two values.
            unsafe {
                if !all_reach(values.len(), 2, put_indices(at)) {
                    return [0.0; LANES];
                }
                get(lerp(pairs(values.as_ptr(), at), put(fraction)))
            }
        }

        #[inline(always)]
        fn bilinear(values: &[f32], stride: usize, at: &Indices, [along, across]: [&Lanes; 2]) -> Lanes {
            // SAFETY: whoever takes this way has found AVX2; all places have two values, and two more `stride` further.
            unsafe {
                if !all_reach(values.len(), stride + 2, put_indices(at)) {
                    return [0.0; LANES];
                }
                let (near, far) = (pairs(values.as_ptr(), at), pairs(values.as_ptr().add(stride), at));
                let (near, far) = (lerp(near, put(along)), lerp(far, put(along)));
                get(lerp([near, far], put(across)))
            }
        }

        #[inline(always)]
        fn bilinear_vectors(values: &[Vec4], stride: usize, at: &Indices, fractions: [&Lanes; 2]) -> [Lanes; 4] {
            // SAFETY: whoever takes this way has found AVX2; all places have two vectors, and two more `stride` further.
            unsafe {
                if !all_reach(values.len(), stride + 2, put_indices(at)) {
                    return [[0.0; LANES]; 4];
                }
                let [a, b, c, d] = between_vectors(values, stride, at, fractions);
                let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
                let (rest_ab, rest_cd) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
                [
                    get(_mm256_shuffle_ps::<0b01_00_01_00>(ab, cd)),
                    get(_mm256_shuffle_ps::<0b11_10_11_10>(ab, cd)),
                    get(_mm256_shuffle_ps::<0b01_00_01_00>(rest_ab, rest_cd)),
                    get(_mm256_shuffle_ps::<0b11_10_11_10>(rest_ab, rest_cd)),
                ]
            }
        }

        #[inline(always)]
        fn keep_below(numbers: &Lanes, limit: f32, these: &Lanes) -> Lanes {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let below = _mm256_cmp_ps::<_CMP_LT_OQ>(put(numbers), _mm256_set1_ps(limit));
                get(_mm256_and_ps(put(these), below))
            }
        }

        #[inline(always)]
        fn columns(rows: &[Lanes; 4]) -> [Vec4; LANES] {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let (x, y, z, w) = (put(&rows[0]), put(&rows[1]), put(&rows[2]), put(&rows[3]));
                let (xz, yw) = (_mm256_unpacklo_ps(x, z), _mm256_unpacklo_ps(y, w));
                let (rest_xz, rest_yw) = (_mm256_unpackhi_ps(x, z), _mm256_unpackhi_ps(y, w));
                halves([
                    _mm256_unpacklo_ps(xz, yw),
                    _mm256_unpackhi_ps(xz, yw),
                    _mm256_unpacklo_ps(rest_xz, rest_yw),
                    _mm256_unpackhi_ps(rest_xz, rest_yw),
                ])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::simd::{Kernel, dispatch};

    /// All steps from one position to what is read there, bit by bit.
    fn steps<W: Wide>(positions: &[Lanes; 2], values: &[f32]) -> Vec<u32> {
        let cells = CellRow { low: 3.0, high: 11.5, origin: 2.0, last: 7.0 };
        let [[row, along], [column, across]] = positions.each_ref().map(|at| W::cells(at, &cells));
        let index = W::indices(&row, &column, 9.0);
        let mut found = vec![row, along, column, across];
        found.push(W::linear(values, &index, &along));
        found.push(W::bilinear(values, 9, &index, [&along, &across]));
        let vectors: Vec<_> = values.windows(4).map(Vec4::from_slice).collect();
        found.extend(W::bilinear_vectors(&vectors, 9, &index, [&along, &across]));
        let zero = W::Numbers::all(0.0);
        let [row, column] = positions.each_ref().map(|at| W::Numbers::load(at).most(zero).store());
        let (entries, fractions) = W::entries([&row, &column], 77);
        found.extend(fractions);
        found.extend([row, column]);
        found.push(W::keep_below(&column, 7.0, &row));
        let columns = W::columns(&[row, column, along, across]);
        found.extend(rows(&columns));
        found.extend(columns.as_chunks().0.iter().map(|two: &[Vec4; 2]| {
            let mut lanes = [0.0; LANES];
            lanes[..4].copy_from_slice(&two[0].to_array());
            lanes[4..].copy_from_slice(&two[1].to_array());
            lanes
        }));
        let numbers = found.as_flattened().iter().map(|number| number.to_bits());
        index.into_iter().chain(entries).chain(numbers).collect()
    }

    struct Both<'a>(&'a [Lanes; 2], &'a [f32]);

    impl Kernel for Both<'_> {
        type Output = [Vec<u32>; 2];

        fn run(self) -> Self::Output {
            [(); 2].map(|()| steps::<Portable>(self.0, self.1))
        }

        #[cfg(target_arch = "x86_64")]
        fn run_avx2(self) -> Self::Output {
            [steps::<Portable>(self.0, self.1), steps::<Avx2>(self.0, self.1)]
        }
    }

    proptest! {
        #[test]
        fn wide_registers_give_the_same_bits(
            positions in prop::array::uniform2(prop::array::uniform8(-3.0f32..20.0)),
            values in prop::collection::vec(-1e3f32..1e3, 0..200),
        ) {
            let [portable, wide] = dispatch(Both(&positions, &values));
            prop_assert_eq!(portable, wide);
        }
    }

    #[test]
    fn values_are_interpolated_between_their_neighbours() {
        let values: Vec<_> = (0..40).map(|n| (n * n) as f32).collect();
        let (at, half, quarter) = ([0, 1, 2, 3, 4, 5, 6, 28], [0.5; LANES], [0.25; LANES]);
        let expected = |at: u32| {
            let [a, b, c, d] = [at, at + 1, at + 10, at + 11].map(|n| (n * n) as f32);
            (a + b) * 0.5 * 0.75 + (c + d) * 0.5 * 0.25
        };
        assert_eq!(Portable::bilinear(&values, 10, &at, [&half, &quarter]), at.map(expected));
        let vectors: Vec<_> = values.iter().map(|v| Vec4::new(*v, -v, 2.0 * v, 1.0)).collect();
        let [x, y, z, w] = Portable::bilinear_vectors(&vectors, 10, &at, [&half, &quarter]);
        assert_eq!([x, y, z, w], [at.map(expected), x.map(|x| -x), x.map(|x| 2.0 * x), [1.0; LANES]]);
        assert_eq!(Portable::linear(&values, &at, &half), at.map(|n| n as f32 * n as f32 + n as f32 + 0.5));
        // One index too far.
        let at = [29; LANES];
        assert_eq!(Portable::bilinear(&values, 10, &at, [&half, &quarter]), [0.0; LANES]);
    }
}
