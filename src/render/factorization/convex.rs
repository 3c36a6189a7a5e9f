//! What the scanlines of slices meet of a convex shape.
//!
//! A kernel asks for each scanline of each slice, so that a half-space is told by where along the scanline it begins or ends: a sum, no
//! division.

use std::ops::Range;

use glam::{DAffine3, DVec3};

use super::Lattice;
use crate::render::view::{Ball, Clip, HalfSpace};

/// Voxels by which rounding may be off.
const MARGIN: f64 = 1e-9;

/// Where something is, as seen from what may hold it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meeting {
    Inside,
    Outside,
    /// Perhaps both.
    Across,
}

/// Some of a shape's half-spaces: a bit for each, the last one for all from it on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Halves(u64);

impl Halves {
    /// All that there may be.
    pub const ALL: Self = Self(u64::MAX);

    #[inline(always)]
    fn bit(n: usize) -> u64 {
        1 << n.min(63)
    }

    /// Those of `halves`.
    #[inline(always)]
    fn of(self, halves: &[HalfSpace]) -> impl Iterator<Item = &HalfSpace> {
        halves.iter().enumerate().filter(move |(n, _)| self.0 & Self::bit(*n) != 0).map(|(_, half)| half)
    }
}

/// A convex shape in voxel coordinates i, j, k.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Convex {
    /// Of half-spaces that a scanline enters or leaves, the first component of the normal is 1 or -1.
    clip: Clip,
    /// What scanlines ask of its balls.
    rounds: Vec<Round>,
    /// Half-spaces that hold all of it, in the same form: its own, and those around its balls.
    bounds: Vec<HalfSpace>,
}

/// A ball, as scanlines along i meet it.
#[derive(Clone, Debug, PartialEq)]
struct Round {
    /// It is the unit ball of this space, in which a step along i is `along`.
    unit_from_voxel: DAffine3,
    along: DVec3,
    /// The square of that step's length.
    square: f64,
    /// From where to where it reaches along i.
    reach: [f64; 2],
}

/// A slice, and where pixels meet it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plane {
    pub lattice: Lattice,
    pub k: f64,
}

impl Convex {
    pub fn new(clip: &Clip) -> Self {
        let halves: Vec<_> = clip.halves.iter().map(along_scanlines).collect();
        let of_balls = clip.balls.iter().flat_map(Ball::bounds).map(|half| along_scanlines(&half));
        let bounds = halves.iter().copied().chain(of_balls).collect();
        let rounds = clip.balls.iter().map(Round::new).collect();
        Self { clip: Clip { halves, balls: clip.balls.clone() }, rounds, bounds }
    }

    /// True where it is everything.
    pub fn is_empty(&self) -> bool {
        self.clip.is_empty()
    }

    /// What of a span of `start + t step` is within it.
    #[inline(always)]
    pub fn span(&self, start: DVec3, step: DVec3, span: [f64; 2]) -> [f64; 2] {
        self.clip.span(start, step, span)
    }

    /// Of `width` pixels of scanline `v` those that may meet it between two slices; and
    /// those that are within it all the way, since it is convex. Of half-spaces only those are looked at that `cut` ([`Self::cutting`]).
    #[inline(always)]
    pub fn pixels(&self, v: usize, slices: &[Plane; 2], width: usize, cut: Halves) -> [Range<usize>; 2] {
        const NOTHING: [f64; 2] = [1.0, 0.0];
        let rows = slices.map(|Plane { lattice: Lattice { offset, scale }, k }| (offset.y + scale * v as f64, k));
        // From places along i, one for either slice, to pixels.
        let per_voxel = slices.map(|Plane { lattice, .. }| 1.0 / lattice.scale);
        let pixels = |i: [f64; 2]| [0, 1].map(|n| (i[n] - slices[n].lattice.offset.x) * per_voxel[n]);

        // What lies between the slices may reach further than on either, or lie between them altogether. But a ray that passes a
        // half-space there passes it on one of the two.
        let mut some = [f64::NEG_INFINITY, f64::INFINITY];
        let mut whole = some;
        for half in cut.of(&self.clip.halves) {
            let distances = rows.map(|(j, k)| distance(half, j, k));
            if half.normal.x > 0.0 {
                let [a, b] = pixels(distances.map(|distance| -distance));
                (some[0], whole[0]) = (some[0].max(a.min(b)), whole[0].max(a.max(b)));
            } else if half.normal.x < 0.0 {
                let [a, b] = pixels(distances);
                (some[1], whole[1]) = (some[1].min(a.max(b)), whole[1].min(a.min(b)));
            } else {
                match distances.map(|distance| distance < 0.0) {
                    [true, true] => return [0..0, 0..0],
                    [false, false] => {}
                    _ => whole = NOTHING,
                }
            }
        }
        for round in &self.rounds {
            let met = rows.map(|(j, k)| round.scanline(j, k));
            let Some([low, high]) = round.between(&met) else { return [0..0, 0..0] };
            let ([low_a, low_b], [high_a, high_b]) = (pixels(low), pixels(high));
            some = [some[0].max(low_a.min(low_b)), some[1].min(high_a.max(high_b))];
            match met.map(|met| round.span(&met)) {
                [Some(first), Some(second)] => {
                    let [low, high] = [0, 1].map(|end| pixels([first[end], second[end]]));
                    whole = [whole[0].max(low[0].max(low[1])), whole[1].min(high[0].min(high[1]))];
                }
                _ => whole = NOTHING,
            }
        }
        [some, whole].map(|[low, high]| {
            let (low, high) = (low.max(0.0).ceil(), high.min((width - 1) as f64).floor());
            if low > high { 0..0 } else { low as usize..high as usize + 1 }
        })
    }

