//! What the request's head decides: the format of the answer, and whether one is needed at all.

use axum::http::{HeaderMap, HeaderName, header};
use headers_accept::Accept;
use mediatype::MediaType;

use crate::encode::Format;

/// The format that `Accept` prefers among `offered`.
pub fn format(headers: &HeaderMap, offered: &[Format]) -> Option<Format> {
    let types: Vec<_> = offered.iter().map(|format| format.media_type()).collect();
    choose(headers, &types).map(|at| offered[at])
}

/// Which of the `offered` media types `Accept` prefers; `None` where it accepts none of them. Without
/// the header, or with one that cannot be read, the first one offered.
pub fn choose(headers: &HeaderMap, offered: &[&str]) -> Option<usize> {
    let first = (!offered.is_empty()).then_some(0);
    let Some(accept) = joined(headers, header::ACCEPT).and_then(|text| text.parse::<Accept>().ok()) else {
        return first;
    };
    if accept.media_types().next().is_none() {
        return first;
    }
    let types: Vec<_> = offered.iter().map(|name| MediaType::parse(name).expect("our own are valid")).collect();
    let chosen = accept.negotiate(&types)?.to_string();
    offered.iter().position(|name| chosen == *name)
}

/// True where `If-None-Match` names `etag` (weak comparison, as RFC 9110 13.1.2 asks) or is `*`.
pub fn is_known(headers: &HeaderMap, etag: &str) -> bool {
    let Some(known) = joined(headers, header::IF_NONE_MATCH) else { return false };
    known.trim() == "*" || known.split(',').any(|one| one.trim().trim_start_matches("W/") == etag)
}

/// A list header as one line, however many lines it came in.
fn joined(headers: &HeaderMap, name: HeaderName) -> Option<String> {
    let lines: Vec<_> = headers.get_all(name).iter().map(|value| value.to_str().ok()).collect::<Option<_>>()?;
    (!lines.is_empty()).then(|| lines.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: HeaderName, values: &[&'static str]) -> HeaderMap {
        values.iter().map(|value| (name.clone(), value.parse().unwrap())).collect()
    }

    #[test]
    fn accept_chooses_by_quality_then_order_and_png_where_it_is_open() {
        for (accept, expected) in [
            (&["*/*"][..], Some(Format::Png)),
            (&["image/*"], Some(Format::Png)),
            (&["image/webp"], Some(Format::Webp)),
            (&["image/jpeg;q=0.5, image/webp;q=0.9"], Some(Format::Webp)),
            (&["text/html", "image/jpeg"], Some(Format::Jpeg)),
            (&["application/octet-stream"], Some(Format::Raw)),
            (&["*/*;q=0.1, image/png;q=0"], Some(Format::Jpeg)),
            (&["text/html"], None),
            (&["image/png;q=0"], None),
            (&["not a header at all"], Some(Format::Png)),
            (&[""], Some(Format::Png)),
            (&[], Some(Format::Png)),
        ] {
            assert_eq!(format(&headers(header::ACCEPT, accept), &Format::ALL), expected, "{accept:?}");
        }
    }

    #[test]
    fn if_none_match_is_a_list_compared_weakly() {
        for (known, expected) in [
            (&["\"a\""][..], true),
            (&["W/\"a\""], true),
            (&["\"b\", \"a\""], true),
            (&["\"b\"", "\"a\""], true),
            (&["*"], true),
            (&["\"b\""], false),
            (&["a"], false),
            (&[], false),
        ] {
            assert_eq!(is_known(&headers(header::IF_NONE_MATCH, known), "\"a\""), expected, "{known:?}");
        }
    }
}
