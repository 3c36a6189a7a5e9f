//! [`RenderRequest`] + volume -> what the renderer takes, with every default filled in.

mod labels;

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::fields::WindowFields;
use super::{
    AlgorithmChoice, GeometryRequest, InvalidField, RegionRequest, RenderRequest, RequestError, ShadingChoice, Transfer,
};
use crate::classify::labels::Labels;
use crate::classify::presets::{self, FittedPresets};
use crate::classify::{Purpose, TransferFunction};
use crate::encode::Format;
use crate::render::raster::{self, Solid};
use crate::render::regions::{Region, render_with_regions};
use crate::render::shadow::Shadow;
use crate::render::{
    self, Algorithm, Background, Blend, BufferSlice, Cancel, Clip, Image, Preintegration, Quality, RenderError, Scene,
    Settings, Shading, Stage, Timings, View, Window,
};
use crate::volume::{PreparedVolume, Volume, pyramid};
pub use labels::ResolvedLabels;

/// Half of what shows in one voxel on an 8-bit display.
const MIN_OPACITY: f64 = 0.002;

/// Tables of a frame's labels at most: 1 MiB each, for volumes of 16 bits.
const MAX_LABEL_TABLES: usize = 256;

/// How large an image may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageLimits {
    /// Pixels across or down.
    pub max_side: u32,
    /// Pixels in all.
    pub max_pixels: u64,
}

/// A request on a volume, ready to render.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedRequest {
    pub view: View,
    /// Of the volume; of its background too.
    pub look: Look,
    /// Where it looks otherwise, in order: of two that hold a point the later one is meant.
    pub regions: Vec<RegionLook>,
    /// Where a light casts them.
    pub shadows: Option<ResolvedShadows>,
    /// Meshes beside the volume.
    pub geometry: Vec<GeometryRequest>,
    /// `None`: the request leaves it open.
    pub format: Option<Format>,
}

/// How the volume, or a part of it, looks.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    pub settings: Settings,
    /// Its `opacity_distance` is told.
    pub transfer: TransferFunction,
    /// A segmentation by which voxels look otherwise, the same for all of a frame's looks; the transfer function is then the union of all.
    pub labels: Option<ResolvedLabels>,
    /// Voxels at or below it count as transparent (for [`Algorithm::Classified`]).
    pub min_opacity: f64,
    /// Of the volume's pyramid; the same for all of a frame's looks.
    pub level: usize,
}

/// Shadows: all that they depend on besides the scene that casts them.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedShadows {
    /// Towards the light, world.
    towards: DVec3,
    /// What is cut away casts none.
    clip: Clip,
    holes: Vec<Clip>,
}

impl ResolvedShadows {
    /// The shadows that a volume casts on itself, made on the current rayon pool; see [`Shadow::cast`].
    pub fn cast(&self, prepared: &PreparedVolume, transfer: &TransferFunction, labels: Option<Labels<'_>>) -> Shadow {
        Shadow::cast(prepared, transfer, labels, self.towards, &self.clip, &self.holes)
    }
}

/// How the volume looks within a convex part of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionLook {
    /// World mm.
    pub shape: Clip,
    /// `None`: nothing is there. Algorithm, quality and level are the frame's.
    pub look: Option<Look>,
}

impl RenderRequest {
    /// The request on `volume`, to which `presets` were fitted.
    ///
    /// # Errors
    /// [`RequestError::Refused`] for an image over the limits, an unknown preset, a degenerate
    /// camera, and what the algorithm does not do.
    pub fn resolve(
        &self,
        volume: &Volume,
        presets: &FittedPresets,
        limits: &ImageLimits,
    ) -> Result<ResolvedRequest, RequestError> {
        self.resolve_json(volume, presets, limits).map_err(|error| error.spelled(self.spelling))
    }

    /// What the camera sees of `volume`. Pointers are those of the JSON request.
    ///
    /// # Errors
    /// For a degenerate camera, which an orbit never is.
    pub fn view(&self, volume: &Volume) -> Result<View, RequestError> {
        View::new(&self.camera, volume.centre(), volume.radius(), self.width, self.height)
            .map(|view| view.clipped(&self.clip))
            .map_err(|e| RequestError::refused(&format!("/camera{}", e.pointer()), e.to_string()))
    }

