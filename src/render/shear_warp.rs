//! A frame by the shear-warp factorization: the paper's outline.

mod slabs;
mod voxels;

use std::time::{Duration, Instant};

use super::composite::cue::DepthTables;
use super::composite::{Composite, naive};
use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::shade::ShadingTable;
use super::{Algorithm, Cancel, Image, RenderError, Scene, Settings, Timings, View, warp};
use crate::classify::Classification;
use crate::volume::gradient::GradientFrame;

/// A frame by the shear-warp factorization: the paper's outline.
pub(super) fn frame(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    let start = Instant::now();
    let volume = scene.prepared.volume();

    // Factor the view into shear and warp.
    let factorization = Factorization::new(view, volume)?;

    // Make the tables that depend on the view: shading by normal, fading by depth, and, in the pass,
    // opacity and colour by code or by pairs of them.
    let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let shading =
        settings.shading.as_ref().map(|s| ShadingTable::new(s, factorization.direction, frame.world_from_frame));
    let cue = settings.depth_cueing.as_ref().map(|cueing| DepthTables::new(cueing, view, volume, &factorization));
    let pass = Pass {
        scene,
        classification: scene.classification.expect("the algorithm needs a classification"),
        factorization: &factorization,
        shading: shading.as_ref(),
        cue: cue.as_ref(),
        settings,
        cancel,
    };

    // Shear, resample and composite the slices into the intermediate image.
    let mut intermediate = IntermediateImage::new(factorization.size);
    let begun = match settings.algorithm {
        Algorithm::Preintegrated => pass.slabs(&mut intermediate),
        _ => pass.voxels(&mut intermediate),
    }?;
    let composite = start.elapsed();

    // Warp the intermediate image into the final one.
    let (width, height) = view.size();
    let channels = settings.background.channels();
    let mut pixels = vec![0; width as usize * height as usize * channels];
    warp::warp(&intermediate, &factorization, &settings.background, width as usize, &mut pixels, cancel)?;
    let render = start.elapsed();

    let Begun { at: ready, preintegration_table } = begun;
    let (shade, composite, warp) =
        (ready - start - preintegration_table, composite - (ready - start), render - composite);
    let timings = Timings { preintegration_table, shade, composite, warp, render };
    Ok((Image { width, height, channels: channels as u8, pixels }, timings))
}

/// What compositing takes from the frame, whatever its type parameters.
#[derive(Clone, Copy)]
struct Pass<'a> {
    scene: &'a Scene<'a>,
    classification: &'a Classification,
    factorization: &'a Factorization,
    shading: Option<&'a ShadingTable>,
    cue: Option<&'a DepthTables>,
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
