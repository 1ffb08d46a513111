//! A locator that keeps learning: two experts, joined by what the left-out pokes say of each.
//!
//! The forward expert is a [`Locator`]: from place to frame, good with few pokes, because it interpolates what is smooth
//! and may say that several places are likely. With thousands of pokes it stops improving, because what varies between
//! two touches of one place (what was pressed before, drift) is not the same noise everywhere. The inverse expert is a
//! kernel regression from frame to place, poor with few pokes and good with many, because it learns which parts of a
//! frame tell the place. Their product is at least as good as the better one: temperature and power that
//! switch either expert off are among those tried.
//!
//! Nothing need be known of the skin's geometry: positions that cover its outline and a number of channels are enough
//! ([`SignatureMap::without_physics`]). Where physics is given it is used if it predicts left-out pokes better.
//!
//! A calibration of another skin of the family ([`FusedLocator::fit_with_prior`]) lends its covariance between channels,
//! as an inverse Wishart prior, and its map as the mean of the new one, each only if left-out pokes are predicted better.

mod drift;
mod features;
mod fit;
mod form;
mod fusion;
mod inverse;
mod live;
mod prior;
mod report;
mod state;

pub use drift::SessionDrift;
pub use live::FusedScratch;
pub use report::{Accuracy, FusedReport, PriorUse};
pub use state::FUSED_VERSION;

use super::data::{Examples, SignatureMap, SuggestedPoke};
use super::error::LocatorError;

/// Options of [`FusedLocator::fit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusedOptions {
    /// Up to so many examples every one is used by both experts. Time grows with its cube, memory with its square.
    pub exact_examples: usize,
    /// With more examples than that, so many evenly drawn ones make the forward expert's map and are the inverse
    /// expert's landmarks; all still teach the inverse expert.
    pub landmarks: usize,
    /// Examples that the others contradict are left out and reported.
    pub leave_out_doubtful: bool,
}

impl Default for FusedOptions {
    fn default() -> Self {
        Self { exact_examples: 3000, landmarks: 2000, leave_out_doubtful: true }
    }
}

/// A fitted locator of two experts. Serialisable; reading one back checks its version, lengths and values.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "state::FusedState", into = "state::FusedState")]
pub struct FusedLocator {
    state: state::FusedState,
    cells: fusion::Cells,
}

impl FusedLocator {
    /// Fits to pokes. `map` holds the positions among which touches are looked for, with what physics predicts there,
    /// or zeros.
    ///
    /// # Errors
    /// As [`Locator::fit`](super::Locator::fit); options out of range.
    pub fn fit(examples: &Examples, map: &SignatureMap, options: &FusedOptions) -> Result<Self, LocatorError> {
        fit::fit(examples, map, options, None)
    }

    /// [`FusedLocator::fit`] with a calibration of a skin of the same outline and electrodes to start from.
    ///
    /// # Errors
    /// As [`FusedLocator::fit`]; a prior with another number of channels.
    pub fn fit_with_prior(
        examples: &Examples,
        map: &SignatureMap,
        options: &FusedOptions,
        sister: &FusedLocator,
    ) -> Result<Self, LocatorError> {
        super::error::check_length("channels of the prior", examples.channels(), sister.channels())?;
        fit::fit(examples, map, options, Some(&prior::Sister::new(sister)?))
    }

    /// How good it is, and what it makes use of.
    pub fn report(&self) -> &FusedReport {
        &self.state.report
    }

    /// Number of channels a frame must have.
    pub fn channels(&self) -> usize {
        self.state.features.weights.len()
    }

    /// The positions among which touches are looked for, metres.
    pub fn positions_m(&self) -> &[[f64; 2]] {
        self.state.forward.positions_m()
    }

    /// Where more pokes would help most; see [`Locator::suggest_pokes`](super::Locator::suggest_pokes).
    ///
    /// # Errors
    /// As there.
    pub fn suggest_pokes(&self, count: usize) -> Result<Vec<SuggestedPoke>, LocatorError> {
        self.state.forward.suggest_pokes(count)
    }
}
