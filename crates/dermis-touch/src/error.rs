//! Errors between an image and a touch, with the offending value and what was expected.

/// The only error type of this crate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// A buffer's length does not match the geometry or the channel count.
    #[error("{what}: expected {expected} values, got {got}")]
    Length {
        /// Name of the buffer.
        what: &'static str,
        /// Expected length.
        expected: usize,
        /// Actual length.
        got: usize,
    },
    /// A parameter is outside its range.
    #[error("{name} = {value}: expected {expected}")]
    Parameter {
        /// Name of the parameter, as in its struct.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Description of the range.
        expected: &'static str,
    },
    /// A value that must be finite is NaN or infinite.
    #[error("{what}, index {index}: expected a finite number, got {value}")]
    NonFinite {
        /// Name of the buffer.
        what: &'static str,
        /// Index of the value.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A frame is older than one already processed.
    #[error("time {time_ns} ns lies before the previous frame's {previous_ns} ns: times must not decrease")]
    TimeReversed {
        /// The frame's time.
        time_ns: u64,
        /// The latest time processed.
        previous_ns: u64,
    },
    /// A tare was requested, without force, while the skin is touched.
    #[error("tare refused: the skin is under load (release it, or force the tare)")]
    TareUnderLoad,
    /// Too few frames for a statistic.
    #[error("{what}: expected at least {expected} frames, got {got}")]
    TooFewFrames {
        /// Name of the statistic.
        what: &'static str,
        /// Minimum count.
        expected: usize,
        /// Actual count.
        got: usize,
    },
    /// A covariance matrix cannot be inverted.
    #[error(
        "the {channels} x {channels} noise covariance is not positive definite (smallest variance {smallest_variance:e}): \
         leave out constant channels or use more frames"
    )]
    SingularCovariance {
        /// Number of channels.
        channels: usize,
        /// The smallest diagonal entry, in squared channel units.
        smallest_variance: f64,
    },
    /// A calibration belongs to another skin.
    #[error("calibration of skin {got:?} refused: expected one of {expected:?}")]
    OtherSkin {
        /// The skin it should be for.
        expected: String,
        /// The skin it was made for.
        got: String,
    },
}

/// Checks a parameter; `expected` describes the range.
pub(crate) fn require(ok: bool, name: &'static str, value: f64, expected: &'static str) -> Result<(), TouchError> {
    if ok { Ok(()) } else { Err(TouchError::Parameter { name, value, expected }) }
}

/// Checks the length of a buffer.
pub(crate) fn require_length(what: &'static str, expected: usize, got: usize) -> Result<(), TouchError> {
    if expected == got { Ok(()) } else { Err(TouchError::Length { what, expected, got }) }
}

/// Checks that every value is finite.
pub(crate) fn require_finite(what: &'static str, values: &[f64]) -> Result<(), TouchError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(TouchError::NonFinite { what, index, value: values[index] }),
    }
}
