//! A client's scene: a depth buffer and a picture, to be merged with a volume's frame.
//!
//! They come with the request as `multipart/form-data`: `request` (JSON, whose camera is told by matrices, for a depth buffer means
//! nothing without them), `depth` and, if the volume is to be blended over it, `color`. Sizes are checked against the request before
//! anything is decoded.

use std::borrow::Cow;
use std::convert::Infallible;
use std::future::ready;
use std::io::Cursor;
use std::ops::{Deref, Range};
use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::multipart::{Field, MultipartError};
use axum::extract::{DefaultBodyLimit, FromRequest, Multipart, Request};
use axum::http::{HeaderMap, StatusCode, header};
use glam::DMat4;
use png::{BitDepth, ColorType, Transformations};
use tokio::sync::OwnedSemaphorePermit;
use tower::{Layer, ServiceExt, service_fn};
use xxhash_rust::xxh3::xxh3_128;

use super::App;
use super::error::Problem;
use crate::render::depth::{Met, SceneDepth};
use crate::render::spare::Spare;
use crate::render::{Image, View};
use crate::volume::Volume;

const OCTETS: &str = "application/octet-stream";
const PNG: &str = "image/png";

/// The largest value of a 16-bit depth.
const WHITE: f32 = u16::MAX as f32;

/// What came with the request.
pub struct Parts {
    depth: Part,
    /// Of the depth part, where that is floats.
    met: Met,
    color: Option<Part>,
    /// Their place among the scenes that may be in memory, held as long as they are.
    _place: OwnedSemaphorePermit,
}

struct Part {
    content_type: String,
    bytes: Received,
}

/// Memory for parts, kept from one request to the next: what the system gives anew costs a fault for every page.
static SPARE_PARTS: Spare<u8> = Spare::none();

/// The bytes of a part.
struct Received(Vec<u8>);

impl Received {
    /// `watch` is shown what there is as it comes.
    async fn read(mut field: Field<'_>, mut watch: impl FnMut(&[u8])) -> Result<Self, MultipartError> {
        let mut received = Self(SPARE_PARTS.take());
        received.0.clear();
        while let Some(chunk) = field.chunk().await? {
            received.0.extend_from_slice(&chunk);
            watch(&received.0);
        }
        Ok(received)
    }
}

impl Deref for Received {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

impl Drop for Received {
    fn drop(&mut self) {
        SPARE_PARTS.give(std::mem::take(&mut self.0));
    }
}

/// A scene, ready to be merged with.
#[derive(Debug)]
pub struct ClientScene {
    pub depth: Arc<SceneDepth>,
    /// Opaque.
    pub picture: Option<Image>,
}

/// True where the body has several parts.
pub fn is_multipart(headers: &HeaderMap) -> bool {
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    content_type.is_some_and(|text| text.trim_start().to_ascii_lowercase().starts_with("multipart/form-data"))
}

/// The request's JSON and its other parts, if there is room for them.
pub async fn read(app: &App, request: Request) -> Result<(Bytes, Parts), Problem> {
    let retry_after = app.config.render.retry_after_seconds.get();
    let place = Arc::clone(&app.scenes).try_acquire_owned().map_err(|_| Problem::Busy { retry_after })?;
    let reading = tokio::time::timeout(app.config.http.body_timeout, parts(app, request, place));
    reading.await.map_err(|_| Problem::BodyTimeout)?
}

async fn parts(app: &App, request: Request, place: OwnedSemaphorePermit) -> Result<(Bytes, Parts), Problem> {
    let limit = app.config.http.max_scene_bytes.get();
    let failed = |error: MultipartError| match error.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Problem::BodyTooLarge { limit },
        _ => Problem::Malformed(error.body_text()),
    };
    let request = with_body_limit(request, limit).await;
    let mut multipart =
        Multipart::from_request(request, &()).await.map_err(|rejection| Problem::Malformed(rejection.body_text()))?;
    let (mut request, mut depth, mut color, mut met) = (None, None, None, Met::default());
    while let Some(field) = multipart.next_field().await.map_err(failed)? {
        let name = field.name().unwrap_or_default().to_owned();
        let place = match name.as_str() {
            "request" => &mut request,
            "depth" => &mut depth,
            "color" => &mut color,
            _ => return Err(Problem::refused(format!("/{name}"), "expected the parts request, depth and color")),
        };
        if place.is_some() {
            return Err(Problem::refused(format!("/{name}"), "expected one such part, got two"));
        }
        let content_type = field.content_type().unwrap_or_default().to_owned();
        let watch = |bytes: &[u8]| {
            if name == "depth" {
                met.advance(bytes)
            }
        };
        *place = Some(Part { content_type, bytes: Received::read(field, watch).await.map_err(failed)? });
    }
    let depth = depth.ok_or_else(|| Problem::refused("/depth", "expected a part with the depth buffer"))?;
    let request = request.map(|part: Part| Bytes::copy_from_slice(&part.bytes));
    Ok((request.unwrap_or_default(), Parts { depth, met, color, _place: place }))
}

