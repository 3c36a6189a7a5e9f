//! What the scanlines of slices meet of a convex shape.
//!
//! A kernel asks for each scanline of each slice, so that a half-space is told by where along the scanline it begins or ends: a sum, no
//! division.

use glam::DVec3;

use super::rows::{Round, Rows, SlicePlane, Spans};
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
    /// Its balls, as scanlines meet them.
    rounds: Vec<Round>,
    /// Half-spaces that hold all of it, in the same form: its own, and those around its balls.
    bounds: Vec<HalfSpace>,
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

    /// Of `N` scanlines from `v` on the pixels that may meet it between two slices; and those that are within it all the way, since it is
    /// convex. Of half-spaces only those are looked at that `cut` ([`Self::cutting`]).
    #[inline(always)]
    pub fn pixels<const N: usize>(&self, v: usize, slices: &[SlicePlane; 2], cut: Halves) -> [Spans<N>; 2] {
        let (rows, mut spans) = (Rows::new(v, slices), [Spans::ALL; 2]);
        for half in cut.of(&self.clip.halves) {
            rows.cut(half, &mut spans);
        }
        for round in &self.rounds {
            round.cut(&rows, &mut spans);
        }
        spans
    }

    /// Where a block of voxel coordinates is.
    #[inline(always)]
    pub fn meets(&self, block: [DVec3; 2]) -> Meeting {
        if self.bounds.iter().any(|half| along(half, block)[1] < -MARGIN) {
            return Meeting::Outside;
        }
        let is_inside = self.clip.halves.iter().all(|half| along(half, block)[0] > MARGIN)
            && self.rounds.iter().all(|round| round.holds(block));
        if is_inside { Meeting::Inside } else { Meeting::Across }
    }

    /// Which half-spaces may not hold all of a block of voxel coordinates.
    #[inline(always)]
    pub fn cutting(&self, block: [DVec3; 2]) -> Halves {
        let cut = self.bounds.iter().enumerate().filter(|(_, half)| along(half, block)[0] <= MARGIN);
        Halves(cut.fold(0, |halves, (n, _)| halves | Halves::bit(n)))
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

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use proptest::prelude::*;

    use super::*;
    use crate::render::factorization::Lattice;

    proptest! {
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
            let slices = [SlicePlane { lattice: lattices[0], k: 7.0 }, SlicePlane { lattice: lattices[1], k: 8.0 }];
            let [a, b] = slices.map(|SlicePlane { lattice: Lattice { offset, scale }, k }| {
                [(0, vs.start), (width - 1, vs.end - 1)].map(|(u, v)| (offset + DVec2::new(u as f64, v as f64) * scale).extend(k))
            });
            let cut = shape.cutting([a[0].min(b[0]), a[1].max(b[1])]);
            let [told, expected] = [cut, Halves::ALL].map(|halves| shape.pixels::<4>(first, &slices, halves));
            for row in 0..vs.len() {
                let pixels = |spans: &[Spans<4>; 2]| [0, 1].map(|n| spans[n].pixels(row, width));
                prop_assert_eq!(pixels(&told), pixels(&expected));
            }
        }
    }
}
