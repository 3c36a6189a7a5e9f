//! Depth cueing: colours fade with depth, `front * exp(-density * depth)`.
//!
//! Under parallel projection depth is an affine function of (u, v, k), so its exponential is a product of
//! three functions of one variable each: short tables in place of an exponential for every sample. In
//! perspective it is affine within a slice only, at a rate that grows with the slice's scale, and every
//! sample pays for its exponential.

use glam::DVec3;

use crate::render::factorization::Factorization;
use crate::render::{DepthCueing, View};
use crate::volume::Volume;

/// Exponents are kept within this, so that a product of three factors stays finite. It takes a density
/// above 25 to reach it, which leaves nothing to be seen but what is in front.
const LARGEST_EXPONENT: f64 = 25.0;

/// What colours are multiplied with.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one a frame")]
pub enum Cue {
    /// Under parallel projection.
    Tables(DepthTables),
    /// In perspective.
    Depth(Depth),
}

/// The same for one slice.
#[derive(Clone, Copy, Debug)]
pub enum SliceCue<'a> {
    Tables { tables: &'a DepthTables, along_k: f32 },
    Depth { depth: &'a Depth, start: f64, rates: [f64; 2] },
}

/// The same for one of its scanlines.
#[derive(Clone, Copy, Debug)]
pub enum ScanlineCue<'a> {
    Tables { along_u: &'a [f32], scanline: f32 },
    Depth { front: f64, start: f64, rate: f64 },
}

/// One factor along each of u, v and k, all of them 1 (times `front` and the fading there) in the middle
/// of sheared space.
#[derive(Clone, Debug)]
pub struct DepthTables {
    along_u: Vec<f32>,
    along_v: Vec<f32>,
    /// The exponent's rate along k, the middle, and the factor there.
    rate: f64,
    middle: f64,
    factor: f64,
}

/// Depth as an affine function of voxel coordinates.
#[derive(Clone, Debug)]
pub struct Depth {
    cueing: DepthCueing,
    /// Along i, j, k; and at voxel (0, 0, 0).
    rates: DVec3,
    start: f64,
    factorization: Factorization,
}

impl Cue {
    /// For a part of a view of `volume`.
    pub fn new(cueing: &DepthCueing, view: &View, volume: &Volume, factorization: &Factorization) -> Self {
        let across = view.forward() / (2.0 * volume.radius());
        let depth = |at: DVec3| {
            across.dot(volume.world_from_index().transform_point3(factorization.index_from_voxel(at)) - volume.centre())
                + 0.5
        };
        let start = depth(DVec3::ZERO);
        let rates = DVec3::from_array(DVec3::AXES.map(|axis| depth(axis) - start));
        if factorization.is_parallel() {
            return Self::Tables(DepthTables::new(cueing, rates, start, factorization));
        }
        Self::Depth(Depth { cueing: *cueing, rates, start, factorization: factorization.clone() })
    }

    /// For the slice at `k`, which may be between two slices of voxels.
    pub fn slice(&self, k: f64) -> SliceCue<'_> {
        match self {
            Self::Tables(tables) => {
                let along_k = (tables.factor * fade(tables.rate * (k - tables.middle))) as f32;
                SliceCue::Tables { tables, along_k }
            }
            Self::Depth(depth) => {
                let lattice = depth.factorization.lattice(k);
                let start = depth.start + depth.rates.dot(lattice.offset.extend(k));
                SliceCue::Depth { depth, start, rates: [depth.rates.x, depth.rates.y].map(|r| r * lattice.scale) }
            }
        }
    }
}

impl<'a> SliceCue<'a> {
    /// For scanline `v`.
    #[inline(always)]
    pub fn scanline(&self, v: usize) -> ScanlineCue<'a> {
        match *self {
            Self::Tables { tables, along_k } => {
                ScanlineCue::Tables { along_u: &tables.along_u, scanline: along_k * tables.along_v[v] }
            }
            Self::Depth { depth, start, rates } => {
                let DepthCueing { front, density } = depth.cueing;
                let start = start + rates[1] * v as f64;
                ScanlineCue::Depth { front, start: -density * start, rate: -density * rates[0] }
            }
        }
    }
}

impl ScanlineCue<'_> {
    /// The factor on the colour of pixel `u`.
    #[inline(always)]
    pub fn at(&self, u: usize) -> f32 {
        match *self {
            Self::Tables { along_u, scanline } => scanline * along_u[u],
            Self::Depth { front, start, rate } => (front * (start + rate * u as f64).exp()) as f32,
        }
    }
}

impl DepthTables {
    /// From depth's rates along i, j, k and its value at voxel (0, 0, 0).
    fn new(cueing: &DepthCueing, rates: DVec3, start: f64, factorization: &Factorization) -> Self {
        let depth = |at: DVec3| {
            let [u, v, k] = at.to_array();
            start + rates.dot(factorization.voxel_from_sheared(u, v, k))
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
}

fn fade(exponent: f64) -> f64 {
    exponent.clamp(-LARGEST_EXPONENT, LARGEST_EXPONENT).exp()
}
