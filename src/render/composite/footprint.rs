//! The voxels under a pixel where slices are scaled (Lacroute and Levoy 1994, section 3.2).
//!
//! Pixels of a scaled slice lie `scale` voxels apart, so a pixel stands for more than two voxels along
//! each axis and several voxel scanlines fall on one of the image. Lacroute reconstructs with a box as
//! wide as a voxel and filters with a box as wide as a pixel: a voxel's weight is what its unit interval
//! shares with the interval of `scale` voxels around the pixel's centre. At scale one that is the
//! bilinear filter; where a slice is enlarged the filter stays that.
//!
//! The filter is separable, each axis has a footprint of its own. The slice's outermost voxels go on to
//! infinity, so that the weights of a pixel add up to 1 wherever it is.

use std::ops::Range;

use crate::render::factorization::Lattice;

/// A slice's pixels along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Pixel `u` has its centre at voxel `offset + scale u`.
    offset: f64,
    scale: f64,
    /// Half of what a pixel stands for, voxels.
    half: f64,
    /// One over what it stands for.
    per_width: f64,
    voxels: usize,
    taps: usize,
}

impl Footprint {
    /// Along axis 0 (u, of `voxels` along i) or 1 (v, along j) of a slice.
    pub fn new(lattice: &Lattice, axis: usize, voxels: usize) -> Self {
        let width = lattice.scale.max(1.0);
        let taps = (width.ceil() as usize + 1).min(voxels);
        Self {
            offset: lattice.offset[axis],
            scale: lattice.scale,
            half: width / 2.0,
            per_width: 1.0 / width,
            voxels,
            taps,
        }
    }

    /// Voxels under a pixel, those of weight 0 included: the same number for all.
    #[inline(always)]
    pub fn taps(&self) -> usize {
        self.taps
    }

    /// The first voxel under pixel `u`.
    #[inline(always)]
    pub fn first(&self, u: usize) -> usize {
        let from = self.offset + self.scale * number(u) - self.half;
        // Truncation is floor: what is below 0 goes to 0 either way.
        ((from + 0.5) as usize).min(self.voxels - self.taps)
    }

    /// The weight of voxel `i` under pixel `u`.
    #[inline(always)]
    pub fn weight(&self, u: usize, i: usize) -> f32 {
        let centre = self.offset + self.scale * number(u);
        let (low, high) = (centre - self.half, centre + self.half);
        let (from, to) = (number(i) - 0.5, number(i) + 0.5);
        // Nothing here is no number, which `f64::max` would look for.
        let begin = if i == 0 || low > from { low } else { from };
        let end = if i + 1 == self.voxels || high < to { high } else { to };
        let under = if end > begin { end - begin } else { 0.0 };
        (under * self.per_width) as f32
    }

    /// The pixels, of `count`, whose centres lie on the slice.
    pub fn inside(&self, count: usize) -> Range<usize> {
        let last = (self.voxels - 1) as f64;
        if self.scale == 0.0 {
            return if (0.0..=last).contains(&self.offset) { 0..count } else { 0..0 };
        }
        let (low, high) = ((-self.offset / self.scale).ceil(), ((last - self.offset) / self.scale).floor());
        if high < low.max(0.0) { 0..0 } else { (low as usize).min(count)..(high as usize + 1).min(count) }
    }

    /// Pixels that stand for something between voxel positions `low` and `high`: all that do, and
    /// perhaps a neighbour.
    #[inline(always)]
    pub fn touching(&self, low: f64, high: f64) -> Range<usize> {
        if self.scale == 0.0 {
            return 0..usize::MAX;
        }
        let first = (low - self.half - self.offset) / self.scale;
        let last = (high + self.half - self.offset) / self.scale;
        // Casts saturate. A hair wider than exact, so that rounding leaves no pixel out.
        let first = (first - 1e-6).ceil() as usize;
        first..((last + 1e-6).floor() + 1.0).max(0.0) as usize
    }

    /// The voxels under the pixels `us`, which are not none.
    #[inline(always)]
    pub fn under(&self, us: &Range<usize>) -> Range<usize> {
        self.first(us.start)..self.first(us.end - 1) + self.taps
    }
}

/// A count below 2^32: one instruction, where any count takes four.
#[inline(always)]
fn number(count: usize) -> f64 {
    f64::from(count as u32)
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;

    fn footprint(offset: f64, scale: f64, voxels: usize) -> Footprint {
        Footprint::new(&Lattice { offset: DVec2::splat(offset), scale }, 0, voxels)
    }

    const CASES: [(f64, f64, usize); 9] = [
        (0.0, 1.0, 30),
        (-0.3, 1.0, 2),
        (-3.25, 1.37, 40),
        (2.1, 1.999, 33),
        (-10.0, 2.0, 33),
        (0.5, 7.3, 20),
        (3.3, 0.13, 9),
        (4.25, 0.0, 12),
        (-3.0, 40.0, 17),
    ];

    #[test]
    fn weights_are_shares_of_the_pixels_interval_and_add_up_to_one() {
        for (offset, scale, voxels) in CASES {
            let f = footprint(offset, scale, voxels);
            for u in 0..50 {
                let first = f.first(u);
                let weights: Vec<f32> = (first..first + f.taps()).map(|i| f.weight(u, i)).collect();
                assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{f:?} {u}: {weights:?}");
                let others = (0..voxels).filter(|i| !(first..first + f.taps()).contains(i));
                assert!(others.into_iter().all(|i| f.weight(u, i) < 1e-9), "{f:?} {u}");
            }
        }
    }

    #[test]
    fn at_scale_one_the_filter_is_bilinear() {
        let f = footprint(-2.25, 1.0, 10);
        assert_eq!((f.taps(), f.first(5)), (2, 2));
        assert_eq!([2, 3].map(|i| f.weight(5, i)), [0.25, 0.75]);
    }

    #[test]
    fn pixels_that_touch_voxels_are_those_that_give_them_weight() {
        for (offset, scale, voxels) in CASES {
            let f = footprint(offset, scale, voxels);
            for i in 1..voxels - 1 {
                let touching = f.touching(i as f64 - 0.5, i as f64 + 0.5);
                for u in 0..50 {
                    let distance = (offset + scale * f64::from(u) - i as f64).abs() - f.half - 0.5;
                    let near = distance < 2.0 * scale || scale == 0.0;
                    let weighs = f.weight(u as usize, i) > 0.0;
                    let touches = touching.contains(&(u as usize));
                    assert!(touches || !weighs, "{f:?}: voxel {i}, pixel {u}");
                    assert!(near || !touches, "{f:?}: voxel {i}, pixel {u} from afar");
                }
            }
        }
    }

    #[test]
    fn pixels_inside_have_their_centres_on_the_slice() {
        for (offset, scale, voxels) in CASES {
            let f = footprint(offset, scale, voxels);
            for u in 0..50 {
                let centre = offset + scale * u as f64;
                assert_eq!(f.inside(50).contains(&u), (0.0..=(voxels - 1) as f64).contains(&centre), "{f:?} {u}");
            }
        }
    }
}
