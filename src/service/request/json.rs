//! Bytes -> JSON that means one thing only.
//!
//! Serde's derive is lenient where a contract must not be: it takes an array for a struct, `null`
//! for an absent field, and serde_json's `Value` keeps the last of two equal keys. A request that
//! is read differently from how it was meant gives a wrong picture without a word, so both are
//! closed here: [`parse`] refuses repeated keys and numbers beyond what a float holds, and [`read`]
//! takes objects for structs and nothing for `null`. Both name the field at fault.

use std::fmt;

use serde::de::value::{MapDeserializer, SeqDeserializer};
use serde::de::{
    self, DeserializeOwned, DeserializeSeed, Deserializer, IntoDeserializer, MapAccess, SeqAccess, Visitor,
};
use serde_json::{Map, Number, Value};
use serde_path_to_error::{Path, Segment, Track};

use super::{InvalidField, RequestError};

/// Longer details are cut: a client gets told what was wrong, not its own megabyte back.
const MAX_DETAIL: usize = 300;

/// What serde expects, by Rust's names of it, and what a client would call that.
const EXPECTED: [(&str, &str); 9] = [
    ("f64", "a number"),
    ("f32", "a number"),
    ("u8", "a whole number from 0 to 255"),
    ("u16", "a whole number from 0 to 65535"),
    ("u32", "a whole number from 0 on"),
    ("u64", "a whole number from 0 on"),
    ("usize", "a whole number from 0 on"),
    ("a nonzero u32", "a whole number from 1 on"),
    ("a nonzero usize", "a whole number from 1 on"),
];

/// The JSON in `bytes`; the sign of negative zeros is dropped.
///
/// # Errors
/// [`RequestError::Malformed`] for what is not JSON, [`RequestError::Refused`] for repeated keys and
/// numbers that are not finite as a 64-bit float.
pub fn parse(bytes: &[u8]) -> Result<Value, RequestError> {
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let mut track = Track::new();
    let value = match Unambiguous.deserialize(serde_path_to_error::Deserializer::new(&mut json, &mut track)) {
        Ok(value) => value,
        Err(error) => {
            // A number such as 1e999 is JSON, but serde_json counts it among the syntax errors.
            let too_large = error.to_string().starts_with("number out of range");
            return Err(if too_large || error.is_data() {
                RequestError::Refused(vec![refusal(&track.path(), &error)])
            } else {
                malformed(&error)
            });
        }
    };
    json.end().map_err(|error| malformed(&error))?;
    Ok(value)
}

/// `value` as a `T`: unknown fields are refused where `T` says so, `null` and arrays in place of
/// objects always.
///
/// # Errors
/// The first field that does not fit.
pub fn read<T: DeserializeOwned>(value: Value) -> Result<T, InvalidField> {
    serde_path_to_error::deserialize(Strict(value)).map_err(|error| refusal(error.path(), error.inner()))
}

/// A JSON number; `None` unless finite. Whole numbers become integers, as JSON does not tell 512.0
/// from 512, nor -0 from 0.
pub fn number(value: f64) -> Option<Value> {
    /// Floats count every integer up to here.
    const EXACT: f64 = (1_u64 << 53) as f64;
    let whole = value.fract() == 0.0 && value.abs() <= EXACT;
    if whole { Some((value as i64).into()) } else { Number::from_f64(value).map(Value::Number) }
}

fn malformed(error: &serde_json::Error) -> RequestError {
    RequestError::Malformed { detail: format!("expected JSON: {error}") }
}

fn refusal(path: &Path, error: &serde_json::Error) -> InvalidField {
    let mut detail = error.to_string();
    if let Some((got, expected)) = detail.rsplit_once(", expected ")
        && let Some((_, expected)) = EXPECTED.iter().find(|(name, _)| *name == expected)
    {
        detail = format!("{got}, expected {expected}");
    }
    if let Some((at, _)) = detail.char_indices().nth(MAX_DETAIL) {
        detail.truncate(at);
        detail.push('…');
    }
    InvalidField { pointer: pointer(path), detail }
}

/// A path as a JSON pointer (RFC 6901).
fn pointer(path: &Path) -> String {
    let mut pointer = String::new();
    for segment in path {
        match segment {
            Segment::Seq { index } => pointer.push_str(&format!("/{index}")),
            Segment::Map { key } => {
                pointer.push('/');
                pointer.push_str(&escape(key));
            }
            // An enum's variant is the value itself; unknown ends the path.
            Segment::Enum { .. } | Segment::Unknown => {}
        }
    }
    pointer
}

/// A key as part of a JSON pointer.
pub fn escape(key: &str) -> String {
    key.replace('~', "~0").replace('/', "~1")
}

/// Reads a [`Value`] and refuses repeated keys.
struct Unambiguous;

