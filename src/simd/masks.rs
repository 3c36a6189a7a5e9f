//! Masks, a bit for each voxel or pixel of a scanline, four words at once.

use super::wide::Portable;

/// Words that are taken together.
pub const FOUR: usize = 4;

/// Open pixels of a scanline over one of voxels.
#[derive(Clone, Copy, Debug)]
pub struct Over {
    /// Bit of the first word of pixels that is the pixel on a word's first voxel, or after it: 0..64.
    pub shift: u32,
    /// True where pixels are between voxels: each touches the one before it and the one after.
    pub between: bool,
}

/// Pixels to work on, a bit for each by the voxel that it lies on or after, in words of which there are a multiple of [`FOUR`].
#[derive(Debug)]
pub struct Found<'a> {
    /// Those that were found.
    pub touched: &'a mut [u64],
    /// The first bits of aligned fours of voxels, which hold all that the pixels touch.
    pub asked: &'a mut [u64],
}

/// A way to intersect masks. Implementations are `#[inline(always)]`.
pub trait Masks {
    /// Finds the pixels that are `open` and `within` what they may be in, and touch a voxel of either scanline. Gives the first word and past
    /// the last in which there are any; where there is none, the latter is 0. Scanlines and open pixels have a word more than there are.
    fn touch(scanlines: [&[u64]; 2], open: &[u64], over: Over, within: &[u64], found: Found<'_>) -> [usize; 2];

    /// Finds the pixels that are `open` and over a cell of either scanline: of those that are `within` it, each raised by so many bits (0..64). What
    /// is raised above the last word is lost. True where there are any. Words are as many as those of `within`, a multiple of [`FOUR`].
    fn over_cells(scanlines: [(&[u64], u32); 2], within: &[u64], open: [&[u64]; 2], pixels: &mut [u64]) -> bool;

    /// A word's pixels with numbers that are `until` at most, and those with numbers `below` another.
    fn numbers(numbers: &[f32; WORD], until: f32, below: f32) -> [u64; 2];
}

/// Bits of a word.
pub const WORD: usize = 64;

/// The last bit of every four.
const LAST: u64 = (u64::MAX / 0b1111) << 3;

/// The first bit of every aligned four of bits in which any is set.
#[inline(always)]
pub fn fours(bits: u64) -> u64 {
    let pairs = bits | bits >> 1;
    (pairs | pairs >> 2) & (LAST >> 3)
}

/// The first bits of aligned fours of voxels that hold all that a word's pixels touch: the one that each lies on and the next. The last
/// one's next is the first of the word after that.
#[inline(always)]
pub fn asked(touched: u64) -> u64 {
    fours(touched) | (touched & LAST) << 1
}

impl Masks for Portable {
    #[inline(always)]
    fn touch(
        [upper, lower]: [&[u64]; 2],
        open: &[u64],
        Over { shift, between }: Over,
        within: &[u64],
        found: Found<'_>,
    ) -> [usize; 2] {
        let (mut from, mut to, mut carry) = (usize::MAX, 0, 0);
        for (n, (touched, asks)) in found.touched.iter_mut().zip(found.asked).enumerate() {
            let marks = upper[n] | lower[n];
            let next = if between { marks >> 1 | (upper[n + 1] | lower[n + 1]) << 63 } else { 0 };
            let open = open[n] >> shift | open[n + 1] << 1 << (63 - shift);
            *touched = (marks | next) & open & within[n];
            *asks = asked(*touched) | carry;
            carry = *touched >> 63;
            if *touched != 0 {
                from = from.min(n);
                to = n + 1;
            }
        }
        [from, to]
    }

    #[inline(always)]
    fn over_cells(scanlines: [(&[u64], u32); 2], within: &[u64], open: [&[u64]; 2], pixels: &mut [u64]) -> bool {
        let (mut any, mut before) = (0, [0; 2]);
        for (n, within) in within.iter().enumerate() {
            let mut raised = 0;
            for ((cells, shift), before) in scanlines.iter().zip(&mut before) {
                let cells = cells[n] & within;
                raised |= cells << shift | *before >> 1 >> (63 - shift);
                *before = cells;
            }
            pixels[n] = raised & open[0][n] & open[1][n];
            any |= pixels[n];
        }
        any != 0
    }

