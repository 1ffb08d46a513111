//! Errors of inverse operators, and checks of their input values.

use thiserror::Error;

/// Reasons why an inverse operator cannot be computed.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum InverseError {
    /// Two sizes that should match differ.
    #[error("{what}: expected {expected}, got {got}")]
    Size {
        /// The items counted.
        what: &'static str,
        /// Expected count.
        expected: usize,
        /// Found count.
        got: usize,
    },
    /// An invalid value.
    #[error("{what}{at}: {value} is not {expected}", at = index.map(|i| format!(" {i}")).unwrap_or_default())]
    Value {
        /// Name of the value.
        what: &'static str,
        /// Index in its list, if it is in one.
        index: Option<usize>,
        /// The value.
        value: f64,
        /// Expected values.
        expected: &'static str,
    },
    /// A matrix that should be positive definite is not.
    #[error("{what} is not positive definite; {hint}")]
    Singular {
        /// Name of the matrix.
        what: &'static str,
        /// Possible remedy.
        hint: &'static str,
    },
    /// The forward model failed at an iterate of a nonlinear inversion.
    #[error("forward model: {0}")]
    Forward(#[from] crate::eit::EitError),
    /// A fit with invalid parameters.
    #[error(transparent)]
    Fit(#[from] crate::least_squares::Error),
    /// Priors nested too deeply.
    #[error("prior: mixtures are nested deeper than {most}; expected at most that")]
    Nested {
        /// Maximum depth.
        most: usize,
    },
    /// Every channel is missing.
    #[error("all {channels} channels are missing")]
    NoChannels {
        /// Number of channels.
        channels: usize,
    },
    /// Too few frames to calibrate on.
    #[error("calibration needs at least {needed} frames with any change in them, got {useful} in {given} frames")]
    TooFewFrames {
        /// Minimum number of frames.
        needed: usize,
        /// Number of frames with a channel that is present and not zero.
        useful: usize,
        /// Total number of frames.
        given: usize,
    },
    /// The search for a hyperparameter failed.
    #[error("no hyperparameter gives a noise figure of {target}: the reachable range is {low:.3} to {high:.3}")]
    NoiseFigure {
        /// Target figure.
        target: f64,
        /// Minimum reachable.
        low: f64,
        /// Maximum reachable.
        high: f64,
    },
}

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
