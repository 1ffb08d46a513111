//! A value inside a JSON document that knows its path, so that every error can name the place, the value found and
//! the value expected.

use std::fmt;
use std::path::Path;

use serde_json::Value;

use crate::Error;

/// A value and the path to it.
#[derive(Clone, Copy)]
pub(super) struct Field<'a> {
    file: &'a Path,
    parent: Option<&'a Field<'a>>,
    step: Step<'a>,
    value: &'a Value,
}

#[derive(Clone, Copy)]
enum Step<'a> {
    Root,
    Key(&'a str),
    Index(usize),
}

impl<'a> Field<'a> {
    /// The whole document.
    pub(super) fn root(file: &'a Path, value: &'a Value) -> Self {
        Self { file, parent: None, step: Step::Root, value }
    }

    /// The value of a key, if present and not null.
    pub(super) fn get(&'a self, key: &'a str) -> Option<Self> {
        let value = self.value.get(key).filter(|value| !value.is_null())?;
        Some(Self { file: self.file, parent: Some(self), step: Step::Key(key), value })
    }

    /// The value of a required key.
    pub(super) fn need(&'a self, key: &'a str, expected: &str) -> Result<Self, Error> {
        self.get(key).ok_or_else(|| {
            let missing = Self { file: self.file, parent: Some(self), step: Step::Key(key), value: &Value::Null };
            missing.error(format!("is missing; expected {expected}"))
        })
    }

    /// The entries of a list.
    pub(super) fn list(&'a self, expected: &str) -> Result<impl ExactSizeIterator<Item = Field<'a>> + use<'a>, Error> {
        let entries = self.value.as_array().ok_or_else(|| self.refuse(expected))?;
        let entry = move |(index, value)| Self { file: self.file, parent: Some(self), step: Step::Index(index), value };
        Ok(entries.iter().enumerate().map(entry))
    }

    /// Length of a list.
    pub(super) fn len(&self, expected: &str) -> Result<usize, Error> {
        self.value.as_array().map(Vec::len).ok_or_else(|| self.refuse(expected))
    }

    /// A list of exactly `count` entries.
    pub(super) fn list_of(
        &'a self,
        count: usize,
        what: &str,
    ) -> Result<impl ExactSizeIterator<Item = Field<'a>> + use<'a>, Error> {
        let entries = self.list(&format!("a list of {count} {what}"))?;
        if entries.len() != count {
            return Err(self.error(format!("holds {} values; expected {count} {what}", entries.len())));
        }
        Ok(entries)
    }

    /// A finite number. JSON itself has no NaN, and its reader rejects numbers too large for a float.
    pub(super) fn number(&self) -> Result<f64, Error> {
        self.value.as_f64().filter(|value| value.is_finite()).ok_or_else(|| self.refuse("a finite number"))
    }

    /// A finite number above zero.
    pub(super) fn positive(&self, what: &str) -> Result<f64, Error> {
        let value = self.number()?;
        if value > 0.0 { Ok(value) } else { Err(self.refuse(&format!("a positive {what}"))) }
    }

    /// A zero-based index below `count`. A whole number written as `3.0` is accepted.
    pub(super) fn index(&self, count: usize, what: &str) -> Result<u32, Error> {
        let whole = self.value.as_u64().or_else(|| {
            let value = self.value.as_f64()?;
            (value >= 0.0 && value.fract() == 0.0).then_some(value as u64)
        });
        match whole {
            Some(index) if index < count as u64 && index <= u64::from(u32::MAX) => Ok(index as u32),
            _ => Err(self.refuse(&format!("a zero-based index of one of {count} {what}"))),
        }
    }

    /// Text.
    pub(super) fn text(&self, expected: &str) -> Result<&'a str, Error> {
        self.value.as_str().ok_or_else(|| self.refuse(expected))
    }

    /// True for a list.
    pub(super) fn is_list(&self) -> bool {
        self.value.is_array()
    }

    /// An error that shows the value and what was expected.
    pub(super) fn refuse(&self, expected: &str) -> Error {
        self.error(format!("is {}; expected {expected}", shown(self.value)))
    }

    /// An error at this place.
    pub(super) fn error(&self, reason: impl Into<String>) -> Error {
        Error::Live(dermis_live::Error::Content {
            file: self.file.to_path_buf(),
            field: self.to_string(),
            reason: reason.into(),
        })
    }
}

impl fmt::Display for Field<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.parent, self.step) {
            (_, Step::Root) | (None, _) => write!(out, "document"),
            (Some(parent), Step::Key(key)) if matches!(parent.step, Step::Root) => write!(out, "{key}"),
            (Some(parent), Step::Key(key)) => write!(out, "{parent}.{key}"),
            (Some(parent), Step::Index(index)) => write!(out, "{parent}[{index}]"),
        }
    }
}

/// A value, shortened to fit into a message.
fn shown(value: &Value) -> String {
    const MOST: usize = 40;
    match value {
        Value::Array(entries) => format!("a list of {} values", entries.len()),
        Value::Object(_) => "an object".to_string(),
        other => {
            let text = other.to_string();
            match text.char_indices().nth(MOST) {
                Some((end, _)) => format!("{}...", &text[..end]),
                None => text,
            }
        }
    }
}
