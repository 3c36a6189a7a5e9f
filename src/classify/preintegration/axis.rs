//! Where a table's entries lie on the scalar axis.
//!
//! Codes of 8 bits have an entry each. Of 12 or 16 bits there are too many: with 256 entries at equal
//! distances, hundreds of codes may lie from one to the next, and what a transfer function does between
//! them is lost where slabs are short: a peak narrower than that, or all of it where one voxel of
//! metal stretches the range. But most of the axis is dull. Interpolating between entries errs by
//! the second derivative of what is interpolated, so entries are dense where that is large: their
//! density is its square root, which makes all errors alike (de Boor 1973 for splines).
//!
//! What is interpolated are slabs, by one of their ends with the other one held. For the optical
//! depth `D` from `f` to `b` of a medium `k` (and in the same way for its light) the derivatives follow from
//! the fundamental theorem:
//!
//! ```text
//! D = 1 / (b - f) int_f^b k ds        D' = (D - k(f)) / (b - f)        D'' = (2 D' - k'(f)) / (b - f)
//! ```
//!
//! They are largest at control points and fade with the distance to them, so `D''` is looked at in places
//! that crowd there geometrically, a few hundred in all. Behind depth nothing shows; `exp(-D)` says so.
//!
//! From codes to entries leads a piecewise linear function with equidistant knots, for which a scalar
//! needs one multiplication, two neighbouring reads and an interpolation. It rises by at most one entry a
//! code, so that no entry lies between the positions of two codes without being next to one of them.

use glam::DVec4;

use super::fixed::{cell, split};
use super::medium::Medium;
use crate::simd::numbers::Numbers;
use crate::simd::wide::{CellRow, LANES, Lanes, Wide};

/// Scalar codes -> positions on a table's axis.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabAxis {
    first_code: f32,
    entries: usize,
    knots_per_code: f32,
    /// Positions at equidistant codes from the first to the last or beyond, and once more the last one; none
    /// where entries are codes.
    knots: Vec<f32>,
}

/// Intervals between knots at most: one for each code of 12 bits; 16 kB.
const KNOTS: usize = 4096;

/// Rounding of a position, in entries: below what [`split`] rounds positions to.
const POSITION_ROUNDING: f32 = 1.0 / 4096.0;

/// Density of entries everywhere, as a share of the mean density asked for.
const EVENLY: f64 = 0.1;

/// Looks at so many places for density at most, as long as each piece has its few.
const PLACES: usize = 1024;

impl SlabAxis {
    /// At most so many `entries` between two codes, where slabs of `medium` of about `length` mm need them.
    pub(super) fn new(medium: &Medium, (low, high): (u16, u16), entries: usize, length: f64) -> Self {
        let codes = usize::from(high - low) + 1;
        let mut axis = Self { first_code: f32::from(low), entries: codes.max(2), knots_per_code: 1.0, knots: vec![] };
        if codes > entries {
            // A power of two codes from a knot to the next, so that nothing is rounded.
            let step = (codes - 1).div_ceil(KNOTS).next_power_of_two();
            let intervals = (codes - 1).div_ceil(step);
            let (low, step) = (f64::from(low), step as f64);
            let density = density(medium, low, low + step * intervals as f64, length);
            let asked = masses(&density, low, step, intervals);
            axis.entries = entries;
            axis.knots_per_code = (1.0 / step) as f32;
            axis.knots = positions(&asked, step, (entries - 1) as f64);
        }
        axis
    }

    /// Position of a (fractional) code on the axis, 0..=entries - 1.
    #[inline(always)]
    pub fn coordinate(&self, code: f32) -> f32 {
        if self.knots.is_empty() { self.above_first(code) } else { self.between_knots(code) }
    }

    /// At least 0: rounding may leave a scalar a hair below the first code.
    #[inline(always)]
    fn above_first(&self, code: f32) -> f32 {
        let code = code - self.first_code;
        if code > 0.0 { code } else { 0.0 }
    }

    #[inline(always)]
    fn between_knots(&self, code: f32) -> f32 {
        let (knot, share) = cell((code - self.first_code) * self.knots_per_code);
        // Always there: codes are those of the volume.
        let Some(ends) = self.knots.get(knot..knot + 2) else { return 0.0 };
        ends[0] + (ends[1] - ends[0]) * share
    }

    /// Positions of eight codes.
    #[inline(always)]
    pub fn coordinates<W: Wide>(&self, codes: &Lanes) -> Lanes {
        let from_first = W::Numbers::load(codes) - W::Numbers::all(self.first_code);
        if self.knots.is_empty() {
            return from_first.most(W::Numbers::all(0.0)).store();
        }
        let at = (from_first * W::Numbers::all(self.knots_per_code)).store();
        let everywhere = CellRow { low: 0.0, high: f32::INFINITY, origin: 0.0, last: f32::INFINITY };
        let [knots, shares] = W::cells(&at, &everywhere);
        W::linear(&self.knots, &W::indices(&[0.0; LANES], &knots, 0.0), &shares)
    }

    /// True where each code has an entry of its own.
    pub(super) fn are_codes(&self) -> bool {
        self.knots.is_empty()
    }

    /// Entries along the axis.
    pub fn entries(&self) -> usize {
        self.entries
    }

    /// The code at each entry.
    pub(super) fn codes(&self) -> Vec<f64> {
        let first = f64::from(self.first_code);
        if self.knots.is_empty() {
            return (0..self.entries).map(|entry| first + entry as f64).collect();
        }
        let mut knot = 0;
        let code = |entry: usize| {
            while knot + 3 < self.knots.len() && self.knots[knot + 1] <= entry as f32 {
                knot += 1;
            }
            let [low, high] = [self.knots[knot], self.knots[knot + 1]].map(f64::from);
            first + (knot as f64 + (entry as f64 - low) / (high - low)) / f64::from(self.knots_per_code)
        };
        (0..self.entries).map(code).collect()
    }