    /// Pointers are those of the JSON request.
    fn resolve_json(
        &self,
        volume: &Volume,
        presets: &FittedPresets,
        limits: &ImageLimits,
    ) -> Result<ResolvedRequest, RequestError> {
        self.keep_to(limits)?;
        self.suits(volume)?;
        let view = self.view(volume)?;
        let level = self.level(volume, &view)?;
        let look = self.look(volume, presets, level, None)?;
        let labelled = self.labels.is_some();
        render::check(volume, labelled, &view, &look.settings).map_err(refused)?;
        let shown = self.regions.iter().enumerate().map(|(index, region)| {
            let look = self.look(volume, presets, level, Some((index, region)))?;
            render::check(volume, labelled, &view, &look.settings).map_err(refused)?;
            let of_voxels = matches!(look.settings.algorithm, Algorithm::Classified | Algorithm::FastClassification);
            if of_voxels && region.projection.is_some() != self.projection.is_some() {
                let detail = "projections beside what is composited go with preintegrated and raycast";
                return Err(RequestError::refused(&format!("/regions/{index}/blend"), detail));
            }
            Ok(RegionLook { shape: region.shape.clone(), look: Some(look) })
        });
        // What is cut out stays so, whatever is to be shown there.
        let cut_out = self.cut_out.iter().map(|shape| Ok(RegionLook { shape: shape.clone(), look: None }));
        let regions = shown.chain(cut_out).collect::<Result<_, RequestError>>()?;
        let light = look.settings.shading.as_ref().filter(|_| look.settings.blend == Blend::Composite);
        let shadows = light.and_then(Shading::shadow_light).map(|towards| ResolvedShadows {
            towards,
            clip: self.clip.clone(),
            holes: self.cut_out.clone(),
        });
        let geometry = self.geometry.clone();
        Ok(ResolvedRequest { view, look, regions, shadows, geometry, format: self.format })
    }

    /// How the volume looks, in a region if there is one.
    fn look(
        &self,
        volume: &Volume,
        presets: &FittedPresets,
        level: usize,
        region: Option<(usize, &RegionRequest)>,
    ) -> Result<Look, RequestError> {
        let (place, told) = match region.and_then(|(index, region)| Some((index, region.transfer.as_ref()?))) {
            Some((index, transfer)) => (format!("/regions/{index}/transfer_function"), transfer),
            None => ("/transfer_function".into(), &self.transfer),
        };
        let region = region.map(|(_, region)| region);
        let (mut transfer, shaded) = fitted(told, presets, &place)?;
        transfer.opacity_distance = Some(transfer.reference_length(volume.smallest_spacing()));
        let opacity = region.map_or(1.0, |region| region.opacity);
        transfer.points.iter_mut().for_each(|point| point.opacity *= opacity);
        let shading = match region.and_then(|region| region.shading.as_ref()).unwrap_or(&self.shading) {
            ShadingChoice::Automatic => shaded.then(Shading::default),
            ShadingChoice::Off => None,
            ShadingChoice::On(shading) => Some(shading.clone()),
        };
        let projection = region.map_or(self.projection, |region| region.projection);
        let window = region.and_then(|region| region.window.as_ref()).unwrap_or(&self.window);
        let defaults = Settings::new(self.algorithm(volume), self.quality);
        let settings = Settings {
            blend: projection.map_or(Blend::Composite, |which| Blend::Projection(which, fill(window, volume))),
            preintegration: self.preintegration,
            depth_cueing: self.depth_cueing,
            background: self.background,
            stage: self.stage,
            shading,
            early_ray_termination: self.early_ray_termination.map_or(defaults.early_ray_termination, |t| t as f32),
            sample_distance: self.sample_distance.unwrap_or(defaults.sample_distance),
            sampling: self.sampling.unwrap_or_default(),
            ..defaults
        };
        let min_opacity = self.min_opacity.unwrap_or(MIN_OPACITY);
        let look = Look { settings, transfer, labels: None, min_opacity, level };
        match &self.labels {
            Some(labels) => look.by_label(labels, opacity, volume, presets),
            None => Ok(look),
        }
    }

    fn keep_to(&self, limits: &ImageLimits) -> Result<(), RequestError> {
        let (width, height) = (self.width, self.height);
        let sides = [("/image/width", width), ("/image/height", height)];
        let mut refused: Vec<_> = sides
            .into_iter()
            .filter(|(_, side)| *side > limits.max_side)
            .map(|(pointer, side)| InvalidField {
                pointer: pointer.into(),
                detail: format!("expected at most {} pixels, got {side}", limits.max_side),
            })
            .collect();
        if refused.is_empty() && u64::from(width) * u64::from(height) > limits.max_pixels {
            let detail = format!("expected at most {} pixels in all, got {width} x {height}", limits.max_pixels);
            refused.push(InvalidField { pointer: "/image/width".into(), detail });
        }
        if refused.is_empty() { Ok(()) } else { Err(RequestError::Refused(refused)) }
    }

