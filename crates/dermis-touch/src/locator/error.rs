//! Errors in the examples, the physics, a frame or a stored locator, with the offending value.

/// The errors of [`Locator`](super::Locator).
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LocatorError {
    /// A buffer's length does not match the corresponding counts.
    #[error("{field}: expected {expected} values, got {got}")]
    Length {
        /// Name of the buffer.
        field: &'static str,
        /// Expected length.
        expected: usize,
        /// Actual length.
        got: usize,
    },
    /// The number of items is too small or too large for the method.
    #[error("{field}: expected {expected}, got {got}")]
    Count {
        /// Name of the items counted.
        field: &'static str,
        /// Actual count.
        got: usize,
        /// Description of the range.
        expected: &'static str,
    },
    /// A number is not finite, or not within its range.
    #[error("{field}, index {index}: expected {expected}, got {value}")]
    Value {
        /// Name of the buffer or parameter.
        field: &'static str,
        /// Index of the value; 0 for a single parameter.
        index: usize,
        /// The value.
        value: f64,
        /// Description of the range.
        expected: &'static str,
    },
    /// A frame has too few channels that are finite and known to the locator.
    #[error("frame {frame}: expected at least {expected} usable channels, got {got}")]
    TooFewChannels {
        /// Index of the frame among the examples; 0 at prediction.
        frame: usize,
        /// Number of usable channels.
        got: usize,
        /// Minimum number of usable channels.
        expected: usize,
    },
    /// All usable channels of a frame are exactly zero, so it has no direction to compare.
    #[error("frame {frame}: every usable channel is zero, so it holds no touch to locate")]
    EmptyFrame {
        /// Index of the frame among the examples; 0 at prediction.
        frame: usize,
    },
    /// A covariance could not be factorised or diagonalised: the examples are degenerate.
    #[error("{what} is not positive definite: are the examples all alike?")]
    Singular {
        /// Name of the matrix.
        what: &'static str,
    },
    /// A stored locator has a different format version.
    #[error("stored locator has version {got}, expected {expected}: calibrate again")]
    Version {
        /// The version this module reads.
        expected: u32,
        /// The version found.
        got: u32,
    },
}

/// Rejects a slice of the wrong length.
pub(super) fn check_length(field: &'static str, expected: usize, got: usize) -> Result<(), LocatorError> {
    if expected == got { Ok(()) } else { Err(LocatorError::Length { field, expected, got }) }
}

/// Rejects a slice with a value that is NaN or infinite.
pub(super) fn check_finite(field: &'static str, values: &[f64]) -> Result<(), LocatorError> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(LocatorError::Value { field, index, value: values[index], expected: "a finite number" }),
        None => Ok(()),
    }
}

/// Rejects positions with a coordinate that is NaN or infinite. `index` in the error counts positions.
pub(super) fn check_positions(field: &'static str, positions: &[[f64; 2]]) -> Result<(), LocatorError> {
    match positions.iter().position(|p| !(p[0].is_finite() && p[1].is_finite())) {
        Some(index) => {
            let value = if positions[index][0].is_finite() { positions[index][1] } else { positions[index][0] };
            Err(LocatorError::Value { field, index, value, expected: "finite coordinates in metres" })
        }
        None => Ok(()),
    }
}

/// Rejects the first value that `accept` does not accept.
pub(super) fn check_first(
    field: &'static str,
    mut values: impl Iterator<Item = f64>,
    accept: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Result<(), LocatorError> {
    let mut index = 0;
    values
        .find(|v| {
            !accept(*v) || {
                index += 1;
                false
            }
        })
        .map_or(Ok(()), |value| Err(LocatorError::Value { field, index, value, expected }))
}