    #[inline(always)]
    fn numbers(numbers: &[f32; WORD], until: f32, below: f32) -> [u64; 2] {
        let mut bits = [0; 2];
        for (n, &number) in numbers.iter().enumerate() {
            bits[0] |= u64::from(number <= until) << n;
            bits[1] |= u64::from(number < below) << n;
        }
        bits
    }
}

#[cfg(target_arch = "x86_64")]
impl Masks for super::wide::Avx2 {
    #[inline(always)]
    fn numbers(numbers: &[f32; WORD], until: f32, below: f32) -> [u64; 2] {
        use std::arch::x86_64::*;

        let mut bits = [0; 2];
        for (n, eight) in numbers.as_chunks::<8>().0.iter().enumerate() {
            // SAFETY: whoever takes this way has found AVX2; eight numbers are there.
            unsafe {
                let eight = _mm256_loadu_ps(eight.as_ptr());
                let up_to = _mm256_cmp_ps::<_CMP_LE_OQ>(eight, _mm256_set1_ps(until));
                let below = _mm256_cmp_ps::<_CMP_LT_OQ>(eight, _mm256_set1_ps(below));
                bits[0] |= (_mm256_movemask_ps(up_to) as u64) << (8 * n);
                bits[1] |= (_mm256_movemask_ps(below) as u64) << (8 * n);
            }
        }
        bits
    }

    #[inline(always)]
    fn over_cells(scanlines: [(&[u64], u32); 2], within: &[u64], open: [&[u64]; 2], pixels: &mut [u64]) -> bool {
        use std::arch::x86_64::*;

        let count = within.len();
        let [(front, front_shift), (back, back_shift)] = scanlines;
        let lengths = [front.len(), back.len(), open[0].len(), open[1].len(), pixels.len()];
        assert!(count.is_multiple_of(FOUR) && lengths.iter().all(|length| *length >= count), "words by fours");
        // SAFETY: whoever takes this way has found AVX2. Four words are read and written from each multiple of four below the count on.
        unsafe {
            let shift = |bits: u32| _mm_cvtsi32_si128(bits as i32);
            // All bits are gone where the count is 64.
            let shifts = [(shift(front_shift), shift(64 - front_shift)), (shift(back_shift), shift(64 - back_shift))];
            let (mut any, mut carried) = (_mm256_setzero_si256(), [_mm256_setzero_si256(); 2]);
            for at in (0..count).step_by(FOUR) {
                let within = _mm256_loadu_si256(within.as_ptr().add(at).cast());
                let mut raised = _mm256_setzero_si256();
                for n in 0..2 {
                    let cells = if n == 0 { front } else { back };
                    let cells = _mm256_and_si256(_mm256_loadu_si256(cells.as_ptr().add(at).cast()), within);
                    // Each word's lower neighbour; the lowest one's is the last word before.
                    let turned = _mm256_permute4x64_epi64::<0b10_01_00_11>(cells);
                    let lower = _mm256_blend_epi32::<0b11>(turned, carried[n]);
                    carried[n] = turned;
                    let (up, down) = shifts[n];
                    let both = _mm256_or_si256(_mm256_sll_epi64(cells, up), _mm256_srl_epi64(lower, down));
                    raised = _mm256_or_si256(raised, both);
                }
                for open in open {
                    raised = _mm256_and_si256(raised, _mm256_loadu_si256(open.as_ptr().add(at).cast()));
                }
                _mm256_storeu_si256(pixels.as_mut_ptr().add(at).cast(), raised);
                any = _mm256_or_si256(any, raised);
            }
            _mm256_testz_si256(any, any) == 0
        }
    }

