//! Frames: a request is read, refused or rendered, and answered with what it cost.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use axum::extract::rejection::{BytesRejection, PathRejection};
use axum::extract::{FromRequest, Path, RawQuery, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use glam::DMat4;
use xxhash_rust::xxh3::xxh3_128;

use super::classified::ClassifiedKey;
use super::error::Problem;
use super::observe::Rendered;
use super::render_pool::Ticket;
use super::request::{GeometryRequest, RenderRequest, RequestError, ResolvedRequest};
use super::scene::{self, Parts};
use super::store::LoadedVolume;
use super::{App, metrics, negotiate};
use crate::encode::{Format, encode};
use crate::mesh::Mesh;
use crate::render::raster::Solid;
use crate::render::shadow::Shadow;
use crate::render::{self, Background, Image, Scene, Stage, Timings};

const IMAGE_WARP: HeaderName = HeaderName::from_static("x-image-warp");
const ALGORITHM: HeaderName = HeaderName::from_static("x-render-algorithm");
const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");

/// What the raw format leaves out of its bytes.
const RAW_HEADERS: [HeaderName; 3] = [
    HeaderName::from_static("x-image-width"),
    HeaderName::from_static("x-image-height"),
    HeaderName::from_static("x-image-channels"),
];

/// Clients may keep a frame, but ask whether it is still the one: with the ETag that costs them
/// 304 and no rendering, and a scan replaced under the same name never shows as the old one.
const CACHE_CONTROL: &str = "no-cache";

/// `POST /v1/volumes/{id}/frame`
pub async fn from_body(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
    request: Request,
) -> Result<Response, Problem> {
    let Path(id) = id?;
    let volume = app.store.loaded(&id)?;
    let headers = request.headers().clone();
    let (body, parts) = if scene::is_multipart(&headers) {
        let (body, parts) = scene::read(&app, request).await?;
        (body, Some(parts))
    } else {
        (read_json(&app, request).await?, None)
    };
    let request = RenderRequest::from_body(&body)?;
    let accepted = |format: &Format| request.clone().with_format(*format).is_ok();
    let offered: Vec<_> = Format::ALL.into_iter().filter(accepted).collect();
    let format = match request.format() {
        Some(format) => format,
        None => negotiate::format(&headers, &offered).ok_or(Problem::NotAcceptable)?,
    };
    let asked = Asked::new(&app, id, volume, request.clone(), format)?;
    let asked = match parts {
        None => asked,
        Some(parts) => asked.within(parts, &request)?,
    };
    asked.rendered(&app).await
}

/// `GET /v1/volumes/{id}/frame.{extension}`
pub async fn from_query(
    format: Format,
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
    RawQuery(query): RawQuery,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let Path(id) = id?;
    let volume = app.store.loaded(&id)?;
    let request = RenderRequest::from_query(query.as_deref().unwrap_or_default())?;
    let asked = Asked::new(&app, id, volume, request, format)?;
    if negotiate::is_known(&headers, &asked.etag) {
        return Ok(asked.not_modified());
    }
    asked.rendered(&app).await
}

/// The body of a request that says it is JSON; empty where there is none.
pub(super) async fn read_json(app: &App, request: Request) -> Result<Bytes, Problem> {
    let content_type = request.headers().get(header::CONTENT_TYPE).cloned();
    let got = content_type.as_ref().map_or("none", |value| value.to_str().unwrap_or("an unreadable one"));
    let unsupported = || Problem::UnsupportedMediaType { expected: "application/json", got: got.to_owned() };
    if content_type.is_some() && !is_json(got) {
        return Err(unsupported());
    }
    let arrived = tokio::time::timeout(app.config.http.body_timeout, Bytes::from_request(request, &()));
    let body = arrived.await.map_err(|_| Problem::BodyTimeout)?.map_err(|rejection| refused_body(app, &rejection))?;
    if !body.is_empty() && content_type.is_none() {
        return Err(unsupported());
    }
    Ok(body)
}

fn is_json(content_type: &str) -> bool {
    mediatype::MediaType::parse(content_type)
        .is_ok_and(|media| media.ty == "application" && media.subty == "json" && media.suffix.is_none())
}

fn refused_body(app: &App, rejection: &BytesRejection) -> Problem {
    match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Problem::BodyTooLarge { limit: app.config.http.max_body_bytes.get() },
        _ => Problem::Malformed(rejection.body_text()),
    }
}

