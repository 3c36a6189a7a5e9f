//! What operators, their machines and people with a browser ask for.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::metrics::{self, Gauges};
use super::store::Status;
use super::{App, store};

/// The contract, served as it is.
pub const OPENAPI: &str = include_str!("../../openapi.yaml");

const INDEX: &str = include_str!("../../web/index.html");

/// Where [`INDEX`] has its list of volumes.
const VOLUMES_MARK: &str = "<!-- volumes -->";

/// The page runs nothing and loads nothing but frames of this service.
const PAGE_POLICY: &str =
    "default-src 'none'; img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'";

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
    let text = metrics::render(Gauges { waiting, running, cache, volumes: app.store.counts() });
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
}

/// `GET /openapi.yaml`
pub async fn openapi() -> Response {
    ([(header::CONTENT_TYPE, "application/yaml")], OPENAPI).into_response()
}

/// `GET /`: one frame of each volume, until there is a viewer.
pub async fn index(State(app): State<Arc<App>>) -> Response {
    let volumes: String = app.store.entries().map(|entry| figure(entry)).collect();
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (header::CONTENT_SECURITY_POLICY, PAGE_POLICY),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    (headers, INDEX.replace(VOLUMES_MARK, &volumes)).into_response()
}

fn figure(entry: &store::Entry) -> String {
    let name = escaped(&entry.name);
    match entry.status() {
        Status::Loading => format!("<p>{name}: still being loaded; reload this page in a moment.</p>\n"),
        Status::Failed(reason) => format!("<p>{name}: could not be loaded: {}</p>\n", escaped(&reason)),
        Status::Ready(volume) => {
            let frame = format!("v1/volumes/{}/frame.png", percent_encoded(&entry.id));
            let [x, y, z] = volume.volume().dims();
            format!(
                "<figure><a href=\"{frame}?azimuth=30&amp;elevation=10&amp;width=1024&amp;height=1024\">\
                 <img src=\"{frame}?azimuth=30&amp;elevation=10&amp;width=384&amp;height=384\" width=\"384\" height=\"384\" \
                 alt=\"Rendering of {name}\"></a><figcaption>{name}, {x} &times; {y} &times; {z} voxels</figcaption></figure>\n"
            )
        }
    }
}

/// Names come from files: they may hold anything.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// An id as one segment of a URL's path.
fn percent_encoded(id: &str) -> String {
    let safe = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
    id.bytes().map(|byte| if safe(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_leave_their_place_in_the_page() {
        assert_eq!(escaped("<a href=\"x\">&"), "&lt;a href=&quot;x&quot;&gt;&amp;");
        assert_eq!(percent_encoded("a b/..\"ö"), "a%20b%2F..%22%C3%B6");
    }

    #[test]
    fn the_page_has_a_place_for_the_volumes_and_no_script() {
        assert!(INDEX.contains(VOLUMES_MARK) && !INDEX.contains("<script"));
    }
}
