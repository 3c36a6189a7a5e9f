//! Scanlines side by side: what they meet between two slices.
//!
//! What is told of one is told of all, in one loop without a branch, so that the compiler can take four at once.

use std::ops::Range;

use glam::{DAffine3, DVec3};

use super::Lattice;
use crate::render::view::{Ball, HalfSpace};
use crate::simd::wide::{least, most};

/// A scanline with half a chord of less than that, squared, of a ball of radius 1, no more than touches it.
const TOUCH: f64 = 1e-9;

/// A slice, and where pixels meet it.
#[derive(Clone, Copy, Debug, Default)]
pub struct SlicePlane {
    pub lattice: Lattice,
    pub k: f64,
}

/// From where to where something is on each of `N` scanlines, in pixels; nowhere where `low` is above `high`.
#[derive(Clone, Debug)]
pub struct Spans<const N: usize> {
    low: [f64; N],
    high: [f64; N],
}

impl<const N: usize> Spans<N> {
    pub const ALL: Self = Self { low: [f64::NEG_INFINITY; N], high: [f64::INFINITY; N] };

    /// The pixels of one of the scanlines, which has `width` of them.
    #[inline(always)]
    pub fn pixels(&self, row: usize, width: usize) -> Range<usize> {
        let (low, high) = (self.low[row].max(0.0).ceil(), self.high[row].min((width - 1) as f64).floor());
        if low > high { 0..0 } else { low as usize..high as usize + 1 }
    }

    /// What of one of them is from `low` to `high` too.
    #[inline(always)]
    fn keep(&mut self, row: usize, low: f64, high: f64) {
        self.low[row] = most(self.low[row], low);
        self.high[row] = least(self.high[row], high);
    }
}

impl<const N: usize> Default for Spans<N> {
    fn default() -> Self {
        Self::ALL
    }
}

/// Places along i at a scanline of one slice and of the next.
type Pair = [f64; 2];

/// `N` scanlines of pixels on two slices.
pub struct Rows<const N: usize> {
    /// Where they are along j, by slice.
    j: [[f64; N]; 2],
    k: Pair,
    /// Where pixel 0 is, and pixels from a voxel to the next.
    first: Pair,
    per_voxel: Pair,
}

impl<const N: usize> Rows<N> {
    /// From scanline `v` on.
    #[inline(always)]
    pub fn new(v: usize, slices: &[SlicePlane; 2]) -> Self {
        let mut j = [[0.0; N]; 2];
        for (j, SlicePlane { lattice, .. }) in j.iter_mut().zip(slices) {
            for (row, j) in j.iter_mut().enumerate() {
                *j = lattice.offset.y + lattice.scale * f64::from((v + row) as i32);
            }
        }
        let [a, b] = slices;
        Self {
            j,
            k: [a.k, b.k],
            first: [a.lattice.offset.x, b.lattice.offset.x],
            per_voxel: [1.0 / a.lattice.scale, 1.0 / b.lattice.scale],
        }
    }

    /// The pixel at a place along i of one of the slices.
    #[inline(always)]
    fn pixel(&self, slice: usize, i: f64) -> f64 {
        (i - self.first[slice]) * self.per_voxel[slice]
    }

    /// What of `some` a half-space meets, and of `whole` holds all the way, whose normal's first component is 1, 0 or -1.
    ///
    /// What lies between the slices may reach further than on either, or lie between them altogether. But a ray that passes a
    /// half-space there passes it on one of the two.
    #[inline(always)]
    pub fn cut(&self, half: &HalfSpace, [some, whole]: &mut [Spans<N>; 2]) {
        let HalfSpace { normal, .. } = half;
        let [rest_a, rest_b] = [normal.z * self.k[0] + half.offset, normal.z * self.k[1] + half.offset];
        for row in 0..N {
            // How far within it scanlines begin.
            let (a, b) = (normal.y * self.j[0][row] + rest_a, normal.y * self.j[1][row] + rest_b);
            if normal.x > 0.0 {
                let (a, b) = (self.pixel(0, -a), self.pixel(1, -b));
                some.keep(row, least(a, b), f64::INFINITY);
                whole.keep(row, most(a, b), f64::INFINITY);
            } else if normal.x < 0.0 {
                let (a, b) = (self.pixel(0, a), self.pixel(1, b));
                some.keep(row, f64::NEG_INFINITY, most(a, b));
                whole.keep(row, f64::NEG_INFINITY, least(a, b));
            } else {
                let limit = |is_there: bool| if is_there { f64::INFINITY } else { f64::NEG_INFINITY };
                some.keep(row, f64::NEG_INFINITY, limit((a >= 0.0) | (b >= 0.0)));
                whole.keep(row, f64::NEG_INFINITY, limit((a >= 0.0) & (b >= 0.0)));
            }
        }
    }
}