    /// The codes of the entries that are read for a scalar within `rounding` of `code`.
    pub(super) fn reach(&self, codes: &[f64], code: f32, rounding: f32) -> (f64, f64) {
        let last = (self.entries - 1) as f32;
        let position_rounding = if self.knots.is_empty() { 0.0 } else { POSITION_ROUNDING };
        let at = |code: f32, rounding: f32| split((self.coordinate(code) + rounding).clamp(0.0, last));
        let (low, high) = (at(code - rounding, -position_rounding), at(code + rounding, position_rounding));
        (codes[low.0], codes[high.0 + usize::from(high.1 > 0.0)])
    }

    /// Bytes in memory.
    pub(super) fn bytes(&self) -> u64 {
        size_of_val(&self.knots[..]) as u64
    }
}

/// Codes in ascending order, and how dense entries should be there (up to a factor).
fn density(medium: &Medium, low: f64, high: f64, length: f64) -> Vec<(f64, f64)> {
    let places = places(medium, low, high);
    // At each place: depth and light so far, and their rate and its rate; the depth in w.
    let rate = |code: f64| {
        let (extinction, color) = medium.at(code);
        (color * extinction).extend(extinction) * length
    };
    let mut running = vec![DVec4::ZERO];
    for ends in places.windows(2) {
        let passed = medium.light(ends[0].0, ends[1].0) * length;
        running.push(running[running.len() - 1] + passed);
    }
    let at_place = |(at, &(code, room)): (usize, &(f64, f64))| {
        let (value, slope) = (rate(code), (rate(code + room) - rate(code - room)) / (2.0 * room));
        let mut bend = 0f64;
        let mut offset = 1;
        while offset < places.len() {
            for other in
                [at.checked_sub(offset), Some(at + offset).filter(|other| *other < places.len())].into_iter().flatten()
            {
                let distance = places[other].0 - code;
                let mean = (running[other] - running[at]) / distance;
                let first = (mean - value) / distance;
                let second = (first * 2.0 - slope) / distance;
                // exp(-depth), or nearly.
                let shows = 1.0 / (1.0 + mean.w + 0.5 * mean.w * mean.w);
                bend = bend.max(shows * (second.abs().max_element() + first.w * first.w));
            }
            offset += 1 + offset / 2;
        }
        (code, bend.sqrt())
    };
    places.iter().enumerate().map(at_place).collect()
}

/// Codes to look at, in ascending order, none of them a control point; and how far from each there is none.
fn places(medium: &Medium, low: f64, high: f64) -> Vec<(f64, f64)> {
    let ends = medium.ends(low, high);
    let halvings = (PLACES / (2 * ends.len())).max(1);
    let mut places = Vec::new();
    for ends in ends.windows(2) {
        let distances: Vec<f64> = (1..=halvings)
            .map(|n| (ends[1] - ends[0]) * 0.5f64.powi(n as i32))
            .take_while(|&distance| distance > 0.25)
            .collect();
        places.extend(distances.iter().rev().map(|&d| (ends[0] + d, 0.25 * d)));
        places.extend(distances.iter().skip(1).map(|&d| (ends[1] - d, 0.25 * d)));
        if distances.is_empty() {
            places.push((ends[0].midpoint(ends[1]), 0.25 * (ends[1] - ends[0])));
        }
    }
    places
}

/// What the density comes to between knots, `step` codes apart: linear between the places where it is
/// known, constant outside, and everywhere at least a share of its mean.
fn masses(density: &[(f64, f64)], low: f64, step: f64, intervals: usize) -> Vec<f64> {
    let mut masses = vec![0.0; intervals];
    let mut next = 0;
    for (interval, mass) in masses.iter_mut().enumerate() {
        let (mut from, to) = (low + step * interval as f64, low + step * (interval + 1) as f64);
        // The trapezoids up to each place within the interval, and to its end.
        while from < to {
            while next < density.len() && density[next].0 <= from {
                next += 1;
            }
            let until = density.get(next).map_or(to, |place| place.0.min(to));
            let known = |code: f64| match (next.checked_sub(1).map(|before| density[before]), density.get(next)) {
                (Some((a, da)), Some((b, db))) => da + (db - da) * (code - a) / (b - a),
                (Some((_, only)), None) | (None, Some(&(_, only))) => only,
                (None, None) => 0.0,
            };
            *mass += (until - from) * known(from.midpoint(until));
            from = until;
        }
    }
    let mean = masses.iter().sum::<f64>() / intervals as f64;
    masses.iter().map(|mass| mass + if mean > 0.0 { EVENLY * mean } else { 1.0 }).collect()
}

/// Positions from 0 to `last` that rise in proportion to `masses`, but by no more than `most` at a time; the
/// last one twice.
fn positions(masses: &[f64], most: f64, last: f64) -> Vec<f32> {
    let mut scale = 0.0;
    for _ in 0..16 {
        let (mut full, mut rest) = (0.0, 0.0);
        for mass in masses {
            if mass * scale >= most {
                full += most;
            } else {
                rest += mass;
            }
        }
        scale = if rest > 0.0 { (last - full) / rest } else { scale };
    }
    let steps = masses.iter().map(|mass| (mass * scale).min(most));
    let total: f64 = steps.clone().sum();
    let mut position = 0.0;
    let mut positions = vec![0.0];
    positions.extend(steps.map(|step| {
        position += step;
        (position * last / total) as f32
    }));
    positions.push(last as f32);
    positions
}
