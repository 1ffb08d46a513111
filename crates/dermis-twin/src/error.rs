//! Errors of a twin, with the value, the field and what was expected.

use dermis_mit::MitError;
use dermis_tomo::eit::{EitError, ProtocolError};
use dermis_tomo::mesh::MeshError;
use dermis_tomo::sparse::SparseError;
use thiserror::Error;

/// Reasons why a twin cannot be built, commanded or stepped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TwinError {
    /// A skin file from which no twin can be built.
    #[error(transparent)]
    Skin(#[from] Box<dermis_skin::Error>),
    /// A missing key that a skin of this kind needs.
    #[error("{field} is left out; expected it in {of}")]
    Missing {
        /// The key.
        field: &'static str,
        /// The kind of skin that needs it.
        of: &'static str,
    },
    /// An invalid parameter.
    #[error("{field}: {value} refused; expected {expected}")]
    Value {
        /// Name of the parameter, with its unit.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Expected values.
        expected: &'static str,
    },
    /// A position that is not on the skin.
    #[error("{what} at ({x_m}, {y_m}) m refused; expected {expected}")]
    Place {
        /// The item at that position.
        what: &'static str,
        /// Position to the right of the origin.
        x_m: f64,
        /// Position above the origin.
        y_m: f64,
        /// Permitted positions.
        expected: &'static str,
    },
    /// A count that does not match the electrodes, elements and so on.
    #[error("{field}: {got} refused; expected {expected}")]
    Count {
        /// The items counted.
        field: &'static str,
        /// Actual count.
        got: usize,
        /// Expected count, and the reason.
        expected: String,
    },
    /// A pointer was moved without pressing.
    #[error("pointer {pointer} moved, but is not pressing; expected a press before it")]
    Pointer {
        /// The pointer named.
        pointer: u64,
    },
    /// A treatment that this skin does not support.
    #[error(
        "this skin's twin does not support this treatment; expected a sheet or a sandwich to cut, warm or renew, and a sandwich \
         that heals to lay a heat pad on"
    )]
    NotTreatable,
    /// An event of a script that does not fit the earlier ones.
    #[error("script event {event}: {reason}")]
    Event {
        /// Index of the event in the list, zero-based.
        event: usize,
        /// The problem, with the value.
        reason: String,
    },
    /// A script that is not valid TOML of the expected form.
    #[error("script: {0}")]
    Script(#[from] toml::de::Error),
    /// Geometry that cannot be meshed.
    #[error("twin's mesh: {0}")]
    Mesh(#[from] MeshError),
    /// Currents or measurements that form no valid protocol.
    #[error("twin's protocol: {0}")]
    Protocol(#[from] ProtocolError),
    /// The field equations could not be solved.
    #[error("twin's fields: {0}")]
    Fields(#[from] SparseError),
    /// The forward model refused the body or its conductivity.
    #[error("twin's forward model: {0}")]
    Forward(#[from] EitError),
    /// Invalid coils or conducting bodies.
    #[error("twin's coils and bodies: {0}")]
    Magnetic(#[from] MitError),
}

/// Refuses a value that is not finite or not in `least..=most`.
pub(crate) fn check(
    field: &'static str,
    value: f64,
    least: f64,
    most: f64,
    expected: &'static str,
) -> Result<(), TwinError> {
    if value.is_finite() && (least..=most).contains(&value) {
        return Ok(());
    }
    Err(TwinError::Value { field, value, expected })
}

/// Refuses a value that is not positive and finite.
pub(crate) fn check_positive(field: &'static str, value: f64) -> Result<(), TwinError> {
    check(field, value, f64::MIN_POSITIVE, f64::MAX, "positive and finite")
}

impl From<dermis_skin::Error> for TwinError {
    fn from(error: dermis_skin::Error) -> Self {
        Self::Skin(Box::new(error))
    }
}
