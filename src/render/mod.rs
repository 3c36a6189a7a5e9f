//! Classified volume + [`View`] -> [`Image`]: one frame, pure, without async.

pub mod composite;
pub mod factorization;
mod image;
pub mod intermediate;
pub mod material;
pub mod shade;
pub mod view;
pub mod warp;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::DVec3;
use rayon::prelude::*;

use crate::classify::{ClassifiedVolume, TransferFunction};
use crate::raycast::raycast;
use crate::volume::gradient::GradientFrame;
use crate::volume::{PreparedVolume, Volume};
use composite::Composite;
use factorization::Factorization;
pub use image::Image;
use intermediate::IntermediateImage;
use material::{Material, SliceTables};
use shade::ShadingTable;
pub use view::{Camera, LookAt, Orbit, Projection, Ray, View, ViewError};

/// How a frame is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Algorithm {
    /// Run-length encoded volumes (Lacroute and Levoy 1994, section 3.1).
    Classified,
    /// The image-order reference.
    Raycast,
}

impl Algorithm {
    /// The name used by the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Classified => "classified",
            Self::Raycast => "raycast",
        }
    }
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
    },
}

/// What lies behind the volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// The image is RGBA with straight alpha.
    Transparent,
    /// The image is RGB.
    Opaque([f32; 3]),
}

/// All that a frame depends on besides volume, transfer function and view.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    pub algorithm: Algorithm,
    pub background: Background,
    /// `None`: colours as the transfer function gives them.
    pub shading: Option<Shading>,
    /// Accumulated opacity at which a pixel is done; 1: never.
    pub early_ray_termination: f32,
    /// Ray caster only: step in units of the smallest spacing.
    pub sample_distance: f64,
    /// Whether empty space is skipped; the picture is the same bit for bit.
    pub skipping: bool,
}

/// How long each stage of a frame took. Stages that did not run are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timings {
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
    /// Needed by [`Algorithm::Classified`], not looked at by [`Algorithm::Raycast`].
    pub classified: Option<&'a ClassifiedVolume>,
}

/// Refuses what [`render`] would refuse, before anything is built or queued for it.
///
/// # Errors
/// [`RenderError::Unsupported`] with the field at fault.
pub fn check(volume: &Volume, view: &View, settings: &Settings) -> Result<(), RenderError> {
    match settings.algorithm {
        Algorithm::Raycast => Ok(()),
        Algorithm::Classified => Factorization::new(view, volume).map(|_| ()),
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
    match settings.algorithm {
        Algorithm::Raycast => reference(scene, view, settings, cancel),
        Algorithm::Classified => shear_warp(scene, view, settings, cancel),
    }
}

/// A frame by the ray caster.
fn reference(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    let start = Instant::now();
    let rays = raycast(scene, view, settings, cancel)?;
    let composite = start.elapsed();
    let (width, height) = view.size();
    let channels = settings.background.channels();
    let mut pixels = vec![0; rays.len() * channels];
    let rows = pixels.par_chunks_mut(width as usize * channels).zip(rays.par_chunks(width as usize));
    rows.for_each(|(out, row)| image::write_row(row, &settings.background, out));
    let timings = Timings { composite, render: start.elapsed(), ..Timings::default() };
    Ok((Image { width, height, channels: channels as u8, pixels }, timings))
}

/// A frame by the shear-warp factorization: the paper's outline.
fn shear_warp(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    let classified = scene.classified.expect("the algorithm classified needs a classified volume");
    let start = Instant::now();
    let volume = scene.prepared.volume();

    // Factor the view into shear and warp.
    let factorization = Factorization::new(view, volume)?;

    // Make the tables that depend on the view: opacity and colour by code, shading by normal.
    let factored = !scene.transfer.gradient_opacity.is_empty();
    let tables = SliceTables::new(classified.tables(), &factorization, factored);
    let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let shading =
        settings.shading.as_ref().map(|s| ShadingTable::new(s, factorization.direction, frame.world_from_frame));
    let shade = start.elapsed();

    // Shear, resample and composite the slices into the intermediate image.
    let mut intermediate = IntermediateImage::new(factorization.size);
    let frame = ClassifiedFrame { classified, factorization: &factorization, settings, cancel };
    match (&shading, factored) {
        (Some(_), true) => frame.composite::<true, true>(&tables, shading.as_ref(), &mut intermediate),
        (Some(_), false) => frame.composite::<true, false>(&tables, shading.as_ref(), &mut intermediate),
        (None, true) => frame.composite::<false, true>(&tables, None, &mut intermediate),
        (None, false) => frame.composite::<false, false>(&tables, None, &mut intermediate),
    }?;
    let composite = start.elapsed();

    // Warp the intermediate image into the final one.
    let (width, height) = view.size();
    let channels = settings.background.channels();
    let mut pixels = vec![0; width as usize * height as usize * channels];
    warp::warp(&intermediate, &factorization, &settings.background, width as usize, &mut pixels, cancel)?;
    let render = start.elapsed();

    let timings = Timings { shade, composite: composite - shade, warp: render - composite, render };
    Ok((Image { width, height, channels: channels as u8, pixels }, timings))
}

/// What compositing takes from the frame, whatever its type parameters.
struct ClassifiedFrame<'a> {
    classified: &'a ClassifiedVolume,
    factorization: &'a Factorization,
    settings: &'a Settings,
    cancel: &'a Cancel,
}

impl ClassifiedFrame<'_> {
    fn composite<const LIT: bool, const FACTORED: bool>(
        &self,
        tables: &SliceTables,
        shading: Option<&ShadingTable>,
        image: &mut IntermediateImage,
    ) -> Result<(), RenderError> {
        let composite = Composite::<LIT, FACTORED> {
            encoding: self.classified.run_lengths().for_axis(self.factorization.principal_axis),
            factorization: self.factorization,
            material: Material::new(tables, shading),
            opaque: self.settings.early_ray_termination,
            cancel: self.cancel,
        };
        if self.settings.skipping { composite.run(image) } else { composite::naive::run(&composite, image) }
    }
}
