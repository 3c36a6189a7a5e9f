//! What a client asks for: one model for HTTP bodies, query strings, the WebSocket and `--request`.
//!
//! A request is read in two steps. [`RenderRequest::from_json`] checks all that can be known without
//! a volume: names, types, ranges, which camera it is. [`RenderRequest::resolve`] adds the volume and
//! fills every default, so that nothing later asks "unless told"; what it gives is what the renderer
//! takes, and its canonical text is what an ETag stands for.
//!
//! Every refusal names its field by a JSON pointer, and all fields that are out of range are named
//! at once.

mod check;
mod fields;
pub(super) mod json;
mod options;
mod resolve;

use std::sync::Arc;

use glam::{DAffine3, DMat4};
use serde_json::Value;

pub use crate::classify::InvalidField;
use crate::classify::{Color, TransferFunction};
use crate::encode::Format;
use crate::mesh::Mesh;
use crate::render::raster::Solid;
use crate::render::{
    Background, Camera, Clip, DepthCueing, IntensityProjection, Preintegration, Quality, Sampling, Shading, Stage,
};
use fields::WindowFields;
pub use options::{Kind, OPTIONS, RequestOption};
pub use resolve::{ImageLimits, Look, ResolvedLabels, ResolvedRequest, ResolvedShadows};

/// Why there is no request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RequestError {
    /// Not JSON.
    #[error("{detail}")]
    Malformed { detail: String },
    /// Fields that are unknown or hold what they must not; at least one.
    #[error("{}", .0.iter().map(|f| format!("{}: {}", f.pointer, f.detail)).collect::<Vec<_>>().join("; "))]
    Refused(Vec<InvalidField>),
}

impl RequestError {
    /// One field at fault.
    pub fn refused(pointer: &str, detail: impl Into<String>) -> Self {
        Self::Refused(vec![InvalidField { pointer: pointer.into(), detail: detail.into() }])
    }
}

/// Which algorithm a client names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum AlgorithmChoice {
    #[default]
    Auto,
    Classified,
    FastClassification,
    Preintegrated,
    Raycast,
}

/// Where the transfer function comes from.
#[derive(Clone, Debug, PartialEq)]
enum Transfer {
    /// Chosen by the volume.
    Automatic,
    Preset(String),
    Given(TransferFunction),
}

/// Whether a frame is shaded.
#[derive(Clone, Debug, PartialEq)]
enum ShadingChoice {
    /// As the preset says; shaded without one.
    Automatic,
    Off,
    On(Shading),
}

/// How a client wrote the request, so that refusals name what the client wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Spelling {
    /// Pointers into the JSON document.
    Json,
    /// Pointers like `/azimuth`: the short names of [`OPTIONS`].
    Short,
}

/// A request whose fields are sound by themselves; not yet known to suit a volume.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderRequest {
    camera: Camera,
    width: u32,
    height: u32,
    format: Option<Format>,
    background: Background,
    stage: Stage,
    transfer: Transfer,
    shading: ShadingChoice,
    algorithm: AlgorithmChoice,
    quality: Quality,
    early_ray_termination: Option<f64>,
    min_opacity: Option<f64>,
    sample_distance: Option<f64>,
    /// Of the volume's pyramid.
    level: Option<u32>,
    /// For volumes with colours of their own.
    sampling: Option<Sampling>,
    projection: Option<IntensityProjection>,
    /// The volume's range of values unless told.
    window: WindowFields,
    preintegration: Preintegration,
    depth_cueing: Option<DepthCueing>,
    /// What is left, world mm, but for what is cut out.
    clip: Clip,
    cut_out: Vec<Clip>,
    /// Of two that hold a point the later one is meant.
    regions: Vec<RegionRequest>,
    labels: Option<LabelsRequest>,
    geometry: Vec<GeometryRequest>,
    spelling: Spelling,
}

/// A mesh in the volume's space.
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryRequest {
    /// Its id.
    pub mesh: String,
    color: Color,
    world_from_mesh: DAffine3,
}

