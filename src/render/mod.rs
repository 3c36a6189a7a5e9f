//! Classified volume + [`View`] -> [`Image`]: one frame, pure, without async.

mod image;
pub mod view;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::DVec3;
use rayon::prelude::*;

use crate::classify::{ClassifiedVolume, TransferFunction};
use crate::raycast::raycast;
use crate::volume::PreparedVolume;
pub use image::Image;
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
pub fn check(_view: &View, _settings: &Settings) -> Result<(), RenderError> {
    Ok(())
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
    check(view, settings)?;
    match settings.algorithm {
        Algorithm::Raycast => reference(scene, view, settings, cancel),
        Algorithm::Classified => Err(RenderError::Unsupported { pointer: "/algorithm", detail: "later".into() }),
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