/// A ball, as scanlines along i meet it.
#[derive(Clone, Debug, PartialEq)]
pub struct Round {
    /// It is the unit ball of this space, in which a step along i is `along`.
    unit_from_voxel: DAffine3,
    along: DVec3,
    /// The square of that step's length.
    square: f64,
    /// From where to where it reaches along i.
    reach: [f64; 2],
}

impl Round {
    pub fn new(ball: &Ball) -> Self {
        let unit_from_voxel = ball.unit_from_space();
        let along = unit_from_voxel.matrix3.x_axis;
        let [low, high, ..] = ball.bounds();
        Self { unit_from_voxel, along, square: along.length_squared(), reach: [-low.offset, high.offset] }
    }

    /// True where it holds a block of voxel coordinates.
    #[inline(always)]
    pub fn holds(&self, block: [DVec3; 2]) -> bool {
        let mut farthest = 0.0;
        for corner in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|axis| block[corner >> axis & 1][axis]);
            farthest = most(farthest, self.unit_from_voxel.transform_point3(DVec3::new(x, y, z)).length_squared());
        }
        farthest < 1.0 - TOUCH
    }

    /// What of `some` it meets, and of `whole` holds all the way.
    ///
    /// What it meets lies within two half-spaces, which touch it where the scanline half-way between the slices enters and leaves it; where
    /// that misses it, nothing is beyond the one that touches it where that is nearest.
    #[inline(always)]
    pub fn cut<const N: usize>(&self, rows: &Rows<N>, [some, whole]: &mut [Spans<N>; 2]) {
        let DAffine3 { matrix3, translation } = self.unit_from_voxel;
        let (step, along, square, per_square) = (matrix3.y_axis, self.along, self.square, 1.0 / self.square);
        let [a, b] = [translation + matrix3.z_axis * rows.k[0], translation + matrix3.z_axis * rows.k[1]];
        for row in 0..N {
            let (ja, jb) = (rows.j[0][row], rows.j[1][row]);
            // In the ball's space, where the scanlines of either slice are at i = 0. The square of the distance from the middle at i is
            // 1 + square i^2 + 2 slope i + rest.
            let (ax, ay, az) = (a.x + step.x * ja, a.y + step.y * ja, a.z + step.z * ja);
            let (bx, by, bz) = (b.x + step.x * jb, b.y + step.y * jb, b.z + step.z * jb);
            let (slope_a, rest_a) = (ax * along.x + ay * along.y + az * along.z, ax * ax + ay * ay + az * az - 1.0);
            let (slope_b, rest_b) = (bx * along.x + by * along.y + bz * along.z, bx * bx + by * by + bz * bz - 1.0);
            let product = ax * bx + ay * by + az * bz - 1.0;

            // Half-way.
            let (slope, rest) = (0.5 * (slope_a + slope_b), 0.25 * (rest_a + rest_b) + 0.5 * product);
            let root = slope * slope - square * rest;
            let is_met = root > TOUCH * square;
            let root = if is_met { root } else { square }.sqrt();
            let per_root = 1.0 / root;
            // From the middle towards a place there, how far along that the scanlines are at i = 0, less 1.
            let (ahead_a, ahead_b) = (0.5 * (rest_a + product), 0.5 * (rest_b + product));
            let (enter, leave) = ((-root - slope) * per_square, (root - slope) * per_square);
            let low = [(ahead_a + enter * slope_a) * per_root, (ahead_b + enter * slope_b) * per_root];
            let high = [-(ahead_a + leave * slope_a) * per_root, -(ahead_b + leave * slope_b) * per_root];
            let nearest = -slope * per_square;
            let distance = most(rest + 1.0 + slope * nearest, 1.0).sqrt() - 1.0;
            let is_beyond = (ahead_a + nearest * slope_a > distance) & (ahead_b + nearest * slope_b > distance);

            let [least_i, most_i] = self.reach;
            let low_a = rows.pixel(0, if is_met { low[0] } else { least_i });
            let low_b = rows.pixel(1, if is_met { low[1] } else { least_i });
            let high_a = rows.pixel(0, if is_met { high[0] } else { most_i });
            let high_b = rows.pixel(1, if is_met { high[1] } else { most_i });
            let is_nowhere = !is_met & is_beyond;
            some.keep(row, least(low_a, low_b), if is_nowhere { f64::NEG_INFINITY } else { most(high_a, high_b) });

            // What both scanlines have of it.
            let (root_a, root_b) = (slope_a * slope_a - square * rest_a, slope_b * slope_b - square * rest_b);
            let is_held = (root_a >= 0.0) & (root_b >= 0.0);
            let (root_a, root_b) = (most(root_a, 0.0).sqrt(), most(root_b, 0.0).sqrt());
            let low_a = rows.pixel(0, (-root_a - slope_a) * per_square);
            let low_b = rows.pixel(1, (-root_b - slope_b) * per_square);
            let high_a = rows.pixel(0, (root_a - slope_a) * per_square);
            let high_b = rows.pixel(1, (root_b - slope_b) * per_square);
            whole.keep(row, most(low_a, low_b), if is_held { least(high_a, high_b) } else { f64::NEG_INFINITY });
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use proptest::prelude::*;

    use super::*;

    /// Whether any point, and whether every point, of some along a pixel's ray between two slices is in a ball.
    fn meets(ball: &Ball, [u, v]: [usize; 2], slices: &[SlicePlane; 2]) -> [bool; 2] {
        let [from, to] = slices.map(|SlicePlane { lattice, k }| {
            (lattice.offset + DVec2::new(u as f64, v as f64) * lattice.scale).extend(k)
        });
        let mut inside = (0..=64).map(|n| {
            ball.unit_from_space().transform_point3(from.lerp(to, f64::from(n) / 64.0)).length() <= 1.0 - 1e-9
        });
        let first = inside.next() == Some(true);
        inside.fold([first; 2], |[some, whole], inside| [some || inside, whole && inside])
    }

    fn met_by<const N: usize>(ball: &Ball, v: usize, slices: &[SlicePlane; 2]) -> [Spans<N>; 2] {
        let mut spans = [Spans::ALL; 2];
        Round::new(ball).cut(&Rows::new(v, slices), &mut spans);
        spans
    }

    #[test]
    fn a_ball_meets_few_pixels_in_vain() {
        let ball = Ball::new(DVec3::new(30.3, 31.2, 30.4), 20.7);
        let (mut told, mut met) = (0, 0);
        for k in 8..53 {
            let slices = [0.0, 1.0].map(|behind| {
                let k = f64::from(k) + behind;
                SlicePlane { lattice: Lattice { offset: DVec2::new(0.4 * k, -0.3 * k), scale: 1.0 + 0.01 * behind }, k }
            });
            let spans = met_by::<80>(&ball, 0, &slices);
            for v in 0..80 {
                told += spans[0].pixels(v, 80).len();
                met += (0..80).filter(|u| meets(&ball, [*u, v], &slices)[0]).count();
            }
        }
        assert!(told >= met && told - met < met / 20, "{told} of {met}");
    }

    proptest! {
        #[test]
        fn what_a_ball_meets_and_what_it_holds_is_told(
            centre in prop::array::uniform3(-5.0f64..25.0),
            radius in 0.2f64..30.0,
            lattices in prop::array::uniform2((prop::array::uniform2(-6.0f64..6.0), 0.6f64..1.4)),
            v in 0usize..24,
        ) {
            let ball = Ball::new(centre.into(), radius);
            let lattices = lattices.map(|(offset, scale)| Lattice { offset: DVec2::from(offset), scale });
            let slices = [SlicePlane { lattice: lattices[0], k: 7.0 }, SlicePlane { lattice: lattices[1], k: 8.0 }];
            let [some, whole] = met_by::<1>(&ball, v, &slices).map(|spans| spans.pixels(0, 24));
            for u in 0..24 {
                let [is_met, is_held] = meets(&ball, [u, v], &slices);
                prop_assert!(some.contains(&u) || !is_met, "{u} is met, not {some:?}");
                prop_assert!(is_held || !whole.contains(&u), "{u} is not held, but {whole:?}");
            }
        }
    }
}