/// The request with a limit of its own: the router's is for JSON.
pub async fn with_body_limit(request: Request, limit: usize) -> Request {
    let limited =
        DefaultBodyLimit::max(limit).layer(service_fn(|request: Request| ready(Ok::<_, Infallible>(request))));
    let Ok(request) = limited.oneshot(request).await;
    request
}

impl Parts {
    /// True where the volume is to be blended over a picture.
    pub fn have_picture(&self) -> bool {
        self.color.is_some()
    }

    /// Decodes the parts for the view that these matrices (view and projection) make, on the current rayon pool. Nothing is told of rays that
    /// pass none of the voxels `shown` of a volume, where these are given.
    ///
    /// # Errors
    /// 422 where a part is not what it should be.
    pub fn scene(
        &self,
        view: &View,
        [camera, projection]: &[DMat4; 2],
        shown: Option<(&Volume, &[Range<usize>; 3])>,
    ) -> Result<ClientScene, Problem> {
        let values = self.depth.depths(view.size())?;
        // Of what was decoded nothing is known yet.
        let met = if matches!(values, Cow::Borrowed(_)) { self.met.clone() } else { Met::default() };
        let depth = SceneDepth::from_window(&values, met, view, [projection, camera], shown);
        let depth = Arc::new(depth.map_err(|error| Problem::refused("/depth", error.to_string()))?);
        let picture = self.color.as_ref().map(|color| color.picture(view.size())).transpose()?;
        Ok(ClientScene { depth, picture })
    }
}

impl ClientScene {
    /// Of all that frames show of it.
    pub fn hash(&self) -> u128 {
        let picture = self.picture.as_ref().map_or(0, |picture| xxh3_128(&picture.pixels));
        xxh3_128(format!("{:?} {picture:032x}", self.depth).as_bytes())
    }
}

impl Part {
    /// Window-space depths, row by row from the top.
    fn depths(&self, (width, height): (u32, u32)) -> Result<Cow<'_, [f32]>, Problem> {
        let pixels = width as usize * height as usize;
        match self.content_type.as_str() {
            OCTETS | "" => {
                let expected = pixels * size_of::<f32>();
                if self.bytes.len() != expected {
                    let detail = format!(
                        "expected {expected} bytes, 32-bit floats for {width} x {height} pixels, got {}",
                        self.bytes.len()
                    );
                    return Err(Problem::refused("/depth", detail));
                }
                match bytemuck::try_cast_slice(&self.bytes) {
                    Ok(values) if cfg!(target_endian = "little") => Ok(Cow::Borrowed(values)),
                    _ => Ok(self.bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()),
                }
            }
            PNG => {
                let (color, depth, bytes) = self.decode("/depth", (width, height), Transformations::IDENTITY)?;
                if (color, depth) != (ColorType::Grayscale, BitDepth::Sixteen) {
                    let detail = format!("expected 16-bit gray, got {color:?} of {} bits", depth as u8);
                    return Err(Problem::refused("/depth", detail));
                }
                let values = bytes.chunks_exact(2);
                Ok(values.map(|pair| f32::from(u16::from_be_bytes([pair[0], pair[1]])) / WHITE).collect())
            }
            other => {
                let detail =
                    format!("expected {OCTETS} (32-bit floats, little endian) or {PNG} (16-bit gray), got {other}");
                Err(Problem::refused("/depth", detail))
            }
        }
    }

    /// An opaque picture; transparency is not looked at.
    fn picture(&self, size: (u32, u32)) -> Result<Image, Problem> {
        if self.content_type != PNG {
            let detail = format!("expected {PNG}, got {:?}", self.content_type);
            return Err(Problem::refused("/color", detail));
        }
        let (color, _, bytes) = self.decode("/color", size, Transformations::normalize_to_color8())?;
        let channels = color.samples();
        let rgb = |pixel: &[u8]| if channels < 3 { [pixel[0]; 3] } else { [pixel[0], pixel[1], pixel[2]] };
        let pixels = bytes.chunks_exact(channels).flat_map(rgb).collect();
        Ok(Image { width: size.0, height: size.1, channels: 3, pixels, warp: None })
    }

    fn decode(
        &self,
        pointer: &str,
        (width, height): (u32, u32),
        transformations: Transformations,
    ) -> Result<(ColorType, BitDepth, Vec<u8>), Problem> {
        let failed =
            |error: png::DecodingError| Problem::refused(pointer, format!("not a PNG that can be read: {error}"));
        let mut decoder = png::Decoder::new(Cursor::new(&self.bytes[..]));
        decoder.set_transformations(transformations);
        let mut reader = decoder.read_info().map_err(failed)?;
        let got = reader.info().size();
        if got != (width, height) {
            let detail = format!("expected the frame's {width} x {height} pixels, got {} x {}", got.0, got.1);
            return Err(Problem::refused(pointer, detail));
        }
        let size = reader.output_buffer_size().ok_or_else(|| Problem::refused(pointer, "the picture is too large"))?;
        let mut bytes = vec![0; size];
        let info = reader.next_frame(&mut bytes).map_err(failed)?;
        bytes.truncate(info.buffer_size());
        Ok((info.color_type, info.bit_depth, bytes))
    }
}