    #[inline(always)]
    fn touch(
        [upper, lower]: [&[u64]; 2],
        open: &[u64],
        Over { shift, between }: Over,
        within: &[u64],
        Found { touched, asked }: Found<'_>,
    ) -> [usize; 2] {
        use std::arch::x86_64::*;

        let count = touched.len();
        assert!(count.is_multiple_of(FOUR) && within.len() == count && asked.len() == count, "words by fours");
        assert!(upper.len() > count && lower.len() > count && open.len() > count, "a word more than there are");
        let (mut from, mut to, mut carry) = (usize::MAX, 0, 0);
        // SAFETY: whoever takes this way has found AVX2. Four words are read and written from each multiple of four below the count on,
        // and four from the word after that, of what has a word more.
        unsafe {
            let beside = _mm256_set1_epi64x(-i64::from(between));
            // All bits are gone where the count is 64.
            let (first_shift, second_shift) = (_mm_cvtsi32_si128(shift as i32), _mm_cvtsi32_si128(64 - shift as i32));
            let last = _mm256_set1_epi64x(LAST as i64);
            for at in (0..count).step_by(FOUR) {
                let (upper, lower, open) = (upper.as_ptr().add(at), lower.as_ptr().add(at), open.as_ptr().add(at));
                let marks = _mm256_or_si256(_mm256_loadu_si256(upper.cast()), _mm256_loadu_si256(lower.cast()));
                let after =
                    _mm256_or_si256(_mm256_loadu_si256(upper.add(1).cast()), _mm256_loadu_si256(lower.add(1).cast()));
                let next = _mm256_or_si256(_mm256_srli_epi64::<1>(marks), _mm256_slli_epi64::<63>(after));
                let first = _mm256_srl_epi64(_mm256_loadu_si256(open.cast()), first_shift);
                let second = _mm256_sll_epi64(_mm256_loadu_si256(open.add(1).cast()), second_shift);
                let within = _mm256_loadu_si256(within.as_ptr().add(at).cast());
                let open = _mm256_and_si256(_mm256_or_si256(first, second), within);
                let found = _mm256_and_si256(_mm256_or_si256(marks, _mm256_and_si256(next, beside)), open);
                _mm256_storeu_si256(touched.as_mut_ptr().add(at).cast(), found);
                let none = _mm256_cmpeq_epi64(found, _mm256_setzero_si256());
                let any = !_mm256_movemask_pd(_mm256_castsi256_pd(none)) as usize & 0b1111;
                // The carry of the last word before is the lowest bit of these.
                let of_last = std::mem::replace(&mut carry, 0);
                if any != 0 {
                    from = from.min(at + any.trailing_zeros() as usize);
                    to = at + (usize::BITS - any.leading_zeros()) as usize;
                    let pairs = _mm256_or_si256(found, _mm256_srli_epi64::<1>(found));
                    let fours = _mm256_and_si256(
                        _mm256_or_si256(pairs, _mm256_srli_epi64::<2>(pairs)),
                        _mm256_srli_epi64::<3>(last),
                    );
                    let next = _mm256_slli_epi64::<1>(_mm256_and_si256(found, last));
                    let carried = _mm256_srli_epi64::<63>(_mm256_permute4x64_epi64::<0b10_01_00_00>(found));
                    let carried = _mm256_blend_epi32::<0b11>(carried, _mm256_setzero_si256());
                    let asks = _mm256_or_si256(_mm256_or_si256(fours, next), carried);
                    _mm256_storeu_si256(asked.as_mut_ptr().add(at).cast(), asks);
                    carry = touched[at + FOUR - 1] >> 63;
                } else {
                    _mm256_storeu_si256(asked.as_mut_ptr().add(at).cast(), _mm256_setzero_si256());
                }
                if of_last != 0 {
                    asked[at] |= of_last;
                }
            }
        }
        [from, to]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::simd::{Kernel, dispatch};

    const WORDS: usize = 2 * FOUR;

    #[derive(Debug)]
    struct Step {
        scanlines: [[u64; WORDS + 1]; 2],
        open: [u64; WORDS + 1],
        over: Over,
        within: [u64; WORDS],
    }

    /// What is touched, what is asked for, and which words; what is over cells, and whether anything is.
    type Output = ([u64; WORDS], [u64; WORDS], [usize; 2], ([u64; WORDS], bool));

    impl Step {
        fn touch<W: Masks>(&self) -> Output {
            let (mut touched, mut asked, [upper, lower]) = ([7; WORDS], [7; WORDS], &self.scanlines);
            let found = Found { touched: &mut touched, asked: &mut asked };
            let range = W::touch([upper, lower], &self.open, self.over, &self.within, found);
            let mut over = [7; WORDS];
            let [front, back] = self.raised();
            let open = [&self.open[..], &self.within[..]];
            let any = W::over_cells([(upper, front), (lower, back)], &self.within, open, &mut over);
            (touched, asked, range, (over, any))
        }

        /// By how much either scanline is raised.
        fn raised(&self) -> [u32; 2] {
            [self.over.shift, if self.over.between { 63 - self.over.shift } else { self.over.shift }]
        }
    }

    impl Kernel for &Step {
        type Output = [Output; 2];

        fn run(self) -> Self::Output {
            [self.touch::<Portable>(), self.touch::<Portable>()]
        }

        #[cfg(target_arch = "x86_64")]
        fn run_avx2(self) -> Self::Output {
            [self.touch::<Portable>(), self.touch::<super::super::wide::Avx2>()]
        }
    }

    prop_compose! {
        /// Some empty, some sparse.
        fn words()(words in prop::array::uniform9(any::<u64>()), sparse in 0..4) -> [u64; WORDS + 1] {
            words.map(|word| match sparse {
                0 => word,
                1 => word & word >> 7,
                2 => word & word >> 7 & word >> 19 & word << 5 & word << 11,
                _ => if word & 3 == 0 { u64::MAX } else { 0 },
            })
        }
    }

    struct Numbers<'a>(&'a [f32; WORD], [f32; 2]);

