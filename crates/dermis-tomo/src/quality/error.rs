//! Why a figure of merit has no value, and what every figure checks.

use thiserror::Error;

/// Why a figure of merit has no value.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum QualityError {
    /// An image has another number of pixels than the grid or the image that it is compared with.
    #[error("{what}: expected {expected} pixels, got {got}")]
    Length {
        /// Which image.
        what: &'static str,
        /// Pixels expected.
        expected: usize,
        /// Pixels given.
        got: usize,
    },
    /// Nothing is left to compute from.
    #[error("{what}: {reason}")]
    Undefined {
        /// Which figure.
        what: &'static str,
        /// What is missing.
        reason: &'static str,
    },
    /// A parameter outside its range.
    #[error("{field} = {value}: expected {expected}")]
    Value {
        /// Which parameter, with its unit.
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
