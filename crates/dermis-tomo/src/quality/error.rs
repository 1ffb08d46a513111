//! Errors of figures of merit, and checks shared by all of them.

use thiserror::Error;

/// Reasons why a figure of merit is undefined.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum QualityError {
    /// An image has a different number of pixels than the grid or the other image.
    #[error("{what}: expected {expected} pixels, got {got}")]
    Length {
        /// Name of the image.
        what: &'static str,
        /// Number of pixels expected.
        expected: usize,
        /// Number of pixels given.
        got: usize,
    },
    /// No data to compute from.
    #[error("{what}: {reason}")]
    Undefined {
        /// Name of the figure.
        what: &'static str,
        /// The missing data.
        reason: &'static str,
    },
    /// A parameter outside its range.
    #[error("{field} = {value}: expected {expected}")]
    Value {
        /// Name of the parameter, with its unit.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        expected: &'static str,
    },
}

pub(super) fn check_length(what: &'static str, expected: usize, got: usize) -> Result<(), QualityError> {
    if expected == got { Ok(()) } else { Err(QualityError::Length { what, expected, got }) }
}

pub(super) fn check_positive(field: &'static str, value: f64) -> Result<(), QualityError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(QualityError::Value { field, value, expected: "positive and finite" })
}
