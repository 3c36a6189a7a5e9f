//! Everything that a client can be refused for, and the one place that says with which status.
//!
//! Every failure leaves as `application/problem+json` (RFC 9457), those that the framework finds
//! (unknown routes, wrong methods, unreadable paths, panics) like those of the handlers, so that a
//! client needs one way to read them.

use std::any::Any;

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

use super::render_pool::PoolError;
use super::request::RequestError;
use crate::classify::InvalidField;
use crate::render::RenderError;

/// Why there is no answer but this.
#[derive(Clone, Debug)]
pub enum Problem {
    /// The request is not what its media type or URL says.
    Malformed(String),
    NoSuchRoute,
    NoSuchVolume(String),
    NoSuchPreset(String),
    NoSuchMesh(String),
    /// Meshes take as many bytes as they may.
    MeshesFull {
        limit: u64,
    },
    MethodNotAllowed,
    /// None of the formats in `Accept` is offered.
    NotAcceptable,
    /// The body did not arrive in time.
    BodyTimeout,
    /// The volume's file could not be read when the service started.
    VolumeFailed {
        id: String,
        detail: String,
    },
    BodyTooLarge {
        limit: usize,
    },
    UnsupportedMediaType {
        expected: &'static str,
        got: String,
    },
    /// The route speaks WebSocket, the request does not.
    UpgradeRequired(String),
    /// A page of another origin opened a WebSocket: browsers would let it read the frames.
    ForeignOrigin(String),
    /// As many streams are open as may be.
    TooManyStreams {
        limit: usize,
        retry_after: u64,
    },
    /// Values that were understood and cannot be served; each with its field.
    Refused(Vec<InvalidField>),
    /// The queue is full.
    Busy {
        retry_after: u64,
    },
    /// The volume is still being loaded.
    Loading {
        id: String,
        retry_after: u64,
    },
    /// The work took longer than it may.
    Deadline,
    /// A defect: a panic, or a frame that could not be encoded.
    Internal(&'static str),
}

impl Problem {
    /// One refused field.
    pub fn refused(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Refused(vec![InvalidField { pointer: pointer.into(), detail: detail.into() }])
    }

