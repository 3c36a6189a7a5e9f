//! What every range of the scalar axis between two entries holds, whatever a slab's length.
//!
//! A slab from entry `f` to entry `b` stretches the range between them over its length, so its optical
//! depth `u` is the range's own times a factor. What it emits depends on where along that depth the
//! range has its colours: with the colour `c(w)` as a function of the share `w` of the depth passed,
//!
//! ```text
//! color = int_0^1 c(w) u exp(-u w) dw
//! ```
//!
//! As long as `u` is small, `exp(-u w)` is nearly linear in `w`, and two moments of `c` are all that
//! matters; the third tells how much is missing, `u^3 / 12` times as much. So a range is kept as
//! three moments over its depth ([`Moments`]). They are exact, by a rule for two ranges that follow
//! one another; a slab that is too deep for them is cut in two until its parts are not, or are
//! the stretches that the medium itself is cut into. Most slabs of most transfer functions need no cut: a
//! table of 256 entries for another length takes an exponential for each entry and little else,
//! where integrating each anew takes 256 / 3 of them. The ranges themselves are made once for a transfer
//! function.

use glam::Vec4;
use rayon::prelude::*;

use super::Form;
use super::medium::{Medium, Stretch};
use crate::simd::wide::{LANES, Lanes, least, most};
use crate::simd::{self, Kernel};

/// Colours err by at most this where a range is taken for its two moments: a thirtieth of what 8 bits
/// tell apart.
const TOLERANCE: f32 = 1.0 / 8192.0;

/// Moments of the colour over a range's share of optical depth, `w` from 0 to 1: of 1, of
/// 6 (w - 1/2) and of 6 w^2 - 6 w + 1. Of a colour linear in `w`, the second is half the change.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    mean: Vec4,
    tilt: Vec4,
    bend: Vec4,
}

impl Moments {
    fn of(stretch: &Stretch) -> Self {
        let [low, high] = stretch.colors.map(|color| color.as_vec3().extend(0.0));
        Self { mean: (low + high) * 0.5, tilt: (high - low) * 0.5, bend: Vec4::ZERO }
    }

    /// Of two ranges, one after the other, the first with a share `p` of their depth.
    fn then(self, next: Self, p: f32) -> Self {
        let (a, b, q) = (self, next, 1.0 - p);
        let change = b.mean - a.mean;
        Self {
            mean: a.mean * p + b.mean * q,
            tilt: a.tilt * (p * p) + b.tilt * (q * q) + change * (3.0 * p * q),
            bend: a.bend * (p * p * p) + b.bend * (q * q * q) + (b.tilt * q - a.tilt * p + change * (p - q)) * (p * q),
        }
    }
}

/// A range between two entries.
#[derive(Clone, Copy, Debug)]
struct Range {
    /// Mean colour over its optical depth; in `w` the depth itself, 1 / mm times codes.
    mean: Vec4,
    /// Half the change of colour over its depth; in `w` the largest third moment.
    tilt: Vec4,
}

/// Ranges from an entry to eight others, by component.
#[derive(Clone, Copy, Debug, Default)]
struct EightRanges {
    /// Mean colour and depth.
    mean: [Lanes; 4],
    /// Half the change, and the largest third moment.
    tilt: [Lanes; 4],
}

/// Slabs from an entry to eight others and back, by component.
#[derive(Clone, Copy, Debug)]
pub struct EightSlabs {
    /// Premultiplied colour towards the later entry, and opacity.
    pub up: [Lanes; 4],
    /// The same of the way back.
    pub down: [Lanes; 4],
    /// Optical depth.
    pub depth: Lanes,
}

/// All ranges between a table's entries.
#[derive(Clone, Debug)]
pub struct Ranges {
    /// Code of each entry.
    codes: Vec<f64>,
    /// Stretches between an entry and the next, from `starts[entry]` to `starts[entry + 1]`.
    stretches: Vec<Range>,
    starts: Vec<u32>,
    /// From each entry on to each later one, by eights: from entry f to b in `[f]`, lane b - f - 1.
    ranges: Vec<Vec<EightRanges>>,
    /// Colour, and extinction per mm, at each entry.
    media: Vec<Vec4>,
}

