//! What can go wrong with a twin, with the value, the field and what was expected.

use dermis_mit::MitError;
use dermis_tomo::eit::{EitError, ProtocolError};
use dermis_tomo::mesh::MeshError;
use dermis_tomo::sparse::SparseError;
use thiserror::Error;

/// Why a twin could not be made, commanded or stepped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TwinError {
    /// A skin file that its twin cannot be made from.
    #[error(transparent)]
    Skin(#[from] Box<dermis_skin::Error>),
    /// Something that a skin of this kind needs.
    #[error("{field} is left out; expected it in {of}")]
    Missing {
        /// The key.
        field: &'static str,
        /// What needs it.
        of: &'static str,
    },
    /// A parameter that makes no sense.
    #[error("{field}: {value} refused; expected {expected}")]
    Value {
        /// Which parameter, with its unit.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A place that is not on the skin.
    #[error("{what} at ({x_m}, {y_m}) m refused; expected {expected}")]
    Place {
        /// What is there.
        what: &'static str,
        /// Position to the right of the origin.
        x_m: f64,
        /// Position above the origin.
        y_m: f64,
        /// Where it may be.
        expected: &'static str,
    },
    /// Another number of something than of electrodes, elements and so on.
    #[error("{field}: {got} refused; expected {expected}")]
    Count {
        /// What is counted.
        field: &'static str,
        /// How many there are.
        got: usize,
        /// How many were expected, and why.
        expected: String,
    },
    /// A pointer that presses nothing was moved.
    #[error("pointer {pointer} moved, but it presses nothing; expected a press before it")]
    Pointer {
        /// The pointer named.
        pointer: u64,
    },
    /// A skin was to be cut, heated or renewed that cannot be.
    #[error(
        "this skin's twin cannot be treated so; expected a sheet or a sandwich to cut, warm or renew, and a sandwich \
         that heals to lay a heat pad on"
    )]
    NotTreatable,
    /// An event of a script does not fit those before it.
    #[error("script event {event}: {reason}")]
    Event {
        /// Index of the event in the list, zero-based.
        event: usize,
        /// What is wrong, with the value.
        reason: String,
    },
    /// A script is not the TOML that was expected.
    #[error("script: {0}")]
    Script(#[from] toml::de::Error),
    /// Geometry that cannot be meshed.
    #[error("twin's mesh: {0}")]
    Mesh(#[from] MeshError),
    /// Currents or measurements that make no protocol.
    #[error("twin's protocol: {0}")]
    Protocol(#[from] ProtocolError),
    /// The field equations could not be solved.
    #[error("twin's fields: {0}")]
    Fields(#[from] SparseError),
    /// The forward model refused the body or its conductivity.
    #[error("twin's forward model: {0}")]
    Forward(#[from] EitError),
    /// Coils or conducting bodies that make no sense.
    #[error("twin's coils and bodies: {0}")]
    Magnetic(#[from] MitError),
}

/// Refuses a value that is not finite or not within `least..=most`.
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
