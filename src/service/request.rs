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
mod json;
mod options;
mod resolve;

use serde_json::Value;

pub use crate::classify::InvalidField;
use crate::classify::TransferFunction;
use crate::encode::Format;
use crate::render::{Background, Camera, Shading};
pub use options::OPTIONS;
pub use resolve::{ImageLimits, ResolvedRequest};

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

/// Draft, standard or high.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    Draft,
    #[default]
    Standard,
    High,
}

impl Quality {
    /// The name used by the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::High => "high",
        }
    }
}

/// Which algorithm a client names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
enum AlgorithmChoice {
    #[default]
    Auto,
    Classified,
    Raycast,
    // Names of the API that `fields::refuse_unsupported` turns away for now.
    FastClassification,
    Preintegrated,
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
    transfer: Transfer,
    shading: ShadingChoice,
    algorithm: AlgorithmChoice,
    quality: Quality,
    early_ray_termination: Option<f64>,
    min_opacity: Option<f64>,
    sample_distance: Option<f64>,
    spelling: Spelling,
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
