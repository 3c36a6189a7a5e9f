//! [`RenderRequest`] + volume -> what the renderer takes, with every default filled in.

use super::fields::WindowFields;
use super::{
    AlgorithmChoice, InvalidField, LabelRequest, LabelsRequest, RegionRequest, RenderRequest, RequestError,
    ShadingChoice, Transfer,
};
use crate::classify::labels::{LabelLook, LabelTables, union};
use crate::classify::presets::{self, FittedPresets};
use crate::classify::{Purpose, TransferFunction};
use crate::encode::Format;
use crate::render::regions::{Region, render_with_regions};
use crate::render::{
    self, Algorithm, Blend, BufferSlice, Cancel, Clip, Image, Preintegration, Quality, RenderError, Scene, Settings,
    Shading, Timings, View, Window,
};
use crate::volume::{Volume, pyramid};

/// Half of what shows in one voxel on an 8-bit display.
const MIN_OPACITY: f64 = 0.002;

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
    /// A segmentation by which voxels look otherwise; the look's transfer function is then the union of all.
    pub labels: Option<ResolvedLabels>,
    /// Where it looks otherwise, in order: of two that hold a point the later one is meant.
    pub regions: Vec<RegionLook>,
    /// `None`: the request leaves it open.
    pub format: Option<Format>,
}

/// How voxels look by their labels.
#[derive(Clone, Debug, PartialEq)]
pub struct ResolvedLabels {
    /// The id of the volume of labels.
    pub volume: String,
    looks: Vec<LabelLook>,
    /// Of voxels with other labels.
    others: TransferFunction,
    min_opacity: f64,
}

impl ResolvedLabels {
    /// Refuses a volume of labels that is not on the volume's grid.
    ///
    /// # Errors
    /// [`RequestError::Refused`], for the field that names it.
    pub fn suit(&self, volume: &Volume, labels: &Volume) -> Result<(), RequestError> {
        let refused = |detail: String| Err(RequestError::refused("/labels/volume", detail));
        let (wanted, got) = (volume.dims(), labels.dims());
        if wanted != got {
            return refused(format!("expected labels on the volume's grid of {wanted:?} voxels, got {got:?}"));
        }
        if labels.colors().is_some() {
            return refused("expected labels, got colours".into());
        }
        let [a, b] = [volume, labels].map(Volume::world_from_index);
        let apart = (a - b).to_cols_array().iter().fold(0.0, |most: f64, element| most.max(element.abs()));
        let extent = 1e-3 * volume.smallest_spacing();
        if apart > extent {
            return refused("expected labels on the volume's grid, got another place, spacing or orientation".into());
        }
        Ok(())
    }

    /// The tables of both volumes.
    pub fn tables(&self, volume: &Volume, labels: &Volume) -> LabelTables {
        LabelTables::new(volume, labels, &self.looks, &self.others, self.min_opacity)
    }
}

