//! Perspective views: slices sheared and scaled about the eye (Lacroute and Levoy 1994, section 2), and
//! which part of the picture has which principal axis.
//!
//! Let `e` be the eye in permuted voxel coordinates and the intermediate image a plane parallel to the
//! slices, `distance` of them in front of the eye, with a pixel on every voxel position of that plane. The
//! ray of the plane's point `q` meets slice `k` at
//!
//! ```text
//! e + (q - e) scale_k        scale_k = |k - e_k| / distance
//! ```
//!
//! so that a slice is a lattice with `scale_k` voxels from pixel to pixel: the paper's scaling, told from
//! the slices' side. The plane is the front slice, the volume's nearest to the eye: it lies on the
//! pixel lattice and no slice is enlarged. Only for an eye nearer to the volume than half its width the
//! plane stays at that distance: the front slice would have a pixel for each of the few voxels that are
//! seen of it, and what lies behind would be told by as few. Finer than the final image the plane
//! then need not be.
//!
//! **Parts.** One principal axis will do as long as every ray that meets the volume within the
//! picture advances by at most [`SLOPE_LIMIT`] voxels a slice, along the axis for which that
//! slope is least. Otherwise, and always where the eye stands among the slices of all axes, the
//! picture is split: each final pixel belongs to the axis that its own ray is most parallel to, up to
//! six parts of rays with slopes up to 1, each with a factorization of its own. The intermediate image of
//! a part holds what the picture shows of the volume within its pyramid and no more.
//!
//! All of these are bounds on linear functions of the pixel coordinates (a ray's direction is one), so a
//! part is a convex polygon of the final image, and slopes are largest at its corners.

use std::ops::Range;

use glam::{DMat3, DVec2, DVec3};

use super::{AXIS_MARGIN, Convex, Factorization, PERMUTATIONS, Shear, permuted};
use crate::render::view::View;
use crate::volume::Volume;

/// Voxels by which a ray may move from slice to slice along either axis before the picture is split. (A
/// parallel view has at most 1; a view at 45 degrees to two axes reaches this with half a field of view of
/// 18 degrees.) On a CT scan at such angles one part with this limit and two parts with 1 come equally
/// near to the ray caster, within 1 dB in favour of either; one part has no joint.
const SLOPE_LIMIT: f64 = 2.0;

/// So far beyond what the picture's outermost rays see the image goes on, pixels: rounding leaves none out.
const MARGIN: f64 = 1.0 / 64.0;

/// Positions this far below a whole pixel are on it, pixels.
const ROUNDING: f64 = 1e-6;

/// A perspective view in voxel coordinates of the volume's own axes.
struct Pyramid {
    eye: DVec3,
    /// Rays' directions from pixel coordinates (x, y, 1).
    direction_from_image: DMat3,
    /// Index of the last voxel.
    last: DVec3,
    /// The corners of the image's outermost pixel centres.
    corners: [DVec2; 4],
}

/// A principal axis and the order of slices along it.
#[derive(Clone, Copy)]
struct Axis {
    axis: usize,
    reversed: bool,
}

/// The parts of a perspective view whose rays leave `eye` along the directions that `columns` give for
/// x, y and 1 (world).
pub(super) fn parts(columns: [DVec3; 3], eye: DVec3, view: &View, volume: &Volume) -> Vec<Factorization> {
    let index_from_world = volume.world_from_index().inverse();
    let (width, height) = view.size();
    let directions = DMat3::from_cols_array_2d(&columns.map(|v| index_from_world.transform_vector3(v).to_array()));
    let middle = DVec3::new(f64::from(width) / 2.0, f64::from(height) / 2.0, 1.0);
    let (right, bottom) = (f64::from(width) - 0.5, f64::from(height) - 0.5);
    let pyramid = Pyramid {
        eye: index_from_world.transform_point3(eye),
        // Of any length; so that they can be told from rounding, of about one.
        direction_from_image: directions * (directions * middle).length_recip(),
        last: DVec3::from_array(volume.dims().map(|n| (n - 1) as f64)),
        corners: [(0.5, 0.5), (right, 0.5), (right, bottom), (0.5, bottom)].map(DVec2::from),
    };
    match pyramid.one_axis() {
        Some((axis, polygon)) => pyramid.part(axis, &polygon, view, volume).into_iter().collect(),
        None => {
            let axes = [2, 1, 0].into_iter().flat_map(|axis| [false, true].map(|reversed| Axis { axis, reversed }));
            axes.filter_map(|axis| pyramid.part(axis, &pyramid.dominated(axis), view, volume)).collect()
        }
    }
}

