//! A frame by the shear-warp factorization: the paper's outline.

mod slabs;
mod voxels;

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec4;

use super::composite::cue::Cue;
use super::composite::sources::Stored;
use super::composite::{Composite, naive};
use super::depth::InverseWarp;
use super::factorization::Factorization;
use super::intermediate::IntermediateImage;
use super::ray_light::RayLight;
use super::regions::{self, Layers, Region, Shape};
use super::shade::ShadingTable;
use super::{Algorithm, Cancel, Image, RenderError, Scene, Settings, Stage, Timings, View, image, shown, warp};
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
    let in_regions = regions.iter().filter_map(|region| region.shown.as_ref()).map(|(scene, _)| scene);
    let shown = shown(in_regions.chain([scene]));
    let mut layers = vec![];
    for factorization in &parts {
        let pixels = factorization.pixels_over(&shown);
        let depth = InverseWarp::of(view, scene.prepared.volume(), factorization, pixels.clone());
        layers.push((
            part(scene, view, (factorization, &pixels, depth.as_ref()), settings, regions, &mut timings, cancel)?,
            depth,
        ));
    }
    let composited = start.elapsed();

    // Warp the intermediate images into the final one, or leave that to whoever asked.
    let (width, height) = view.size();
    let channels = settings.background.channels();
    let image_size = [width, height].map(|side| side as usize);
    let with_layers = parts.iter().zip(&layers);
    let parts: Vec<_> = with_layers
        .map(|(factorization, (image, depth))| warp::Part { factorization, image, depth: depth.as_ref() })
        .collect();
    let unwarped = match (settings.stage, &parts[..]) {
        (Stage::Intermediate, [part]) => warp::unwarped(part, &settings.background, image_size),
        _ => None,
    };
    let image = match unwarped {
        Some(image) => image,
        None => {
            let mut pixels = image::unwritten(image_size[0] * image_size[1] * channels);
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
    (factorization, pixels, depth): (&Factorization, &[Range<usize>; 2], Option<&InverseWarp<'_>>),
    settings: &Settings,
    regions: &[Region<'_>],
    timings: &mut Timings,
    cancel: &Cancel,
) -> Result<IntermediateImage, RenderError> {
    let start = Instant::now();
    let volume = scene.prepared.volume();
    let behind = settings.background.behind();
    let cue = settings.depth_cueing.as_ref().map(|cueing| Cue::new(cueing, view, volume, factorization));
    // What is cut out is a hole to the kernels.
    if regions.iter().all(|region| region.shown.is_none()) {
        let tables = Tables::new(scene, settings, factorization);
        let holes = regions.iter().map(|region| &region.shape);
        let limited = factorization.clone().limited(depth.map(|depth| depth.limits())).cut_out(volume, holes);
        let pass = Pass::new(scene, settings, &limited, &tables, cue.as_ref(), cancel);
        timings.shade += start.elapsed();
        return pass.image(behind, timings);
    }

    // Where regions look otherwise, layer behind layer, in this image already: a ray's pieces are blended before
    // rays are. One layer is over the background at once.
    let layers = Layers::new(volume, factorization, pixels, depth, &Shape::of(regions), cancel)?;
    let all = layers.which();
    let ground = if all.len() == 1 { behind } else { Vec4::ZERO };
    let mut image = IntermediateImage::blank(factorization.size);
    let mut tables = BTreeMap::new();
    timings.shade += start.elapsed();
    for &which in &all {
        let start = Instant::now();
        let (scene, settings) = regions::shown(which, (scene, settings), regions);
        let limits = layers.limits(which, &image, settings.early_ray_termination);
        if limits.is_empty() {
            continue;
        }
        let limited = factorization.clone().limited(Some(Arc::new(limits)));
        let tables = tables.entry(which.within).or_insert_with(|| Tables::new(scene, settings, factorization));
        let pass = Pass::new(scene, settings, &limited, tables, cue.as_ref(), cancel);
        timings.shade += start.elapsed();
        let layer = pass.image(ground, timings)?;
        if all.len() == 1 {
            return Ok(layer);
        }
        image.put_behind(&layer);
    }
    image.put_ground_behind(behind);
    Ok(image)
}

/// What depends on the view, of volumes that look the same.
struct Tables {
    light: LightTable,
    /// The same where the light that casts shadows is gone, if one does.
    in_shadow: Option<LightTable>,
}

/// What a volume is lit by.
enum LightTable {
    Off,
    /// Rays are parallel.
    ByNormal(ShadingTable),
    /// Each is lit along its own.
    ByRay(RayLight),
}

impl LightTable {
    /// That of parallel rays, if there is light.
    fn by_normal(&self) -> Option<&ShadingTable> {
        match self {
            Self::ByNormal(table) => Some(table),
            Self::Off | Self::ByRay(_) => None,
        }
    }
}

impl Tables {
    fn new(scene: &Scene<'_>, settings: &Settings, factorization: &Factorization) -> Self {
        let volume = scene.prepared.volume();
        let Some(shading) = &settings.shading else { return Self { light: LightTable::Off, in_shadow: None } };
        let table = |transmittance| match RayLight::new(shading, transmittance, volume, factorization) {
            Some(ray_light) => LightTable::ByRay(ray_light),
            None => {
                let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
                let forward = factorization.direction;
                LightTable::ByNormal(ShadingTable::new(shading, transmittance, forward, frame.world_from_frame))
            }
        };
        Self { light: table(1.0), in_shadow: scene.shadow.map(|_| table(0.0)) }
    }
}

/// What compositing takes from the frame, whatever its type parameters.
#[derive(Clone, Copy)]
struct Pass<'a> {
    scene: &'a Scene<'a>,
    classification: &'a Classification,
    factorization: &'a Factorization,
    tables: &'a Tables,
    cue: Option<&'a Cue>,
    settings: &'a Settings,
    cancel: &'a Cancel,
}

/// When compositing began, and how long of the time before a pre-integration table took.
struct Begun {
    at: Instant,
    preintegration_table: Duration,
}

impl<'a> Pass<'a> {
    fn new(
        scene: &'a Scene<'a>,
        settings: &'a Settings,
        factorization: &'a Factorization,
        tables: &'a Tables,
        cue: Option<&'a Cue>,
        cancel: &'a Cancel,
    ) -> Self {
        let classification = scene.classification.expect("the algorithm needs a classification");
        Self { scene, classification, factorization, tables, cue, settings, cancel }
    }

    /// How much of the light that casts shadows each voxel lacks, in 255ths.
    fn lacking(&self) -> Option<Stored<'_, u8>> {
        self.scene.shadow.map(|shadow| Stored::new(shadow.lacking(), self.factorization))
    }

    /// The image over a premultiplied pixel.
    fn image(&self, behind: Vec4, timings: &mut Timings) -> Result<IntermediateImage, RenderError> {
        let start = Instant::now();
        let mut image = IntermediateImage::new(self.factorization.size, behind);
        let Begun { at, preintegration_table } = match self.settings.algorithm {
            Algorithm::Preintegrated => self.slabs(&mut image),
            _ => self.voxels(&mut image),
        }?;
        timings.shade += at - start - preintegration_table;
        timings.preintegration_table += preintegration_table;
        Ok(image)
    }

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
