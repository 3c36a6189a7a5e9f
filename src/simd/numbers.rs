//! Numbers side by side that are computed with as if they were one.
//!
//! The compiler finds loops over arrays of eight by itself, but not what a long chain of them comes to: it takes some for lanes, others for
//! numbers of their own, and spends more on moving them about than on computing. So such chains are written once for any [`Numbers`]: an array, or
//! a register. Both give the same bits.

use std::ops::{Add, Div, Mul, Sub};

/// Added to a number from -2^22 to 2^22, rounds it to an integer and leaves that in the lowest bits.
pub const INTEGER: f32 = 12_582_912.0;

const MANTISSA_BITS: u32 = 23;
const EXPONENT_OF_1: u32 = 127;

/// Numbers side by side. All of it is `#[inline(always)]`.
pub trait Numbers: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    /// Where they are kept.
    type Memory;

    /// Those of `memory`.
    fn load(memory: &Self::Memory) -> Self;

    /// To be kept.
    fn store(self) -> Self::Memory;

    /// One number everywhere.
    fn all(number: f32) -> Self;

    /// Square roots.
    fn sqrt(self) -> Self;

    /// Without their signs.
    fn abs(self) -> Self;

    /// The lesser of each and the other.
    fn least(self, other: Self) -> Self;

    /// The greater of each and the other.
    fn most(self, other: Self) -> Self;

    /// 2 to the power of whole numbers from -126 to 127.
    fn powers_of_2(self) -> Self;

    /// Those of `these` where a number is above `limit`, else those of `others`.
    fn where_above(self, limit: f32, these: Self, others: Self) -> Self;

    /// Some number is not 0.
    fn any(self) -> bool;

    /// Raised to a power, one by one.
    fn powf(self, exponent: f32) -> Self;
}

/// e^x, to 3e-7 of it; x at most 88.
#[inline(always)]
pub fn exp<V: Numbers>(x: V) -> V {
    let (whole, rest) = powers(x);
    (exp_m1_of_rest(rest) + V::all(1.0)) * whole.powers_of_2()
}

/// e^x - 1, to 7e-7 of it; x at most 88.
#[inline(always)]
pub fn exp_m1<V: Numbers>(x: V) -> V {
    let (whole, rest) = powers(x);
    let scale = whole.powers_of_2();
    exp_m1_of_rest(rest) * scale + (scale - V::all(1.0))
}

/// A whole number and a rest of at most a half of ln 2, so that e^x is 2 to the power of the one times e to the power of the other.
#[inline(always)]
fn powers<V: Numbers>(x: V) -> (V, V) {
    let integer = V::all(INTEGER);
    let x = x.most(V::all(-87.0));
    let whole = (x * V::all(std::f32::consts::LOG2_E) + integer) - integer;
    // ln 2 in two parts, the first of few bits.
    (whole, (x - whole * V::all(0.693_359_4)) + whole * V::all(2.121_944_4e-4))
}

#[inline(always)]
fn exp_m1_of_rest<V: Numbers>(rest: V) -> V {
    let mut sum = V::all(1.0 / 720.0);
    for coefficient in [1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0] {
        sum = sum * rest + V::all(coefficient);
    }
    sum * rest
}

/// So many numbers in an array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Array<const N: usize>(pub [f32; N]);

macro_rules! by_number {
    ($($operator:ident $method:ident $symbol:tt)*) => {$(
        impl<const N: usize> $operator for Array<N> {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for n in 0..N {
                    self.0[n] $symbol other.0[n];
                }
                self
            }
        }
    )*};
}

by_number!(Add add += Sub sub -= Mul mul *= Div div /=);

impl<const N: usize> Numbers for Array<N> {
    type Memory = [f32; N];

    #[inline(always)]
    fn load(memory: &[f32; N]) -> Self {
        Self(*memory)
    }

    #[inline(always)]
    fn store(self) -> [f32; N] {
        self.0
    }

    #[inline(always)]
    fn all(number: f32) -> Self {
        Self([number; N])
    }

