//! The whole URL space on one page.

use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware;
use axum::routing::{MethodRouter, get, post};
use tower_http::catch_panic::CatchPanicLayer;

use super::error::{Problem, panicked};
use super::{App, frames, meshes, observe, operations, presets, stream, turntable, viewer, volumes};
use crate::encode::Format;

/// Every path with its methods; `GET` includes `HEAD`. openapi.yaml states the same.
pub(super) fn routes() -> Vec<(&'static str, MethodRouter<Arc<App>>)> {
    let service = [
        ("/v1/volumes", get(volumes::list)),
        ("/v1/volumes/{id}", get(volumes::one)),
        ("/v1/volumes/{id}/histogram", get(volumes::histogram)),
        ("/v1/volumes/{id}/transfer-function", get(volumes::transfer_function)),
        ("/v1/volumes/{id}/frame", post(frames::from_body)),
        ("/v1/volumes/{id}/frame.png", get(|a, b, c, d| frames::from_query(Format::Png, a, b, c, d))),
        ("/v1/volumes/{id}/frame.jpg", get(|a, b, c, d| frames::from_query(Format::Jpeg, a, b, c, d))),
        ("/v1/volumes/{id}/frame.jpeg", get(|a, b, c, d| frames::from_query(Format::Jpeg, a, b, c, d))),
        ("/v1/volumes/{id}/frame.webp", get(|a, b, c, d| frames::from_query(Format::Webp, a, b, c, d))),
        ("/v1/volumes/{id}/frame.raw", get(|a, b, c, d| frames::from_query(Format::Raw, a, b, c, d))),
        ("/v1/volumes/{id}/turntable", post(turntable::from_body)),
        ("/v1/volumes/{id}/stream", get(stream::open)),
        ("/v1/meshes", get(meshes::list).post(meshes::create)),
        ("/v1/meshes/{id}", get(meshes::one).delete(meshes::delete)),
        ("/v1/presets", get(presets::list)),
        ("/v1/presets/{name}", get(presets::one)),
        ("/healthz", get(operations::healthz)),
        ("/readyz", get(operations::readyz)),
        ("/metrics", get(operations::metrics)),
        ("/openapi.yaml", get(operations::openapi)),
    ];
    viewer::routes().into_iter().chain(service).collect()
}

/// The paths of all routes, as openapi.yaml writes them.
pub fn paths() -> impl Iterator<Item = &'static str> {
    routes().into_iter().map(|(path, _)| path)
}

/// All routes.
pub(super) fn router(app: Arc<App>) -> Router {
    let limit = app.config.http.max_body_bytes.get();
    let routes = routes().into_iter().fold(Router::new(), |router, (path, methods)| router.route(path, methods));
    around(routes, limit).with_state(app)
}

/// What is around every route: its failures, the router's own and panics included, are
/// problem+json, and every answer is logged and counted.
fn around<S: Clone + Send + Sync + 'static>(routes: Router<S>, body_limit: usize) -> Router<S> {
    routes
        .fallback(async || Problem::NoSuchRoute)
        .method_not_allowed_fallback(async || Problem::MethodNotAllowed)
        .layer(DefaultBodyLimit::max(body_limit))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn(observe::observe))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::error::ProblemBody;

    async fn defective() -> &'static str {
        panic!("a defect in a handler")
    }

    #[tokio::test]
    async fn a_panic_in_a_handler_is_500_and_the_service_lives_on() {
        let routes = Router::new().route("/defect", get(defective)).route("/sound", get(async || "sound"));
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let base = format!("http://{}", listener.local_addr().unwrap());
        tokio::spawn(async { axum::serve(listener, around(routes, 1000)).await });
        let response = reqwest::get(format!("{base}/defect")).await.unwrap();
        assert_eq!(response.status(), 500);
        assert_eq!(response.headers()["content-type"], "application/problem+json");
        let problem: ProblemBody = response.json().await.unwrap();
        assert_eq!((problem.status, problem.r#type.as_str()), (500, "urn:shearwarp:problem:internal"));
        let response = reqwest::get(format!("{base}/sound")).await.unwrap();
        assert_eq!(response.text().await.unwrap(), "sound");
    }
}
