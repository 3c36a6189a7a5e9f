//! Fields -> [`RenderRequest`]: ranges, and what goes with what.
//!
//! Every check runs and reports; the request is there only where none complained.

mod camera;
mod places;

use std::ops::{Bound, RangeBounds, RangeInclusive};

use glam::DVec3;

use super::fields::{
    Blend, DepthCueingFields, Either, Fields, ImageFields, LightFields, LightName, PreintegrationFields, ShadingFields,
    WindowFields,
};
use super::{AlgorithmChoice, InvalidField, RenderRequest, ShadingChoice, Spelling, Transfer};
use crate::classify::{Color, TransferFunction};
use crate::encode::{Format, Unfit};
use crate::render::{Background, DepthCueing, IntensityProjection, Light, Preintegration, Quality, Shading, SlabTable};

/// World mm: a thousand kilometres, far from where squares overflow.
const POSITION: RangeInclusive<f64> = -1e9..=1e9;
/// Ambient, diffuse, specular, and a light's intensity: the sum is clamped to white anyway.
const COEFFICIENT: RangeInclusive<f64> = 0.0..=10.0;
const SHININESS: RangeInclusive<f64> = 0.0..=1000.0;
const MAX_LIGHTS: usize = 8;
const EARLY_RAY_TERMINATION: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Included(1.0));
const MIN_OPACITY: std::ops::Range<f64> = 0.0..1.0;
/// Smallest spacings: finer is a long wait for nothing, coarser skips the volume.
const SAMPLE_DISTANCE: RangeInclusive<f64> = 0.01..=8.0;
/// More than the levels of any volume, which say how many they are.
const LEVEL: RangeInclusive<f64> = 0.0..=16.0;
/// Window centres and widths: any value of a file, and widths above what divides to infinity.
const WINDOW_CENTER: RangeInclusive<f64> = -1e12..=1e12;
const WINDOW_WIDTH: RangeInclusive<f64> = 1e-6..=1e12;
const CUE_FRONT: RangeInclusive<f64> = 0.0..=10.0;
const CUE_DENSITY: RangeInclusive<f64> = 0.0..=100.0;
/// Of a two-dimensional table. 1024 take 16 MiB, as much as a large image in the making; more would tell 12-bit
/// values apart no better, between which a lookup interpolates.
const ENTRIES: RangeInclusive<f64> = 2.0..=1024.0;
/// Beyond, slabs are shorter than what 8-bit pixels tell apart.
const SAMPLES_PER_VOXEL: RangeInclusive<f64> = 1.0..=8.0;
const DEFAULT_SIDE: u32 = 512;

pub const NO_AZIMUTH: &str = "expected an orbit camera: frames around the vertical axis start from its azimuth";

/// The request that the fields make.
///
/// # Errors
/// Every field at fault.
pub fn check(fields: Fields) -> Result<RenderRequest, Vec<InvalidField>> {
    let mut refusals = Refusals(vec![]);
    refusals.options_of_algorithms(&fields);
    let camera = refusals.camera(&fields.camera);
    let (width, height, format, background) = refusals.image(&fields.image);
    let transfer = refusals.transfer("", fields.transfer_function);
    let shading = refusals.shading("", fields.shading);
    refusals.range("/early_ray_termination", fields.early_ray_termination, EARLY_RAY_TERMINATION);
    refusals.range("/min_opacity", fields.min_opacity, MIN_OPACITY);
    refusals.range("/sample_distance", fields.sample_distance, SAMPLE_DISTANCE);
    refusals.range("/level", fields.level.map(f64::from), LEVEL);
    let projection = projection(fields.blend.unwrap_or(Blend::Composite));
    let window = refusals.window("", projection, fields.window);
    let preintegration = refusals.preintegration(fields.quality, fields.preintegration.as_ref());
    let depth_cueing = fields.depth_cueing.as_ref().map(|cueing| refusals.depth_cueing(cueing));
    let (clip, cut_out) = refusals.clip(fields.clip.unwrap_or_default());
    let labels = fields.labels.map(|labels| refusals.labels(labels));
    let geometry = refusals.geometry(fields.geometry.unwrap_or_default());
    let regions = refusals.regions(fields.regions.unwrap_or_default(), projection, fields.algorithm);
    let request = RenderRequest {
        camera,
        width,
        height,
        format,
        background,
        stage: fields.image.stage,
        transfer,
        shading,
        algorithm: fields.algorithm,
        quality: fields.quality,
        early_ray_termination: fields.early_ray_termination,
        min_opacity: fields.min_opacity,
        sample_distance: fields.sample_distance,
        level: fields.level,
        sampling: fields.sampling,
        projection,
        window,
        preintegration,
        depth_cueing,
        clip,
        cut_out,
        regions,
        labels,
        geometry,
        spelling: Spelling::Json,
    };
    if refusals.0.is_empty() { Ok(request) } else { Err(refusals.0) }
}