    impl Kernel for Numbers<'_> {
        type Output = [[u64; 2]; 2];

        fn run(self) -> Self::Output {
            let Self(numbers, [until, below]) = self;
            [Portable::numbers(numbers, until, below); 2]
        }

        #[cfg(target_arch = "x86_64")]
        fn run_avx2(self) -> Self::Output {
            let Self(numbers, [until, below]) = self;
            [Portable::numbers(numbers, until, below), super::super::wide::Avx2::numbers(numbers, until, below)]
        }
    }

    proptest! {
        #[test]
        fn numbers_are_compared(
            numbers in prop::collection::vec(prop_oneof![4 => (-3i8..4).prop_map(f32::from), 1 => Just(f32::NEG_INFINITY)], WORD),
            [until, below] in prop::array::uniform2((-3i8..4).prop_map(f32::from)),
        ) {
            let numbers = *numbers.first_chunk().unwrap();
            let [plain, wide] = dispatch(Numbers(&numbers, [until, below]));
            for (n, number) in numbers.into_iter().enumerate() {
                prop_assert_eq!(plain.map(|bits| bits >> n & 1 == 1), [number <= until, number < below], "{}", number);
            }
            prop_assert_eq!(plain, wide);
        }

        /// Pixel by pixel, and in wide registers.
        #[test]
        fn a_pixel_is_touched_by_the_voxels_beside_it(
            scanlines in prop::array::uniform2(words()), open in words(), within in words(), shift in 0u32..64, between: bool,
        ) {
            let within = *within.first_chunk().unwrap();
            let step = Step { scanlines, open, over: Over { shift, between }, within };
            let bit = |words: &[u64], at: usize| words.get(at / 64).is_some_and(|word| word >> (at % 64) & 1 == 1);
            let voxel = |i: usize| step.scanlines.iter().any(|marks| bit(marks, i));
            let [plain, wide] = dispatch(&step);
            let (touched, asked, [from, to], _) = plain;
            for i in 0..WORDS * 64 {
                let touches = voxel(i) || between && voxel(i + 1);
                prop_assert_eq!(bit(&touched, i), touches && bit(&open, i + shift as usize) && bit(&within, i), "{}", i);
            }
            for i in 0..WORDS * 64 {
                let needs = |i: usize| bit(&touched, i) || i > 0 && bit(&touched, i - 1);
                prop_assert_eq!(bit(&asked, i), i % 4 == 0 && (i..i + 4).any(needs), "{}", i);
            }
            let cells = plain.3;
            for i in 0..WORDS * 64 {
                let over = step.scanlines.iter().zip(step.raised()).any(|(cells, shift)| {
                    i.checked_sub(shift as usize).is_some_and(|i| bit(cells, i) && bit(&within, i))
                });
                prop_assert_eq!(bit(&cells.0, i), over && bit(&open, i) && bit(&within, i), "{}", i);
            }
            prop_assert_eq!(cells.1, cells.0 != [0; WORDS]);
            let words = (0..WORDS).filter(|n| touched[*n] != 0);
            prop_assert_eq!(words.clone().min().unwrap_or(usize::MAX), from);
            prop_assert_eq!(words.max().map_or(0, |last| last + 1), to);
            prop_assert_eq!(plain, wide);
        }
    }
}