/// How the volume, or a part of it, looks.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    pub settings: Settings,
    /// Its `opacity_distance` is told.
    pub transfer: TransferFunction,
    /// Voxels at or below it count as transparent (for [`Algorithm::Classified`]).
    pub min_opacity: f64,
    /// Of the volume's pyramid; the same for all of a frame's looks.
    pub level: usize,
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
        let mut look = self.look(volume, presets, level, None)?;
        let labels =
            self.labels.as_ref().map(|labels| self.by_label(labels, &mut look, volume, presets)).transpose()?;
        render::check(volume, &view, &look.settings).map_err(refused)?;
        let shown = self.regions.iter().enumerate().map(|(index, region)| {
            let look = self.look(volume, presets, level, Some((index, region)))?;
            render::check(volume, &view, &look.settings).map_err(refused)?;
            let of_voxels = matches!(look.settings.algorithm, Algorithm::Classified | Algorithm::FastClassification)
                || volume.colors().is_some() && look.settings.algorithm != Algorithm::Raycast;
            if of_voxels && region.projection.is_some() != self.projection.is_some() {
                let detail = "projections beside what is composited go with preintegrated (of scalars) and raycast";
                return Err(RequestError::refused(&format!("/regions/{index}/blend"), detail));
            }
            Ok(RegionLook { shape: region.shape.clone(), look: Some(look) })
        });
        // What is cut out stays so, whatever is to be shown there.
        let cut_out = self.cut_out.iter().map(|shape| Ok(RegionLook { shape: shape.clone(), look: None }));
        let regions = shown.chain(cut_out).collect::<Result<_, RequestError>>()?;
        Ok(ResolvedRequest { view, look, labels, regions, format: self.format })
    }

    /// The looks of labels; that of the volume becomes one for all.
    fn by_label(
        &self,
        labels: &LabelsRequest,
        look: &mut Look,
        volume: &Volume,
        presets: &FittedPresets,
    ) -> Result<ResolvedLabels, RequestError> {
        let of_label = |(index, told): (usize, &LabelRequest)| {
            let mut transfer = match &told.transfer {
                None => look.transfer.clone(),
                Some(transfer) => fitted(transfer, presets, &format!("/labels/looks/{index}/transfer_function"))?.0,
            };
            transfer.opacity_distance = Some(transfer.reference_length(volume.smallest_spacing()));
            for point in &mut transfer.points {
                point.opacity *= told.opacity;
                point.color = told.color.unwrap_or(point.color);
            }
            Ok(LabelLook { label: told.label, transfer })
        };
        let looks = labels.looks.iter().enumerate().map(of_label).collect::<Result<Vec<_>, RequestError>>()?;
        let others = look.transfer.clone();
        let all = looks.iter().map(|look| &look.transfer).chain([&others]);
        if all.clone().any(|transfer| !transfer.gradient_opacity.is_empty()) {
            return Err(RequestError::refused("/labels", "go with transfer functions without gradient_opacity"));
        }
        // What is skipped is transparent for every label.
        look.transfer = union(all, volume.smallest_spacing());
        let min_opacity = if look.settings.algorithm == Algorithm::Raycast { 0.0 } else { look.min_opacity };
        look.min_opacity = 0.0;
        Ok(ResolvedLabels { volume: labels.volume.clone(), looks, others, min_opacity })
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
        if let Some(region) = region {
            transfer.points.iter_mut().for_each(|point| point.opacity *= region.opacity);
        }
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
        Ok(Look { settings, transfer, min_opacity: self.min_opacity.unwrap_or(MIN_OPACITY), level })
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
        if self.is_of_voxels(volume) && self.algorithm == AlgorithmChoice::Preintegrated && self.projection.is_none() {
            let detail = "pre-integration is of scalars: colours and labels are rendered by classified, fast-classification and raycast";
            return Err(RequestError::refused("/algorithm", detail));
        }
        if self.labels.is_some() {
            for (pointer, there, detail) in [
                ("/labels", volume.colors().is_some(), "belong to volumes of scalars"),
                ("/labels", self.projection.is_some(), "belong to the blend composite"),
                ("/regions", !self.regions.is_empty(), "do not go with labels"),
                ("/level", self.level.is_some_and(|level| level > 0), "labels have level 0 only"),
            ] {
                if there {
                    return Err(RequestError::refused(pointer, detail));
                }
            }
        }
        Ok(())
    }

    /// True where voxels look each as they are, and not by their scalars alone.
    fn is_of_voxels(&self, volume: &Volume) -> bool {
        volume.colors().is_some() || self.labels.is_some()
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
        if self.quality != Quality::Draft || self.labels.is_some() || self.algorithm(volume) == Algorithm::Raycast {
            return Ok(0);
        }
        let voxels = view.pixel_size(volume.centre()) / volume.smallest_spacing();
        Ok((1 + voxels.max(1.0).log2() as usize).min(levels - 1))
    }

    /// `auto` is resolved from the request and the kind of the volume alone.
    fn algorithm(&self, volume: &Volume) -> Algorithm {
        match self.algorithm {
            AlgorithmChoice::Auto if self.is_of_voxels(volume) && self.projection.is_none() => match self.quality {
                Quality::Draft | Quality::Standard => Algorithm::Classified,
                Quality::High => Algorithm::Raycast,
            },
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

    /// The frame as `view` sees it; `scenes` are what the [`Self::looks`] show, in their order.
    ///
    /// # Errors
    /// As [`render::render`].
    pub fn render(&self, view: &View, scenes: &[Scene<'_>], cancel: &Cancel) -> Result<(Image, Timings), RenderError> {
        let mut shown = self.looks().zip(scenes).map(|(look, scene)| (*scene, &look.settings));
        let mut next = || shown.next().expect("as many scenes as looks");
        let (scene, settings) = next();
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
        let labels = self.labels.as_ref().map_or(String::new(), |labels| format!(" {labels:?}"));
        format!("{frame} {}{}{labels}", self.look.canonical(), regions.collect::<String>())
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
                "early_ray_termination {:?} {:?} {:?} {:?} {:?}",
                settings.early_ray_termination,
                settings.depth_cueing,
                settings.shading,
                settings.sampling,
                self.transfer
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
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::render::IntensityProjection;
    use crate::volume::{ImportReport, Placement, ScalarType, Scalars};

    const LIMITS: ImageLimits = ImageLimits { max_side: 4096, max_pixels: 4096 * 2048 };

    fn volume() -> Volume {
        let scalars = Scalars::U8((0..5 * 6 * 7).map(|i| i as u8).collect());
        let placement = Placement::from_spacing(DVec3::new(1.0, 0.5, 2.0));
        Volume::new([5, 6, 7], placement, scalars, (1.0, 0.0), ImportReport::plain("test", ScalarType::U8)).unwrap()
    }

    fn resolve(json: &str) -> Result<ResolvedRequest, RequestError> {
        RenderRequest::from_json(json.as_bytes())?.resolve(&volume(), &FittedPresets::of(&volume(), None), &LIMITS)
    }

    fn pointer(result: Result<ResolvedRequest, RequestError>) -> String {
        match result {
            Err(RequestError::Refused(fields)) => fields[0].pointer.clone(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_empty_request_has_every_default() {
        let resolved = resolve("{}").unwrap();
        assert_eq!(resolved.view.size(), (512, 512));
        assert_eq!(resolved.look.settings.algorithm, Algorithm::Preintegrated);
        assert_eq!(resolved.look.settings.shading, Some(Shading::default()));
        assert_eq!(resolved.look.settings.early_ray_termination, 0.99);
        assert_eq!(resolved.look.min_opacity, 0.002);
        assert_eq!(resolved.look.transfer.opacity_distance, Some(0.5));
        assert_eq!(resolved.format, None);
    }

    #[test]
    fn auto_is_preintegrated_whatever_the_view_and_the_quality() {
        let algorithm = |json| resolve(json).unwrap().look.settings.algorithm;
        assert_eq!(algorithm(r#"{"quality": "draft"}"#), Algorithm::Preintegrated);
        assert_eq!(algorithm(r#"{"quality": "high"}"#), Algorithm::Preintegrated);
        assert_eq!(algorithm(r#"{"camera": {"projection": "perspective"}}"#), Algorithm::Preintegrated);
        assert_eq!(algorithm(r#"{"algorithm": "raycast"}"#), Algorithm::Raycast);
    }

    #[test]
    fn a_projection_shows_the_range_of_values_unless_told() {
        let blend = |json: &str| resolve(json).unwrap().look.settings.blend;
        let window = Window { center: 104.5, width: 209.0 };
        assert_eq!(blend(r#"{"blend": "maximum"}"#), Blend::Projection(IntensityProjection::Maximum, window));
        for (told, center, width) in [(r#""center": 40, "width": 400"#, 40.0, 400.0), (r#""width": 9"#, 104.5, 9.0)] {
            let json = format!(r#"{{"blend": "average", "window": {{{told}}}}}"#);
            let window = Window { center, width };
            assert_eq!(blend(&json), Blend::Projection(IntensityProjection::Average, window));
        }
    }

    #[test]
    fn quality_sets_termination_and_sample_distance() {
        let settings = |json| resolve(json).unwrap().look.settings;
        assert_eq!(settings(r#"{"quality": "draft"}"#).early_ray_termination, 0.98);
        assert_eq!(settings(r#"{"algorithm": "raycast"}"#).early_ray_termination, 0.9999);
        assert_eq!(settings(r#"{"algorithm": "raycast"}"#).sample_distance, 0.5);
        assert_eq!(settings(r#"{"quality": "high"}"#).sample_distance, 0.125);
        assert_eq!(settings(r#"{"quality": "high", "sample_distance": 1}"#).sample_distance, 1.0);
    }

    #[test]
    fn equal_requests_written_differently_have_one_canonical_text() {
        let canonical = |json: &str| resolve(json).unwrap().canonical();
        let equal = [
            r#"{}"#,
            r#"{"camera": {"azimuth": -0.0, "zoom": 1.0}, "quality": "standard"}"#,
            r##"{"camera": {"azimuth": 360}, "image": {"background": "#000000", "format": "png", "width": 512.0}}"##,
            r#"{"early_ray_termination": 0.99, "min_opacity": 2e-3, "sample_distance": 3, "algorithm": "auto"}"#,
            r#"{"shading": {"lights": ["headlight"]}, "algorithm": "preintegrated", "blend": "composite"}"#,
            r#"{"preintegration": {"entries": 256, "lookup": "bilinear", "buffer": "image"}}"#,
            r#"{"clip": []}"#,
            r#"{"level": 0}"#,
            r#"{"image": {"stage": "final"}}"#,
        ];
        for json in equal {
            assert_eq!(canonical(json), canonical("{}"), "{json}");
        }
        let projection = canonical(r#"{"blend": "maximum"}"#);
        for further in [
            r#""window": {"center": 104.5, "width": 209}"#,
            r#""shading": false, "transfer_function": "gray-ramp", "depth_cueing": {}, "early_ray_termination": 1"#,
            r#""preintegration": {"samples_per_voxel": 1, "lookup": "nearest", "entries": 9}"#,
        ] {
            assert_eq!(canonical(&format!(r#"{{"blend": "maximum", {further}}}"#)), projection, "{further}");
        }
        let running_sums = canonical(r#"{"preintegration": {"table": "1d"}}"#);
        let with_entries = r#"{"preintegration": {"table": "1d", "entries": 512, "lookup": "nearest"}}"#;
        assert_eq!(canonical(with_entries), running_sums);
        let ray_cast = canonical(r#"{"algorithm": "raycast"}"#);
        assert_eq!(canonical(r#"{"algorithm": "raycast", "quality": "high", "sample_distance": 0.5}"#), ray_cast);
        let given = |distance: &str, light: &str| {
            canonical(&format!(
                r##"{{"transfer_function": {{"points": [{{"value": 1, "opacity": 0.5, "color": "#Ff0000"}}] {distance}}},
                "shading": {{"lights": [{{"direction": {light}}}]}}}}"##
            ))
        };
        assert_eq!(given("", "[0, 0, 2]"), given(r#", "opacity_distance": 0.5"#, "[0, 0, 1]"));
    }

    #[test]
    fn whatever_changes_the_pixels_changes_the_canonical_text() {
        let different = [
            r#"{}"#,
            r#"{"camera": {"azimuth": 1e-9}}"#,
            r#"{"image": {"width": 511}}"#,
            r#"{"image": {"background": "transparent"}}"#,
            r##"{"image": {"background": "#000001"}}"##,
            r#"{"image": {"stage": "intermediate"}}"#,
            r#"{"shading": false}"#,
            r#"{"shading": {"ambient": 0.3}}"#,
            r#"{"algorithm": "raycast"}"#,
            r#"{"algorithm": "raycast", "sample_distance": 0.4}"#,
            r#"{"early_ray_termination": 1}"#,
            r#"{"algorithm": "classified"}"#,
            r#"{"algorithm": "classified", "min_opacity": 0}"#,
            r#"{"algorithm": "classified", "quality": "draft", "early_ray_termination": 0.99}"#,
            r#"{"algorithm": "fast-classification"}"#,
            r#"{"quality": "high"}"#,
            r#"{"quality": "draft", "early_ray_termination": 0.99}"#,
            r#"{"quality": "high", "preintegration": {"samples_per_voxel": 1}, "early_ray_termination": 0.99}"#,
            r#"{"blend": "maximum"}"#,
            r#"{"blend": "maximum", "quality": "draft"}"#,
            r#"{"blend": "maximum", "preintegration": {"samples_per_voxel": 4}}"#,
            r#"{"blend": "maximum", "algorithm": "raycast"}"#,
            r#"{"blend": "minimum"}"#,
            r#"{"blend": "maximum", "window": {"center": 0, "width": 1}}"#,
            r#"{"depth_cueing": {}}"#,
            r#"{"depth_cueing": {"density": 2}}"#,
            r#"{"clip": [{"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}]}"#,
            r#"{"clip": [{"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}, "keep": "outside"}]}"#,
            r#"{"clip": [{"box": {"min": [-1, -1, -1], "max": [1, 1, 1]}}]}"#,
            r#"{"clip": [{"box": {"min": [-1, -1, -1], "max": [1, 1, 1], "pose": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 9, 1]}}]}"#,
            r#"{"clip": [{"sphere": {"center": [0, 0, 0], "radius": 3}}]}"#,
            r#"{"clip": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "keep": "outside"}]}"#,
            r#"{"clip": [{"hull": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}}]}"#,
            r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}}]}"#,
            r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "blend": "maximum"}]}"#,
            r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "opacity": 0.5}]}"#,
            r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "shading": false}]}"#,
            r#"{"level": 1}"#,
            r#"{"level": 1, "algorithm": "raycast"}"#,
            r#"{"preintegration": {"entries": 100}}"#,
            r#"{"preintegration": {"lookup": "nearest"}}"#,
            r#"{"preintegration": {"table": "1d"}}"#,
            r#"{"preintegration": {"opacity_correction": "off"}}"#,
            r#"{"preintegration": {"samples_per_voxel": 2}}"#,
            r##"{"transfer_function": {"points": [{"value": 1, "opacity": 0.5, "color": "#ff0000"}]}}"##,
        ];
        let texts: std::collections::HashSet<_> =
            different.iter().map(|json| resolve(json).unwrap().canonical()).collect();
        assert_eq!(texts.len(), different.len());
    }

    #[test]
    fn images_over_the_limits_are_refused() {
        assert_eq!(pointer(resolve(r#"{"image": {"width": 100000, "height": 100000}}"#)), "/image/width");
        assert_eq!(pointer(resolve(r#"{"image": {"height": 4097}}"#)), "/image/height");
        let many = resolve(r#"{"image": {"height": 4096, "width": 4096}}"#).unwrap_err();
        assert!(many.to_string().contains("in all"), "{many}");
    }

    #[test]
    fn an_unknown_preset_is_refused_with_the_names_there_are() {
        let refused = resolve(r#"{"transfer_function": "no-such"}"#).unwrap_err().to_string();
        assert!(refused.starts_with("/transfer_function: ") && refused.contains("gray-ramp"), "{refused}");
        let query = RenderRequest::from_query("preset=no-such").unwrap();
        assert_eq!(pointer(query.resolve(&volume(), &FittedPresets::of(&volume(), None), &LIMITS)), "/preset");
    }

    #[test]
    fn drafts_take_the_level_of_their_pixels_and_a_level_may_be_told() {
        let placement = Placement::from_spacing(DVec3::ONE);
        let scalars = Scalars::U8(vec![0; 300 * 300 * 2]);
        let report = ImportReport::plain("test", ScalarType::U8);
        let volume = Volume::new([300, 300, 2], placement, scalars, (1.0, 0.0), report).unwrap();
        let presets = FittedPresets::of(&volume, None);
        let level = |json: &str| {
            let request = RenderRequest::from_json(json.as_bytes()).unwrap();
            request.resolve(&volume, &presets, &LIMITS).map(|resolved| resolved.level())
        };
        // The picture is 423 mm high.
        for (rest, expected) in [
            (r#""image": {"height": 512}"#, 1),
            (r#""image": {"height": 200}"#, 2),
            (r#""image": {"height": 200}, "camera": {"zoom": 4}"#, 1),
            (r#""image": {"height": 20}"#, 3),
            (r#""image": {"height": 20}, "camera": {"projection": "perspective"}"#, 3),
            (r#""image": {"height": 20}, "level": 0"#, 0),
            (r#""image": {"height": 20}, "algorithm": "raycast""#, 0),
        ] {
            assert_eq!(level(&format!(r#"{{"quality": "draft", {rest}}}"#)), Ok(expected), "{rest}");
        }
        assert_eq!(level(r#"{"image": {"height": 20}}"#), Ok(0));
        assert_eq!(level(r#"{"level": 3, "quality": "high"}"#), Ok(3));
        let refused = level(r#"{"level": 4}"#).unwrap_err().to_string();
        assert!(refused.starts_with("/level: expected a level from 0 to 3"), "{refused}");
    }

    #[test]
    fn a_region_is_as_around_but_for_what_it_tells() {
        let sphere = r#""sphere": {"center": [0, 0, 0], "radius": 3}"#;
        let points = r##"[{"value": 1, "opacity": 0.5, "color": "#ff0000"}]"##;
        let resolved = |around: &str, region: &str| {
            let resolved = resolve(&format!(r#"{{{around} "regions": [{{{sphere}{region}}}]}}"#)).unwrap();
            (resolved.look, resolved.regions[0].look.clone().unwrap())
        };
        for around in ["", r#""blend": "minimum", "window": {"center": 3},"#, r#""shading": false, "quality": "high","#]
        {
            let (around, region) = resolved(around, "");
            assert_eq!(region, around);
        }
        let given = format!(r#""transfer_function": {{"points": {points}}}, "shading": {{"ambient": 0.5}},"#);
        let (around, region) = resolved(&given, r#", "opacity": 0.25"#);
        assert_eq!((around.transfer.points[0].opacity, region.transfer.points[0].opacity), (0.5, 0.125));
        assert_eq!(region.settings, around.settings);
        let (around, region) = resolved(&given, r#", "blend": "maximum", "shading": true"#);
        assert_eq!(around.settings.blend, Blend::Composite);
        assert!(matches!(region.settings.blend, Blend::Projection(IntensityProjection::Maximum, _)));
        assert_eq!(region.settings.shading, Some(Shading::default()));
        let unknown = format!(r#"{{"regions": [{{{sphere}, "transfer_function": "no-such"}}]}}"#);
        assert_eq!(pointer(resolve(&unknown)), "/regions/0/transfer_function");
    }

    #[test]
    fn cameras_without_a_view_are_refused_by_their_field() {
        let look = r#"{"camera": {"look_at": {"position": [0, 0, 9], "target": [0, 0, 0]}}}"#;
        assert_eq!(pointer(resolve(look)), "/camera/look_at");
        let zeros = [0; 16];
        let matrices = format!(r#"{{"camera": {{"matrices": {{"view": {zeros:?}, "projection": {zeros:?}}}}}}}"#);
        assert_eq!(pointer(resolve(&matrices)), "/camera/matrices/view");
    }

    #[test]
    fn a_query_resolves_like_its_json() {
        let json = r##"{"camera": {"azimuth": 30, "fov_y": 40, "projection": "perspective"}, "image": {"width": 64,
            "background": "#102030"}, "transfer_function": "gray-ramp", "shading": false, "quality": "draft"}"##;
        let rest =
            "azimuth=30.0&fov_y=4e1&projection=perspective&width=64&preset=gray-ramp&shading=false&quality=draft";
        for background in ["102030", "%23102030"] {
            let query = RenderRequest::from_query(&format!("{rest}&background={background}")).unwrap();
            assert_eq!(
                query.resolve(&volume(), &FittedPresets::of(&volume(), None), &LIMITS).unwrap(),
                resolve(json).unwrap()
            );
        }
    }
}
