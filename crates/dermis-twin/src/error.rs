//! What can go wrong with a twin, with the value, the field and what was expected.

use dermis_tomo::eit::{EitError, ProtocolError};
use dermis_tomo::mesh::MeshError;
use dermis_tomo::mit::MitError;
use dermis_tomo::sparse::SparseError;
use thiserror::Error;

/// Why a twin could not be made, commanded or stepped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TwinError {
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
    /// A pointer that presses nothing was moved.
    #[error("pointer {pointer} moved, but it presses nothing; expected a press before it")]
    Pointer {
        /// The pointer named.
        pointer: u64,
    },
    /// A skin whose sheet is neither cut nor healed was to be.
    #[error("this skin's twin cannot be cut, heated or renewed; expected a self-healing sandwich (healing-square)")]
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