impl GeometryRequest {
    /// The mesh of that id where it is to be.
    pub fn solid(&self, mesh: &Arc<Mesh>) -> Solid {
        Solid { mesh: Arc::clone(mesh), world_from_mesh: self.world_from_mesh, color: self.color.0 }
    }
}

/// What is told of a segmentation.
#[derive(Clone, Debug, PartialEq)]
struct LabelsRequest {
    /// The id of its volume.
    volume: String,
    looks: Vec<LabelRequest>,
}

/// What voxels of a label look like. What is not told is as without labels.
#[derive(Clone, Debug, PartialEq)]
struct LabelRequest {
    label: u16,
    /// Factor of the transfer function's opacities.
    opacity: f64,
    color: Option<Color>,
    transfer: Option<Transfer>,
}

/// What is shown in another way within a convex region. What is not told is as around.
#[derive(Clone, Debug, PartialEq)]
struct RegionRequest {
    /// World mm.
    shape: Clip,
    transfer: Option<Transfer>,
    /// Factor of the transfer function's opacities.
    opacity: f64,
    shading: Option<ShadingChoice>,
    projection: Option<IntensityProjection>,
    window: Option<WindowFields>,
}

impl RenderRequest {
    /// Reads a request as JSON; `{}` asks for the defaults.
    ///
    /// # Errors
    /// [`RequestError::Malformed`] for what is not JSON, [`RequestError::Refused`] for unknown or
    /// repeated fields, wrong types, and values out of range.
    pub fn from_json(bytes: &[u8]) -> Result<Self, RequestError> {
        Self::from_value(json::parse(bytes)?, Spelling::Json)
    }

    /// Reads the body of an HTTP request; an empty one asks for the defaults, too.
    ///
    /// # Errors
    /// As [`Self::from_json`].
    pub fn from_body(bytes: &[u8]) -> Result<Self, RequestError> {
        Self::from_json(if bytes.is_empty() { b"{}" } else { bytes })
    }

    /// Reads a query string (without the `?`) of the short names in [`OPTIONS`].
    ///
    /// # Errors
    /// [`RequestError::Refused`], as for JSON; pointers are `/key`.
    pub fn from_query(query: &str) -> Result<Self, RequestError> {
        let mut document = Value::Object(serde_json::Map::new());
        options::set_from_query(&mut document, query)?;
        Self::from_value(document, Spelling::Short)
    }

    /// Reads a request as JSON and lets short names (see [`OPTIONS`]) override its fields.
    ///
    /// # Errors
    /// As [`Self::from_json`].
    pub fn from_json_and_options<'a>(
        bytes: &[u8],
        options: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<Self, RequestError> {
        let mut document = json::parse(bytes)?;
        options::set_all(&mut document, options)?;
        Self::from_value(document, Spelling::Json)
    }

    /// Reads a request from a document that is JSON already; a `quality` stands in for its own.
    ///
    /// # Errors
    /// [`RequestError::Refused`], as for JSON.
    pub(super) fn from_document(mut document: Value, quality: Option<Quality>) -> Result<Self, RequestError> {
        if let (Some(quality), Value::Object(members)) = (quality, &mut document) {
            members.insert("quality".into(), quality.name().into());
        }
        Self::from_value(document, Spelling::Json)
    }

    fn from_value(document: Value, spelling: Spelling) -> Result<Self, RequestError> {
        let checked = json::read(document).map_err(|field| vec![field]).and_then(check::check);
        match checked {
            Ok(request) => Ok(Self { spelling, ..request }),
            Err(fields) => Err(RequestError::Refused(fields).spelled(spelling)),
        }
    }

    /// The format that the request names.
    pub fn format(&self) -> Option<Format> {
        self.format
    }

    /// Refuses intermediate images, for what keeps no warps beside them.
    ///
    /// # Errors
    /// [`RequestError::Refused`].
    pub fn is_final(&self) -> Result<(), RequestError> {
        match self.stage {
            Stage::Final => Ok(()),
            Stage::Intermediate => {
                Err(RequestError::refused("/image/stage", "expected final: there is no room for a warp"))
            }
        }
    }

    /// View and projection matrix of the camera, where it is told by them.
    pub(super) fn matrices(&self) -> Option<[DMat4; 2]> {
        match &self.camera {
            Camera::Matrices { view, projection } => Some([*view, *projection]),
            _ => None,
        }
    }

