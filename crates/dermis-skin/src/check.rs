//! Ranges of the numbers of a skin file: every refusal names the file, the key, the value and what was expected.

use crate::error::Error;

/// Longest length that a skin file may hold, millimetres: ten metres.
pub(crate) const MOST_MM: f64 = 1e4;
/// Shortest one: a micrometre.
pub(crate) const LEAST_MM: f64 = 1e-3;

/// The file that is checked, to name it in errors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Checker<'a> {
    pub file: &'a str,
}

impl Checker<'_> {
    /// An error about one key.
    pub fn refused(&self, field: &str, value: impl ToString, expected: impl Into<String>) -> Error {
        Error::SkinField {
            file: self.file.to_string(),
            field: field.to_string(),
            value: value.to_string(),
            expected: expected.into(),
        }
    }

    /// A number within a range, ends included.
    pub fn within(&self, field: &str, value: f64, low: f64, high: f64) -> Result<(), Error> {
        if value >= low && value <= high {
            return Ok(());
        }
        Err(self.refused(field, value, format!("{} to {}", number(low), number(high))))
    }

    /// A length in millimetres.
    pub fn length_mm(&self, field: &str, value: f64) -> Result<(), Error> {
        self.within(field, value, LEAST_MM, MOST_MM)
    }

    /// A coordinate in millimetres.
    pub fn place_mm(&self, field: &str, value: &[f64]) -> Result<(), Error> {
        value.iter().try_for_each(|&v| self.within(field, v, -MOST_MM, MOST_MM))
    }

    /// A whole number within a range, ends included.
    pub fn count(&self, field: &str, value: usize, low: usize, high: usize) -> Result<(), Error> {
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(self.refused(field, value, format!("{low} to {high}")))
    }
}

fn number(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) { format!("{value:e}") } else { value.to_string() }
}
