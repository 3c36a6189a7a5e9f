//! Classified volume + [`View`] -> [`Image`]: one frame, pure, without async.

mod awake;
mod bands;
pub mod composite;
pub mod depth;
pub mod factorization;
mod image;
pub mod intermediate;
pub mod lighting;
pub mod material;
pub mod pixel;
mod ranges;
pub mod raster;
pub mod ray_light;
pub mod regions;
pub mod shade;
pub mod shadow;
mod shear_image;
mod shear_warp;
pub mod slab;
pub mod spare;
pub mod view;
pub mod warp;

use std::array::from_fn;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::{DVec3, Vec4};

use crate::classify::labels::Labels;
use crate::classify::{Classification, Encodings, TransferFunction};
use crate::raycast::raycast;
use crate::simd;
use crate::volume::{PreparedVolume, Volume};
use factorization::Factorization;
pub use image::Image;
use ranges::hull;
use shadow::Shadow;
pub use view::{Ball, Camera, Clip, HalfSpace, LookAt, Orbit, Projection, Ray, View, ViewError};

/// Accumulated opacity at which a pixel is done: what is left of the light would change an 8-bit
/// channel by up to 5 (draft), 3 (standard), or nothing (reference).
const TERMINATION_DRAFT: f32 = 0.98;
const TERMINATION_STANDARD: f32 = 0.99;
const TERMINATION_REFERENCE: f32 = 0.9999;
/// In smallest spacings: two samples per voxel, as sampling theory asks for.
const SAMPLE_DISTANCE: f64 = 0.5;
const SAMPLE_DISTANCE_HIGH: f64 = 0.125;

/// How a frame is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Algorithm {
    /// Run-length encoded volumes (Lacroute and Levoy 1994, section 3.1).
    Classified,
    /// Octree and summed-area table over the unencoded volume (section 3.3); the same pixels.
    FastClassification,
    /// Slabs between slices, looked up in a pre-integration table (Schulze et al. 2003); those between voxels that have colours of
    /// their own or labels are the means of two samples.
    Preintegrated,
    /// The image-order reference.
    Raycast,
}

impl Algorithm {
    /// The name used by the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Classified => "classified",
            Self::FastClassification => "fast-classification",
            Self::Preintegrated => "preintegrated",
            Self::Raycast => "raycast",
        }
    }
}

/// How much a frame may cost, and how near to the integral it comes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// A coarser level of the volume, for dragging.
    Draft,
    /// Voxel resolution: one sample per voxel, and a warp into the final image.
    #[default]
    Standard,
    /// The output's own rays, two samples per voxel, and no warp.
    High,
}

impl Quality {
    /// The name used by the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::High => "high",
        }
    }
}

/// What becomes of the samples along a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Blend {
    /// Emission and absorption: the optical model.
    #[default]
    Composite,
    /// An intensity projection: an opaque gray for every ray that meets the volume.
    Projection(IntensityProjection, Window),
}

/// Which of a ray's scalars is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum IntensityProjection {
    Maximum,
    Minimum,
    Average,
}

/// Which values are shown from black (`center - width / 2`) to white, in the file's own units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    pub center: f64,
    /// Above 0.
    pub width: f64,
}

/// Colours fade with depth: times `front * exp(-density * depth)`, with depth 0 at the front and 1
/// at the back of the volume's bounding sphere, along the camera's axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthCueing {
    pub front: f64,
    pub density: f64,
}

/// Options of [`Algorithm::Preintegrated`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Preintegration {
    pub table: SlabTable,
    /// Entries along each axis of a two-dimensional table.
    pub entries: usize,
    pub lookup: Lookup,
    pub opacity_correction: OpacityCorrection,
    pub buffer: BufferSlice,
    /// Slabs from one slice to the next.
    pub samples_per_voxel: usize,
}

impl Preintegration {
    /// Entries of a table whose size is not told.
    pub const ENTRIES: usize = 256;

    /// What a quality uses where the request does not tell.
    pub const fn of(quality: Quality) -> Self {
        Self {
            table: SlabTable::TwoDimensional,
            entries: Self::ENTRIES,
            lookup: Lookup::Bilinear,
            opacity_correction: OpacityCorrection::View,
            buffer: BufferSlice::Slice,
            samples_per_voxel: match quality {
                Quality::Draft | Quality::Standard => 1,
                Quality::High => 2,
            },
        }
    }
}

/// The table that slabs are looked up in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SlabTable {
    /// By front and back scalar (Schulze et al. 2003).
    TwoDimensional,
    /// Running sums over one scalar (Kye et al. 2005).
    OneDimensional,
}