    /// The same request for an answer in `format`.
    ///
    /// # Errors
    /// Where the format cannot hold the image: its size, or transparency in JPEG.
    pub fn with_format(mut self, format: Format) -> Result<Self, RequestError> {
        let alpha = self.background == Background::Transparent;
        let unfit = check::fit(format, self.width, self.height, alpha).err();
        self.format = Some(format);
        unfit.map_or(Ok(self.clone()), |field| Err(RequestError::Refused(vec![field]).spelled(self.spelling)))
    }

    /// The same request with the camera turned by `degrees` about its target's vertical axis.
    ///
    /// # Errors
    /// Where the camera is not an orbit: it has no azimuth to add to.
    pub fn turned(&self, degrees: f64) -> Result<Self, RequestError> {
        let mut turned = self.clone();
        match &mut turned.camera {
            Camera::Orbit(orbit) => orbit.azimuth += degrees,
            Camera::LookAt(_) => return Err(RequestError::refused("/camera/look_at", check::NO_AZIMUTH)),
            Camera::Matrices { .. } => return Err(RequestError::refused("/camera/matrices", check::NO_AZIMUTH)),
        }
        Ok(turned)
    }
}

impl RequestError {
    /// Names fields as the client wrote them.
    fn spelled(self, spelling: Spelling) -> Self {
        match self {
            Self::Refused(mut fields) if spelling == Spelling::Short => {
                fields.iter_mut().for_each(|field| options::shorten(&mut field.pointer));
                Self::Refused(fields)
            }
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pointers of what is refused.
    fn refused(result: Result<RenderRequest, RequestError>) -> Vec<String> {
        match result {
            Err(RequestError::Refused(fields)) => fields.into_iter().map(|f| f.pointer).collect(),
            other => panic!("{other:?}"),
        }
    }

    fn json(text: &str) -> Result<RenderRequest, RequestError> {
        RenderRequest::from_json(text.as_bytes())
    }

    #[test]
    fn the_request_of_the_contract_is_read() {
        let text = r##"{
            "camera": {"projection": "parallel", "azimuth": 30, "elevation": 15, "roll": 0, "zoom": 1, "fov_y": 30,
                "target": [1, 2.5, 3]},
            "image": {"width": 512, "height": 512, "format": "png", "background": "#000000"},
            "transfer_function": {"points": [{"value": -1000, "opacity": 0, "color": "#000000"}],
                "opacity_distance": 1.0, "gradient_opacity": [{"value": 0, "opacity": 0}]},
            "shading": {"ambient": 0.1, "diffuse": 0.8, "specular": 0.2, "shininess": 20,
                "lights": ["headlight", {"direction": [0, 0, 1], "intensity": 1}]},
            "blend": "composite", "algorithm": "auto", "quality": "standard", "early_ray_termination": 0.99,
            "min_opacity": 0.002, "sample_distance": 0.125, "depth_cueing": {"front": 1.0, "density": 1.0},
            "clip": [{"plane": {"point": [0, 0, 0], "normal": [0, 1, 0]}, "keep": "outside"},
                {"box": {"min": [-1, -1, -1], "max": [1, 1, 1]}}, {"sphere": {"center": [0, 0, 0], "radius": 2}},
                {"hull": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "keep": "outside"},
                {"box": {"min": [0, 0, 0], "max": [1, 1, 1], "pose": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]}}],
            "preintegration": {"table": "2d", "entries": 256, "lookup": "bilinear", "opacity_correction": "view",
                "buffer": "slice", "samples_per_voxel": 1}
        }"##;
        assert_eq!(json(text).unwrap().format(), Some(Format::Png));
    }

