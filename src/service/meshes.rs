//! Meshes that clients upload, to be named in the `geometry` of their requests.
//!
//! They are kept in memory until they are deleted or the service ends, up to a limit. A mesh's id is its content's hash: whoever
//! uploads the same file again gets the same id, and a frame's ETag says which content it shows.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequest, Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::App;
use super::error::Problem;
use super::scene::with_body_limit;
use crate::mesh::Mesh;
use crate::mesh::formats::{self, MeshFormat};

/// The types of bodies, for a refusal.
const MEDIA_TYPES: &str = "model/stl, model/obj, model/ply, model/gltf-binary or application/octet-stream";

/// Of bodies whose format is to be found out.
const OCTETS: &str = "application/octet-stream";

/// Bytes of a hash that make an id: more than anybody can make collide.
const ID_BYTES: usize = 16;

/// The meshes in memory.
#[derive(Debug)]
pub struct Meshes {
    by_id: Mutex<BTreeMap<String, Arc<Uploaded>>>,
    /// Bytes of all at most.
    room: u64,
}

/// A mesh and what it came as.
#[derive(Debug)]
pub struct Uploaded {
    format: MeshFormat,
    pub mesh: Arc<Mesh>,
}

#[derive(Serialize)]
pub struct MeshList {
    meshes: Vec<MeshBody>,
}

#[derive(Serialize)]
pub struct MeshBody {
    id: String,
    format: &'static str,
    vertices: usize,
    triangles: usize,
    /// mm: its least and its greatest corner.
    bounds: [[f32; 3]; 2],
    /// In memory.
    bytes: u64,
}

impl Meshes {
    /// None yet, and room for so many bytes.
    pub fn new(room: u64) -> Self {
        Self { by_id: Mutex::default(), room }
    }

    /// The mesh of this id.
    pub fn get(&self, id: &str) -> Option<Arc<Uploaded>> {
        self.held().get(id).cloned()
    }

    /// How many there are, and their bytes.
    pub fn size(&self) -> (usize, u64) {
        let held = self.held();
        (held.len(), held.values().map(|uploaded| uploaded.mesh.bytes()).sum())
    }

    /// Keeps a mesh; false where it is there already.
    fn keep(&self, id: &str, uploaded: Uploaded) -> Result<bool, Problem> {
        let mut held = self.held();
        if held.contains_key(id) {
            return Ok(false);
        }
        let bytes: u64 = held.values().map(|uploaded| uploaded.mesh.bytes()).sum();
        if bytes + uploaded.mesh.bytes() > self.room {
            return Err(Problem::MeshesFull { limit: self.room });
        }
        held.insert(id.to_owned(), Arc::new(uploaded));
        Ok(true)
    }

    fn held(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Uploaded>>> {
        self.by_id.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MeshBody {
    fn of(id: &str, Uploaded { format, mesh }: &Uploaded) -> Self {
        Self {
            id: id.to_owned(),
            format: format.name(),
            vertices: mesh.positions().len(),
            triangles: mesh.triangles().len(),
            bounds: mesh.bounds().map(|corner| corner.to_array()),
            bytes: mesh.bytes(),
        }
    }
}

/// `GET /v1/meshes`
pub async fn list(State(app): State<Arc<App>>) -> Json<MeshList> {
    let meshes = app.meshes.held().iter().map(|(id, uploaded)| MeshBody::of(id, uploaded)).collect();
    Json(MeshList { meshes })
}

/// `GET /v1/meshes/{id}`
pub async fn one(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<MeshBody>, Problem> {
    let Path(id) = id?;
    let uploaded = app.meshes.get(&id).ok_or_else(|| Problem::NoSuchMesh(id.clone()))?;
    Ok(Json(MeshBody::of(&id, &uploaded)))
}

/// `DELETE /v1/meshes/{id}`; frames in the making keep what they show.
pub async fn delete(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
) -> Result<StatusCode, Problem> {
    let Path(id) = id?;
    let deleted = app.meshes.held().remove(&id);
    deleted.map(|_| StatusCode::NO_CONTENT).ok_or(Problem::NoSuchMesh(id))
}

/// `POST /v1/meshes`
pub async fn create(State(app): State<Arc<App>>, request: Request) -> Result<Response, Problem> {
    let format = format(&request)?;
    // As with scenes: whoever sends much waits for a place before it is read.
    let retry_after = app.config.render.retry_after_seconds.get();
    let place = Arc::clone(&app.scenes).try_acquire_owned().map_err(|_| Problem::Busy { retry_after })?;
    let limit = app.config.meshes.max_upload_bytes.get();
    let reading = async { Bytes::from_request(with_body_limit(request, limit).await, &()).await };
    let bytes = tokio::time::timeout(app.config.http.body_timeout, reading).await.map_err(|_| Problem::BodyTimeout)?;
    let bytes = bytes.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Problem::BodyTooLarge { limit },
        _ => Problem::Malformed(rejection.body_text()),
    })?;
    let job = move |_: &_| {
        let id: String = Sha256::digest(&bytes)[..ID_BYTES].iter().map(|byte| format!("{byte:02x}")).collect();
        let format = format.unwrap_or_else(|| formats::sniff(&bytes));
        let mesh = formats::read(format, &bytes).map_err(|error| Problem::refused("", error.to_string()))?;
        drop(place);
        Ok::<_, Problem>((id, Uploaded { format, mesh: Arc::new(mesh) }))
    };
    let (id, uploaded) = app.pool.admit()?.run(job).await?.0?;
    let body = MeshBody::of(&id, &uploaded);
    let status = if app.meshes.keep(&id, uploaded)? { StatusCode::CREATED } else { StatusCode::OK };
    let location = HeaderValue::from_str(&format!("/v1/meshes/{id}")).expect("hexadecimal digits are visible ASCII");
    Ok((status, [(header::LOCATION, location)], Json(body)).into_response())
}

/// What the body is said to be; `None`: one of the formats.
fn format(request: &Request) -> Result<Option<MeshFormat>, Problem> {
    let got = request
        .headers()
        .get(header::CONTENT_TYPE)
        .map_or("none", |value| value.to_str().unwrap_or("an unreadable one"));
    let told = mediatype::MediaType::parse(got).ok().map(|media| media.essence().to_string().to_ascii_lowercase());
    let found = MeshFormat::ALL.into_iter().find(|format| told.as_deref() == Some(format.media_type()));
    if found.is_some() || told.as_deref() == Some(OCTETS) {
        return Ok(found);
    }
    Err(Problem::UnsupportedMediaType { expected: MEDIA_TYPES, got: got.to_owned() })
}