    /// Where a block of voxel coordinates is.
    #[inline(always)]
    pub fn meets(&self, block: [DVec3; 2]) -> Meeting {
        if self.bounds.iter().any(|half| along(half, block)[1] < -MARGIN) {
            return Meeting::Outside;
        }
        let is_inside =
            self.clip.balls.is_empty() && self.clip.halves.iter().all(|half| along(half, block)[0] > MARGIN);
        if is_inside { Meeting::Inside } else { Meeting::Across }
    }

    /// Which half-spaces may not hold all of a block of voxel coordinates.
    #[inline(always)]
    pub fn cutting(&self, block: [DVec3; 2]) -> Halves {
        let cut = self.bounds.iter().enumerate().filter(|(_, half)| along(half, block)[0] <= MARGIN);
        Halves(cut.fold(0, |halves, (n, _)| halves | Halves::bit(n)))
    }
}

/// A scanline of voxels in a ball's space.
#[derive(Clone, Copy)]
struct Met {
    /// Where it is at i = 0.
    from: DVec3,
    /// Of the squared distance from the middle at i, less 1: `along^2 i^2 + 2 slope i + rest`.
    slope: f64,
    rest: f64,
}

impl Round {
    fn new(ball: &Ball) -> Self {
        let unit_from_voxel = ball.unit_from_space();
        let along = unit_from_voxel.matrix3.x_axis;
        let [low, high, ..] = ball.bounds();
        Self { unit_from_voxel, along, square: along.length_squared(), reach: [-low.offset, high.offset] }
    }

    /// The scanline at j of the slice at k.
    #[inline(always)]
    fn scanline(&self, j: f64, k: f64) -> Met {
        let DAffine3 { matrix3, translation } = self.unit_from_voxel;
        let from = translation + matrix3.y_axis * j + matrix3.z_axis * k;
        Met { from, slope: from.dot(self.along), rest: from.length_squared() - 1.0 }
    }

    /// What it has of a scanline, along i.
    #[inline(always)]
    fn span(&self, met: &Met) -> Option<[f64; 2]> {
        let root = met.slope * met.slope - self.square * met.rest;
        (root >= 0.0).then(|| [-root.sqrt(), root.sqrt()].map(|root| (root - met.slope) / self.square))
    }

    /// Where along i a half-space begins, and where another one ends, at a scanline of one slice and of the next, that hold all that it has
    /// between them; `None` where that is nothing. They touch it where the scanline half-way enters and leaves it.
    #[inline(always)]
    fn between(&self, [a, b]: &[Met; 2]) -> Option<[[f64; 2]; 2]> {
        let product = a.from.dot(b.from) - 1.0;
        let (slope, rest) = (0.5 * (a.slope + b.slope), 0.25 * (a.rest + b.rest) + 0.5 * product);
        let root = slope * slope - self.square * rest;
        // From the middle of the ball through i of the scanline half-way: how far along that the other scanlines are, less 1.
        let towards = |i: f64| [a, b].map(|met| 0.5 * (met.rest + product) + i * met.slope);
        if root > 1e-9 * self.square {
            let root = root.sqrt();
            let [enter, leave] = [-root, root].map(|root| (root - slope) / self.square);
            return Some([towards(enter).map(|ahead| ahead / root), towards(leave).map(|ahead| -ahead / root)]);
        }
        // It is missed half-way: nothing is beyond the plane that touches it where it is nearest.
        let nearest = -slope / self.square;
        let distance = (rest + 1.0 + slope * nearest).max(1.0).sqrt();
        if towards(nearest).into_iter().all(|ahead| ahead + 1.0 > distance) {
            return None;
        }
        Some(self.reach.map(|reach| [reach; 2]))
    }
}

