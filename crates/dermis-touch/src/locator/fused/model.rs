//! A fitted locator of two experts.

use super::fusion::Cells;
use super::report::FusedReport;
use super::state::FusedState;
use crate::locator::data::{LeaveOneOut, SuggestedPoke};
use crate::locator::error::{LocatorError, check_first};

/// A fitted locator of two experts. Serialisable; deserialising checks version, lengths and values.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "FusedState", into = "FusedState")]
pub struct FusedLocator {
    pub(super) state: FusedState,
    pub(super) cells: Cells,
}

impl FusedLocator {
    /// Its accuracy, and the parts it uses.
    pub fn report(&self) -> &FusedReport {
        &self.state.report
    }

    /// Accuracy of each example as located by the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        &self.state.report.left_out
    }

    /// Number of channels a frame must have.
    pub fn channels(&self) -> usize {
        self.state.features.weights.len()
    }

    /// The positions at which touches are searched for, metres.
    pub fn positions_m(&self) -> &[[f64; 2]] {
        self.state.forward.positions_m()
    }

    /// Multiplies all standard deviations of positions.
    ///
    /// # Errors
    /// A factor that is not finite and above zero.
    pub fn scale_sigmas(&mut self, factor: f64) -> Result<(), LocatorError> {
        let is_factor = |v: f64| v.is_finite() && v > 0.0;
        check_first("factor on sigma", std::iter::once(factor), is_factor, "a finite number above zero")?;
        self.state.sigma_factors.iter_mut().for_each(|sigma| *sigma *= factor);
        self.state.extrapolation_m *= factor;
        Ok(())
    }

    /// Weight of each channel; 0 if it is never used.
    pub fn channel_weights(&self) -> &[f64] {
        &self.state.features.weights
    }

    /// Positions where more pokes would help most; see
    /// [`Locator::suggest_pokes`](crate::locator::Locator::suggest_pokes).
    ///
    /// # Errors
    /// As there.
    pub fn suggest_pokes(&self, count: usize) -> Result<Vec<SuggestedPoke>, LocatorError> {
        self.state.forward.suggest_pokes(count)
    }
}

impl TryFrom<FusedState> for FusedLocator {
    type Error = LocatorError;

    fn try_from(state: FusedState) -> Result<Self, LocatorError> {
        state.check()?;
        let forward = &state.forward.state;
        let cells = Cells::new(&forward.positions_m, forward.spacing_m);
        Ok(Self { state, cells })
    }
}

impl From<FusedLocator> for FusedState {
    fn from(locator: FusedLocator) -> Self {
        locator.state
    }
}