/// Whether `format` holds the image.
///
/// # Errors
/// The field at fault.
pub fn fit(format: Format, width: u32, height: u32, alpha: bool) -> Result<(), InvalidField> {
    format.holds(width, height, alpha).map_err(|unfit| {
        let pointer = match unfit {
            Unfit::Alpha => "/image/background",
            Unfit::Side { .. } if width >= height => "/image/width",
            Unfit::Side { .. } => "/image/height",
        };
        InvalidField { pointer: pointer.into(), detail: unfit.to_string() }
    })
}

/// What a blend projects; `None`: it composites.
fn projection(blend: Blend) -> Option<IntensityProjection> {
    match blend {
        Blend::Composite => None,
        Blend::Maximum => Some(IntensityProjection::Maximum),
        Blend::Minimum => Some(IntensityProjection::Minimum),
        Blend::Average => Some(IntensityProjection::Average),
    }
}

/// What was wrong so far.
struct Refusals(Vec<InvalidField>);

impl Refusals {
    fn refuse(&mut self, pointer: impl Into<String>, detail: impl Into<String>) {
        self.0.push(InvalidField { pointer: pointer.into(), detail: detail.into() });
    }

    /// Refuses what is there and out of range.
    fn range(&mut self, pointer: impl Into<String>, value: Option<f64>, range: impl RangeBounds<f64>) {
        if let Some(got) = value.filter(|v| !range.contains(v)) {
            let end = |bound: Bound<&f64>, excluded: &str| match bound {
                Bound::Included(end) => format!("{end}"),
                Bound::Excluded(end) => format!("{excluded} {end}"),
                Bound::Unbounded => "any".into(),
            };
            let (low, high) = (end(range.start_bound(), "above"), end(range.end_bound(), "below"));
            self.refuse(pointer, format!("expected {low} to {high}, got {got}"));
        }
    }

    /// Refuses elements out of range, each by its index.
    fn elements(&mut self, pointer: &str, values: &[f64], range: &RangeInclusive<f64>) {
        for (index, value) in values.iter().enumerate() {
            self.range(format!("{pointer}/{index}"), Some(*value), range.clone());
        }
    }

    fn vector(&mut self, pointer: &str, vector: [f64; 3]) -> DVec3 {
        self.elements(pointer, &vector, &POSITION);
        DVec3::from_array(vector)
    }

    fn image(&mut self, image: &ImageFields) -> (u32, u32, Option<Format>, Background) {
        let (width, height) = (image.width.unwrap_or(DEFAULT_SIDE), image.height.unwrap_or(DEFAULT_SIDE));
        for (name, side) in [("width", width), ("height", height)] {
            if side == 0 {
                self.refuse(format!("/image/{name}"), "expected at least 1 pixel, got 0");
            }
        }
        let background = match image.background.as_deref() {
            None => Background::Opaque([0.0; 3]),
            Some("transparent") => Background::Transparent,
            Some(text) => match Color::from_hex(text) {
                Some(Color(color)) => Background::Opaque(color),
                None => {
                    self.refuse("/image/background", "expected \"#rrggbb\" or \"transparent\"");
                    Background::Transparent
                }
            },
        };
        let format = image.format.as_deref().and_then(|name| {
            let format = Format::from_name(name);
            if format.is_none() {
                let names = Format::ALL.map(Format::name).join(", ");
                self.refuse("/image/format", format!("expected one of {names}"));
            }
            format
        });
        if let Some(Err(field)) = format.map(|f| fit(f, width, height, background == Background::Transparent)) {
            self.0.push(field);
        }
        (width, height, format, background)
    }

    /// `place` is a pointer to what holds the transfer function; here and below.
    fn transfer(&mut self, place: &str, transfer: Option<Either<String, TransferFunction>>) -> Transfer {
        match transfer {
            None => Transfer::Automatic,
            Some(Either::Short(name)) => Transfer::Preset(name),
            Some(Either::Full(transfer)) => {
                for field in transfer.validate() {
                    self.refuse(format!("{place}/transfer_function{}", field.pointer), field.detail);
                }
                Transfer::Given(transfer)
            }
        }
    }

    fn shading(&mut self, place: &str, shading: Option<Either<bool, ShadingFields>>) -> ShadingChoice {
        let fields = match shading {
            None => return ShadingChoice::Automatic,
            Some(Either::Short(false)) => return ShadingChoice::Off,
            Some(Either::Short(true)) => return ShadingChoice::On(Shading::default()),
            Some(Either::Full(fields)) => fields,
        };
        let default = Shading::default();
        self.range(format!("{place}/shading/ambient"), fields.ambient, COEFFICIENT);
        self.range(format!("{place}/shading/diffuse"), fields.diffuse, COEFFICIENT);
        self.range(format!("{place}/shading/specular"), fields.specular, COEFFICIENT);
        self.range(format!("{place}/shading/shininess"), fields.shininess, SHININESS);
        let lights = fields.lights.map_or(default.lights, |lights| {
            if lights.len() > MAX_LIGHTS {
                let detail = format!("expected at most {MAX_LIGHTS} lights, got {}", lights.len());
                self.refuse(format!("{place}/shading/lights"), detail);
            }
            let light = |(index, light)| self.light(&format!("{place}/shading/lights/{index}"), light);
            let lights: Vec<_> = lights.iter().enumerate().map(light).collect();
            self.shadows(place, &lights);
            lights
        });
        ShadingChoice::On(Shading {
            ambient: fields.ambient.unwrap_or(default.ambient),
            diffuse: fields.diffuse.unwrap_or(default.diffuse),
            specular: fields.specular.unwrap_or(default.specular),
            shininess: fields.shininess.unwrap_or(default.shininess),
            lights,
        })
    }

