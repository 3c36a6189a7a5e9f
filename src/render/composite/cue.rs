//! Depth cueing: colours fade with depth, `front * exp(-density * depth)`.
//!
//! Depth is an affine function of (u, v, k), so its exponential is a product of three functions of
//! one variable each: short tables in place of an exponential for every sample.

use glam::DVec3;

use crate::render::factorization::Factorization;
use crate::render::{DepthCueing, View};
use crate::volume::Volume;

/// Exponents are kept within this, so that a product of three factors stays finite. It takes a density
/// above 25 to reach it, which leaves nothing to be seen but what is in front.
const LARGEST_EXPONENT: f64 = 25.0;

/// What colours are multiplied with: one factor along each of u, v and k, all of them 1 (times `front`
/// and the fading there) in the middle of sheared space.
#[derive(Clone, Debug)]
pub struct DepthTables {
    pub along_u: Vec<f32>,
    pub along_v: Vec<f32>,
    /// The exponent's rate along k, the middle, and the factor there.
    rate: f64,
    middle: f64,
    factor: f64,
}

impl DepthTables {
    /// For a view of `volume`.
    pub fn new(cueing: &DepthCueing, view: &View, volume: &Volume, factorization: &Factorization) -> Self {
        let world_from_index = volume.world_from_index();
        let across = view.forward() / (2.0 * volume.radius());
        let depth = |at: DVec3| {
            let [u, v, k] = at.to_array();
            let world = world_from_index.transform_point3(factorization.index_from_sheared(u, v, k));
            across.dot(world - volume.centre()) + 0.5
        };
        let [width, height] = factorization.size;
        let middle = DVec3::new(width as f64, height as f64, factorization.dims[2] as f64) / 2.0;
        let [along_u, along_v, along_k] =
            DVec3::AXES.map(|axis| -cueing.density * (depth(middle + axis) - depth(middle)));
        let table =
            |rate: f64, middle: f64, length| (0..length).map(|at| fade(rate * (at as f64 - middle)) as f32).collect();
        Self {
            along_u: table(along_u, middle.x, width),
            along_v: table(along_v, middle.y, height),
            rate: along_k,
            middle: middle.z,
            factor: cueing.front * fade(-cueing.density * depth(middle)),
        }
    }

    /// The factor along k, at a position that may be between two slices of voxels.
    pub fn slice(&self, k: f64) -> f32 {
        (self.factor * fade(self.rate * (k - self.middle))) as f32
    }
}

fn fade(exponent: f64) -> f64 {
    exponent.clamp(-LARGEST_EXPONENT, LARGEST_EXPONENT).exp()
}
