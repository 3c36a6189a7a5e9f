//! Fields of text headers (NRRD, MetaImage), by lower-case name, with the numbers in them.

use std::collections::HashMap;
use std::str::FromStr;

use super::decode::DecodeError;

/// The fields of one header.
pub(super) struct TextFields {
    format: &'static str,
    fields: HashMap<String, String>,
}

impl TextFields {
    pub(super) fn new(format: &'static str) -> Self {
        Self { format, fields: HashMap::new() }
    }

    /// Keeps a field; a later one of the same name wins.
    pub(super) fn set(&mut self, name: String, value: &str) {
        self.fields.insert(name, value.trim().to_owned());
    }

    /// The first of `names` that the header has: synonyms, preferred first.
    pub(super) fn get(&self, names: &[&str]) -> Option<&str> {
        names.iter().find_map(|&name| self.fields.get(name)).map(String::as_str)
    }

    /// As [`Self::get`], where the header must have it.
    pub(super) fn required(&self, names: &[&str]) -> Result<&str, DecodeError> {
        self.get(names).ok_or_else(|| self.malformed(&format!("expected a field {:?}, got none", names[0])))
    }

    /// Numbers between white space, `None` where the field is absent; `count` where it must fit.
    pub(super) fn numbers<T: FromStr>(&self, names: &[&str], count: usize) -> Result<Option<Vec<T>>, DecodeError> {
        let Some(text) = self.get(names) else { return Ok(None) };
        let numbers: Option<Vec<T>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
        match numbers.filter(|numbers| numbers.len() == count) {
            Some(numbers) => Ok(Some(numbers)),
            None => Err(self.malformed(&format!("{}: expected {count} numbers, got {text:?}", names[0]))),
        }
    }

    /// One number, `None` where the field is absent.
    pub(super) fn number<T: FromStr + Copy>(&self, names: &[&str]) -> Result<Option<T>, DecodeError> {
        Ok(self.numbers(names, 1)?.map(|numbers| numbers[0]))
    }

    /// An error about this header.
    pub(super) fn malformed(&self, message: &str) -> DecodeError {
        DecodeError::Malformed(format!("{}: {message}", self.format))
    }

    /// An error about what this header asks for.
    pub(super) fn unsupported(&self, message: &str) -> DecodeError {
        DecodeError::Unsupported(format!("{}: {message}", self.format))
    }
}