impl Ranges {
    /// The ranges of `medium` between the given codes, in ascending order.
    pub fn new(medium: &Medium, codes: Vec<f64>) -> Self {
        let entries = codes.len();
        let mut stretches = Vec::new();
        let mut starts = vec![0];
        let mut intervals = Vec::with_capacity(entries - 1);
        let mut running = vec![0.0];
        for ends in codes.windows(2) {
            let first = stretches.len();
            medium.stretches(ends[0], ends[1], &mut stretches);
            let (mut moments, mut depth) = (Moments::default(), 0.0);
            for stretch in &stretches[first..] {
                depth += stretch.depth;
                let share = if depth > 0.0 { 1.0 - stretch.depth / depth } else { 0.0 };
                moments = moments.then(Moments::of(stretch), share as f32);
            }
            intervals.push(moments);
            starts.push(stretches.len() as u32);
            running.push(running[running.len() - 1] + depth);
        }
        let media = codes.iter().map(|&code| {
            let (extinction, color) = medium.at(code);
            color.as_vec3().extend(extinction as f32)
        });
        let media = media.collect();
        let stretches = stretches.iter().map(|stretch| Range::new(Moments::of(stretch), stretch.depth)).collect();
        let ranges = (0..entries).into_par_iter().map(|from| {
            let mut moments = Moments::default();
            let to_each = (from..entries - 1).map(|at| {
                let depth = running[at + 1] - running[from];
                let share = if depth > 0.0 { (running[at] - running[from]) / depth } else { 0.0 };
                moments = moments.then(intervals[at], share as f32);
                Range::new(moments, depth)
            });
            let mut eights = Vec::with_capacity((entries - from).div_ceil(LANES));
            for (n, range) in to_each.enumerate() {
                if n % LANES == 0 {
                    eights.push(EightRanges::default());
                }
                eights[n / LANES].set(n % LANES, range);
            }
            eights
        });
        Self { ranges: ranges.collect(), codes, stretches, starts, media }
    }

    /// Code of each entry.
    pub fn codes(&self) -> &[f64] {
        &self.codes
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        let Self { codes, stretches, starts, ranges, media } = self;
        let ranges: usize = ranges.iter().map(|row| size_of_val(&row[..])).sum();
        (ranges
            + size_of_val(&codes[..])
            + size_of_val(&stretches[..])
            + size_of_val(&starts[..])
            + size_of_val(&media[..])) as u64
    }

    /// The slab of `length` mm of the one scalar at `entry`.
    pub fn constant(&self, entry: usize, length: f32, form: Form) -> Vec4 {
        let medium = self.media[entry];
        let depth = medium.w * length;
        let [[opacity], _] = light(&[depth]);
        form.slab((medium * opacity).with_w(opacity), depth)
    }

    /// The slabs of `length` mm from an entry to each later one, and back. Of the last eight those past the last entry mean nothing.
    pub fn slabs(&self, from: usize, length: f32) -> Vec<EightSlabs> {
        simd::dispatch(Row { ranges: self, from, length })
    }

    /// The range between two entries.
    fn range(&self, from: usize, to: usize) -> Range {
        let n = to - from - 1;
        let EightRanges { mean, tilt } = &self.ranges[from][n / LANES];
        let of = |lanes: &[Lanes; 4]| Vec4::from_array(lanes.map(|lanes| lanes[n % LANES]));
        Range { mean: of(mean), tilt: of(tilt) }
    }

    /// Composites the range between two entries behind the first of `slabs` and before the second.
    fn composite(&self, from: usize, to: usize, scale: f32, slabs: &mut [Vec4; 2]) {
        let range = self.range(from, to);
        let depth = range.mean.w * scale;
        if depth * depth * depth * range.tilt.w <= 12.0 * TOLERANCE {
            range.composite(depth, slabs);
        } else if to - from > 1 {
            let middle = from.midpoint(to);
            self.composite(from, middle, scale, slabs);
            self.composite(middle, to, scale, slabs);
        } else {
            let stretches = self.starts[from] as usize..self.starts[to] as usize;
            for stretch in &self.stretches[stretches] {
                stretch.composite(stretch.mean.w * scale, slabs);
            }
        }
    }
}