    #[test]
    fn every_wrong_field_is_named_by_its_pointer() {
        let cases = [
            ("[]", ""),
            ("null", ""),
            ("3", ""),
            (r#"{"colour": 1}"#, "/colour"),
            (r#"{"a/b~c": 1}"#, "/a~1b~0c"),
            (r#"{"camera": null}"#, "/camera"),
            (r#"{"camera": [1]}"#, "/camera"),
            (r#"{"camera": {"azimut": 1}}"#, "/camera/azimut"),
            (r#"{"camera": {"azimuth": "30"}}"#, "/camera/azimuth"),
            (r#"{"camera": {"azimuth": null}}"#, "/camera/azimuth"),
            (r#"{"camera": {"azimuth": 1e7}}"#, "/camera/azimuth"),
            (r#"{"camera": {"azimuth": 1, "azimuth": 1}}"#, "/camera/azimuth"),
            (r#"{"camera": {"azimuth": 1e400}}"#, "/camera/azimuth"),
            (r#"{"camera": {"zoom": 0}}"#, "/camera/zoom"),
            (r#"{"camera": {"fov_y": 180}}"#, "/camera/fov_y"),
            (r#"{"camera": {"target": [1, 2]}}"#, "/camera/target"),
            (r#"{"camera": {"target": [1, 2, 3, 4]}}"#, "/camera/target"),
            (r#"{"camera": {"target": [1, true, 3]}}"#, "/camera/target/1"),
            (r#"{"camera": {"target": [1, 2, 1e10]}}"#, "/camera/target/2"),
            (r#"{"camera": {"projection": "fisheye"}}"#, "/camera/projection"),
            (r#"{"camera": {"projection": {"parallel": null}}}"#, "/camera/projection"),
            (r#"{"camera": {"look_at": {"position": [0, 0, 0]}}}"#, "/camera/look_at"),
            (r#"{"camera": {"view_height": 3}}"#, "/camera/view_height"),
            (r#"{"image": {"width": 0}}"#, "/image/width"),
            (r#"{"image": {"width": -1}}"#, "/image/width"),
            (r#"{"image": {"width": 1.5}}"#, "/image/width"),
            (r#"{"image": {"width": 1e12}}"#, "/image/width"),
            (r#"{"image": {"format": "bmp"}}"#, "/image/format"),
            (r#"{"image": {"background": "black"}}"#, "/image/background"),
            (r#"{"image": {"format": "jpeg", "background": "transparent"}}"#, "/image/background"),
            (r#"{"image": {"format": "webp", "height": 20000}}"#, "/image/height"),
            (r#"{"transfer_function": 3}"#, "/transfer_function"),
            (r#"{"transfer_function": {"points": []}}"#, "/transfer_function/points"),
            (r#"{"transfer_function": {"points": [[1, 0, "000000"]]}}"#, "/transfer_function/points/0"),
            (r#"{"transfer_function": {"points": [{"value": 1, "opacity": 0}]}}"#, "/transfer_function/points/0"),
            (
                r##"{"transfer_function": {"points": [{"value": 1, "opacity": 2, "color": "#000000"}]}}"##,
                "/transfer_function/points/0/opacity",
            ),
            (
                r#"{"transfer_function": {"points": [{"value": 1, "opacity": 0, "color": "red"}]}}"#,
                "/transfer_function/points/0/color",
            ),
            (
                r#"{"transfer_function": {"points": [], "opacity_distance": null}}"#,
                "/transfer_function/opacity_distance",
            ),
            (r#"{"shading": "on"}"#, "/shading"),
            (r#"{"shading": {"ambient": -1}}"#, "/shading/ambient"),
            (r#"{"shading": {"lights": ["sun"]}}"#, "/shading/lights/0"),
            (r#"{"shading": {"lights": [{"direction": [0, 0, 0]}]}}"#, "/shading/lights/0/direction"),
            (
                r#"{"shading": {"lights": ["headlight", {"direction": [0, 0, 1], "power": 1}]}}"#,
                "/shading/lights/1/power",
            ),
            (r#"{"algorithm": "magic"}"#, "/algorithm"),
            (r#"{"quality": 1}"#, "/quality"),
            (r#"{"early_ray_termination": 0}"#, "/early_ray_termination"),
            (r#"{"min_opacity": 1}"#, "/min_opacity"),
            (r#"{"algorithm": "raycast", "min_opacity": 0.1}"#, "/min_opacity"),
            (r#"{"algorithm": "classified", "sample_distance": 1}"#, "/sample_distance"),
            (r#"{"sample_distance": 0}"#, "/sample_distance"),
            (r#"{"algorithm": "classified", "quality": "high"}"#, "/quality"),
            (r#"{"algorithm": "fast-classification", "quality": "high"}"#, "/quality"),
            (r#"{"algorithm": "preintegrated", "sample_distance": 1}"#, "/sample_distance"),
            (r#"{"algorithm": "classified", "preintegration": {}}"#, "/preintegration"),
            (r#"{"preintegration": {"entries": 1}}"#, "/preintegration/entries"),
            (r#"{"preintegration": {"entries": 100000}}"#, "/preintegration/entries"),
            (r#"{"preintegration": {"samples_per_voxel": 0}}"#, "/preintegration/samples_per_voxel"),
            (r#"{"preintegration": {"lookup": "cubic"}}"#, "/preintegration/lookup"),
            (r#"{"preintegration": {"table": "3d"}}"#, "/preintegration/table"),
            (r#"{"blend": "sum"}"#, "/blend"),
            (r#"{"window": {"center": 40, "width": 400}}"#, "/window"),
            (r#"{"blend": "maximum", "window": 40}"#, "/window"),
            (r#"{"blend": "maximum", "window": {"level": 40}}"#, "/window/level"),
            (r#"{"blend": "maximum", "window": {"center": 1e13}}"#, "/window/center"),
            (r#"{"blend": "maximum", "window": {"center": 40, "width": 0}}"#, "/window/width"),
            (r#"{"clip": {}}"#, "/clip"),
            (r#"{"clip": [{}]}"#, "/clip/0"),
            (r#"{"clip": [{"cone": {}}]}"#, "/clip/0/cone"),
            (r#"{"clip": [{"sphere": {"center": [0, 0, 0], "radius": 0}}]}"#, "/clip/0/sphere/radius"),
            (r#"{"regions": [{}]}"#, "/regions/0"),
            (
                r#"{"clip": [{"hull": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}}]}"#,
                "/clip/0/hull/points",
            ),
            (r#"{"clip": [{"hull": {"points": []}}]}"#, "/clip/0/hull/points"),
            (r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "color": 1}]}"#, "/regions/0/color"),
            (r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "opacity": 2}]}"#, "/regions/0/opacity"),
            (
                r#"{"algorithm": "classified", "regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "blend": "maximum"}]}"#,
                "/regions/0/blend",
            ),
            (
                r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "window": {"center": 3}}]}"#,
                "/regions/0/window",
            ),
            (
                r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "shading": {"lights": ["sun"]}}]}"#,
                "/regions/0/shading/lights/0",
            ),
            (
                r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "shading": {"diffuse": -1}}]}"#,
                "/regions/0/shading/diffuse",
            ),
            (
                r#"{"regions": [{"sphere": {"center": [0, 0, 0], "radius": 3}, "transfer_function": {"points": []}}]}"#,
                "/regions/0/transfer_function/points",
            ),
            (
                r#"{"clip": [{"box": {"min": [0, 0, 0], "max": [1, 1, 1], "pose": [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}}]}"#,
                "/clip/0/box/pose",
            ),
            (r#"{"clip": [{"plane": {"point": [0, 0, 0], "normal": [0, 0, 0]}}]}"#, "/clip/0/plane/normal"),
            (r#"{"clip": [{"box": {"min": [0, 0, 0], "max": [1, 0, 1]}}]}"#, "/clip/0/box/max/1"),
            (
                r#"{"clip": [{"box": {"min": [0, 0, 0], "max": [1, 1, 1]}, "plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}]}"#,
                "/clip/0",
            ),
            (r#"{"depth_cueing": {"front": -1}}"#, "/depth_cueing/front"),
            (r#"{"depth_cueing": {"fog": 1}}"#, "/depth_cueing/fog"),
        ];
        for (text, pointer) in cases {
            assert_eq!(refused(json(text)), [pointer], "{text}");
        }
        let five = [r#"{"sphere": {"center": [0, 0, 0], "radius": 3}}"#; 5].join(", ");
        assert_eq!(refused(json(&format!(r#"{{"regions": [{five}]}}"#))), ["/regions"]);
        let nine = format!(r#"{{"shading": {{"lights": {:?}}}}}"#, ["headlight"; 9]);
        assert_eq!(refused(json(&nine)), ["/shading/lights"]);
    }

    #[test]
    fn all_fields_out_of_range_are_named_at_once() {
        let text = r#"{"camera": {"zoom": 0, "roll": 1e9}, "image": {"width": 0}, "min_opacity": 2}"#;
        assert_eq!(refused(json(text)), ["/camera/roll", "/camera/zoom", "/image/width", "/min_opacity"]);
    }

    #[test]
    fn a_camera_is_told_in_one_way() {
        let look = r#""look_at": {"position": [0, -500, 0], "target": [0, 0, 0]}"#;
        let matrices = format!(r#""matrices": {{"view": {0:?}, "projection": {0:?}}}"#, [1; 16]);
        let camera = |fields: &str| json(&format!(r#"{{"camera": {{{fields}}}}}"#));
        assert!(camera(look).is_ok());
        assert!(camera(&format!(r#"{look}, "view_height": 300, "projection": "parallel""#)).is_ok());
        assert_eq!(refused(camera(&format!(r#"{look}, "zoom": 2, "roll": 1"#))), ["/camera/roll", "/camera/zoom"]);
        assert_eq!(refused(camera(&format!(r#"{matrices}, "azimuth": 0"#))), ["/camera/azimuth"]);
        assert_eq!(refused(camera(&format!(r#"{matrices}, "projection": "parallel""#))), ["/camera/projection"]);
        assert_eq!(refused(camera(&format!("{look}, {matrices}"))), ["/camera/matrices"]);
    }

    #[test]
    fn wrong_parameters_are_named_as_the_client_wrote_them() {
        for (query, pointer) in [
            ("azimuth=inf", "/azimuth"),
            ("azimuth=", "/azimuth"),
            ("azimuth=1e7", "/azimuth"),
            ("azimuth=1&azimuth=2", "/azimuth"),
            ("width=0", "/width"),
            ("width=1.5", "/width"),
            ("shading=1", "/shading"),
            ("background=red", "/background"),
            ("projection=fisheye", "/projection"),
            ("quality=best", "/quality"),
            ("algorithm=magic", "/algorithm"),
            ("blend=product", "/blend"),
            ("blend=maximum&window_width=0", "/window_width"),
            ("blend=maximum&window_center=x", "/window_center"),
            ("format=png", "/format"),
            ("a%2Fb=1", "/a~1b"),
        ] {
            assert_eq!(refused(RenderRequest::from_query(query)), [pointer], "{query}");
        }
        assert!(RenderRequest::from_query("").is_ok());
    }

    #[test]
    fn short_names_override_the_fields_of_the_json() {
        let text = br#"{"camera": {"azimuth": 10, "elevation": 5}}"#;
        let expected = json(r#"{"camera": {"azimuth": 20, "elevation": 5}, "image": {"width": 7}}"#);
        let options = [("azimuth", "20"), ("width", "7")];
        assert_eq!(RenderRequest::from_json_and_options(text, options), expected);
        let wrong = RenderRequest::from_json_and_options(br#"{"camera": 3}"#, options);
        assert_eq!(refused(wrong), ["/camera"]);
    }

    #[test]
    fn a_turned_request_has_another_azimuth() {
        let turned = json(r#"{"camera": {"azimuth": 10}}"#).unwrap().turned(4.0).unwrap();
        assert_eq!(Ok(turned), json(r#"{"camera": {"azimuth": 14}}"#));
        let look = json(r#"{"camera": {"look_at": {"position": [0, -500, 0], "target": [0, 0, 0]}}}"#).unwrap();
        assert_eq!(refused(look.turned(4.0)), ["/camera/look_at"]);
    }

    #[test]
    fn jpeg_is_refused_for_transparent_images_however_it_is_asked_for() {
        let request = RenderRequest::from_query("background=transparent").unwrap();
        assert_eq!(refused(request.clone().with_format(Format::Jpeg)), ["/background"]);
        assert_eq!(request.with_format(Format::Webp).unwrap().format(), Some(Format::Webp));
    }
}