/// The least and the greatest distance of a block of voxel coordinates within a half-space.
#[inline(always)]
fn along(half: &HalfSpace, block: [DVec3; 2]) -> [f64; 2] {
    let [a, b] = block.map(|corner| half.normal * corner);
    [a.min(b), a.max(b)].map(|corner| corner.element_sum() + half.offset)
}

/// The same half-space with a first component of 1, 0 or -1.
fn along_scanlines(half: &HalfSpace) -> HalfSpace {
    let size = half.normal.x.abs();
    // What a scanline would meet beyond any volume is met by all of it or by nothing.
    if size <= 1e-12 * half.normal.length() {
        return HalfSpace { normal: half.normal.with_x(0.0), ..*half };
    }
    HalfSpace { normal: half.normal / size, offset: half.offset / size }
}

/// How far within a half-space a scanline begins.
#[inline(always)]
fn distance(half: &HalfSpace, j: f64, k: f64) -> f64 {
    half.normal.y * j + half.normal.z * k + half.offset
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use proptest::prelude::*;

    use super::*;

    /// Whether any point, and whether every point, of some along a pixel's ray between two slices is in a ball.
    fn meets(ball: &Ball, [u, v]: [usize; 2], slices: &[Plane; 2]) -> [bool; 2] {
        let [from, to] = slices
            .map(|Plane { lattice, k }| (lattice.offset + DVec2::new(u as f64, v as f64) * lattice.scale).extend(k));
        let mut inside = (0..=64).map(|n| {
            ball.unit_from_space().transform_point3(from.lerp(to, f64::from(n) / 64.0)).length() <= 1.0 - 1e-9
        });
        let first = inside.next() == Some(true);
        inside.fold([first; 2], |[some, whole], inside| [some || inside, whole && inside])
    }

    #[test]
    fn a_ball_meets_few_pixels_in_vain() {
        let ball = Ball::new(DVec3::new(30.3, 31.2, 30.4), 20.7);
        let shape = Convex::new(&Clip { halves: vec![], balls: vec![ball] });
        let (mut told, mut met) = (0, 0);
        for k in 8..53 {
            let slices = [0.0, 1.0].map(|behind| {
                let k = f64::from(k) + behind;
                Plane { lattice: Lattice { offset: DVec2::new(0.4 * k, -0.3 * k), scale: 1.0 + 0.01 * behind }, k }
            });
            for v in 0..80 {
                told += shape.pixels(v, &slices, 80, Halves::ALL)[0].len();
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
            let shape = Convex::new(&Clip { halves: vec![], balls: vec![ball] });
            let lattices = lattices.map(|(offset, scale)| Lattice { offset: DVec2::from(offset), scale });
            let slices = [Plane { lattice: lattices[0], k: 7.0 }, Plane { lattice: lattices[1], k: 8.0 }];
            let [some, whole] = shape.pixels(v, &slices, 24, Halves::ALL);
            for u in 0..24 {
                let [is_met, is_held] = meets(&ball, [u, v], &slices);
                prop_assert!(some.contains(&u) || !is_met, "{u} is met, not {some:?}");
                prop_assert!(is_held || !whole.contains(&u), "{u} is not held, but {whole:?}");
            }
        }

        #[test]
        fn half_spaces_that_hold_a_whole_block_do_not_matter_in_it(
            halves in prop::collection::vec((prop::array::uniform3(-1.0f64..1.0), 0.0f64..40.0), 0..70),
            balls in prop::collection::vec((prop::array::uniform3(-5.0f64..25.0), 2.0f64..30.0), 0..2),
            lattices in prop::array::uniform2((prop::array::uniform2(-6.0f64..6.0), 0.6f64..1.4)),
            first in 0usize..20,
        ) {
            let halves = halves.into_iter().map(|(normal, offset)| HalfSpace { normal: normal.into(), offset });
            let balls = balls.into_iter().map(|(centre, radius)| Ball::new(centre.into(), radius));
            let shape = Convex::new(&Clip { halves: halves.collect(), balls: balls.collect() });
            let (width, vs) = (24, first..first + 4);
            let lattices = lattices.map(|(offset, scale)| Lattice { offset: DVec2::from(offset), scale });
            let slices = [Plane { lattice: lattices[0], k: 7.0 }, Plane { lattice: lattices[1], k: 8.0 }];
            let [a, b] = slices.map(|Plane { lattice: Lattice { offset, scale }, k }| {
                [(0, vs.start), (width - 1, vs.end - 1)].map(|(u, v)| (offset + DVec2::new(u as f64, v as f64) * scale).extend(k))
            });
            let cut = shape.cutting([a[0].min(b[0]), a[1].max(b[1])]);
            for v in vs {
                prop_assert_eq!(shape.pixels(v, &slices, width, cut), shape.pixels(v, &slices, width, Halves::ALL));
            }
        }
    }
}