    /// Refuses what volumes without colours of their own, or with, do not have.
    fn suits(&self, volume: &Volume) -> Result<(), RequestError> {
        if volume.colors().is_none() && self.sampling.is_some() {
            return Err(RequestError::refused("/sampling", "belongs to colour volumes, and this one is of scalars"));
        }
        if let Some(labels) = &self.labels {
            if volume.colors().is_some() {
                return Err(RequestError::refused("/labels", "belong to volumes of scalars"));
            }
            self.keep_to_tables(labels.looks.len())?;
        }
        Ok(())
    }

    /// Refuses more tables, of so many labels and other voxels, around regions and in each of them, than there may be.
    fn keep_to_tables(&self, looks: usize) -> Result<(), RequestError> {
        let tables = (looks + 1) * (self.regions.len() + 1);
        if tables <= MAX_LABEL_TABLES {
            return Ok(());
        }
        let detail = format!(
            "expected at most {MAX_LABEL_TABLES} looks in all, around regions and in each of them, got {tables}: those \
             of {looks} labels and of other voxels, in {} regions",
            self.regions.len()
        );
        Err(RequestError::refused("/labels/looks", detail))
    }

    /// True where voxels look each as they are, and not by their scalars alone.
    fn is_of_voxels(&self, volume: &Volume) -> bool {
        volume.colors().is_some() || self.labels.is_some()
    }

    /// True where nothing is projected, in no region either.
    fn is_composited(&self) -> bool {
        self.projection.is_none() && self.regions.iter().all(|region| region.projection.is_none())
    }

    /// The level that is told, or else 0, and for drafts the finest whose voxels are larger than pixels, at least 1.
    fn level(&self, volume: &Volume, view: &View) -> Result<usize, RequestError> {
        let levels = pyramid::levels(volume.dims());
        if let Some(level) = self.level {
            let level = usize::try_from(level).ok().filter(|level| *level < levels);
            return level.ok_or_else(|| {
                let detail =
                    format!("expected a level from 0 to {}, got {}", levels - 1, self.level.unwrap_or_default());
                RequestError::refused("/level", detail)
            });
        }
        if self.quality != Quality::Draft || self.algorithm(volume) == Algorithm::Raycast {
            return Ok(0);
        }
        let voxels = view.pixel_size(volume.centre()) / volume.smallest_spacing();
        Ok((1 + voxels.max(1.0).log2() as usize).min(levels - 1))
    }

    /// `auto` is resolved from the request and the kind of the volume alone.
    fn algorithm(&self, volume: &Volume) -> Algorithm {
        match self.algorithm {
            AlgorithmChoice::Auto
                if self.is_of_voxels(volume) && self.is_composited() && self.quality != Quality::High =>
            {
                Algorithm::Classified
            }
            AlgorithmChoice::Auto | AlgorithmChoice::Preintegrated => Algorithm::Preintegrated,
            AlgorithmChoice::Classified => Algorithm::Classified,
            AlgorithmChoice::FastClassification => Algorithm::FastClassification,
            AlgorithmChoice::Raycast => Algorithm::Raycast,
        }
    }
}

/// The transfer function that a request tells at `place`, and whether it asks for shading.
fn fitted(told: &Transfer, presets: &FittedPresets, place: &str) -> Result<(TransferFunction, bool), RequestError> {
    match told {
        Transfer::Automatic => Ok((presets.default.transfer.clone(), presets.default.shading)),
        Transfer::Preset(name) => {
            let (preset, fitted) = presets.get(name).ok_or_else(|| {
                let names: Vec<_> = presets::all().iter().map(|preset| preset.name.as_str()).collect();
                let detail = format!("unknown preset, expected one of {}", names.join(", "));
                RequestError::refused(place, detail)
            })?;
            Ok((fitted.clone(), preset.shading))
        }
        Transfer::Given(transfer) => Ok((transfer.clone(), true)),
    }
}

/// What a projection shows from black to white: the volume's range of values unless told.
fn fill(window: &WindowFields, volume: &Volume) -> Window {
    let (low, high) = volume.value_range();
    let range = if high > low { high - low } else { 1.0 };
    Window { center: window.center.unwrap_or(low + range / 2.0), width: window.width.unwrap_or(range) }
}

impl ResolvedRequest {
    /// The level of the volume's pyramid that the frame shows.
    pub fn level(&self) -> usize {
        self.look.level
    }

    /// The volume's look, and those of the regions that show something.
    pub fn looks(&self) -> impl Iterator<Item = &Look> {
        [&self.look].into_iter().chain(self.regions.iter().filter_map(|region| region.look.as_ref()))
    }

