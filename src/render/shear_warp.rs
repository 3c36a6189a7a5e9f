//! A frame by the shear-warp factorization: the paper's outline.

use std::time::Instant;

use super::composite::{self, Composite};
use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::material::{Material, SliceTables};
use super::shade::ShadingTable;
use super::{Cancel, Image, RenderError, Scene, Settings, Timings, View, warp};
use crate::classify::{Encodings, RunLengthVolume};
use crate::volume::gradient::GradientFrame;

/// A frame by the shear-warp factorization: the paper's outline.
pub(super) fn frame(
    scene: &Scene<'_>,
    view: &View,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<(Image, Timings), RenderError> {
    let classification = scene.classification.expect("the algorithm needs a classification");
    let run_lengths = scene.encodings.and_then(Encodings::voxels).expect("the algorithm needs encodings");
    let start = Instant::now();
    let volume = scene.prepared.volume();

    // Factor the view into shear and warp.
    let parts = Factorization::parts(view, volume)?;
    let [factorization] = &parts[..] else { return Err(perspective()) };
    if !factorization.is_parallel() {
        return Err(perspective());
    }

    // Make the tables that depend on the view: opacity and colour by code, shading by normal.
    let factored = !scene.transfer.gradient_opacity.is_empty();
    let tables = SliceTables::new(classification.tables(), factorization, factored);
    let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    let shading =
        settings.shading.as_ref().map(|s| ShadingTable::new(s, factorization.direction, frame.world_from_frame));
    let shade = start.elapsed();

    // Shear, resample and composite the slices into the intermediate image.
    let mut intermediate = IntermediateImage::new(factorization.size);
    let frame = ClassifiedFrame { run_lengths, factorization, settings, cancel };
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
    let parts = [warp::Part { factorization, image: &intermediate }];
    warp::warp(&parts, &settings.background, width as usize, &mut pixels, cancel)?;
    let render = start.elapsed();

    let timings = Timings { shade, composite: composite - shade, warp: render - composite, render };
    Ok((Image { width, height, channels: channels as u8, pixels }, timings))
}

/// What is said of perspective views.
pub(super) fn perspective() -> RenderError {
    RenderError::Unsupported {
        pointer: "/camera/projection",
        detail: "the algorithm classified is for parallel projection".into(),
    }
}

/// What compositing takes from the frame, whatever its type parameters.
struct ClassifiedFrame<'a> {
    run_lengths: &'a RunLengthVolume,
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
            encoding: self.run_lengths.for_axis(self.factorization.principal_axis),
            factorization: self.factorization,
            material: Material::new(tables, shading),
            opaque: self.settings.early_ray_termination,
            cancel: self.cancel,
        };
        if self.settings.skipping { composite.run(image) } else { composite::naive::run(&composite, image) }
    }
}
