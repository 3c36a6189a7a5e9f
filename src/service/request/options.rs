//! Short names for the fields that fit into one word: query strings and command lines.
//!
//! A short name stands for a place in the JSON request. It is put there before the request is read,
//! so that there is one set of checks and defaults for all spellings.

use serde_json::{Map, Value};

use super::{RequestError, json};

/// What an option's text means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Number,
    /// `true` or `false`.
    Flag,
    Text,
    /// `#rrggbb`, `rrggbb` or `transparent`.
    Color,
}

/// A short name for a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RequestOption {
    /// In query strings; command lines write `-` for `_`.
    pub name: &'static str,
    pub kind: Kind,
    /// For people.
    pub help: &'static str,
    /// The field, as a JSON pointer without the leading slash.
    field: &'static str,
}

const fn option(name: &'static str, kind: Kind, field: &'static str, help: &'static str) -> RequestOption {
    RequestOption { name, kind, help, field }
}

/// Every short name.
pub const OPTIONS: [RequestOption; 16] = [
    option(
        "azimuth",
        Kind::Number,
        "camera/azimuth",
        "Degrees around the vertical axis; 0 looks at the face, 90 stands at the patient's left",
    ),
    option("elevation", Kind::Number, "camera/elevation", "Degrees above the axial plane"),
    option("roll", Kind::Number, "camera/roll", "Degrees about the viewing axis"),
    option("zoom", Kind::Number, "camera/zoom", "Magnification"),
    option("fov_y", Kind::Number, "camera/fov_y", "Vertical field of view in degrees (perspective)"),
    option("projection", Kind::Text, "camera/projection", "parallel or perspective"),
    option("width", Kind::Number, "image/width", "Pixels"),
    option("height", Kind::Number, "image/height", "Pixels"),
    option("background", Kind::Color, "image/background", "#rrggbb, rrggbb or transparent"),
    option("preset", Kind::Text, "transfer_function", "Name of a transfer function"),
    option("shading", Kind::Flag, "shading", "true or false"),
    option("algorithm", Kind::Text, "algorithm", "auto, classified, fast-classification, preintegrated or raycast"),
    option("quality", Kind::Text, "quality", "draft, standard or high"),
    option("blend", Kind::Text, "blend", "composite, maximum, minimum or average"),
    option("window_center", Kind::Number, "window/center", "Value in the middle of black and white (projections)"),
    option("window_width", Kind::Number, "window/width", "Values from black to white (projections)"),
];

/// Sets the fields that a query string names.
pub fn set_from_query(document: &mut Value, query: &str) -> Result<(), RequestError> {
    let pairs: Vec<_> = form_urlencoded::parse(query.as_bytes()).collect();
    for (index, (name, _)) in pairs.iter().enumerate() {
        if pairs[..index].iter().any(|(before, _)| before == name) {
            return Err(refused(name, "expected each parameter once, got it again".into()));
        }
    }
    set_all(document, pairs.iter().map(|(name, text)| (name.as_ref(), text.as_ref())))
}

/// Sets the fields that `options`, pairs of a short name and its text, stand for.
pub fn set_all<'a>(
    document: &mut Value,
    options: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> Result<(), RequestError> {
    for (name, text) in options {
        let Some(option) = OPTIONS.iter().find(|option| option.name == name) else {
            let names = OPTIONS.map(|option| option.name).join(", ");
            return Err(refused(name, format!("unknown parameter, expected one of {names}")));
        };
        let value =
            option.kind.read(text).map_err(|expected| refused(name, format!("expected {expected}, not {text:?}")))?;
        set(document, option.field, value);
    }
    Ok(())
}

/// Turns the pointer of a field that has a short name into `/name`.
pub fn shorten(pointer: &mut String) {
    if let Some(option) = OPTIONS.iter().find(|option| pointer.strip_prefix('/') == Some(option.field)) {
        *pointer = format!("/{}", option.name);
    }
}

fn refused(name: &str, detail: String) -> RequestError {
    RequestError::refused(&format!("/{}", json::escape(name)), detail)
}

/// Puts `value` where `field` is. What stands in the way and is no object stays: the request's own
/// checks refuse it.
fn set(document: &mut Value, field: &str, value: Value) {
    let mut place = document;
    for key in field.split('/') {
        let Value::Object(entries) = place else { return };
        place = entries.entry(key).or_insert_with(|| Value::Object(Map::new()));
    }
    *place = value;
}

impl Kind {
    /// The value that `text` means, or what was expected.
    fn read(self, text: &str) -> Result<Value, &'static str> {
        match self {
            Self::Number => text.parse().ok().and_then(json::number).ok_or("a finite number"),
            Self::Flag => text.parse().map(Value::Bool).map_err(|_| "true or false"),
            Self::Text => Ok(text.into()),
            Self::Color if text.len() == 6 && text.bytes().all(|b| b.is_ascii_hexdigit()) => {
                Ok(format!("#{text}").into())
            }
            Self::Color => Ok(text.into()),
        }
    }
}