/// A frame that can be had, with all that it depends on.
pub(super) struct Asked {
    arrived: Instant,
    id: String,
    volume: Arc<LoadedVolume>,
    frame: ResolvedRequest,
    /// Where the request names a segmentation.
    labels: Option<Arc<LoadedVolume>>,
    /// Of the request's geometry.
    solids: Arc<[Solid]>,
    format: Format,
    /// A scene to be merged with, for the view that these matrices make.
    scene: Option<(Arc<Parts>, [DMat4; 2])>,
    /// Of the frame without it.
    etag: String,
}

/// A frame and what it took.
pub(super) struct Made {
    /// Width, height, channels.
    pub size: [u32; 3],
    /// Row by row, where it is an intermediate image.
    pub warp: Option<[f64; 9]>,
    pub bytes: Vec<u8>,
    /// Of the scene that it was merged with.
    scene: Option<u128>,
    queue: Duration,
    prepare: Duration,
    stages: Timings,
    encode: Duration,
}

impl Asked {
    /// The last step that refuses; nothing has been queued or built for the request before it.
    pub fn new(
        app: &App,
        id: String,
        volume: Arc<LoadedVolume>,
        request: RenderRequest,
        format: Format,
    ) -> Result<Self, Problem> {
        let arrived = Instant::now();
        let request = request.with_format(format)?;
        let frame = request.resolve(volume.volume(), &volume.presets, &app.config.image.limits())?;
        let labels = frame.look.labels.as_ref().map(|named| {
            let labels = app.store.loaded(&named.volume).map_err(|problem| match problem {
                Problem::NoSuchVolume(_) => RequestError::refused("/labels/volume", "there is no such volume").into(),
                other => other,
            })?;
            named.suit(volume.volume(), labels.volume())?;
            Ok::<_, Problem>(labels)
        });
        let labels = labels.transpose()?;
        if frame.shadows.is_some() {
            let (bytes, room) =
                (Shadow::bytes_of(volume.level(frame.level()).volume().dims()), app.store.classified.shadows_room());
            if bytes > room {
                let detail = format!(
                    "shadows on this volume take {bytes} bytes, over {room} (an eighth of cache.classified_bytes)"
                );
                return Err(Problem::refused("/shading/lights", detail));
            }
        }
        let solid = |(index, told): (usize, &GeometryRequest)| match app.meshes.get(&told.mesh) {
            Some(uploaded) => Ok(told.solid(&uploaded.mesh)),
            None => {
                let detail = format!("there is no mesh {:?}; GET /v1/meshes lists them", told.mesh);
                Err(Problem::refused(format!("/geometry/{index}/mesh"), detail))
            }
        };
        let solids = frame.geometry.iter().enumerate().map(solid).collect::<Result<Arc<[Solid]>, Problem>>()?;
        let count = |of: fn(&Mesh) -> usize| solids.iter().map(|solid| of(&solid.mesh)).sum();
        Mesh::room(count(|mesh| mesh.positions().len()), count(|mesh| mesh.triangles().len()))
            .map_err(|error| Problem::refused("/geometry", error.to_string()))?;
        let etag = etag(&volume, labels.as_deref(), &frame, format);
        Ok(Self { arrived, id, volume, frame, labels, solids, format, scene: None, etag })
    }

