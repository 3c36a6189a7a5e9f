//! One byte for the gradient opacities of several transfer functions.
//!
//! Encodings keep a byte of each voxel's gradient: its gradient opacity. Where labels have different ones, the byte is that of a curve which
//! rises by as much as all of theirs change together. So it tells each of them, off by at most 1/510 of what all change by in all, and
//! of a single one that only rises it is the opacity itself.

use crate::classify::transfer::{GradientPoint, TransferFunction};

/// The least byte of what is not transparent, as a fraction.
const LEAST: f64 = 1.0 / 255.0;

/// The curve that bytes are taken from.
#[derive(Clone, Debug)]
pub(super) struct CommonGradientOpacity {
    /// In ascending order; at a step two of one magnitude, what is below it and what is from it on.
    knots: Vec<Knot>,
}

#[derive(Clone, Copy, Debug)]
struct Knot {
    magnitude: f64,
    side: Side,
    /// Of the curve, 0 to 1.
    rise: f64,
}

#[derive(Clone, Copy, Debug)]
enum Side {
    Below,
    From,
}

impl Knot {
    fn factor(&self, transfer: &TransferFunction) -> f64 {
        match self.side {
            Side::Below => transfer.gradient_factor_below(self.magnitude),
            Side::From => transfer.gradient_factor(self.magnitude),
        }
    }
}

impl CommonGradientOpacity {
    /// `None` where nothing depends on the gradient.
    pub fn new(transfers: &[&TransferFunction]) -> Option<Self> {
        let magnitudes = magnitudes(transfers);
        let mut knots: Vec<Knot> = vec![];
        for magnitude in magnitudes {
            for side in [Side::Below, Side::From] {
                let mut knot = Knot { magnitude, side, rise: 0.0 };
                if let Some(last) = knots.last() {
                    let change = |transfer: &&TransferFunction| (knot.factor(transfer) - last.factor(transfer)).abs();
                    knot.rise = last.rise + transfers.iter().map(change).sum::<f64>();
                }
                knots.push(knot);
            }
        }
        let [first, .., last] = knots[..] else { return None };
        // What is transparent for all where gradients are least has the byte 0.
        let shown = transfers.iter().any(|transfer| first.factor(transfer) > 0.0);
        let start = if shown { LEAST } else { 0.0 };
        for knot in &mut knots {
            knot.rise = if last.rise > 0.0 { start + (1.0 - start) * knot.rise / last.rise } else { start };
        }
        Some(Self { knots })
    }

    /// As a gradient opacity.
    pub fn points(&self) -> Vec<GradientPoint> {
        self.knots.iter().map(|knot| GradientPoint { value: knot.magnitude, opacity: knot.rise }).collect()
    }

    /// What each byte says of one of the transfer functions.
    pub fn factors(&self, transfer: &TransferFunction) -> [f32; 256] {
        std::array::from_fn(|byte| {
            let rise = byte as f64 / 255.0;
            let above = self.knots.partition_point(|knot| knot.rise <= rise);
            let after = &self.knots[above.min(self.knots.len() - 1)];
            let before = &self.knots[above.saturating_sub(1)];
            let (from, to) = (before.factor(transfer), after.factor(transfer));
            if before.rise >= after.rise {
                return from as f32;
            }
            let t = (rise - before.rise) / (after.rise - before.rise);
            // Nothing lies within a step.
            let t = if before.magnitude == after.magnitude { t.round() } else { t };
            (from + (to - from) * t) as f32
        })
    }
}

