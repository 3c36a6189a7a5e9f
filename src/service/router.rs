//! The whole URL space on one page.

use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware;
use axum::routing::{MethodRouter, get, post};
use tower_http::catch_panic::CatchPanicLayer;

use super::error::{Problem, panicked};
use super::{App, frames, observe, operations, presets, volumes};
use crate::encode::Format;

/// Every path with its methods; `GET` includes `HEAD`. openapi.yaml states the same.
pub(super) fn routes() -> Vec<(&'static str, MethodRouter<Arc<App>>)> {
    vec![
        ("/", get(operations::index)),
        ("/v1/volumes", get(volumes::list)),
        ("/v1/volumes/{id}", get(volumes::one)),
        ("/v1/volumes/{id}/histogram", get(volumes::histogram)),
        ("/v1/volumes/{id}/frame", post(frames::from_body)),
        ("/v1/volumes/{id}/frame.png", get(|a, b, c, d| frames::from_query(Format::Png, a, b, c, d))),
        ("/v1/volumes/{id}/frame.jpg", get(|a, b, c, d| frames::from_query(Format::Jpeg, a, b, c, d))),
        ("/v1/volumes/{id}/frame.jpeg", get(|a, b, c, d| frames::from_query(Format::Jpeg, a, b, c, d))),
        ("/v1/volumes/{id}/frame.webp", get(|a, b, c, d| frames::from_query(Format::Webp, a, b, c, d))),
        ("/v1/volumes/{id}/frame.raw", get(|a, b, c, d| frames::from_query(Format::Raw, a, b, c, d))),
        ("/v1/presets", get(presets::list)),
        ("/v1/presets/{name}", get(presets::one)),
        ("/healthz", get(operations::healthz)),
        ("/readyz", get(operations::readyz)),
        ("/metrics", get(operations::metrics)),
        ("/openapi.yaml", get(operations::openapi)),
    ]
}

/// The paths of all routes, as openapi.yaml writes them.
pub fn paths() -> impl Iterator<Item = &'static str> {
    routes().into_iter().map(|(path, _)| path)
}

/// All routes; every failure, the router's own included, is a problem+json.
pub(super) fn router(app: Arc<App>) -> Router {
    let limit = app.config.http.max_body_bytes.get();
    routes()
        .into_iter()
        .fold(Router::new(), |router, (path, methods)| router.route(path, methods))
        .fallback(async || Problem::NoSuchRoute)
        .method_not_allowed_fallback(async || Problem::MethodNotAllowed)
        .layer(DefaultBodyLimit::max(limit))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn(observe::observe))
        .with_state(app)
}
