//! The medium along the scalar axis: a transfer function cut into stretches that integrate exactly.
//!
//! Along a slab the scalar runs from `f` to `b`, so every integral over the slab is one over scalars.
//! Opacity and colour are linear between control points, and the extinction of a linear opacity has
//! a closed antiderivative (over a piece on which the opacity goes from `a0` to `a1`):
//!
//! ```text
//! int -ln(1 - a) da = (1 - a) ln(1 - a) + a
//! mean of -ln(1 - a) = -ln(1 - a0) + 1 + (1 - z) ln(1 - z) / z              z = (a1 - a0) / (1 - a0)
//! ```
//!
//! The second form is the first one's difference without the cancellation. So depths are exact,
//! however narrow a peak. Light is not only a matter of depth but of order: what is behind is dimmed
//! by what is in front. A [`Stretch`] therefore tells its colour at both ends, taken as linear in the
//! optical depth between them; with the two ends chosen so that mean and first moment of the true
//! colour are kept, the error is of third order in the stretch's depth and first in what curvature
//! the colour has over it, which [`PARTS`] keeps small.

use glam::{DVec3, DVec4};

use crate::classify::transfer::{ControlPoint, MAX_OPACITY, TransferFunction};
use crate::volume::Volume;

/// Stretches that a change of colour from 0 to 1 is cut into, where it happens within an interval.
const PARTS: f64 = 32.0;

/// Gauss's rule of three points on 0..=1: where, and with what weight.
const GAUSS: [(f64, f64); 3] =
    [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];

/// Part of the scalar axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stretch {
    /// Integral of the extinction over it, in 1 / mm times codes.
    pub depth: f64,
    /// Colour at its lower and its upper end, linear in the optical depth between.
    pub colors: [DVec3; 2],
}

/// Opacity and colour as linear functions over part of the scalar axis, in codes.
#[derive(Clone, Copy, Debug)]
struct Piece {
    from: f64,
    to: f64,
    opacities: [f64; 2],
    colors: [DVec3; 2],
}

/// A transfer function over a volume's codes.
#[derive(Clone, Debug)]
pub struct Medium {
    pieces: Vec<Piece>,
    /// The length that opacities are meant for, mm.
    reference: f64,
}

impl Medium {
    /// `transfer` on `volume`.
    pub fn new(volume: &Volume, transfer: &TransferFunction) -> Self {
        let (slope, intercept) = volume.rescale();
        let code = |point: &ControlPoint| (point.value - intercept) / slope;
        let (first, last) = (&transfer.points[0], &transfer.points[transfer.points.len() - 1]);
        let mut pieces = Vec::new();
        Piece::between(first, first, f64::NEG_INFINITY, code(first)).push(&mut pieces);
        for ends in transfer.points.windows(2) {
            // Two points at one value are a step: nothing lies between them.
            if code(&ends[0]) < code(&ends[1]) {
                Piece::between(&ends[0], &ends[1], code(&ends[0]), code(&ends[1])).push(&mut pieces);
            }
        }
        Piece::between(last, last, code(last), f64::INFINITY).push(&mut pieces);
        Self { pieces, reference: transfer.reference_length(volume.smallest_spacing()) }
    }

    /// `low`, `high` and the ends of pieces between them, in ascending order.
    pub fn ends(&self, low: f64, high: f64) -> Vec<f64> {
        let inner = self.pieces.iter().map(|piece| piece.to).filter(|&end| low < end && end < high);
        [low].into_iter().chain(inner).chain([high]).collect()
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        size_of_val(&self.pieces[..]) as u64
    }

    /// Extinction per mm and colour at a code. At a step, those of its upper side.
    pub fn at(&self, code: f64) -> (f64, DVec3) {
        let piece = &self.pieces[self.pieces.partition_point(|piece| piece.to <= code)];
        (-(-piece.opacity(code)).ln_1p() / self.reference, piece.color(code))
    }

    /// The parts of the scalar axis that are not transparent, in ascending order, in codes; and whether the
    /// lower end itself shows. The upper end does not, unless it is another's lower one.
    pub fn visible(&self) -> impl Iterator<Item = (f64, f64, bool)> {
        let visible = self.pieces.iter().filter(|piece| piece.opacities != [0.0; 2]);
        visible.map(|piece| (piece.from, piece.to, piece.opacities[0] > 0.0))
    }

    /// Mean of a function of the medium between two codes, by Gauss's rule of three points for each piece.
    pub fn mean(&self, from: f64, to: f64, integrand: impl Fn(f64) -> DVec4) -> DVec4 {
        let first = self.pieces.partition_point(|piece| piece.to <= from);
        let within = self.pieces[first..].iter().take_while(|piece| piece.from < to);
        let parts = within.filter(|piece| piece.opacities != [0.0; 2]).map(|piece| {
            let (low, high) = (from.max(piece.from), to.min(piece.to));
            let sum: DVec4 = GAUSS.iter().map(|&(at, weight)| integrand(low + (high - low) * at) * weight).sum();
            sum * ((high - low) / (to - from))
        });
        parts.sum()
    }

