//! Opacity correction by a lookup table (Lacroute and Levoy 1994, section 3.1; Schulze et al. 2003).
//!
//! A slab that is `r` times as long as the table's has the opacity `1 - (1 - alpha)^r` in place of
//! `alpha`, and its premultiplied colour in the same proportion. The table holds that proportion by
//! opacity, so that one multiplication corrects all four. It is exact at both ends: nothing stays
//! nothing, and opaque stays opaque.

use glam::Vec4;

use super::fixed::cell;

/// Intervals of the table: 4 kB.
const INTERVALS: usize = 1024;

/// Slabs of one length from slabs of another.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectionTable {
    /// Corrected opacity per opacity, from 0 to 1; and once more at 1.
    factors: [f32; INTERVALS + 2],
}

impl CorrectionTable {
    /// For slabs that are `ratio` (above 0) times as long as those that are corrected.
    pub fn new(ratio: f32) -> Self {
        let ratio = f64::from(ratio);
        let factors = std::array::from_fn(|at| {
            let opacity = (at as f64 / INTERVALS as f64).min(1.0);
            let factor = if at == 0 { ratio } else { -(ratio * (-opacity).ln_1p()).exp_m1() / opacity };
            factor as f32
        });
        Self { factors }
    }

    /// Premultiplied colour and opacity, corrected.
    #[inline(always)]
    pub fn correct(&self, slab: Vec4) -> Vec4 {
        let (interval, share) = cell(slab.w * INTERVALS as f32);
        let ends = &self.factors[interval..interval + 2];
        slab * (ends[0] + (ends[1] - ends[0]) * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transparent_and_opaque_are_kept_exactly() {
        for ratio in [0.25, 1.0, 1.7] {
            let table = CorrectionTable::new(ratio);
            assert_eq!(table.correct(Vec4::ZERO), Vec4::ZERO);
            assert_eq!(table.correct(Vec4::new(0.5, 0.25, 1.0, 1.0)), Vec4::new(0.5, 0.25, 1.0, 1.0));
        }
    }

    #[test]
    fn opacity_and_colour_follow_the_length() {
        for ratio in [1.0, 1.2, 1.7, 3.0] {
            let table = CorrectionTable::new(ratio);
            for step in 0..=3000 {
                let opacity = step as f32 / 3000.0;
                let corrected = table.correct(Vec4::new(opacity, 0.5 * opacity, 0.0, opacity));
                let exact = 1.0 - (1.0 - opacity).powf(ratio);
                assert!((corrected.w - exact).abs() < 1e-5, "{opacity} over {ratio}: {}, not {exact}", corrected.w);
                assert_eq!(corrected.x, corrected.w);
                assert_eq!(corrected.y, 0.5 * corrected.w);
            }
        }
    }
}