/// How a two-dimensional table is read between its entries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Lookup {
    Nearest,
    Bilinear,
}

/// How opacities are made to suit the length of a ray within a slab.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OpacityCorrection {
    /// A table for the distance of slices; what is looked up is corrected.
    Lookup,
    /// A table for the view's own length.
    View,
    /// A table for the distance of slices, taken as it is.
    Off,
}

/// Where a slab's back scalars wait to be the next slab's front scalars.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BufferSlice {
    /// Two buffers the size of a slice (SB).
    Slice,
    /// One buffer the size of the intermediate image (IB).
    Image,
}

/// Coefficients of the shading model; see [`Shading::default`] for what "on" means.
#[derive(Clone, Debug, PartialEq)]
pub struct Shading {
    pub ambient: f64,
    pub diffuse: f64,
    pub specular: f64,
    pub shininess: f64,
    pub lights: Vec<Light>,
}

impl Default for Shading {
    fn default() -> Self {
        Self { ambient: 0.2, diffuse: 0.8, specular: 0.2, shininess: 20.0, lights: vec![Light::Headlight] }
    }
}

/// A white light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    /// Shines along the viewing rays, with intensity 1.
    Headlight,
    /// From a fixed direction.
    Directional {
        /// Towards the light, world; of any length above 0.
        direction: DVec3,
        intensity: f64,
        /// Whether what lies before a sample takes some of it ([`shadow`]); of several lights one at most.
        shadows: bool,
    },
}

impl Shading {
    /// Where the light is that casts shadows: towards it, world.
    pub fn shadow_light(&self) -> Option<DVec3> {
        self.lights.iter().find_map(|light| match *light {
            Light::Directional { direction, shadows: true, .. } => Some(direction),
            _ => None,
        })
    }

    /// The factor on colours that have no gradient, which all lights meet alike, where so much of the light that casts
    /// shadows comes through.
    fn facing(&self, transmittance: f64) -> f64 {
        let sum = |transmittance| self.lights.iter().map(|light| light.intensity(transmittance)).sum::<f64>();
        let (left, all) = (sum(transmittance), sum(1.0));
        self.ambient + self.diffuse * if all > 0.0 { left / all } else { 1.0 }
    }
}

impl Light {
    /// Its intensity, where so much of the light that casts shadows comes through.
    fn intensity(&self, transmittance: f64) -> f64 {
        match *self {
            Self::Headlight => 1.0,
            Self::Directional { intensity, shadows: true, .. } => intensity * transmittance,
            Self::Directional { intensity, .. } => intensity,
        }
    }
}

/// What lies behind the volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// The image is RGBA with straight alpha.
    Transparent,
    /// The image is RGB.
    Opaque([f32; 3]),
}

/// How far a frame is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// The view's own pixels.
    #[default]
    Final,
    /// The intermediate image and its warp, for whoever warps it himself, where a frame is one warp of one image that is no
    /// larger than the view's own.
    Intermediate,
}

/// What is interpolated between voxels with colours of their own (Kraus and Bürger 2008).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// Extinction, and colour weighted by it (their section 3): free of artefacts wherever samples fall.
    #[default]
    Extinction,
    /// Opacity, and colour weighted by it, corrected for the sample distance afterwards: the older way.
    Opacity,
}

/// All that a frame depends on besides volume, transfer function and view.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    pub algorithm: Algorithm,
    pub quality: Quality,
    pub blend: Blend,
    /// For [`Algorithm::Preintegrated`].
    pub preintegration: Preintegration,
    pub depth_cueing: Option<DepthCueing>,
    pub background: Background,
    pub stage: Stage,
    /// `None`: colours as the transfer function gives them.
    pub shading: Option<Shading>,
    /// Accumulated opacity at which a pixel is done; 1: never.
    pub early_ray_termination: f32,
    /// Ray caster only: step in units of the smallest spacing.
    pub sample_distance: f64,
    /// Of volumes with colours of their own.
    pub sampling: Sampling,
    /// Whether empty space is skipped; the picture is the same bit for bit.
    pub skipping: bool,
}

impl Settings {
    /// The defaults of an algorithm and a quality: shaded, over black.
    pub fn new(algorithm: Algorithm, quality: Quality) -> Self {
        Self {
            algorithm,
            quality,
            blend: Blend::Composite,
            preintegration: Preintegration::of(quality),
            depth_cueing: None,
            background: Background::Opaque([0.0; 3]),
            stage: Stage::Final,
            shading: Some(Shading::default()),
            early_ray_termination: match (algorithm, quality) {
                (Algorithm::Raycast, _) | (_, Quality::High) => TERMINATION_REFERENCE,
                (_, Quality::Draft) => TERMINATION_DRAFT,
                (_, Quality::Standard) => TERMINATION_STANDARD,
            },
            sample_distance: match quality {
                Quality::Draft | Quality::Standard => SAMPLE_DISTANCE,
                Quality::High => SAMPLE_DISTANCE_HIGH,
            },
            sampling: Sampling::default(),
            skipping: true,
        }
    }
}