    /// Status, the last part of the problem type, and title of every failure.
    pub fn kind(&self) -> (StatusCode, &'static str, &'static str) {
        match self {
            Self::Malformed(_) => (StatusCode::BAD_REQUEST, "malformed", "Malformed request"),
            Self::NoSuchRoute => (StatusCode::NOT_FOUND, "no-such-route", "No such route"),
            Self::NoSuchVolume(_) => (StatusCode::NOT_FOUND, "no-such-volume", "No such volume"),
            Self::NoSuchPreset(_) => (StatusCode::NOT_FOUND, "no-such-preset", "No such preset"),
            Self::NoSuchMesh(_) => (StatusCode::NOT_FOUND, "no-such-mesh", "No such mesh"),
            Self::MeshesFull { .. } => (StatusCode::INSUFFICIENT_STORAGE, "meshes-full", "No room for more meshes"),
            Self::MethodNotAllowed => (StatusCode::METHOD_NOT_ALLOWED, "method-not-allowed", "Method not allowed"),
            Self::NotAcceptable => (StatusCode::NOT_ACCEPTABLE, "not-acceptable", "No acceptable format"),
            Self::BodyTimeout => (StatusCode::REQUEST_TIMEOUT, "body-timeout", "Body too slow"),
            Self::VolumeFailed { .. } => (StatusCode::CONFLICT, "volume-failed", "Volume could not be loaded"),
            Self::BodyTooLarge { .. } => (StatusCode::PAYLOAD_TOO_LARGE, "body-too-large", "Body too large"),
            Self::UnsupportedMediaType { .. } => {
                (StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported-media-type", "Unsupported media type")
            }
            Self::UpgradeRequired(_) => (StatusCode::UPGRADE_REQUIRED, "upgrade-required", "WebSocket only"),
            Self::ForeignOrigin(_) => (StatusCode::FORBIDDEN, "foreign-origin", "Page of another origin"),
            Self::TooManyStreams { .. } => (StatusCode::SERVICE_UNAVAILABLE, "too-many-streams", "Too many streams"),
            Self::Refused(_) => (StatusCode::UNPROCESSABLE_ENTITY, "refused", "Refused value"),
            Self::Busy { .. } => (StatusCode::SERVICE_UNAVAILABLE, "busy", "Too busy"),
            Self::Loading { .. } => (StatusCode::SERVICE_UNAVAILABLE, "loading", "Volume still loading"),
            Self::Deadline => (StatusCode::GATEWAY_TIMEOUT, "deadline", "Past the deadline"),
            Self::Internal(_) => (StatusCode::INTERNAL_SERVER_ERROR, "internal", "Internal error"),
        }
    }

    /// One sentence for a person.
    fn detail(&self) -> String {
        match self {
            Self::Malformed(detail) => detail.clone(),
            Self::NoSuchRoute => "this service has no such route; /openapi.yaml lists them".into(),
            Self::NoSuchVolume(id) => format!("there is no volume {id:?}; GET /v1/volumes lists them"),
            Self::NoSuchPreset(name) => format!("there is no preset {name:?}; GET /v1/presets lists them"),
            Self::NoSuchMesh(id) => format!("there is no mesh {id:?}; GET /v1/meshes lists them"),
            Self::MeshesFull { limit } => {
                format!("meshes may take {limit} bytes in all; DELETE /v1/meshes/{{id}} makes room")
            }
            Self::MethodNotAllowed => "the header Allow lists this route's methods".into(),
            Self::NotAcceptable => {
                "Accept names nothing that this route can answer; /openapi.yaml lists what it can".into()
            }
            Self::BodyTimeout => "the request's body did not arrive in time".into(),
            Self::VolumeFailed { id, detail } => format!("volume {id:?} could not be loaded: {detail}"),
            Self::BodyTooLarge { limit } => format!("expected a body of at most {limit} bytes"),
            Self::UnsupportedMediaType { expected, got } => format!("expected a body of type {expected}, got {got}"),
            Self::UpgradeRequired(detail) => format!("expected a WebSocket handshake: {detail}"),
            Self::ForeignOrigin(origin) => {
                format!("expected a page of this service's own address, got one of {origin}")
            }
            Self::TooManyStreams { limit, .. } => {
                format!("{limit} streams are open, more may not be; Retry-After says when to come back")
            }
            Self::Refused(fields) => {
                let all: Vec<_> = fields.iter().map(|f| format!("{}: {}", f.pointer, f.detail)).collect();
                all.join("; ")
            }
            Self::Busy { .. } => "the queue is full; Retry-After says when to come back".into(),
            Self::Loading { id, .. } => {
                format!("volume {id:?} is still being loaded; Retry-After says when to come back")
            }
            Self::Deadline => "the frame took longer than the service allows; ask for a smaller or plainer one".into(),
            Self::Internal(what) => format!("{what}; the service's log says more under this request's id"),
        }
    }

    /// Seconds after which a client may come back, where that helps.
    fn retry_after(&self) -> Option<u64> {
        match self {
            Self::Busy { retry_after }
            | Self::Loading { retry_after, .. }
            | Self::TooManyStreams { retry_after, .. } => Some(*retry_after),
            _ => None,
        }
    }
}

/// The body of a failure (RFC 9457).
#[derive(Debug, Serialize, Deserialize)]
pub struct ProblemBody {
    pub r#type: String,
    pub title: String,
    pub status: u16,
    pub detail: String,
    /// The fields at fault; with 422 only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldBody>,
}

/// A field at fault.
#[derive(Debug, Serialize, Deserialize)]
pub struct FieldBody {
    /// JSON pointer (RFC 6901) into the request's body; for query parameters `/name`.
    pub pointer: String,
    pub detail: String,
}

impl Problem {
    /// The body of its answer.
    pub fn body(&self) -> ProblemBody {
        let (status, slug, title) = self.kind();
        let errors = match self {
            Self::Refused(fields) => &fields[..],
            _ => &[],
        };
        let field = |f: &InvalidField| FieldBody { pointer: f.pointer.clone(), detail: f.detail.clone() };
        ProblemBody {
            r#type: format!("urn:shearwarp:problem:{slug}"),
            title: title.into(),
            status: status.as_u16(),
            detail: self.detail(),
            errors: errors.iter().map(field).collect(),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let retry_after = self.retry_after();
        let mut response = (self.kind().0, Json(self.body())).into_response();
        let headers = response.headers_mut();
        if matches!(self, Self::UpgradeRequired(_)) {
            headers.insert(header::UPGRADE, HeaderValue::from_static("websocket"));
        }
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Some(seconds) = retry_after {
            headers.insert(header::RETRY_AFTER, seconds.into());
        }
        response
    }
}

/// The answer to a panic in a handler, for `CatchPanicLayer`.
pub fn panicked(_payload: Box<dyn Any + Send>) -> Response {
    super::metrics::panicked();
    Problem::Internal("a defect ended this request").into_response()
}

impl From<WebSocketUpgradeRejection> for Problem {
    fn from(rejection: WebSocketUpgradeRejection) -> Self {
        Self::UpgradeRequired(rejection.body_text())
    }
}

impl From<PathRejection> for Problem {
    fn from(rejection: PathRejection) -> Self {
        Self::Malformed(rejection.body_text())
    }
}

impl From<RequestError> for Problem {
    fn from(error: RequestError) -> Self {
        match error {
            RequestError::Malformed { detail } => Self::Malformed(detail),
            RequestError::Refused(fields) => Self::Refused(fields),
        }
    }
}

impl From<PoolError> for Problem {
    fn from(error: PoolError) -> Self {
        match error {
            PoolError::Full { retry_after } => Self::Busy { retry_after },
            PoolError::Panicked => Self::Internal("a defect ended this frame"),
        }
    }
}

impl From<RenderError> for Problem {
    fn from(error: RenderError) -> Self {
        match error {
            // Only a client that left or a deadline cancels, and neither waits for this answer.
            RenderError::Cancelled => Self::Deadline,
            RenderError::Unsupported { pointer, detail } => Self::refused(pointer, detail),
        }
    }
}