impl<'de> DeserializeSeed<'de> for Unambiguous {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Unambiguous {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Value, E> {
        number(value).ok_or_else(|| E::custom("expected a finite number"))
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_string<E>(self, value: String) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = items.next_element_seed(Self)? {
            values.push(value);
        }
        Ok(values.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut map = Map::new();
        while let Some(key) = entries.next_key::<String>()? {
            if map.contains_key(&key) {
                entries.next_value_seed(Repeated)?;
            }
            map.insert(key, entries.next_value_seed(Self)?);
        }
        Ok(map.into())
    }
}

/// Refuses the value of a key that was there before, from inside the value, where the path is right.
struct Repeated;

impl<'de> DeserializeSeed<'de> for Repeated {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, _: D) -> Result<(), D::Error> {
        Err(de::Error::custom("expected each key once, got it again"))
    }
}

/// A [`Value`] that is neither lenient about `null` nor about arrays in place of objects.
struct Strict(Value);

impl<'de> IntoDeserializer<'de, serde_json::Error> for Strict {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Strict {
    type Error = serde_json::Error;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        match self.0 {
            Value::Array(items) => {
                let mut items = SeqDeserializer::new(items.into_iter().map(Strict));
                let value = visitor.visit_seq(&mut items)?;
                items.end()?;
                Ok(value)
            }
            Value::Object(entries) => {
                let entries = entries.into_iter().map(|(key, value)| (key, Strict(value)));
                visitor.visit_map(MapDeserializer::new(entries))
            }
            scalar => scalar.deserialize_any(visitor),
        }
    }

    /// What is there is not `None`, `null` included.
    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        visitor.visit_some(self)
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        if self.0.is_object() {
            return self.deserialize_any(visitor);
        }
        let unexpected = match &self.0 {
            Value::Null => de::Unexpected::Other("null"),
            Value::Bool(flag) => de::Unexpected::Bool(*flag),
            Value::Number(_) => de::Unexpected::Other("a number"),
            Value::String(text) => de::Unexpected::Str(text),
            Value::Array(_) | Value::Object(_) => de::Unexpected::Seq,
        };
        Err(de::Error::invalid_type(unexpected, &"an object"))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        match self.0 {
            Value::Object(_) => Err(de::Error::invalid_type(de::Unexpected::Map, &"a name")),
            other => other.deserialize_enum(name, variants, visitor),
        }
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct
        newtype_struct seq tuple tuple_struct map identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(bytes: &[u8]) -> InvalidField {
        match parse(bytes) {
            Err(RequestError::Refused(fields)) => fields.into_iter().next().unwrap(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn what_is_not_json_is_malformed() {
        for text in ["", "{", "NaN", r#"{"a": Infinity}"#, "{} {}", "{'a': 1}", "\u{feff}{}"] {
            assert!(matches!(parse(text.as_bytes()), Err(RequestError::Malformed { .. })), "{text}");
        }
        assert!(matches!(parse(b"\"\xff\""), Err(RequestError::Malformed { .. })));
        let deep = "[".repeat(100_000);
        assert!(matches!(parse(deep.as_bytes()), Err(RequestError::Malformed { .. })));
    }

    #[test]
    fn repeated_keys_are_refused_where_they_stand() {
        let field = refused(br#"{"a": [{"b/c": 1, "b/c": 2}]}"#);
        assert_eq!(field.pointer, "/a/0/b~1c");
        assert!(field.detail.contains("once"), "{field:?}");
    }

    #[test]
    fn numbers_beyond_a_float_are_refused_where_they_stand() {
        assert_eq!(refused(br#"{"a": [1, -1e999]}"#).pointer, "/a/1");
    }

    #[test]
    fn numbers_are_equal_however_they_are_written() {
        for text in ["-0.0", "-0", "0e5", "0"] {
            assert_eq!(parse(text.as_bytes()).unwrap(), Value::from(0), "{text}");
        }
        assert_eq!(parse(b"5.12e2").unwrap(), Value::from(512));
        assert_eq!(parse(b"1.5e300").unwrap(), Value::from(1.5e300));
    }

    #[test]
    fn what_is_expected_is_told_in_terms_of_json() {
        let detail = |value: Value| read::<Vec<f64>>(value).unwrap_err().detail;
        assert_eq!(detail(serde_json::json!(["up"])), "invalid type: string \"up\", expected a number");
        let field = read::<std::num::NonZeroU32>(Value::from(0)).unwrap_err();
        assert_eq!(field.detail, "invalid value: integer `0`, expected a whole number from 1 on");
        let field = read::<u32>(Value::from(-1)).unwrap_err();
        assert_eq!(field.detail, "invalid value: integer `-1`, expected a whole number from 0 on");
    }

    #[test]
    fn long_details_are_cut() {
        let text = format!("\"{}\"", "é".repeat(100_000));
        let field = read::<bool>(parse(text.as_bytes()).unwrap()).unwrap_err();
        assert_eq!(field.detail.chars().count(), MAX_DETAIL + 1);
    }
}