impl EightRanges {
    fn set(&mut self, lane: usize, range: Range) {
        for n in 0..4 {
            self.mean[n][lane] = range.mean[n];
            self.tilt[n][lane] = range.tilt[n];
        }
    }
}

/// The slabs of one front entry.
struct Row<'a> {
    ranges: &'a Ranges,
    from: usize,
    length: f32,
}

impl Kernel for Row<'_> {
    type Output = Vec<EightSlabs>;

    /// What [`Ranges::composite`] does to one, for eight at once: as they are, or cut in two; those that must be cut again are left to it.
    #[inline(always)]
    fn run(self) -> Self::Output {
        let Self { ranges, from, length } = self;
        let codes = &ranges.codes;
        let mut slabs = Vec::with_capacity(ranges.ranges[from].len());
        for (at, eight) in ranges.ranges[from].iter().enumerate() {
            let first = from + 1 + at * LANES;
            let mut gaps = [0.0; LANES];
            match codes.get(first..).and_then(<[f64]>::first_chunk::<LANES>) {
                Some(codes_to) => {
                    for n in 0..LANES {
                        gaps[n] = (codes_to[n] - codes[from]) as f32;
                    }
                }
                None => {
                    for n in 0..LANES {
                        gaps[n] = (codes[(first + n).min(codes.len() - 1)] - codes[from]) as f32;
                    }
                }
            }
            let mut scale = [0.0; LANES];
            for n in 0..LANES {
                scale[n] = length / gaps[n];
            }
            let (mut found, mut deep) = eight.slabs(&scale);
            deep &= (1u64 << (codes.len() - first).min(LANES)).wrapping_sub(1) as u32;
            if deep != 0 {
                // Most are not too deep once they are cut in two.
                let [near, far] = ranges.halves(from, first, deep).map(|halves| halves.slabs(&scale));
                let (cut, still_deep) = (EightSlabs::over(&near.0, &far.0, found.depth), near.1 | far.1);
                let mut left = deep;
                while left != 0 {
                    let n = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let to = first + n;
                    if still_deep >> n & 1 == 1 || to == from + 1 {
                        let mut slabs = [Vec4::ZERO; 2];
                        ranges.composite(from, to, scale[n], &mut slabs);
                        found.set(n, slabs);
                    } else {
                        found.set(n, cut.lane(n));
                    }
                }
            }
            slabs.push(found);
        }
        slabs
    }
}

impl Ranges {
    /// The ranges from an entry to the one in the middle of each of eight ranges from it, and from there on: in those `lanes` that are set, and have a middle.
    #[inline(always)]
    fn halves(&self, from: usize, first: usize, lanes: u32) -> [EightRanges; 2] {
        let mut halves = [EightRanges::default(); 2];
        for n in 0..LANES {
            let to = first + n;
            if lanes >> n & 1 == 1 && to > from + 1 {
                let middle = from.midpoint(to);
                halves[0].set(n, self.range(from, middle));
                halves[1].set(n, self.range(middle, to));
            }
        }
        halves
    }
}

impl EightRanges {
    /// Slabs of so much of each range's depth, and those of them, a bit for each, that should be cut.
    #[inline(always)]
    fn slabs(&self, scale: &Lanes) -> (EightSlabs, u32) {
        let Self { mean, tilt } = self;
        let (mut depth, mut deep) = ([0.0; LANES], 0);
        for n in 0..LANES {
            depth[n] = mean[3][n] * scale[n];
            let is_deep = depth[n] * depth[n] * depth[n] * tilt[3][n] > 12.0 * TOLERANCE;
            deep |= u32::from(is_deep) << n;
        }
        let [opacity, behind] = light(&depth);
        let mut slabs = EightSlabs { up: [opacity; 4], down: [opacity; 4], depth };
        for c in 0..3 {
            for n in 0..LANES {
                let (even, odd) = (mean[c][n] * opacity[n], tilt[c][n] * (2.0 * behind[n] - opacity[n]));
                // A linear colour may leave 0..=1 where the true one does not.
                slabs.up[c][n] = least(most(even + odd, 0.0), opacity[n]);
                slabs.down[c][n] = least(most(even - odd, 0.0), opacity[n]);
            }
        }
        (slabs, deep)
    }
}

