//! One door to wider registers: the same safe code, compiled twice.
//!
//! The kernels are plain code over arrays and [`glam::Vec4`]. What makes them fast is that they are also
//! compiled for AVX2, and which of the two runs is decided once for a job (a band of scanlines). Only
//! the warp's innermost loop, what packets of rays read ([`wide`]) and compute ([`numbers`]), pixels of 16-bit numbers ([`shorts`]) and [`masks`]
//! have twins written in AVX2's own terms ([`Kernel::run_avx2`]). Both give the same bits: nothing here fuses a multiplication with an addition.
//!
//! [`prefetch`] stands here too, for it is the other thing that a processor has and the language has not.
//!
//! A kernel's functions must be `#[inline(always)]` down to the last: what is not inlined into the
//! entry below is compiled without its features.

pub mod masks;
pub mod numbers;
pub mod shorts;
pub mod wide;

/// Bytes that memory is moved by.
#[cfg(target_arch = "x86_64")]
const CACHE_LINE: usize = 64;

/// A job to be compiled for several instruction sets.
pub trait Kernel {
    type Output;

    /// The job. Implementations are `#[inline(always)]`.
    fn run(self) -> Self::Output;

    /// The same where AVX2 is there, for what the compiler does not find by itself.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn run_avx2(self) -> Self::Output
    where
        Self: Sized,
    {
        self.run()
    }
}

/// Runs `kernel` with the widest registers that the machine has.
#[inline(always)]
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
    {
        // SAFETY: the features were just found.
        return unsafe { with_avx2(kernel) };
    }
    kernel.run()
}

/// Asks for the memory of `slice` to be brought near, without waiting for it.
#[inline(always)]
pub fn prefetch<T>(slice: &[T]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let bytes = slice.as_ptr().cast::<i8>();
        for offset in (0..size_of_val(slice)).step_by(CACHE_LINE) {
            // SAFETY: a hint that reads nothing, whatever the address.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(bytes.wrapping_add(offset)) };
        }
    }
}

/// The same for what is `at` elements behind the beginning of `slice`, or where that would be.
#[inline(always)]
pub fn prefetch_at<T>(slice: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint that reads nothing, whatever the address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(slice.as_ptr().wrapping_add(at).cast()) };
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run_avx2()
}
