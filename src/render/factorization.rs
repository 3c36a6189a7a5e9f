//! [`View`] + volume -> [`Factorization`]: principal axis, shear, warp, size of the intermediate
//! image (Lacroute and Levoy 1994, section 2).
//!
//! With `i, j, k` the permuted voxel indices and `k` along the principal viewing axis, a parallel
//! ray advances by `d = (d_i, d_j, d_k)` indices per mm. Shearing slice `k` by `-d_i/d_k, -d_j/d_k`
//! a slice makes all rays parallel to `k`; a further translation by whole pixels makes the
//! intermediate image start at 0:
//!
//! ```text
//! u = i + shear_u (k - front) + translation_u        v = j + shear_v (k - front) + translation_v
//! ```
//!
//! The front slice, the one nearest to the viewer, stays on the pixel lattice: what is seen first is
//! not blurred, and the lattice does not depend on the direction in which slices are stored. A
//! final pixel's ray meets the front slice in one point, which gives the warp without inverting a view
//! matrix: (u, v) is an affine function of (x, y).

use std::ops::Range;

use glam::{DAffine2, DMat4, DVec2, DVec3};

use super::RenderError;
use super::view::{Rays, View};
use crate::volume::Volume;

/// For each principal axis the volume's axes that i, j, k stand for, as the encodings store them.
pub const PERMUTATIONS: [[usize; 3]; 3] = [[1, 2, 0], [0, 2, 1], [0, 1, 2]];

/// An axis must beat another by this factor to become the principal one, so that a view between
/// two axes does not flip from one to the other by rounding.
const AXIS_MARGIN: f64 = 1.0 + 1e-6;

/// A slice's position is rounded to this many pixels: a shear that differs from a whole number of
/// pixels by rounding only gets whole pixels, and the same voxels are inside the volume's box.
const OFFSET_STEP: f64 = 1.0 / 16384.0;

/// Pixels of an intermediate image at most (1 GiB).
const MAX_PIXELS: usize = 1 << 26;

/// Half of sheared space: `u, v` pixels and slices `k` with `coefficients . (u, v, k) + offset >= 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShearedHalfSpace {
    pub coefficients: DVec3,
    pub offset: f64,
}

/// The shear-warp factorization of a parallel view.
#[derive(Clone, Debug, PartialEq)]
pub struct Factorization {
    /// The volume's axis along which slices are stacked.
    pub principal_axis: usize,
    /// Voxels along i, j, k.
    pub dims: [usize; 3],
    /// True where the viewer stands beyond the last slice: front to back is k descending.
    pub reversed: bool,
    shear: DVec2,
    /// Where slice 0 begins: the module's translation less the shear from slice 0 to the front.
    translation: DVec2,
    /// Pixels of the intermediate image along u and v.
    pub size: [usize; 2],
    /// The rays' direction in the world, unit.
    pub direction: DVec3,
    /// Length of a ray between two slices, mm.
    pub slice_distance: f64,
    /// The warp: intermediate pixels (samples at integers) from final pixel coordinates.
    pub sheared_from_image: DAffine2,
    /// The view's clip planes.
    pub clip: Vec<ShearedHalfSpace>,
}

/// Where a slice lies over the intermediate image: pixel (u, v) gathers from the voxels
/// `(u - first_u, v - first_v)` and their successors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlicePlacement {
    /// First pixel that lies on the slice, along u and v.
    pub first: [usize; 2],
    /// How far between a voxel and its successor pixels lie, 0..1, along u and v.
    pub fraction: [f32; 2],
}

impl Factorization {
    /// Factors `view` on `volume`.
    ///
    /// # Errors
    /// [`RenderError::Unsupported`] for a perspective view, and where the intermediate image would
    /// outgrow memory.
    pub fn new(view: &View, volume: &Volume) -> Result<Self, RenderError> {
        let Rays::Parallel { corner, dx, dy, direction } = *view.rays() else {
            return Err(RenderError::Unsupported {
                pointer: "/camera/projection",
                detail: "the algorithm classified is for parallel projection".into(),
            });
        };
        let world_from_index = volume.world_from_index();
        let index_from_world = world_from_index.inverse();
        let along = index_from_world.transform_vector3(direction);
        let principal_axis = principal_axis(along);
        let permutation = PERMUTATIONS[principal_axis];
        let permuted = |v: DVec3| DVec3::from_array(permutation.map(|axis| v[axis]));
        let dims = permutation.map(|axis| volume.dims()[axis]);
        let d = permuted(along);
        let shear = -d.truncate() / d.z;
        let last_slice = (dims[2] - 1) as f64;
        let reversed = d.z < 0.0;
        let (front, depth) = if reversed { (last_slice, -last_slice) } else { (0.0, last_slice) };
        let translation = (-shear * depth).max(DVec2::ZERO).ceil() - shear * front;
        let size = [0, 1].map(|axis| dims[axis] + (shear[axis].abs() * last_slice).ceil() as usize + 1);
        if size[0].saturating_mul(size[1]) > MAX_PIXELS {
            return Err(RenderError::Unsupported {
                pointer: "/camera",
                detail: format!(
                    "the intermediate image would have {} x {} pixels, over {MAX_PIXELS}",
                    size[0], size[1]
                ),
            });
        }
        // All points of a ray shear to the same place.
        let sheared = |p: DVec3| p.truncate() + shear * p.z;
        let vector = |v: DVec3| sheared(permuted(index_from_world.transform_vector3(v)));
        let start = sheared(permuted(index_from_world.transform_point3(corner)));
        let sheared_from_image = DAffine2::from_cols(vector(dx), vector(dy), start + translation);
        let mut factorization = Self {
            principal_axis,
            dims,
            reversed,
            shear,
            translation,
            size,
            direction,
            slice_distance: 1.0 / d.z.abs(),
            sheared_from_image,
            clip: vec![],
        };
        factorization.clip = factorization.sheared_clip(view, &world_from_index);
        Ok(factorization)
    }

