//! The viewer's files, built into the program: one binary is the whole service, and page and routes are
//! always of one version.
//!
//! What stands in `web/` is what is served, at the path that it has there: no bundler, nothing
//! generated. Each file's `ETag` is a hash of its bytes, so that a reload costs a 304 for each file,
//! and a new version shows at once.

use std::sync::{Arc, LazyLock};

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get};
use xxhash_rust::xxh3::xxh3_128;

use super::error::Problem;
use super::{App, negotiate};

/// The page runs its own modules, asks this service, and shows pictures that it got from it.
const POLICY: &str = "default-src 'self'; img-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'self'";

/// A file as it is served.
struct File {
    /// Below `web/`.
    path: &'static str,
    bytes: &'static [u8],
    etag: String,
}

/// Names the files once and embeds them.
macro_rules! files {
    ($($path:literal),* $(,)?) => {
        [$(($path, include_bytes!(concat!("../../web/", $path)).as_slice())),*]
    };
}

static FILES: LazyLock<Vec<File>> = LazyLock::new(|| {
    let files = files![
        "index.html",
        "style.css",
        "icon.svg",
        "icons.svg",
        "js/api.js",
        "js/camera.js",
        "js/controls.js",
        "js/cube.js",
        "js/cut-panel.js",
        "js/dom.js",
        "js/frames.js",
        "js/handles.js",
        "js/input.js",
        "js/lamps.js",
        "js/light-panel.js",
        "js/link.js",
        "js/look-panel.js",
        "js/look.js",
        "js/looks.js",
        "js/main.js",
        "js/messages.js",
        "js/page.js",
        "js/presets.js",
        "js/request.js",
        "js/scan-panel.js",
        "js/share.js",
        "js/state.js",
        "js/stream.js",
        "js/thumbnails.js",
        "js/timings.js",
        "js/transfer-editor.js",
        "js/transfer-plot.js",
        "js/transfer.js",
        "js/turntable.js",
        "js/vector.js",
        "js/view-panel.js",
        "js/view.js",
        "js/warp.js",
    ];
    let file = |(path, bytes)| File { path, bytes, etag: format!("\"{:032x}\"", xxh3_128(bytes)) };
    files.into_iter().map(file).collect()
});

/// What the page's head says of its modules: all of them, so that a slow line fetches them at once and not one import after another.
static PRELOAD: LazyLock<HeaderValue> = LazyLock::new(|| {
    let modules = FILES.iter().map(|file| file.path).filter(|path| path.ends_with(".js"));
    let links: Vec<_> = modules.map(|path| format!("<{path}>; rel=modulepreload")).collect();
    HeaderValue::from_str(&links.join(", ")).expect("our own paths are visible ASCII")
});

/// The viewer's paths; `GET` includes `HEAD`.
pub fn routes() -> [(&'static str, MethodRouter<Arc<App>>); 5] {
    let fixed = |path: &'static str| get(async move |headers: HeaderMap| answer(path, &headers));
    [
        ("/", fixed("index.html")),
        ("/style.css", fixed("style.css")),
        ("/icon.svg", fixed("icon.svg")),
        ("/icons.svg", fixed("icons.svg")),
        ("/js/{file}", get(module)),
    ]
}

async fn module(name: Result<Path<String>, PathRejection>, headers: HeaderMap) -> Result<Response, Problem> {
    let Path(name) = name?;
    answer(&format!("js/{name}"), &headers)
}

fn answer(path: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let file = FILES.iter().find(|file| file.path == path).ok_or(Problem::NoSuchRoute)?;
    let etag = HeaderValue::from_str(&file.etag).expect("a hash in quotes is visible ASCII");
    let validators = [(header::ETAG, etag), (header::CACHE_CONTROL, HeaderValue::from_static("no-cache"))];
    if negotiate::is_known(headers, &file.etag) {
        return Ok((StatusCode::NOT_MODIFIED, validators).into_response());
    }
    let described = [
        (header::CONTENT_TYPE, media_type(path)),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    let preload = (path == "index.html").then(|| [(header::LINK, PRELOAD.clone())]);
    Ok((validators, described, preload, file.bytes).into_response())
}

fn media_type(path: &str) -> &'static str {
    match path.rsplit_once('.') {
        Some((_, "html")) => "text/html; charset=utf-8",
        Some((_, "css")) => "text/css; charset=utf-8",
        Some((_, "svg")) => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn names(folder: &str) -> BTreeSet<String> {
        let web = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("web");
        let entries = std::fs::read_dir(web.join(folder)).unwrap().map(Result::unwrap);
        let files = entries.filter(|entry| entry.file_type().unwrap().is_file());
        files.map(|entry| format!("{folder}{}", entry.file_name().to_str().unwrap())).collect()
    }

    #[test]
    fn every_file_of_the_folder_is_embedded_and_all_are_small() {
        let embedded: BTreeSet<_> = FILES.iter().map(|file| file.path.to_owned()).collect();
        assert_eq!(embedded, names("").union(&names("js/")).cloned().collect());
        let bytes: usize = FILES.iter().map(|file| file.bytes.len()).sum();
        assert!(bytes < 200_000, "{bytes}");
    }

    #[test]
    fn nothing_in_the_files_names_another_host() {
        for file in FILES.iter() {
            let text = std::str::from_utf8(file.bytes).unwrap().replace("http://www.w3.org/", "");
            assert!(
                !text.contains("http://") && !text.contains("https://") && !text.contains("//cdn"),
                "{}",
                file.path
            );
        }
    }
}
