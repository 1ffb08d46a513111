//! What can go wrong between an image and a touch, with the value that was wrong and what was expected.

/// The one error type of this crate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TouchError {
    /// A buffer has another length than the geometry or the channel count asks for.
    #[error("{what}: expected {expected} values, got {got}")]
    Length {
        /// Which buffer.
        what: &'static str,
        /// Its right length.
        expected: usize,
        /// Its length as given.
        got: usize,
    },
    /// A parameter lies outside its range.
    #[error("{name} = {value}: expected {expected}")]
    Parameter {
        /// The parameter's name, as in the struct that holds it.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        expected: &'static str,
    },
    /// A value that must be finite is NaN or infinite.
    #[error("{what}, index {index}: expected a finite number, got {value}")]
    NonFinite {
        /// Which buffer.
        what: &'static str,
        /// Index into it.
        index: usize,
        /// The value found.
        value: f64,
    },
    /// A frame's time lies before the time of the frame already processed.
    #[error("time {time_ns} ns lies before the previous frame's {previous_ns} ns: times must not decrease")]
    TimeReversed {
        /// The time given.
        time_ns: u64,
        /// The latest time processed before.
        previous_ns: u64,
    },
    /// A tare was asked for while the skin is touched, without force.
    #[error("tare refused: the skin is under load (release it, or force the tare)")]
    TareUnderLoad,
    /// Too few frames for a statistic.
    #[error("{what}: expected at least {expected} frames, got {got}")]
    TooFewFrames {
        /// Which statistic.
        what: &'static str,
        /// The smallest count that makes sense.
        expected: usize,
        /// The count given.
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
        /// The skin that it is wanted for.
        expected: String,
        /// The skin that it was made on.
        got: String,
    },
}

/// Checks one parameter; `expected` says the range in words.
pub(crate) fn require(ok: bool, name: &'static str, value: f64, expected: &'static str) -> Result<(), TouchError> {
    if ok { Ok(()) } else { Err(TouchError::Parameter { name, value, expected }) }
}

/// Checks one buffer's length.
pub(crate) fn require_length(what: &'static str, expected: usize, got: usize) -> Result<(), TouchError> {
    if expected == got { Ok(()) } else { Err(TouchError::Length { what, expected, got }) }
}