    /// The frame as `view` sees it; `scenes` are what the [`Self::looks`] show and `solids` what the geometry is, in their order.
    ///
    /// # Errors
    /// As [`render::render`].
    pub fn render(
        &self,
        view: &View,
        scenes: &[Scene<'_>],
        solids: &[Solid],
        cancel: &Cancel,
    ) -> Result<(Image, Timings), RenderError> {
        if solids.is_empty() {
            return self.render_volume(view, &self.look.settings, scenes, cancel);
        }
        let start = Instant::now();
        let settings = &self.look.settings;
        let drawn = raster::draw(solids, view, scenes[0].prepared.volume(), settings, cancel)?;
        let shade = start.elapsed();
        let view = view.clone().ending_at(Arc::new(drawn.depth));
        let settings = Settings { background: Background::Transparent, stage: Stage::Final, ..settings.clone() };
        let (image, timings) = self.render_volume(&view, &settings, scenes, cancel)?;
        let image = image.over(&drawn.picture);
        Ok((image, Timings { shade: timings.shade + shade, render: start.elapsed(), ..timings }))
    }

    /// The volume alone, with the frame's settings told apart.
    fn render_volume(
        &self,
        view: &View,
        settings: &Settings,
        scenes: &[Scene<'_>],
        cancel: &Cancel,
    ) -> Result<(Image, Timings), RenderError> {
        let mut shown = self.looks().zip(scenes).map(|(look, scene)| (*scene, &look.settings));
        let mut next = || shown.next().expect("as many scenes as looks");
        let (scene, _) = next();
        let regions = self.regions.iter();
        let regions: Vec<_> = regions
            .map(|RegionLook { shape, look }| Region { shape: shape.clone(), shown: look.as_ref().map(|_| next()) })
            .collect();
        render_with_regions(&scene, view, settings, &regions, cancel)
    }

    /// All that the pixels depend on besides the volume, as text: the same for requests that mean the
    /// same, however they were written. The format is left out, being known only after negotiation.
    pub fn canonical(&self) -> String {
        let settings = &self.look.settings;
        // Debug writes floats with as many digits as tell them apart.
        let Settings { background, stage, algorithm, .. } = settings;
        let frame = format!("{:?} {background:?} {stage:?} {}", self.view, algorithm.name());
        let regions = self.regions.iter().map(|RegionLook { shape, look }| {
            format!(" {shape:?} {}", look.as_ref().map_or("nothing".into(), Look::canonical))
        });
        let look = self.look.canonical();
        format!("{frame} {look}{} {:?}", regions.collect::<String>(), self.geometry)
    }
}

impl Look {
    /// What it needs classified; `None`: nothing.
    pub fn purpose(&self) -> Option<Purpose> {
        match (self.settings.algorithm, self.settings.blend) {
            (_, Blend::Projection(..)) | (Algorithm::Raycast, _) => None,
            (Algorithm::Classified | Algorithm::FastClassification, _) => {
                Some(Purpose::Voxels { min_opacity: self.min_opacity })
            }
            (Algorithm::Preintegrated, _) => Some(Purpose::Slabs { entries: self.settings.preintegration.entries }),
        }
    }

    /// Whether encodings make the frame faster. Fast classification is what goes without.
    pub fn walks_encodings(&self) -> bool {
        self.settings.algorithm != Algorithm::FastClassification
    }

    /// All that the pixels depend on besides volume, view, background, stage and algorithm.
    fn canonical(&self) -> String {
        let settings = &self.settings;
        let samples = match (settings.algorithm, settings.blend) {
            (Algorithm::Raycast, _) => format!("level {} sample_distance {:?}", self.level, settings.sample_distance),
            (_, Blend::Projection(..)) => {
                format!("level {} samples_per_voxel {}", self.level, settings.preintegration.samples_per_voxel)
            }
            (Algorithm::Classified | Algorithm::FastClassification, _) => {
                format!("level {} min_opacity {:?}", self.level, self.min_opacity)
            }
            (Algorithm::Preintegrated, _) => {
                // Either buffer gives the same pixels.
                let options = Preintegration { buffer: BufferSlice::Slice, ..settings.preintegration };
                format!("level {} {} {options:?}", self.level, settings.quality.name())
            }
        };
        let shown = match settings.blend {
            Blend::Projection(..) => format!("{:?}", settings.blend),
            Blend::Composite => format!(
                "early_ray_termination {:?} {:?} {:?} {:?} {:?} {:?}",
                settings.early_ray_termination,
                settings.depth_cueing,
                settings.shading,
                settings.sampling,
                self.transfer,
                self.labels
            ),
        };
        format!("{samples} {shown}")
    }
}

fn refused(error: RenderError) -> RequestError {
    match error {
        RenderError::Unsupported { pointer, detail } => RequestError::refused(pointer, detail),
        RenderError::Cancelled => unreachable!("a check cannot be cancelled"),
    }
}

#[cfg(test)]
mod tests;