    #[inline(always)]
    fn sqrt(mut self) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].sqrt();
        }
        self
    }

    #[inline(always)]
    fn abs(mut self) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].abs();
        }
        self
    }

    #[inline(always)]
    fn least(mut self, other: Self) -> Self {
        for n in 0..N {
            self.0[n] = if self.0[n] < other.0[n] { self.0[n] } else { other.0[n] };
        }
        self
    }

    #[inline(always)]
    fn most(mut self, other: Self) -> Self {
        for n in 0..N {
            self.0[n] = if self.0[n] > other.0[n] { self.0[n] } else { other.0[n] };
        }
        self
    }

    #[inline(always)]
    fn powers_of_2(mut self) -> Self {
        for n in 0..N {
            let whole = (self.0[n] + INTEGER).to_bits().wrapping_sub(INTEGER.to_bits());
            self.0[n] = f32::from_bits(whole.wrapping_add(EXPONENT_OF_1) << MANTISSA_BITS);
        }
        self
    }

    #[inline(always)]
    fn where_above(mut self, limit: f32, these: Self, others: Self) -> Self {
        for n in 0..N {
            self.0[n] = if self.0[n] > limit { these.0[n] } else { others.0[n] };
        }
        self
    }

    #[inline(always)]
    fn any(self) -> bool {
        let mut bits = 0;
        for n in 0..N {
            bits |= self.0[n].to_bits() << 1;
        }
        bits != 0
    }

    #[inline(always)]
    fn powf(mut self, exponent: f32) -> Self {
        for n in 0..N {
            self.0[n] = self.0[n].powf(exponent);
        }
        self
    }
}

