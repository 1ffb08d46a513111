//! Checks of input values of inverse problems.

use super::InverseError;

/// Refuses NaN and infinities, naming the index.
pub(crate) fn check_finite(what: &'static str, values: &[f64]) -> Result<(), InverseError> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(InverseError::Value { what, index: Some(index), value: values[index], expected: "finite" }),
        None => Ok(()),
    }
}

/// Checks that an operator exists for this lambda.
///
/// # Errors
/// Fails if lambda is not positive and finite.
pub fn check_hyperparameter(lambda: f64) -> Result<(), InverseError> {
    positive("hyperparameter", lambda).map(|_| ())
}

/// The value, if it is positive and finite.
pub(super) fn positive(what: &'static str, value: f64) -> Result<f64, InverseError> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(InverseError::Value { what, index: None, value, expected: "positive and finite" })
    }
}