    /// Integral of colour times extinction between two codes, and of extinction: 1 / mm times codes.
    pub fn light(&self, from: f64, to: f64) -> DVec4 {
        let mut stretches = Vec::new();
        self.stretches(from, to, &mut stretches);
        let light = |stretch: &Stretch| {
            let mean = (stretch.colors[0] + stretch.colors[1]) * 0.5;
            (mean * stretch.depth).extend(stretch.depth)
        };
        stretches.iter().map(light).sum()
    }

    /// The stretches between two codes, in ascending order.
    pub fn stretches(&self, from: f64, to: f64, stretches: &mut Vec<Stretch>) {
        let first = self.pieces.partition_point(|piece| piece.to <= from);
        for piece in self.pieces[first..].iter().take_while(|piece| piece.from < to) {
            let piece = piece.cut(from.max(piece.from), to.min(piece.to));
            let change = (piece.colors[1] - piece.colors[0]).abs().max_element();
            let visible = piece.opacities[0].max(piece.opacities[1]) > 0.0;
            let parts = if visible { (PARTS * change).ceil().max(1.0) } else { 1.0 };
            let end = |part: f64| if part == parts { piece.to } else { piece.from + piece.width() * part / parts };
            for part in 0..parts as usize {
                let part = piece.cut(end(part as f64), end(part as f64 + 1.0));
                stretches.push(part.stretch(self.reference));
            }
        }
    }
}

impl Piece {
    fn between(low: &ControlPoint, high: &ControlPoint, from: f64, to: f64) -> Self {
        let color = |point: &ControlPoint| DVec3::from_array(point.color.0.map(f64::from));
        Self { from, to, opacities: [low, high].map(|point| point.opacity), colors: [low, high].map(color) }
    }

    /// Adds the piece, cut where its opacity reaches the largest that counts.
    fn push(self, pieces: &mut Vec<Self>) {
        let [low, high] = self.opacities;
        let reached = self.from + self.width() * ((MAX_OPACITY - low) / (high - low));
        let crosses = low.min(high) < MAX_OPACITY && low.max(high) > MAX_OPACITY;
        if crosses && self.from < reached && reached < self.to {
            pieces.extend([self.cut(self.from, reached), self.cut(reached, self.to)]);
        } else {
            pieces.push(Self { opacities: self.opacities.map(|opacity| opacity.min(MAX_OPACITY)), ..self });
        }
    }

    fn width(&self) -> f64 {
        self.to - self.from
    }

    /// How far along a code is, 0..=1. Pieces without an end are constant.
    fn share(&self, code: f64) -> f64 {
        if self.width().is_finite() { ((code - self.from) / self.width()).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// At most what counts.
    fn opacity(&self, code: f64) -> f64 {
        let [low, high] = self.opacities;
        let share = self.share(code);
        // Exactly the end's at either end: a piece that ends at zero is transparent there.
        (low * (1.0 - share) + high * share).min(MAX_OPACITY)
    }

    fn color(&self, code: f64) -> DVec3 {
        let [low, high] = self.colors;
        let share = self.share(code);
        low * (1.0 - share) + high * share
    }

    fn cut(&self, from: f64, to: f64) -> Self {
        let ends = [from, to];
        Self { from, to, opacities: ends.map(|code| self.opacity(code)), colors: ends.map(|code| self.color(code)) }
    }

    /// The piece as one stretch.
    fn stretch(&self, reference: f64) -> Stretch {
        let [low, high] = self.opacities;
        let mean = mean_depth(low, high);
        let depth = mean / reference * self.width();
        if mean == 0.0 || self.colors[0] == self.colors[1] {
            return Stretch { depth, colors: self.colors };
        }
        // Where along the piece its light comes from: the mean, and the mean weighted by the share of
        // the depth in front.
        let (mut light, mut at, mut at_depth) = (0.0, 0.0, 0.0);
        for (share, weight) in GAUSS {
            let opacity = low + (high - low) * share;
            let weight = weight * -(-opacity).ln_1p();
            light += weight;
            at += weight * share;
            at_depth += weight * share * (mean_depth(low, opacity) * share / mean);
        }
        let (at, at_depth) = (at / light, at_depth / light);
        let spread = 12.0 * (at_depth - at / 2.0);
        let color = |share: f64| self.colors[0].lerp(self.colors[1], share.clamp(0.0, 1.0));
        Stretch { depth, colors: [color(at - spread / 2.0), color(at + spread / 2.0)] }
    }
}

/// Mean of -ln(1 - a) as the opacity goes linearly from `low` to `high`.
fn mean_depth(low: f64, high: f64) -> f64 {
    let z = (high - low) / (1.0 - low);
    let beyond = if z == 0.0 { 0.0 } else { 1.0 + (1.0 - z) * (-z).ln_1p() / z };
    // The terms cancel where the opacity falls to zero, and must not fall below it.
    (beyond - (-low).ln_1p()).max(0.0)
}