#[cfg(target_arch = "x86_64")]
pub use avx2::Eight;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;
    use crate::simd::wide::{LANES, Lanes};

    /// A register of AVX2's. Only for code that is compiled for it.
    #[derive(Clone, Copy, Debug)]
    pub struct Eight(__m256);

    macro_rules! by_register {
        ($($operator:ident $method:ident $instruction:ident)*) => {$(
            impl $operator for Eight {
                type Output = Self;

                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    // SAFETY: whoever takes this way has found AVX2.
                    Self(unsafe { $instruction(self.0, other.0) })
                }
            }
        )*};
    }

    by_register!(Add add _mm256_add_ps Sub sub _mm256_sub_ps Mul mul _mm256_mul_ps Div div _mm256_div_ps);

    impl Numbers for Eight {
        type Memory = Lanes;

        #[inline(always)]
        fn load(memory: &Lanes) -> Self {
            // SAFETY: whoever takes this way has found AVX2; eight numbers are there.
            Self(unsafe { _mm256_loadu_ps(memory.as_ptr()) })
        }

        #[inline(always)]
        fn store(self) -> Lanes {
            let mut memory = [0.0; LANES];
            // SAFETY: whoever takes this way has found AVX2; there is room for eight numbers.
            unsafe { _mm256_storeu_ps(memory.as_mut_ptr(), self.0) };
            memory
        }

        #[inline(always)]
        fn all(number: f32) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            Self(unsafe { _mm256_set1_ps(number) })
        }

        #[inline(always)]
        fn sqrt(self) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            Self(unsafe { _mm256_sqrt_ps(self.0) })
        }

        #[inline(always)]
        fn abs(self) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            Self(unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), self.0) })
        }

        #[inline(always)]
        fn least(self, other: Self) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            Self(unsafe { _mm256_min_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn most(self, other: Self) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            Self(unsafe { _mm256_max_ps(self.0, other.0) })
        }

        #[inline(always)]
        fn powers_of_2(self) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let whole = _mm256_castps_si256(_mm256_add_ps(self.0, _mm256_set1_ps(INTEGER)));
                // From the sum's bits to an exponent.
                let exponent = _mm256_set1_epi32(EXPONENT_OF_1.wrapping_sub(INTEGER.to_bits()) as i32);
                let bits = _mm256_slli_epi32::<{ MANTISSA_BITS as i32 }>(_mm256_add_epi32(whole, exponent));
                Self(_mm256_castsi256_ps(bits))
            }
        }

        #[inline(always)]
        fn where_above(self, limit: f32, Self(these): Self, Self(others): Self) -> Self {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let above = _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, _mm256_set1_ps(limit));
                Self(_mm256_blendv_ps(others, these, above))
            }
        }

        #[inline(always)]
        fn any(self) -> bool {
            // SAFETY: whoever takes this way has found AVX2.
            unsafe {
                let is_not_0 = _mm256_cmp_ps::<_CMP_NEQ_UQ>(self.0, _mm256_setzero_ps());
                _mm256_movemask_ps(is_not_0) != 0
            }
        }

        #[inline(always)]
        fn powf(self, exponent: f32) -> Self {
            let mut memory = self.store();
            raise(&mut memory, exponent);
            Self::load(&memory)
        }
    }

    /// A call keeps no register: seldom made, and where it is not, the loop around it shall not keep all it has in memory.
    #[cold]
    #[inline(never)]
    fn raise(numbers: &mut Lanes, exponent: f32) {
        for number in numbers {
            *number = number.powf(exponent);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::simd::wide::{LANES, Lanes, Portable, Wide};
    use crate::simd::{Kernel, dispatch};

    fn computed<V: Numbers<Memory = Lanes>>(a: &Lanes, b: &Lanes) -> Vec<u32> {
        let (a, b) = (V::load(a), V::load(b));
        let all = [
            a + b,
            a - b,
            a * b,
            a / b,
            a.abs().sqrt(),
            a.least(b),
            a.most(b),
            (a * V::all(50.0) + V::all(INTEGER) - V::all(INTEGER)).powers_of_2(),
            a.where_above(0.5, b, V::all(3.0)),
            a.abs().powf(1.25),
            V::all(if (a - b).any() { 1.0 } else { 0.0 }),
        ];
        all.iter().flat_map(|numbers| numbers.store()).map(f32::to_bits).collect()
    }

    struct Both<'a>([&'a Lanes; 2]);

    impl Kernel for Both<'_> {
        type Output = [Vec<u32>; 2];

        fn run(self) -> Self::Output {
            let Self([a, b]) = self;
            [(); 2].map(|()| computed::<<Portable as Wide>::Numbers>(a, b))
        }

        #[cfg(target_arch = "x86_64")]
        fn run_avx2(self) -> Self::Output {
            let Self([a, b]) = self;
            [computed::<Array<LANES>>(a, b), computed::<Eight>(a, b)]
        }
    }

    proptest! {
        #[test]
        fn registers_compute_the_same_bits(
            a in prop::array::uniform8(prop_oneof![Just(0.0), Just(-0.0), Just(0.5), -2.0f32..2.0]),
            b in prop::array::uniform8(prop_oneof![Just(0.5), Just(f32::MIN_POSITIVE), 1e-30f32..1e30]),
        ) {
            let [portable, wide] = dispatch(Both([&a, &b]));
            prop_assert_eq!(portable, wide);
            let [portable, wide] = dispatch(Both([&a, &a.map(|number| number + 0.0)]));
            prop_assert_eq!([&portable[10 * LANES..], &wide[10 * LANES..]], [[0; LANES]; 2], "no difference is anything");
        }
    }

    #[test]
    fn powers_are_exact_to_a_few_roundings() {
        let off = |got: f32, expected: f64| (f64::from(got) - expected).abs() / expected.abs();
        for n in -8700..=880 {
            let x = n as f32 / 100.0;
            let error = off(exp(Array([x])).0[0], f64::from(x).exp());
            assert!(error < 3e-7, "{x}: {error}");
        }
        assert_eq!(exp(Array([0.0])), Array([1.0]));
        for x in (-8700..=880).map(|n| n as f32 / 100.0).chain((1..40).map(|n| -0.5f32.powi(n))).filter(|x| *x != 0.0) {
            let error = off(exp_m1(Array([x])).0[0], f64::from(x).exp_m1());
            assert!(error < 7e-7, "{x}: {error}");
        }
        assert_eq!(exp_m1(Array([0.0])), Array([0.0]));
        assert_eq!(exp_m1(Array([-1000.0])), Array([-1.0]));
    }
}