impl Pyramid {
    /// The axis that all rays of the picture can share, and the polygon of those that meet the
    /// volume.
    fn one_axis(&self) -> Option<(Axis, Vec<DVec2>)> {
        let mut best: Option<(f64, Axis, Vec<DVec2>)> = None;
        for axis in [2, 1, 0] {
            let beyond = self.eye[axis] > self.last[axis];
            if self.eye[axis] >= 0.0 && !beyond {
                continue;
            }
            let axis = Axis { axis, reversed: beyond };
            let polygon = self.clipped(self.seeing(axis));
            let slope = polygon.iter().map(|&at| self.slope(axis, at).abs().max_element()).fold(0.0, f64::max);
            if best.as_ref().is_none_or(|(least, ..)| slope * AXIS_MARGIN < *least) {
                best = Some((slope, axis, polygon));
            }
        }
        best.filter(|(slope, ..)| *slope <= SLOPE_LIMIT).map(|(_, axis, polygon)| (axis, polygon))
    }

    /// The polygon of the rays that meet the volume and are most parallel to `axis`.
    fn dominated(&self, axis: Axis) -> Vec<DVec2> {
        let along = axis.along();
        let others = [0, 1, 2].into_iter().filter(|&other| other != axis.axis);
        let dominates = others.flat_map(|other| [along - DVec3::AXES[other], along + DVec3::AXES[other]]);
        self.clipped(dominates.chain(self.seeing(axis)))
    }

    /// Directions `d` that may see the volume along `axis` have `c . d >= 0` with all of these.
    fn seeing(&self, axis: Axis) -> impl Iterator<Item = DVec3> {
        let along = axis.along();
        let bounds = [0, 1].map(|n| self.slope_bounds(axis, n));
        let within = [0, 1].into_iter().flat_map(move |n| {
            let other = DVec3::AXES[PERMUTATIONS[axis.axis][n]];
            let [low, high] = bounds[n];
            [other - along * low, along * high - other]
        });
        std::iter::once(along).chain(within.filter(|c| c.is_finite()))
    }

    /// Between which slopes along the permuted axis `n` (0: i, 1: j) the volume's box is seen.
    fn slope_bounds(&self, axis: Axis, n: usize) -> [f64; 2] {
        let [nearest, farthest] = self.distances(axis);
        let other = PERMUTATIONS[axis.axis][n];
        let (below, above) = (-self.eye[other], self.last[other] - self.eye[other]);
        // Of two bounds of one sign the nearest slice has the larger, whatever the sign.
        let low = if below < 0.0 { below / nearest } else { below / farthest };
        let high = if above > 0.0 { above / nearest } else { above / farthest };
        [low, high]
    }

    /// Slices from the eye to where the volume begins (0 within it) and ends.
    fn distances(&self, Axis { axis, reversed }: Axis) -> [f64; 2] {
        let (eye, last) = (self.eye[axis], self.last[axis]);
        if reversed { [(eye - last).max(0.0), eye] } else { [(-eye).max(0.0), last - eye] }
    }

    /// The slices in front of the eye: none that it stands on.
    fn slices(&self, Axis { axis, reversed }: Axis) -> Range<usize> {
        let (eye, count) = (self.eye[axis], self.last[axis] as usize + 1);
        if reversed {
            0..(eye.ceil() as usize).min(count)
        } else if eye < 0.0 {
            0..count
        } else {
            (eye.floor() as usize).saturating_add(1).min(count)..count
        }
    }

    /// The image's polygon where `c . direction >= 0` for all the `bounds`.
    fn clipped(&self, bounds: impl Iterator<Item = DVec3>) -> Vec<DVec2> {
        bounds.fold(self.corners.to_vec(), |polygon, c| cut(&polygon, self.direction_from_image.transpose() * c))
    }

    /// Voxels along i, j that the ray of a pixel moves by from slice to slice.
    fn slope(&self, axis: Axis, at: DVec2) -> DVec2 {
        let d = permuted(axis.axis, self.direction_from_image * at.extend(1.0));
        d.truncate() / d.z.abs()
    }

    /// The least change of slope from one final pixel to the next.
    fn resolution(&self, axis: Axis, at: DVec2) -> f64 {
        let step = |to: DVec2| (self.slope(axis, at + to) - self.slope(axis, at - to)).length();
        step(DVec2::X / 2.0).min(step(DVec2::Y / 2.0))
    }