/// The gradient magnitudes at which any of the curves bends, in ascending order.
pub(super) fn magnitudes(transfers: &[&TransferFunction]) -> Vec<f64> {
    let points = transfers.iter().flat_map(|transfer| &transfer.gradient_opacity);
    let mut magnitudes: Vec<f64> = points.map(|point| point.value).collect();
    magnitudes.sort_unstable_by(f64::total_cmp);
    magnitudes.dedup();
    magnitudes
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn transfer(points: &[(f64, f64)]) -> TransferFunction {
        let gradient_opacity = points.iter().map(|&(value, opacity)| GradientPoint { value, opacity }).collect();
        TransferFunction { points: vec![], opacity_distance: None, gradient_opacity }
    }

    /// The byte at a gradient magnitude, as encodings have it.
    fn byte(common: &CommonGradientOpacity, magnitude: f64) -> usize {
        let curve = TransferFunction { gradient_opacity: common.points(), ..transfer(&[]) };
        (curve.gradient_factor(magnitude) * 255.0).round() as usize
    }

    #[test]
    fn of_one_that_rises_the_byte_is_its_opacity() {
        let one = transfer(&[(2.0, 0.0), (3.0, 0.25), (5.0, 0.25), (7.0, 1.0)]);
        let common = CommonGradientOpacity::new(&[&one, &one]).unwrap();
        for magnitude in [0.0, 2.0, 2.3, 3.0, 4.0, 5.5, 6.9, 7.0, 9.0] {
            assert_eq!(byte(&common, magnitude), (one.gradient_factor(magnitude) * 255.0).round() as usize);
        }
        let factors = common.factors(&one);
        assert!((0..256).all(|byte| (factors[byte] - byte as f32 / 255.0).abs() < 1e-6));
    }

    #[test]
    fn where_nothing_depends_on_the_gradient_there_is_none_and_what_all_hide_is_zero() {
        let flat = transfer(&[]);
        assert!(CommonGradientOpacity::new(&[&flat, &flat]).is_none());
        let (low, high) = (transfer(&[(1.0, 0.0), (2.0, 1.0)]), transfer(&[(4.0, 0.0), (4.0, 0.5)]));
        let common = CommonGradientOpacity::new(&[&low, &high]).unwrap();
        assert_eq!([0.0, 1.0, 2.0, 3.999, 4.0].map(|magnitude| byte(&common, magnitude)), [0, 0, 170, 170, 255]);
        // One that shows everything keeps what another hides.
        let common = CommonGradientOpacity::new(&[&low, &flat]).unwrap();
        assert_eq!([0.0, 2.0].map(|magnitude| byte(&common, magnitude)), [1, 255]);
        assert_eq!([common.factors(&low)[1], common.factors(&flat)[1]], [0.0, 1.0]);
        // A constant.
        let half = transfer(&[(1.0, 0.5)]);
        let common = CommonGradientOpacity::new(&[&half]).unwrap();
        assert_eq!(common.factors(&half)[byte(&common, 3.0)], 0.5);
    }

    proptest! {
        #[test]
        fn a_byte_tells_every_opacity(
            curves in prop::collection::vec(prop::collection::vec((0u8..12, 0.0..1.0), 0..5), 1..5),
            magnitude in 0.0..13.0f64, whole: bool,
        ) {
            let curves: Vec<_> = curves.into_iter().map(|mut points| {
                points.sort_by_key(|point| point.0);
                transfer(&points.iter().map(|&(value, opacity)| (f64::from(value), opacity)).collect::<Vec<_>>())
            }).collect();
            let all: Vec<_> = curves.iter().collect();
            let magnitude = if whole { magnitude.floor() } else { magnitude };
            match CommonGradientOpacity::new(&all) {
                None => prop_assert!(curves.iter().all(|curve| curve.gradient_opacity.is_empty())),
                Some(common) => {
                    let byte = byte(&common, magnitude);
                    // Half a byte of what all curves change by, steps too; one byte of 255 is that of the least that shows.
                    let change = |curve: &TransferFunction| {
                        curve.gradient_opacity.windows(2).map(|pair| (pair[1].opacity - pair[0].opacity).abs()).sum::<f64>()
                    };
                    let bound = 0.5 / 254.0 * curves.iter().map(change).sum::<f64>() + 1e-6;
                    for curve in &curves {
                        let (got, exact) = (f64::from(common.factors(curve)[byte]), curve.gradient_factor(magnitude));
                        prop_assert!((got - exact).abs() <= bound, "{got} {exact} {bound} {curves:?}");
                    }
                }
            }
        }
    }
}
