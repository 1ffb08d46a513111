//! Why an inverse operator cannot be made.

use thiserror::Error;

/// Why an inverse operator could not be made.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum InverseError {
    /// Two things that belong together have different sizes.
    #[error("{what}: expected {expected}, got {got}")]
    Size {
        /// What was counted.
        what: &'static str,
        /// Expected count.
        expected: usize,
        /// Found count.
        got: usize,
    },
    /// A value that makes no sense where it stands.
    #[error("{what}{at}: {value} is not {expected}", at = index.map(|i| format!(" {i}")).unwrap_or_default())]
    Value {
        /// What it is.
        what: &'static str,
        /// Where in its list, if it is in one.
        index: Option<usize>,
        /// The value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A matrix that should be positive definite is not.
    #[error("{what} is not positive definite; {hint}")]
    Singular {
        /// Which matrix.
        what: &'static str,
        /// What may help.
        hint: &'static str,
    },
    /// The forward model failed at an iterate of a nonlinear inversion.
    #[error("forward model: {0}")]
    Forward(#[from] crate::eit::EitError),
    /// A fit was asked for with parameters that make no sense.
    #[error(transparent)]
    Fit(#[from] crate::least_squares::Error),
    /// Priors within priors.
    #[error("prior: mixtures are nested deeper than {most}; expected at most that")]
    Nested {
        /// Deepest that is taken.
        most: usize,
    },
    /// Every channel is missing.
    #[error("all {channels} channels are missing")]
    NoChannels {
        /// How many there are.
        channels: usize,
    },
    /// Too few frames to calibrate on.
    #[error("calibration needs at least {needed} frames with any change in them, got {useful} in {given} frames")]
    TooFewFrames {
        /// Fewest that do.
        needed: usize,
        /// Frames with a channel that is present and not zero.
        useful: usize,
        /// All frames given.
        given: usize,
    },
    /// A search for a hyperparameter did not find one.
    #[error("no hyperparameter gives a noise figure of {target}: the reachable range is {low:.3} to {high:.3}")]
    NoiseFigure {
        /// What was asked.
        target: f64,
        /// Smallest reachable.
        low: f64,
        /// Largest reachable.
        high: f64,
    },
}
