//! A frame by the shear-warp factorization: the paper's outline.

mod slabs;
mod voxels;

use std::time::{Duration, Instant};

use glam::Vec4;

use super::composite::cue::Cue;
use super::composite::{Composite, naive};
use super::depth::InverseWarp;
use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::ray_light::RayLight;
use super::regions::{self, Layers, Region};
use super::shade::ShadingTable;
use super::{Algorithm, Cancel, Image, RenderError, Scene, Settings, Stage, Timings, View, warp};
use crate::classify::Classification;
use crate::volume::gradient::GradientFrame;

/// A frame by the shear-warp factorization: the paper's outline.
pub(super) fn frame(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    regions: &[Region<'_>],
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    let start = Instant::now();

    // Factor the view into shear and warp; a wide perspective view part by part.
    let parts = Factorization::parts(view, scene.prepared.volume())?;

    // Shear, resample and composite the slices into an intermediate image for each part.
    let mut timings = Timings { shade: start.elapsed(), ..Timings::default() };
    let mut images = vec![];
    for factorization in &parts {
        images.push(part(scene, view, factorization, settings, regions, &mut timings, cancel)?);
    }
    let composited = start.elapsed();

    // Warp the intermediate images into the final one, or leave that to whoever asked.
    let (width, height) = view.size();
    let channels = settings.background.channels();
    let image_size = [width, height].map(|side| side as usize);
    let parts: Vec<_> =
        parts.iter().zip(&images).map(|(factorization, image)| warp::Part { factorization, image }).collect();
    let unwarped = match (settings.stage, &parts[..]) {
        (Stage::Intermediate, [part]) => warp::unwarped(part, &settings.background, image_size),
        _ => None,
    };
    let image = match unwarped {
        Some(image) => image,
        None => {
            let mut pixels = vec![0; image_size[0] * image_size[1] * channels];
            warp::warp(&parts, &settings.background, image_size[0], &mut pixels, cancel)?;
            Image { width, height, channels: channels as u8, pixels, warp: None }
        }
    };

    timings.render = start.elapsed();
    timings.composite = composited - timings.shade - timings.preintegration_table;
    timings.warp = timings.render - composited;
    Ok((image, timings))
}

/// The intermediate image of a part of the view.
fn part(
    scene: &Scene<'_>,
    view: &View,
    factorization: &Factorization,
    settings: &Settings,
    regions: &[Region<'_>],
    timings: &mut Timings,
    cancel: &Cancel,
) -> Result<IntermediateImage, RenderError> {
    let volume = scene.prepared.volume();
    let behind = settings.background.behind();
    let depth = InverseWarp::of(view, volume, factorization);
    if regions.is_empty() {
        let limited = factorization.clone().limited(depth.map(|depth| depth.limits()));
        return layer(scene, view, &limited, settings, behind, timings, cancel);
    }

    // Where regions look otherwise, layer behind layer, in this image already: a ray's pieces are blended before
    // rays are.
    let shapes: Vec<_> = regions.iter().map(|region| region.shape.clone()).collect();
    let layers = Layers::new(volume, factorization, depth.as_ref(), &shapes);
    let mut image = IntermediateImage::blank(factorization.size);
    for which in layers.which() {
        let Some((scene, settings)) = regions::shown(which, (scene, settings), regions) else { continue };
        let begun = Instant::now();
        let limits = layers.limits(which, &image, settings.early_ray_termination);
        timings.shade += begun.elapsed();
        if limits.is_empty() {
            continue;
        }
        let limited = factorization.clone().limited(Some(limits));
        image.put_behind(&layer(scene, view, &limited, settings, Vec4::ZERO, timings, cancel)?);
    }
    image.put_over(behind);
    Ok(image)
}

/// The intermediate image of what a factorization's limits leave, over a premultiplied pixel.
fn layer(
    scene: &Scene<'_>,
    view: &View,
    factorization: &Factorization,
    settings: &Settings,
    behind: Vec4,
    timings: &mut Timings,
    cancel: &Cancel,
) -> Result<IntermediateImage, RenderError> {
    let start = Instant::now();

    // Make the tables that depend on the view: light by normal (in perspective there is none, for
    // every ray has its own), fading by depth, and, in the pass, opacity and colour by code or by
    // pairs of them.
    let volume = scene.prepared.volume();
    let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let shading = settings.shading.as_ref();
    let ray_light = shading.and_then(|s| RayLight::new(s, volume, factorization));
    let table = match &ray_light {
        None => shading.map(|s| ShadingTable::new(s, factorization.direction, frame.world_from_frame)),
        Some(_) => None,
    };
    let cue = settings.depth_cueing.as_ref().map(|cueing| Cue::new(cueing, view, volume, factorization));
    let pass = Pass {
        scene,
        classification: scene.classification.expect("the algorithm needs a classification"),
        factorization,
        table: table.as_ref(),
        ray_light: ray_light.as_ref(),
        cue: cue.as_ref(),
        settings,
        cancel,
    };
    let mut image = IntermediateImage::new(factorization.size, behind);
    let Begun { at, preintegration_table } = match settings.algorithm {
        Algorithm::Preintegrated => pass.slabs(&mut image),
        _ => pass.voxels(&mut image),
    }?;
    timings.shade += at - start - preintegration_table;
    timings.preintegration_table += preintegration_table;
    Ok(image)
}

/// What compositing takes from the frame, whatever its type parameters.
#[derive(Clone, Copy)]
struct Pass<'a> {
    scene: &'a Scene<'a>,
    classification: &'a Classification,
    factorization: &'a Factorization,
    /// Where the volume is shaded: by normal under parallel projection, by ray in perspective.
    table: Option<&'a ShadingTable>,
    ray_light: Option<&'a RayLight>,
    cue: Option<&'a Cue>,
    settings: &'a Settings,
    cancel: &'a Cancel,
}

/// When compositing began, and how long of the time before a pre-integration table took.
struct Begun {
    at: Instant,
    preintegration_table: Duration,
}

impl Pass<'_> {
    /// Composites into `image`.
    fn run(
        &self,
        composite: &(impl Composite + naive::Pixels),
        image: &mut IntermediateImage,
    ) -> Result<Begun, RenderError> {
        let at = Instant::now();
        if self.settings.skipping { composite.run(image) } else { naive::run(composite, image, self.cancel) }?;
        Ok(Begun { at, preintegration_table: Duration::ZERO })
    }
}