impl EightSlabs {
    /// Slabs on the way up before others, and behind them on the way down.
    #[inline(always)]
    fn over(near: &Self, far: &Self, depth: Lanes) -> Self {
        let mut over = Self { up: near.up, down: far.down, depth };
        for c in 0..4 {
            for n in 0..LANES {
                over.up[c][n] += far.up[c][n] * (1.0 - near.up[3][n]);
                over.down[c][n] += near.down[c][n] * (1.0 - far.down[3][n]);
            }
        }
        over
    }

    /// The slabs of a lane.
    #[inline(always)]
    pub fn lane(&self, n: usize) -> [Vec4; 2] {
        [&self.up, &self.down].map(|of| Vec4::from_array(of.map(|lanes| lanes[n])))
    }

    fn set(&mut self, n: usize, [up, down]: [Vec4; 2]) {
        for c in 0..4 {
            self.up[c][n] = up[c];
            self.down[c][n] = down[c];
        }
    }
}

impl Range {
    fn new(Moments { mean, tilt, bend }: Moments, depth: f64) -> Self {
        Self { mean: mean.with_w(depth as f32), tilt: tilt.with_w(bend.abs().max_element()) }
    }

    /// Composites the range, of optical depth `depth`, behind the first of `slabs` and, turned
    /// round, before the second.
    fn composite(&self, depth: f32, [up, down]: &mut [Vec4; 2]) {
        let [[opacity], [behind]] = light(&[depth]);
        let (even, odd) = (self.mean * opacity, self.tilt * (2.0 * behind - opacity));
        // A linear colour may leave 0..=1 where the true one does not.
        let light = |light: Vec4| light.clamp(Vec4::ZERO, Vec4::splat(opacity)).with_w(opacity);
        *up = over(*up, light(even + odd));
        *down = over(light(even - odd), *down);
    }
}

/// A slab behind another.
fn over(front: Vec4, back: Vec4) -> Vec4 {
    front + back * (1.0 - front.w)
}

/// What an optical depth `u` absorbs, and how much of its light is that of its far end where colour is
/// linear over it: `int_0^1 u exp(-u w) dw` and `int_0^1 w u exp(-u w) dw`.
///
/// The series for a small depth, then doublings: of two halves the farther one's light is dimmed by
/// the nearer one. All terms are positive, so that small depths lose no digits, and there is no
/// exponential whose last bits a library might choose.
#[inline(always)]
fn light<const N: usize>(depth: &[f32; N]) -> [[f32; N]; 2] {
    // A deep slab is opaque, but how far the light comes from still falls with its depth.
    let (mut x, mut doublings) = ([0.0; N], [0; N]);
    for n in 0..N {
        x[n] = least(depth[n], f32::MAX);
    }
    let mut most_doublings = 0;
    loop {
        let mut is_any_deep = false;
        for n in 0..N {
            let is_deep = x[n] > 0.25;
            x[n] *= if is_deep { 0.5 } else { 1.0 };
            doublings[n] += i32::from(is_deep);
            is_any_deep |= is_deep;
        }
        if !is_any_deep {
            break;
        }
        most_doublings += 1;
    }
    let (mut opacity, mut behind) = ([0.0; N], [0.0; N]);
    for n in 0..N {
        let x = x[n];
        opacity[n] = x * (1.0 - x * (1.0 / 2.0 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0)))));
        behind[n] = x * (1.0 / 2.0 - x * (1.0 / 3.0 - x * (1.0 / 8.0 - x * (1.0 / 30.0 - x * (1.0 / 144.0)))));
    }
    for doubling in 0..most_doublings {
        for n in 0..N {
            let is_left = doubling < doublings[n];
            let farther = 0.5 * (behind[n] * (2.0 - opacity[n]) + opacity[n] * (1.0 - opacity[n]));
            behind[n] = if is_left { farther } else { behind[n] };
            opacity[n] *= if is_left { 2.0 - opacity[n] } else { 1.0 };
        }
    }
    [opacity, behind]
}