    /// One light casts shadows at most, and it is one of the frame's own.
    fn shadows(&mut self, place: &str, lights: &[Light]) {
        let (allowed, detail) = match place {
            "" => (1, "one light casts shadows at most, and another does"),
            _ => (0, "regions that look otherwise are not in shadow"),
        };
        let casts = |light: &Light| matches!(light, Light::Directional { shadows: true, .. });
        let casting = lights.iter().enumerate().filter(|(_, light)| casts(light));
        for (index, _) in casting.skip(allowed) {
            self.refuse(format!("{place}/shading/lights/{index}/shadows"), detail);
        }
    }

    fn light(&mut self, pointer: &str, light: &Either<LightName, LightFields>) -> Light {
        let light = match light {
            Either::Short(LightName::Headlight) => return Light::Headlight,
            Either::Full(light) => light,
        };
        self.range(format!("{pointer}/intensity"), light.intensity, COEFFICIENT);
        let direction = self.vector(&format!("{pointer}/direction"), light.direction).try_normalize();
        if direction.is_none() {
            self.refuse(format!("{pointer}/direction"), "expected a direction of length above 0");
        }
        Light::Directional {
            direction: direction.unwrap_or(DVec3::Z),
            intensity: light.intensity.unwrap_or(1.0),
            shadows: light.shadows.unwrap_or(false),
        }
    }

    fn window(
        &mut self,
        place: &str,
        projection: Option<IntensityProjection>,
        window: Option<WindowFields>,
    ) -> WindowFields {
        if projection.is_none() && window.is_some() {
            self.refuse(format!("{place}/window"), "belongs to the blends maximum, minimum and average");
        }
        let window = window.unwrap_or_default();
        self.range(format!("{place}/window/center"), window.center, WINDOW_CENTER);
        self.range(format!("{place}/window/width"), window.width, WINDOW_WIDTH);
        window
    }

    fn depth_cueing(&mut self, fields: &DepthCueingFields) -> DepthCueing {
        self.range("/depth_cueing/front", fields.front, CUE_FRONT);
        self.range("/depth_cueing/density", fields.density, CUE_DENSITY);
        DepthCueing { front: fields.front.unwrap_or(1.0), density: fields.density.unwrap_or(1.0) }
    }

    fn preintegration(&mut self, quality: Quality, fields: Option<&PreintegrationFields>) -> Preintegration {
        let default = Preintegration::of(quality);
        let Some(fields) = fields else { return default };
        self.range("/preintegration/entries", fields.entries.map(f64::from), ENTRIES);
        let samples = fields.samples_per_voxel.map(f64::from);
        self.range("/preintegration/samples_per_voxel", samples, SAMPLES_PER_VOXEL);
        let table = fields.table.map_or(default.table, SlabTable::from);
        // Running sums have entries of their own and one way to read them: the same whatever is asked for.
        let (entries, lookup) = match table {
            SlabTable::TwoDimensional => (fields.entries, fields.lookup),
            SlabTable::OneDimensional => (None, None),
        };
        Preintegration {
            table,
            entries: entries.map_or(default.entries, |n| n as usize),
            lookup: lookup.unwrap_or(default.lookup),
            opacity_correction: fields.opacity_correction.unwrap_or(default.opacity_correction),
            buffer: fields.buffer.unwrap_or(default.buffer),
            samples_per_voxel: fields.samples_per_voxel.map_or(default.samples_per_voxel, |n| n as usize),
        }
    }

    /// Options that another algorithm would not look at. `auto` may come to need any of them; what counts
    /// as transparent may be told to `preintegrated`, which skips exact zeros only.
    fn options_of_algorithms(&mut self, fields: &Fields) {
        use AlgorithmChoice::{Auto, Classified, FastClassification, Preintegrated, Raycast};
        let algorithm = fields.algorithm;
        if fields.min_opacity.is_some() && algorithm == Raycast {
            self.refuse("/min_opacity", "belongs to classified and fast-classification");
        }
        if fields.sample_distance.is_some() && !matches!(algorithm, Auto | Raycast) {
            self.refuse("/sample_distance", "belongs to raycast");
        }
        if fields.preintegration.is_some() && !matches!(algorithm, Auto | Preintegrated) {
            self.refuse("/preintegration", "belongs to preintegrated");
        }
        if fields.quality == Quality::High && matches!(algorithm, Classified | FastClassification) {
            self.refuse("/quality", "classified and fast-classification render draft and standard only");
        }
    }
}
