//! What operators and their machines ask for.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::App;
use super::metrics::{self, Gauges};

/// The contract, served as it is.
pub const OPENAPI: &str = include_str!("../../openapi.yaml");

#[derive(Serialize)]
pub struct Health {
    status: &'static str,
}

#[derive(Serialize)]
pub struct Readiness {
    ready: bool,
    volumes: VolumeCounts,
}

#[derive(Serialize)]
struct VolumeCounts {
    ready: usize,
    loading: usize,
    failed: usize,
}

/// `GET /healthz`: the process answers.
pub async fn healthz() -> Json<Health> {
    Json(Health { status: "ok" })
}

/// `GET /readyz`: every volume is loaded or known to be unreadable, and not all are unreadable.
pub async fn readyz(State(app): State<Arc<App>>) -> Response {
    let (ready, loading, failed) = app.store.counts();
    let is_ready = loading == 0 && (ready > 0 || failed == 0);
    let body = Json(Readiness { ready: is_ready, volumes: VolumeCounts { ready, loading, failed } });
    if is_ready {
        return body.into_response();
    }
    let retry_after = app.config.render.retry_after_seconds.get();
    (StatusCode::SERVICE_UNAVAILABLE, [(header::RETRY_AFTER, HeaderValue::from(retry_after))], body).into_response()
}

/// `GET /metrics`
pub async fn metrics(State(app): State<Arc<App>>) -> Response {
    let cache = app.store.classified.size().await;
    let (waiting, running) = (app.pool.waiting(), app.pool.running());
    let (streams, volumes) = (app.streams.open(), app.store.counts());
    let text = metrics::render(Gauges { waiting, running, streams, cache, meshes: app.meshes.size(), volumes });
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
}

/// `GET /openapi.yaml`
pub async fn openapi() -> Response {
    ([(header::CONTENT_TYPE, "application/yaml")], OPENAPI).into_response()
}
