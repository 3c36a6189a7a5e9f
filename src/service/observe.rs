//! Around every request: its id, its line in the log, its metrics.

use std::hash::{BuildHasher, RandomState};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;

use super::metrics;

/// Names a request in the answer and in the log.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Longer ids of clients are not taken over: they would only fill the log.
const MAX_ID: usize = 128;

/// What a handler adds to its request's line in the log, as an extension of the answer.
#[derive(Clone, Debug)]
pub struct Rendered {
    pub volume: String,
    pub algorithm: &'static str,
}

/// The middleware.
pub async fn observe(request: Request, next: Next) -> Response {
    let start = Instant::now();
    let id = request.headers().get(REQUEST_ID).filter(|id| is_sane(id)).cloned().unwrap_or_else(new_id);
    let method = known(request.method());
    let route = request.extensions().get::<MatchedPath>().map_or("unmatched", |path| path.as_str()).to_owned();
    let mut unanswered = Unanswered { id: Some(id.clone()), route: route.clone(), start };

    let mut response = next.run(request).await;

    unanswered.id = None;
    let (status, duration) = (response.status(), start.elapsed());
    let rendered = response.extensions().get::<Rendered>();
    tracing::info!(
        id = id.to_str().unwrap_or_default(),
        method,
        route,
        status = status.as_u16(),
        ms = duration.as_secs_f64() * 1000.0,
        volume = rendered.map(|r| r.volume.as_str()),
        algorithm = rendered.map(|r| r.algorithm),
        "request"
    );
    if status == StatusCode::GATEWAY_TIMEOUT {
        metrics::past_deadline();
    }
    metrics::answered(route, method, status.as_u16(), duration);
    let headers = response.headers_mut();
    headers.insert(REQUEST_ID, id);
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    response
}

/// Logs a request whose client left before its answer: the middleware is then dropped half-way.
struct Unanswered {
    /// Taken once there is an answer.
    id: Option<HeaderValue>,
    route: String,
    start: Instant,
}

impl Drop for Unanswered {
    fn drop(&mut self) {
        if let Some(id) = &self.id {
            let ms = self.start.elapsed().as_secs_f64() * 1000.0;
            tracing::info!(id = id.to_str().unwrap_or_default(), route = self.route, ms, "client left");
        }
    }
}

/// Visible ASCII of some length, so that it cannot forge lines of a log.
fn is_sane(id: &HeaderValue) -> bool {
    (1..=MAX_ID).contains(&id.len()) && id.as_bytes().iter().all(u8::is_ascii_graphic)
}

/// 64 random bits; no secret, only unlike the others.
fn new_id() -> HeaderValue {
    static SEED: LazyLock<RandomState> = LazyLock::new(RandomState::new);
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let id = SEED.hash_one(COUNT.fetch_add(1, Ordering::Relaxed));
    HeaderValue::from_str(&format!("{id:016x}")).expect("hexadecimal digits are valid in a header")
}

/// Clients may invent methods, but each would be a time series of its own.
fn known(method: &Method) -> &'static str {
    const KNOWN: [&str; 9] = ["GET", "HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT"];
    KNOWN.into_iter().find(|name| *name == method.as_str()).unwrap_or("other")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_that_could_forge_a_log_line_are_not_taken_over() {
        for (id, sane) in [("a-1/B", true), ("with space", false), ("", false), ("t\ta", false)] {
            assert_eq!(is_sane(&HeaderValue::from_str(id).unwrap()), sane, "{id:?}");
        }
        assert!(!is_sane(&HeaderValue::from_str(&"x".repeat(MAX_ID + 1)).unwrap()));
        assert_ne!(new_id(), new_id());
    }
}