    /// The view's half-spaces in sheared space.
    fn sheared_clip(&self, view: &View, world_from_index: &DMat4) -> Vec<ShearedHalfSpace> {
        let permutation = PERMUTATIONS[self.principal_axis];
        let to_sheared = |half: &super::view::HalfSpace| {
            let [i, j, k] = permutation.map(|axis| half.normal.dot(world_from_index.col(axis).truncate()));
            let in_slice = DVec2::new(i, j);
            ShearedHalfSpace {
                coefficients: in_slice.extend(k - in_slice.dot(self.shear)),
                offset: half.normal.dot(world_from_index.col(3).truncate()) + half.offset
                    - in_slice.dot(self.translation),
            }
        };
        view.clip().iter().map(to_sheared).collect()
    }

    /// The slices lie between (0, 0) and this, intermediate pixels. The image has at least one
    /// pixel more along either axis.
    pub fn extent(&self) -> DVec2 {
        let last_slice = (self.dims[2] - 1) as f64;
        let offsets = [0.0, last_slice].map(|k| self.shear * k + self.translation);
        offsets[0].max(offsets[1]) + DVec2::new((self.dims[0] - 1) as f64, (self.dims[1] - 1) as f64)
    }

    /// Where slice `k` lies over the intermediate image.
    pub fn slice(&self, k: usize) -> SlicePlacement {
        self.placement(k as f64)
    }

    /// Where a slice lies over the intermediate image that may be between two slices of voxels.
    pub fn placement(&self, k: f64) -> SlicePlacement {
        let offset = (self.shear * k + self.translation) / OFFSET_STEP;
        let offset = offset.round().max(DVec2::ZERO) * OFFSET_STEP;
        let first = offset.ceil();
        let fraction = (first - offset).as_vec2();
        SlicePlacement { first: [first.x as usize, first.y as usize], fraction: fraction.to_array() }
    }

    /// The index coordinates (the volume's axes x, y, z) of pixel (u, v) of a slice, which may be
    /// between two slices of voxels.
    pub fn index_from_sheared(&self, u: f64, v: f64, k: f64) -> DVec3 {
        let in_slice = DVec2::new(u, v) - (self.shear * k + self.translation);
        let mut index = DVec3::ZERO;
        for (axis, at) in PERMUTATIONS[self.principal_axis].into_iter().zip([in_slice.x, in_slice.y, k]) {
            index[axis] = at;
        }
        index
    }

    /// The pixels u of scanline `v` that the view's clip planes leave of a slice, which may be between
    /// two slices of voxels.
    pub fn visible_pixels(&self, v: usize, k: f64) -> Range<usize> {
        let (mut low, mut high) = (0.0, (self.size[0] - 1) as f64);
        for half in &self.clip {
            let rate = half.coefficients.x;
            let rest = half.coefficients.y * v as f64 + half.coefficients.z * k + half.offset;
            if rate > 0.0 {
                low = f64::max(low, -rest / rate);
            } else if rate < 0.0 {
                high = f64::min(high, -rest / rate);
            } else if rest < 0.0 {
                return 0..0;
            }
        }
        if low > high { 0..0 } else { low.ceil() as usize..high.floor() as usize + 1 }
    }

    /// True for the two outermost slices, which stand for half an interval each: n slices span
    /// n - 1 intervals.
    pub fn is_outermost(&self, k: usize) -> bool {
        k == 0 || k == self.dims[2] - 1
    }
}

/// The axis most parallel to the rays, in index space, so that no slice shears by more than a voxel.
fn principal_axis(along: DVec3) -> usize {
    let along = along.abs();
    [1, 0].into_iter().fold(2, |best, axis| if along[axis] > along[best] * AXIS_MARGIN { axis } else { best })
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::render::{Camera, Orbit};
    use crate::volume::phantom;

    /// Both ways from a voxel to the final image agree: through the world, and through sheared
    /// space and the warp.
    #[test]
    fn shear_and_warp_together_are_the_view() {
        let volume = phantom::uniform([30, 40, 50], 1.0);
        for step in 0..60 {
            let orbit = Orbit {
                azimuth: f64::from(step) * 37.0,
                elevation: f64::from(step % 7) * 25.0 - 80.0,
                roll: f64::from(step) * 5.0,
                zoom: 1.3,
                ..Orbit::default()
            };
            let view = View::new(&Camera::Orbit(orbit), volume.centre(), volume.radius(), 200, 150).unwrap();
            let f = Factorization::new(&view, &volume).unwrap();
            let at = DVec2::new(f64::from(step) * 3.0, 140.0 - f64::from(step));
            let ray = view.ray(at);
            let index_from_world = volume.world_from_index().inverse();
            let (start, along) =
                (index_from_world.transform_point3(ray.origin), index_from_world.transform_vector3(ray.direction));
            let k = 7.0;
            let axes = PERMUTATIONS[f.principal_axis];
            let t = (k - start[axes[2]]) / along[axes[2]];
            let point = DVec3::from_array(axes.map(|axis| start[axis] + t * along[axis]));
            let expected = point.truncate() + f.shear * k + f.translation;
            assert!((f.sheared_from_image.transform_point2(at) - expected).length() < 1e-9);
            assert_eq!(f.reversed, along[axes[2]] < 0.0);
            assert!(f.shear.abs().max_element() <= 1.0 + 1e-5);
        }
    }
}
