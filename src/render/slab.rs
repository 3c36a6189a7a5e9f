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
    /// the mean gradient opacity of its two samples.
    fn correct(self, slab: Vec4, density: f32) -> Vec4;
}

/// The table has what is wanted.
#[derive(Clone, Copy, Debug)]
pub struct AsItIs;

impl Correction for AsItIs {
    #[inline(always)]
    fn correct(self, slab: Vec4, _: f32) -> Vec4 {
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
    fn correct(self, slab: Vec4, density: f32) -> Vec4 {
        let alpha = -(-slab.w * (density * self.length)).exp_m1();
        let scale = if slab.w > 0.0 { alpha / slab.w } else { 0.0 };
        (slab * scale).with_w(alpha)
    }
}

/// The table holds opacities of another length.
#[derive(Clone, Copy, Debug)]
pub struct LookedUp<'a>(pub &'a OpacityCorrectionTable);

impl Correction for LookedUp<'_> {
    #[inline(always)]
    fn correct(self, slab: Vec4, _: f32) -> Vec4 {
        slab * self.0.ratio(slab.w)
    }
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
                let corrected = LookedUp(&table).correct(slab, 1.0);
                let expected = 1.0 - (1.0 - alpha).powf(length);
                assert!((f64::from(corrected.w) - expected).abs() < 2e-5, "{alpha} {length}");
                assert!((corrected.x - 0.5 * corrected.w).abs() < 1e-6);
            }
            assert_eq!(LookedUp(&table).correct(Vec4::ZERO, 1.0), Vec4::ZERO);
        }
    }

    #[test]
    fn a_depth_scaled_by_nothing_is_its_opacity() {
        let slab = Vec4::new(0.7, 0.35, 0.0, 0.7);
        let opacity = 1.0 - (-0.7f32).exp();
        let got = Scaled { length: 1.0 }.correct(slab, 1.0);
        assert!((got - Vec4::new(opacity, opacity / 2.0, 0.0, opacity)).abs().max_element() < 1e-6);
        assert_eq!(Scaled { length: 2.0 }.correct(Vec4::ZERO, 0.5), Vec4::ZERO);
        assert_eq!(Scaled { length: 2.0 }.correct(slab, 0.0), Vec4::ZERO);
    }
}
