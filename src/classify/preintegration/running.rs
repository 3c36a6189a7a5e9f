//! A table over one scalar in place of two: running sums (Kye, Hong and Shin 2005).
//!
//! For 12 to 16 bits the square of the number of codes is out of reach, and all of it is to be made anew when
//! the transfer function changes. The transparencies along a slab multiply; their geometric mean is
//! what a slab has. Taking the arithmetic mean in its place leaves sums, and all sums between two
//! scalars are differences of running ones:
//!
//! ```text
//! alpha(f, b) ~ (A(b) - A(f)) / (b - f)      A(x) = int^x alpha(s) ds       alpha(s) = 1 - exp(-tau(s) d)
//! color(f, b) ~ (K(b) - K(f)) / (b - f)      K(x) = int^x c(s) alpha(s) ds
//! ```
//!
//! The paper sums over codes, divides by `b - f` and starts at `f - 1`: one term more than it divides
//! by. Here the sums are integrals, for which its division is right, and where both scalars are
//! the same the quotient's limit is that scalar's own opacity. A mean of transparencies is never below
//! their geometric mean, so the slab is never more opaque than the true one, and the same where the
//! opacity is constant; where one half is opaque and the other one empty, it is half as opaque.
//! Colours do not know which of them is in front.
//!
//! For slabs that are scaled sample by sample the same table holds extinction in place of opacity. Then
//! the mean is the optical depth itself, and opacities are exact.

use glam::{DVec4, Vec4};
use rayon::prelude::*;

use super::fixed::split;
use super::medium::Medium;
use super::{Form, Slabs};

/// Running sums over the codes of a volume, for slabs of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct RunningSums {
    scale: Scale,
    /// Integral from the first entry to each, in entries: of colour times opacity, and of opacity (or
    /// of what [`Form`] says). Sums of thousands of terms are taken apart again: 32 bits are too few.
    sums: Vec<DVec4>,
    /// The integrand at each entry, and one more as the last.
    media: Vec<Vec4>,
    length: f32,
}

/// Entries of running sums: a power of two codes apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    first_code: f32,
    entries_per_code: f32,
    intervals: usize,
}

/// Intervals at most: one for each code of 12 bits; sums of 128 kB.
const INTERVALS: usize = 4095;

impl Scale {
    pub fn new((low, high): (u16, u16)) -> Self {
        let codes = usize::from(high - low).max(1);
        let step = codes.div_ceil(INTERVALS).next_power_of_two();
        Self { first_code: f32::from(low), entries_per_code: 1.0 / step as f32, intervals: codes.div_ceil(step) }
    }

    #[inline(always)]
    fn coordinate(self, code: f32) -> f32 {
        // Rounding may leave a scalar a hair below the first code.
        let code = code - self.first_code;
        if code > 0.0 { code * self.entries_per_code } else { 0.0 }
    }

    fn code(self, entry: usize) -> f64 {
        f64::from(self.first_code) + entry as f64 / f64::from(self.entries_per_code)
    }

    /// The codes of the entries that are read for a scalar within `rounding` of `code`.
    pub fn reach(self, code: f32, rounding: f32) -> (f64, f64) {
        let at = |code: f32| self.coordinate(code).clamp(0.0, self.intervals as f32);
        let (low, high) = (split(at(code - rounding)), split(at(code + rounding)));
        (self.code(low.0), self.code(high.0 + usize::from(high.1 > 0.0)))
    }
}

impl RunningSums {
    /// Sums `medium` for slabs of `length` mm.
    pub(super) fn new(medium: &Medium, scale: Scale, form: Form, length: f32) -> Self {
        let length = f64::from(length);
        let integrand = |code: f64| {
            let (extinction, color) = medium.at(code);
            let depth = extinction * length;
            let weight = match form {
                Form::Opacity => -(-depth).exp_m1(),
                Form::OpticalDepth => depth,
            };
            (color * weight).extend(weight)
        };
        let mean = |from: f64, to: f64| match form {
            Form::Opacity => medium.mean(from, to, integrand),
            Form::OpticalDepth => medium.light(from, to) * (length / (to - from)),
        };
        let intervals: Vec<DVec4> = (0..scale.intervals)
            .into_par_iter()
            .with_min_len(256)
            .map(|interval| mean(scale.code(interval), scale.code(interval + 1)))
            .collect();
        let mut sum = DVec4::ZERO;
        let mut sums = vec![sum];
        sums.extend(intervals.into_iter().map(|mean| {
            sum += mean;
            sum
        }));
        // Beyond the last entry, where rounding may lead, its medium goes on.
        let last = integrand(scale.code(scale.intervals));
        sums.push(sum + last);
        let media = (0..=scale.intervals).map(|entry| integrand(scale.code(entry))).chain([last]);
        let media = media.map(|medium| medium.as_vec4()).collect();
        Self { scale, sums, media, length: length as f32 }
    }

    /// Position of a (fractional) code.
    #[inline(always)]
    pub fn coordinate(&self, code: f32) -> f32 {
        self.scale.coordinate(code)
    }

    /// The slab between two positions.
    #[inline(always)]
    pub fn slab(&self, front: f32, back: f32) -> Vec4 {
        let ((front, wf), (back, wb)) = (split(front), split(back));
        let distance = (back as f32 + wb) - (front as f32 + wf);
        // Always there: positions are on the axis.
        if distance == 0.0 {
            let Some(ends) = self.media.get(front..front + 2) else { return Vec4::ZERO };
            return ends[0] + (ends[1] - ends[0]) * wf;
        }
        let sums = (self.sums.get(front..front + 2), self.sums.get(back..back + 2));
        let (Some(near), Some(far)) = sums else { return Vec4::ZERO };
        let near = near[0] + (near[1] - near[0]) * f64::from(wf);
        let far = far[0] + (far[1] - far[0]) * f64::from(wb);
        // The two have one sign; zero has none.
        ((far - near) / f64::from(distance)).as_vec4().abs()
    }

    /// The length of its slabs, mm.
    pub fn length(&self) -> f32 {
        self.length
    }

    /// Bytes in memory of sums on `scale`.
    pub(super) fn bytes(scale: Scale) -> u64 {
        ((scale.intervals + 2) * (size_of::<DVec4>() + size_of::<Vec4>())) as u64
    }
}

/// Running sums over one scalar.
#[derive(Clone, Copy, Debug)]
pub struct OneDimensional<'a>(pub &'a RunningSums);

impl Slabs for OneDimensional<'_> {
    #[inline(always)]
    fn coordinate(self, code: f32) -> f32 {
        self.0.coordinate(code)
    }

    #[inline(always)]
    fn slab(self, front: f32, back: f32) -> Vec4 {
        self.0.slab(front, back)
    }
}