/// How long each stage of a frame took. Stages that did not run are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timings {
    /// The pre-integration table, where it was not there yet.
    pub preintegration_table: Duration,
    /// Shading and opacity tables of the view.
    pub shade: Duration,
    /// Slices into the intermediate image (or rays through the volume).
    pub composite: Duration,
    /// Intermediate image into the final one.
    pub warp: Duration,
    /// Everything from the view to the pixels in memory.
    pub render: Duration,
}

/// Tells a frame that nobody waits for it any more. Clones share one flag.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks for the end.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// True once [`Self::cancel`] was called.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Why there is no frame.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderError {
    #[error("cancelled")]
    Cancelled,
    #[error("{detail}")]
    Unsupported {
        /// The request's field, as a JSON pointer.
        pointer: &'static str,
        detail: String,
    },
}

/// What a frame shows.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    pub prepared: &'a PreparedVolume,
    pub transfer: &'a TransferFunction,
    /// For the algorithm's purpose; not looked at by [`Algorithm::Raycast`] and by projections.
    pub classification: Option<&'a Classification>,
    /// Of that classification, where they are there: frames without are slower and the same.
    pub encodings: Option<&'a Encodings>,
    /// A segmentation; the transfer function is then the [`crate::classify::labels::union`] of all.
    pub labels: Option<Labels<'a>>,
    /// Of the light that casts shadows ([`Shading::shadow_light`]); without, none are seen.
    pub shadow: Option<&'a Shadow>,
}

impl Scene<'_> {
    /// True where voxels look each as they are, and not by their scalars alone.
    fn is_painted(&self) -> bool {
        self.labels.is_some() || self.prepared.volume().colors().is_some()
    }
}

/// The voxels along a volume's axes x, y, z that all that `scenes` show of it lies among, as far as classifications know.
pub fn shown<'a>(scenes: impl Iterator<Item = &'a Scene<'a>>) -> [Range<usize>; 3] {
    let all = |scene: &Scene<'_>| scene.prepared.volume().dims().map(|voxels| 0..voxels);
    let bounds = scenes.map(|scene| scene.classification.map_or_else(|| all(scene), |known| known.bounds().clone()));
    bounds.fold([0, 1, 2].map(|_| 0..0), |all, own| from_fn(|axis| hull(&all[axis], &own[axis])))
}

/// Refuses what [`render`] would refuse, before anything is built or queued for it. `labelled`: there is a segmentation.
///
/// # Errors
/// [`RenderError::Unsupported`] with the field at fault.
pub fn check(volume: &Volume, labelled: bool, view: &View, settings: &Settings) -> Result<(), RenderError> {
    let is_warped = settings.is_warped(labelled || volume.colors().is_some());
    if is_warped { Factorization::parts(view, volume).map(drop) } else { Ok(()) }
}

impl Settings {
    /// Whether frames are warped from an intermediate image; if not, every pixel has a ray of its own, as slabs between voxels that are
    /// `painted` have.
    fn is_warped(&self, painted: bool) -> bool {
        self.blend == Blend::Composite
            && match self.algorithm {
                Algorithm::Classified | Algorithm::FastClassification => true,
                Algorithm::Preintegrated => self.quality != Quality::High && !painted,
                Algorithm::Raycast => false,
            }
    }
}

/// One frame, on the current rayon pool. The pixels do not depend on the number of threads.
///
/// # Errors
/// [`RenderError::Cancelled`] soon after `cancel` was called; [`RenderError::Unsupported`] for what
/// [`check`] refuses.
pub fn render(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    regions::render_with_regions(scene, view, settings, &[], cancel)
}

/// The pixels of a frame's rays, premultiplied: as the ray caster makes them, or else in shear-image order.
fn rays(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Vec<Vec4>, Timings), RenderError> {
    if settings.algorithm != Algorithm::Raycast {
        return shear_image::rays(scene, view, settings, cancel);
    }
    let start = Instant::now();
    let rays = raycast(scene, view, settings, cancel)?;
    let took = start.elapsed();
    Ok((rays, Timings { composite: took, render: took, ..Timings::default() }))
}
