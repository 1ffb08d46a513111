//! A fitted locator.

use super::data::{Hyperparameters, LeaveOneOut};
use super::error::LocatorError;
use super::state::LocatorState;

/// A fitted locator. Serialisable; deserialising checks version, lengths and values.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "LocatorState", into = "LocatorState")]
pub struct Locator {
    pub(super) state: LocatorState,
    /// Squared length of each whitened signature.
    pub(super) squares: Vec<f64>,
    /// Identifies the locator, so that scratch memory of one is not used for another.
    pub(super) fingerprint: u64,
}

impl TryFrom<LocatorState> for Locator {
    type Error = LocatorError;

    fn try_from(state: LocatorState) -> Result<Self, LocatorError> {
        Self::from_state(state)
    }
}

impl From<Locator> for LocatorState {
    fn from(locator: Locator) -> Self {
        locator.state
    }
}

fn squared_length(row: &[f32]) -> f64 {
    row.iter().map(|v| f64::from(*v).powi(2)).sum()
}

impl Locator {
    /// Accuracy of each example as located by the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        &self.state.report
    }

    /// The hyperparameters in use.
    pub fn hyperparameters(&self) -> Hyperparameters {
        self.state.hyperparameters
    }

    /// Number of channels a frame must have.
    pub fn channels(&self) -> usize {
        self.state.weights.len()
    }

    /// The positions at which touches are searched for, metres.
    pub fn positions_m(&self) -> &[[f64; 2]] {
        &self.state.positions_m
    }

    /// Checks a state and computes the values that are not stored.
    pub(super) fn from_state(state: LocatorState) -> Result<Self, LocatorError> {
        state.check()?;
        let squares = state.signatures.chunks_exact(state.rank).map(squared_length).collect();
        let fingerprint =
            state.signatures.iter().chain(&state.transform).fold(0xcbf2_9ce4_8422_2325, |hash, v| {
                (hash ^ u64::from(v.to_bits())).wrapping_mul(0x0000_0100_0000_01b3)
            });
        Ok(Self { state, squares, fingerprint })
    }
}