    /// The same frame merged with a scene: rays end at its geometry, and its picture is behind the volume.
    fn within(mut self, parts: Parts, request: &RenderRequest) -> Result<Self, Problem> {
        let told = "expected matrices: a depth buffer means nothing without its projection";
        let matrices = request.matrices().ok_or_else(|| Problem::refused("/camera", told))?;
        if parts.have_picture() {
            // Its pixels are the background.
            self.frame.look.settings.background = Background::Transparent;
            self.frame.look.settings.stage = Stage::Final;
        }
        self.scene = Some((Arc::new(parts), matrices));
        Ok(self)
    }

    /// The algorithm that it is made by.
    pub fn algorithm(&self) -> &'static str {
        self.frame.look.settings.algorithm.name()
    }

    /// The format of its bytes.
    pub fn format(&self) -> Format {
        self.format
    }

    async fn rendered(self, app: &App) -> Result<Response, Problem> {
        let made = self.made(app, app.pool.admit()?).await?;
        Ok(self.answer(made))
    }

    /// Renders within the deadline. Dropping this future, as the server does when the client
    /// leaves, cancels the work.
    pub async fn made(&self, app: &App, ticket: Ticket) -> Result<Made, Problem> {
        let making = self.make(app, &ticket);
        tokio::time::timeout(app.config.render.deadline, making).await.map_err(|_| Problem::Deadline)?
    }

    /// What each stage took, `total` from when it was asked for; counted with it.
    pub fn stages(&self, made: &Made) -> [(&'static str, Duration); 7] {
        let stages = [
            ("queue", made.queue),
            ("prepare", made.prepare + made.stages.preintegration_table),
            ("shade", made.stages.shade),
            ("composite", made.stages.composite),
            ("warp", made.stages.warp),
            ("encode", made.encode),
            ("total", self.arrived.elapsed()),
        ];
        stages.iter().for_each(|(stage, duration)| metrics::stage(stage, *duration));
        stages
    }

    async fn make(&self, app: &App, ticket: &Ticket) -> Result<Made, Problem> {
        let start = Instant::now();
        let mut classified = vec![];
        for look in self.frame.looks() {
            classified.push(match ClassifiedKey::of(look) {
                None => None,
                Some(made_from) => {
                    let encoded = look.walks_encodings();
                    Some(app.store.classified.get(ticket, &self.volume, made_from, encoded).await?)
                }
            });
        }
        let mut tables = vec![];
        for told in self.frame.looks().map(|look| look.labels.as_ref()) {
            tables.push(match self.labels.as_ref().zip(told) {
                None => None,
                Some((labels, told)) => {
                    let level = self.frame.level();
                    Some(app.store.classified.labels(ticket, &self.volume, level, labels, told).await?)
                }
            });
        }
        let shadow = match &self.frame.shadows {
            None => None,
            Some(told) => {
                let labels = self.labels.as_ref().zip(self.frame.look.labels.as_ref()).zip(tables[0].as_ref());
                let labels = labels.map(|((volume, told), tables)| (volume, told, tables));
                Some(app.store.classified.shadows(ticket, &self.volume, &self.frame.look, labels, told).await?)
            }
        };
        let prepare = start.elapsed();
        let (volume, frame, format) = (Arc::clone(&self.volume), self.frame.clone(), self.format);
        let (scene, solids, labels) = (self.scene.clone(), Arc::clone(&self.solids), self.labels.clone());
        let job = move |cancel: &render::Cancel| {
            let prepared = volume.level(frame.level());
            let scenes: Vec<_> = frame
                .looks()
                .zip(classified.iter().zip(&tables))
                .enumerate()
                .map(|(nth, (look, (classified, tables)))| Scene {
                    prepared,
                    transfer: &look.transfer,
                    classification: classified.as_ref().map(|c| &*c.classification),
                    encodings: classified.as_ref().and_then(|c| c.encodings.as_deref()),
                    labels: labels.as_ref().zip(tables.as_ref()).map(|(labels, tables)| tables.of(labels.volume())),
                    // Not in regions that look otherwise.
                    shadow: shadow.as_deref().filter(|_| nth == 0),
                })
                .collect();
            // Solids hide, and are hidden, beside the volume too.
            let shown = solids.is_empty().then(|| render::shown(scenes.iter()));
            let shown = shown.as_ref().map(|shown| (prepared.volume(), shown));
            let client = scene.map(|(parts, matrices)| parts.scene(&frame.view, &matrices, shown)).transpose()?;
            let view = match &client {
                None => frame.view.clone(),
                Some(client) => frame.view.clone().ending_at(Arc::clone(&client.depth)),
            };
            let (image, stages) = frame.render(&view, &scenes, &solids, cancel)?;
            let image = match client.as_ref().and_then(|client| client.picture.as_ref()) {
                None => image,
                Some(picture) => image.over(picture),
            };
            let start = Instant::now();
            let bytes = encode(&image, format).map_err(|error| {
                tracing::error!(%error, "a frame could not be encoded");
                Problem::Internal("the frame could not be encoded")
            })?;
            let warp = image.warp.map(|warp| warp.image_from_intermediate.transpose().to_cols_array());
            let scene = client.map(|client| client.hash());
            Ok::<_, Problem>((image_size(&image), warp, bytes, scene, stages, start.elapsed()))
        };
        let (outcome, queue) = ticket.run(job).await?;
        let (size, warp, bytes, scene, stages, encode) = outcome?;
        Ok(Made { size, warp, bytes, scene, queue, prepare, stages, encode })
    }

    fn answer(&self, made: Made) -> Response {
        let stages = self.stages(&made);
        let timing = stages.map(|(stage, duration)| format!("{stage};dur={:.3}", duration.as_secs_f64() * 1000.0));
        let algorithm = self.algorithm();
        let mut response = Body::from(made.bytes).into_response();
        response.extensions_mut().insert(Rendered { volume: self.id.clone(), algorithm });
        let headers = response.headers_mut();
        match made.scene {
            None => validators(headers, &self.etag),
            Some(scene) => validators(headers, &quoted(&format!("{} {scene:032x}", self.etag))),
        }
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.format.media_type()));
        headers.insert(SERVER_TIMING, ascii(&timing.join(", ")));
        headers.insert(ALGORITHM, HeaderValue::from_static(algorithm));
        if let Some(warp) = made.warp {
            headers.insert(IMAGE_WARP, ascii(&warp.map(|element| element.to_string()).join(", ")));
        }
        if self.format == Format::Raw {
            RAW_HEADERS.into_iter().zip(made.size).for_each(|(name, value)| drop(headers.insert(name, value.into())));
        }
        response
    }

    fn not_modified(&self) -> Response {
        let mut response = StatusCode::NOT_MODIFIED.into_response();
        validators(response.headers_mut(), &self.etag);
        response
    }
}

/// What 200 and 304 have in common.
fn validators(headers: &mut HeaderMap, etag: &str) {
    headers.insert(header::ETAG, ascii(etag));
    headers.insert(header::VARY, HeaderValue::from_static("Accept"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(CACHE_CONTROL));
}

/// Width, height, channels.
fn image_size(image: &Image) -> [u32; 3] {
    [image.width, image.height, image.channels.into()]
}

/// A strong validator: equal where every byte of the frame is. Frames are the same bit for bit
/// whatever the number of threads, so what they are made from names them.
fn etag(volume: &LoadedVolume, labels: Option<&LoadedVolume>, frame: &ResolvedRequest, format: Format) -> String {
    let program = env!("CARGO_PKG_VERSION");
    let labels = labels.map_or(0, |labels| labels.fingerprint);
    let made_from =
        format!("{:032x} {labels:032x} {} {program} {}", volume.fingerprint, format.name(), frame.canonical());
    quoted(&made_from)
}

/// What names all that is made from this.
fn quoted(made_from: &str) -> String {
    format!("\"{:032x}\"", xxh3_128(made_from.as_bytes()))
}

fn ascii(text: &str) -> HeaderValue {
    HeaderValue::from_str(text).expect("our own header values are visible ASCII")
}