    /// The part of a `polygon` of pixels; `None` where it sees nothing.
    fn part(&self, axis: Axis, polygon: &[DVec2], view: &View, volume: &Volume) -> Option<Factorization> {
        let slices = self.slices(axis);
        if polygon.is_empty() || slices.is_empty() {
            return None;
        }
        let dims = PERMUTATIONS[axis.axis].map(|axis| volume.dims()[axis]);
        let middle = polygon.iter().sum::<DVec2>() / polygon.len() as f64;
        let width = dims[0].max(dims[1]) as f64;
        let distance = self.distances(axis)[0].max((width / 2.0).min(1.0 / self.resolution(axis, middle)));
        let eye = permuted(axis.axis, self.eye);

        // What the picture sees of the plane, and where the volume ends.
        let seen = polygon.iter().map(|&at| eye.truncate() + self.slope(axis, at) * distance);
        let (low, high) = seen.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), q| (low.min(q), high.max(q)));
        let [[left, right], [top, bottom]] =
            [0, 1].map(|n| self.slope_bounds(axis, n).map(|slope| eye[n] + slope * distance));
        let low = (low - MARGIN).max(DVec2::new(left, top));
        let high = (high + MARGIN).min(DVec2::new(right, bottom)).max(low);
        let origin = (low + ROUNDING).floor();
        let extent = [(low - origin).max(DVec2::ZERO), high - origin];

        // Homogeneous (u, v, 1) times a ray's steps along k, which are positive in this part.
        let sign = if axis.reversed { -1.0 } else { 1.0 };
        let sheared = |d: DVec3| {
            let d = permuted(axis.axis, d) * DVec3::new(1.0, 1.0, sign);
            (d.truncate() * distance + (eye.truncate() - origin) * d.z).extend(d.z)
        };
        let directions = self.direction_from_image;
        let world_from_index = volume.world_from_index();
        let steps = PERMUTATIONS[axis.axis].map(|axis| world_from_index.col(axis).truncate());
        let start = ((origin - eye.truncate()) / distance).extend(sign);
        let ray = DMat3::from_cols(
            steps[0] / distance,
            steps[1] / distance,
            steps[0] * start.x + steps[1] * start.y + steps[2] * start.z,
        );
        let among = if axis.reversed { eye.z <= (dims[2] - 1) as f64 } else { eye.z >= 0.0 };
        let front = match (axis.reversed, among) {
            (false, among) => slices.start - usize::from(among),
            (true, among) => slices.end - usize::from(!among),
        };
        let unclipped = Factorization {
            principal_axis: axis.axis,
            dims,
            reversed: axis.reversed,
            slices,
            front,
            start: if among { (eye.z - front as f64).abs() } else { 0.0 },
            shear: Shear::Perspective { eye, distance, origin, directions },
            size: [0, 1].map(|n| extent[1][n] as usize + 2),
            direction: view.forward(),
            slice_distance: shortest_length(ray, extent),
            ray,
            sheared_from_image: DMat3::from_cols(
                sheared(directions.x_axis),
                sheared(directions.y_axis),
                sheared(directions.z_axis),
            ),
            extent,
            clip: Convex::default(),
            holes: vec![],
            limits: None,
        };
        Some(unclipped.clipped(view, &world_from_index))
    }
}

impl Axis {
    /// The unit vector into the picture.
    fn along(self) -> DVec3 {
        if self.reversed { -DVec3::AXES[self.axis] } else { DVec3::AXES[self.axis] }
    }
}

/// What a half-plane, `half . (x, y, 1) >= 0`, leaves of a convex polygon.
fn cut(polygon: &[DVec2], half: DVec3) -> Vec<DVec2> {
    let mut left = Vec::with_capacity(polygon.len() + 1);
    for (n, &from) in polygon.iter().enumerate() {
        let to = polygon[(n + 1) % polygon.len()];
        let [a, b] = [from, to].map(|at| half.dot(at.extend(1.0)));
        if a >= 0.0 {
            left.push(from);
        }
        if (a >= 0.0) != (b >= 0.0) {
            left.push(from + (to - from) * (a / (a - b)));
        }
    }
    left
}

/// The shortest slab over an intermediate image, whose pixels' rays advance by `ray` times (u, v, 1). The
/// length is a convex function of (u, v), so steps towards its minimum find it.
fn shortest_length(ray: DMat3, [low, high]: [DVec2; 2]) -> f64 {
    let along = |at: DVec2, axis: usize| {
        let mut end = at;
        end[axis] = 0.0;
        let (from, step) = (ray * end.extend(1.0), ray.col(axis));
        end[axis] = (-from.dot(step) / step.length_squared()).clamp(low[axis], high[axis]);
        end
    };
    let mut at = (low + high) / 2.0;
    for _ in 0..8 {
        at = along(along(at, 0), 1);
    }
    (ray * at.extend(1.0)).length()
}
