//! From a looked-up slab to one of the view's length and the samples' density.
//!
//! Where the table was made for the view's own slab length there is nothing to do. A table for the
//! distance of slices suits other lengths after a correction of opacity and colour, alpha' = 1 -
//! (1 - alpha)^(d'/d) and c' = c alpha'/alpha (Schulze et al. 2003; Lacroute and Levoy 1994, section
//! 3.1), the power being read from a table. And where gradient opacity scales the extinction sample
//! by sample, the table holds optical depths, which are scaled by it.
//!
//! Which of the three it is is a type parameter of the kernel.

use glam::Vec4;

/// What a slab is made into.
pub trait Correction: Copy + Send + Sync {
    /// Premultiplied colour and opacity of a slab as the table has it; exactly zero for zero. `density` is
    /// the mean gradient opacity of its two samples, `length` the slab's in units of the view's (1 where
    /// all rays have that).
    fn correct(self, slab: Vec4, density: f32, length: f32) -> Vec4;
}

/// The table has what is wanted.
#[derive(Clone, Copy, Debug)]
pub struct AsItIs;

impl Correction for AsItIs {
    #[inline(always)]
    fn correct(self, slab: Vec4, _: f32, _: f32) -> Vec4 {
        slab
    }
}

/// The table holds optical depths, to be scaled by the density and by a length.
#[derive(Clone, Copy, Debug)]
pub struct Scaled {
    /// Lengths of the view's slabs in units of the table's.
    pub length: f32,
}

impl Correction for Scaled {
    #[inline(always)]
    fn correct(self, slab: Vec4, density: f32, length: f32) -> Vec4 {
        let alpha = -(-slab.w * (density * self.length * length)).exp_m1();
        let scale = if slab.w > 0.0 { alpha / slab.w } else { 0.0 };
        (slab * scale).with_w(alpha)
    }
}

/// The table holds opacities of another length.
#[derive(Clone, Copy, Debug)]
pub struct LookedUp<'a>(pub &'a OpacityCorrectionTable);

impl Correction for LookedUp<'_> {
    #[inline(always)]
    fn correct(self, slab: Vec4, _: f32, _: f32) -> Vec4 {
        slab * self.0.ratio(slab.w)
    }
}

/// The table holds opacities of the view's middle length, or of a fixed one, and rays differ.
///
/// `1 - (1 - a)^r` is near `a r (1 - a/2) / (1 - (1 - r/2) a)`: the same value and the same first and second
/// derivative at 0, the same value at 1. For rays up to twice as long as the table's it is off by less than
/// 0.012, and it takes a division where a power takes a logarithm and an exponential.
#[derive(Clone, Copy, Debug)]
pub struct RayByRay {
    /// Lengths of the view's slabs in units of the table's.
    pub length: f32,
}

impl Correction for RayByRay {
    #[inline(always)]
    fn correct(self, slab: Vec4, _: f32, length: f32) -> Vec4 {
        slab * opacity_ratio(slab.w, self.length * length)
    }
}

/// Near `(1 - (1 - alpha)^length) / alpha`, see [`RayByRay`].
#[inline(always)]
pub fn opacity_ratio(alpha: f32, length: f32) -> f32 {
    if length < 0.999 {
        return shorter(alpha, length);
    }
    let half = 0.5 * length;
    let ratio = length * (1.0 - 0.5 * alpha) / (1.0 - (1.0 - half) * alpha);
    // Rays more than twice as long overshoot.
    ratio.min(1.0 / alpha)
}

/// The same, exact: for the one slab that begins at an eye between two slices.
#[inline(never)]
fn shorter(alpha: f32, length: f32) -> f32 {
    if alpha > 0.0 { (1.0 - (1.0 - alpha).powf(length)) / alpha } else { length }
}

/// alpha' / alpha by alpha, interpolated between its entries.
#[derive(Clone, Debug)]
pub struct OpacityCorrectionTable {
    ratios: Vec<f32>,
}

impl OpacityCorrectionTable {
    /// Intervals of the table: the function is smooth, and what interpolation misses is far below a step
    /// of 8 bits.
    const STEPS: usize = 1024;

    /// For slabs of `length` times that for which opacities are.
    pub fn new(length: f64) -> Self {
        let ratio = |step: usize| {
            let alpha = step as f64 / Self::STEPS as f64;
            let corrected = if step == 0 { length } else { (1.0 - (1.0 - alpha).powf(length)) / alpha };
            corrected as f32
        };
        Self { ratios: (0..=Self::STEPS).map(ratio).collect() }
    }

    #[inline(always)]
    fn ratio(&self, alpha: f32) -> f32 {
        let at = alpha * Self::STEPS as f32;
        let step = (at as u32 as usize).min(Self::STEPS - 1);
        let (low, high) = (self.ratios[step], self.ratios[step + 1]);
        low + (high - low) * (at - step as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corrected_slab_is_that_of_the_other_length() {
        for length in [1.0, 1.2, 3f64.sqrt()] {
            let table = OpacityCorrectionTable::new(length);
            for step in 0..=1000 {
                let alpha = f64::from(step) / 1000.0;
                let slab = Vec4::new(0.5, 0.25, 1.0, 1.0) * alpha as f32;
                let corrected = LookedUp(&table).correct(slab, 1.0, 1.0);
                let expected = 1.0 - (1.0 - alpha).powf(length);
                assert!((f64::from(corrected.w) - expected).abs() < 2e-5, "{alpha} {length}");
                assert!((corrected.x - 0.5 * corrected.w).abs() < 1e-6);
            }
            assert_eq!(LookedUp(&table).correct(Vec4::ZERO, 1.0, 1.0), Vec4::ZERO);
        }
    }

    #[test]
    fn a_depth_scaled_by_nothing_is_its_opacity() {
        let slab = Vec4::new(0.7, 0.35, 0.0, 0.7);
        let opacity = 1.0 - (-0.7f32).exp();
        let got = Scaled { length: 1.0 }.correct(slab, 1.0, 1.0);
        assert!((got - Vec4::new(opacity, opacity / 2.0, 0.0, opacity)).abs().max_element() < 1e-6);
        assert_eq!(Scaled { length: 2.0 }.correct(Vec4::ZERO, 0.5, 1.0), Vec4::ZERO);
        assert_eq!(Scaled { length: 2.0 }.correct(slab, 0.0, 1.0), Vec4::ZERO);
    }

    #[test]
    fn a_rational_function_is_near_the_power_for_rays_of_similar_length() {
        for (length, tolerance) in [(0.1, 1e-6), (0.9, 1e-6), (1.0, 1e-6), (1.1, 0.006), (1.5, 0.012), (2.0, 1e-6)] {
            for step in 0..=100 {
                let alpha = f64::from(step) / 100.0;
                let slab = Vec4::splat(alpha as f32);
                let corrected = RayByRay { length: 2.0 }.correct(slab, 1.0, length as f32 / 2.0);
                let expected = 1.0 - (1.0 - alpha).powf(length);
                assert!((f64::from(corrected.w) - expected).abs() < tolerance, "{alpha} {length}: {}", corrected.w);
            }
        }
        let over = RayByRay { length: 4.0 }.correct(Vec4::splat(0.6), 1.0, 1.0);
        assert_eq!(over, Vec4::ONE);
    }
}
