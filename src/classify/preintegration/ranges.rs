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

/// All ranges between a table's entries.
#[derive(Clone, Debug)]
pub struct Ranges {
    /// Code of each entry.
    codes: Vec<f64>,
    /// Stretches between an entry and the next, from `starts[entry]` to `starts[entry + 1]`.
    stretches: Vec<Range>,
    starts: Vec<u32>,
    /// From each entry on to each later one: from entry f to b at `[f][b - f - 1]`.
    ranges: Vec<Vec<Range>>,
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
            to_each.collect()
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
        let [opacity, _] = light(depth);
        form.slab((medium * opacity).with_w(opacity), depth)
    }

    /// The slabs of `length` mm from an entry to each later one, and back.
    pub fn slabs(&self, from: usize, length: f32, form: Form) -> Vec<[Vec4; 2]> {
        let slab = |(n, range): (usize, &Range)| {
            let to = from + n + 1;
            let scale = length / (self.codes[to] - self.codes[from]) as f32;
            let mut slabs = [Vec4::ZERO; 2];
            self.composite(from, to, scale, &mut slabs);
            slabs.map(|slab| form.slab(slab, range.mean.w * scale))
        };
        self.ranges[from].iter().enumerate().map(slab).collect()
    }

    /// Composites the range between two entries behind the first of `slabs` and before the second.
    fn composite(&self, from: usize, to: usize, scale: f32, slabs: &mut [Vec4; 2]) {
        let range = &self.ranges[from][to - from - 1];
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

impl Range {
    fn new(Moments { mean, tilt, bend }: Moments, depth: f64) -> Self {
        Self { mean: mean.with_w(depth as f32), tilt: tilt.with_w(bend.abs().max_element()) }
    }

    /// Composites the range, of optical depth `depth`, behind the first of `slabs` and, turned
    /// round, before the second.
    fn composite(&self, depth: f32, [up, down]: &mut [Vec4; 2]) {
        let [opacity, behind] = light(depth);
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
fn light(depth: f32) -> [f32; 2] {
    // A deep slab is opaque, but how far the light comes from still falls with its depth.
    let mut x = depth.min(f32::MAX);
    let mut doublings = 0;
    while x > 0.25 {
        x *= 0.5;
        doublings += 1;
    }
    let mut opacity = x * (1.0 - x * (1.0 / 2.0 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0)))));
    let mut behind = x * (1.0 / 2.0 - x * (1.0 / 3.0 - x * (1.0 / 8.0 - x * (1.0 / 30.0 - x * (1.0 / 144.0)))));
    for _ in 0..doublings {
        behind = 0.5 * (behind * (2.0 - opacity) + opacity * (1.0 - opacity));
        opacity *= 2.0 - opacity;
    }
    [opacity, behind]
}
