//! [`RenderRequest`] + volume -> what the renderer takes, with every default filled in.

use super::{AlgorithmChoice, InvalidField, RenderRequest, RequestError, ShadingChoice, Transfer};
use crate::classify::presets::{self, FittedPresets};
use crate::classify::{Purpose, TransferFunction};
use crate::encode::Format;
use crate::render::{
    self, Algorithm, Blend, BufferSlice, Preintegration, Quality, RenderError, Settings, Shading, View, Window,
};
use crate::volume::Volume;

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
    pub settings: Settings,
    /// Its `opacity_distance` is told.
    pub transfer: TransferFunction,
    /// Voxels at or below it count as transparent (for [`Algorithm::Classified`]).
    pub min_opacity: f64,
    /// `None`: the request leaves it open.
    pub format: Option<Format>,
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
        let view = self.view(volume)?;
        let (mut transfer, shaded) = self.transfer(presets)?;
        transfer.opacity_distance = Some(transfer.reference_length(volume.smallest_spacing()));
        let algorithm = self.algorithm();
        let shading = match &self.shading {
            ShadingChoice::Automatic => shaded.then(Shading::default),
            ShadingChoice::Off => None,
            ShadingChoice::On(shading) => Some(shading.clone()),
        };
        let defaults = Settings::new(algorithm, self.quality);
        let settings = Settings {
            blend: self.projection.map_or(Blend::Composite, |which| Blend::Projection(which, self.window(volume))),
            preintegration: self.preintegration,
            depth_cueing: self.depth_cueing,
            background: self.background,
            shading,
            early_ray_termination: self.early_ray_termination.map_or(defaults.early_ray_termination, |t| t as f32),
            sample_distance: self.sample_distance.unwrap_or(defaults.sample_distance),
            ..defaults
        };
        render::check(volume, &view, &settings).map_err(refused)?;
        let min_opacity = self.min_opacity.unwrap_or(MIN_OPACITY);
        Ok(ResolvedRequest { view, settings, transfer, min_opacity, format: self.format })
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

    /// The transfer function, and whether it asks for shading.
    fn transfer(&self, presets: &FittedPresets) -> Result<(TransferFunction, bool), RequestError> {
        match &self.transfer {
            Transfer::Automatic => Ok((presets.default.transfer.clone(), presets.default.shading)),
            Transfer::Preset(name) => {
                let (preset, fitted) = presets.get(name).ok_or_else(|| {
                    let names: Vec<_> = presets::all().iter().map(|preset| preset.name.as_str()).collect();
                    let detail = format!("unknown preset, expected one of {}", names.join(", "));
                    RequestError::refused("/transfer_function", detail)
                })?;
                Ok((fitted.clone(), preset.shading))
            }
            Transfer::Given(transfer) => Ok((transfer.clone(), true)),
        }
    }

    /// What a projection shows from black to white.
    fn window(&self, volume: &Volume) -> Window {
        let (low, high) = volume.value_range();
        let range = if high > low { high - low } else { 1.0 };
        Window { center: self.window.center.unwrap_or(low + range / 2.0), width: self.window.width.unwrap_or(range) }
    }

    /// `auto` is resolved from the request alone.
    fn algorithm(&self) -> Algorithm {
        match self.algorithm {
            AlgorithmChoice::Auto | AlgorithmChoice::Preintegrated => Algorithm::Preintegrated,
            AlgorithmChoice::Classified => Algorithm::Classified,
            AlgorithmChoice::FastClassification => Algorithm::FastClassification,
            AlgorithmChoice::Raycast => Algorithm::Raycast,
        }
    }
}

impl ResolvedRequest {
    /// The level of the volume's pyramid that the frame shows.
    pub fn level(&self) -> usize {
        match (self.settings.algorithm, self.settings.quality) {
            (Algorithm::Raycast, _) | (_, Quality::Standard | Quality::High) => 0,
            (_, Quality::Draft) => 1,
        }
    }

    /// What the frame needs classified; `None`: nothing.
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

    /// All that the pixels depend on besides the volume, as text: the same for requests that mean the
    /// same, however they were written. The format is left out, being known only after negotiation.
    pub fn canonical(&self) -> String {
        let settings = &self.settings;
        // Debug writes floats with as many digits as tell them apart.
        let frame = format!("{:?} {:?} {}", self.view, settings.background, settings.algorithm.name());
        let samples = match (settings.algorithm, settings.blend) {
            (Algorithm::Raycast, _) => format!("sample_distance {:?}", settings.sample_distance),
            (_, Blend::Projection(..)) => {
                format!("level {} samples_per_voxel {}", self.level(), settings.preintegration.samples_per_voxel)
            }
            (Algorithm::Classified | Algorithm::FastClassification, _) => {
                format!("level {} min_opacity {:?}", self.level(), self.min_opacity)
            }
            (Algorithm::Preintegrated, _) => {
                // Either buffer gives the same pixels.
                let options = Preintegration { buffer: BufferSlice::Slice, ..settings.preintegration };
                format!("{} {options:?}", settings.quality.name())
            }
        };
        let shown = match settings.blend {
            Blend::Projection(..) => format!("{:?}", settings.blend),
            Blend::Composite => format!(
                "early_ray_termination {:?} {:?} {:?} {:?}",
                settings.early_ray_termination, settings.depth_cueing, settings.shading, self.transfer
            ),
        };
        format!("{frame} {samples} {shown}")
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
        assert_eq!(resolved.settings.algorithm, Algorithm::Preintegrated);
        assert_eq!(resolved.settings.shading, Some(Shading::default()));
        assert_eq!(resolved.settings.early_ray_termination, 0.99);
        assert_eq!(resolved.min_opacity, 0.002);
        assert_eq!(resolved.transfer.opacity_distance, Some(0.5));
        assert_eq!(resolved.format, None);
    }

    #[test]
    fn auto_is_preintegrated_whatever_the_view_and_the_quality() {
        let algorithm = |json| resolve(json).unwrap().settings.algorithm;
        assert_eq!(algorithm(r#"{"quality": "draft"}"#), Algorithm::Preintegrated);
        assert_eq!(algorithm(r#"{"quality": "high"}"#), Algorithm::Preintegrated);
        assert_eq!(algorithm(r#"{"camera": {"projection": "perspective"}}"#), Algorithm::Preintegrated);
        assert_eq!(algorithm(r#"{"algorithm": "raycast"}"#), Algorithm::Raycast);
    }

    #[test]
    fn a_projection_shows_the_range_of_values_unless_told() {
        let blend = |json: &str| resolve(json).unwrap().settings.blend;
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
        let settings = |json| resolve(json).unwrap().settings;
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
