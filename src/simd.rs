//! One door to wider registers: the same safe code, compiled twice.
//!
//! The kernels are plain code over arrays and [`glam::Vec4`], without intrinsics. What makes them
//! fast is that they are also compiled for AVX2, and which of the two runs is decided once for a job
//! (a band of scanlines). Both give the same bits: nothing here fuses a multiplication with an
//! addition.
//!
//! A kernel's functions must be `#[inline(always)]` down to the last: what is not inlined into the
//! entry below is compiled without its features.

/// A job to be compiled for several instruction sets.
pub trait Kernel {
    type Output;

    /// The job. Implementations are `#[inline(always)]`.
    fn run(self) -> Self::Output;
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

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}
