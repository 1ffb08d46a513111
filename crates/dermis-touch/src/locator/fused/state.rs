//! State of a fused locator, as plain arrays that can be stored and are checked when read back.

use super::excess::Excess;
use super::features::Features;
use super::fusion::Fusion;
use super::inverse::Regression;
use super::report::FusedReport;
use crate::locator::Locator;
use crate::locator::error::{LocatorError, check_first, check_length, check_positions};

/// Format version; a fused locator with a different version is rejected.
pub const FUSED_VERSION: u32 = 1;

/// The stored form of a [`FusedLocator`](super::FusedLocator).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FusedState {
    pub version: u32,
    pub features: Features,
    /// The forward expert, for the frames made by [`Features::forward`].
    pub forward: Locator,
    /// The inverse expert on unit frames and their roots.
    pub plain: Regression,
    /// The inverse expert on the forward expert's whitened frames, if there are enough pokes.
    pub whitened: Option<Regression>,
    /// Weight of `plain` in the inverse expert's position.
    pub plain_share: f64,
    pub fusion: Fusion,
    /// Widening of the posterior by a frame unlike the pokes.
    #[serde(default)]
    pub excess: Excess,
    /// Factors on the posterior's standard deviations of x and y.
    pub sigma_factors: [f64; 2],
    /// Standard deviation that a wholly unexplained map adds, metres.
    pub extrapolation_m: f64,
    /// Positions of the pokes at the inverse expert's points, metres.
    pub places_m: Vec<[f64; 2]>,
    pub report: FusedReport,
}

impl FusedState {
    pub(super) fn check(&self) -> Result<(), LocatorError> {
        if self.version != FUSED_VERSION {
            return Err(LocatorError::Version { expected: FUSED_VERSION, got: self.version });
        }
        self.features.check()?;
        let channels = self.features.weights.len();
        check_length("channels of the forward expert", channels, self.forward.channels())?;
        self.plain.check(self.features.inverse_len())?;
        if let Some(whitened) = &self.whitened {
            whitened.check(self.forward.state.rank)?;
        }
        check_length("places_m", self.plain.points(), self.places_m.len())?;
        check_positions("places_m", &self.places_m)?;
        let share = |v: f64| (0.0..=1.0).contains(&v);
        check_first("plain_share", std::iter::once(self.plain_share), share, "a number from 0 to 1")?;
        if self.whitened.is_none() && self.plain_share < 1.0 {
            let (value, expected) = (self.plain_share, "1 without the regression on whitened frames");
            return Err(LocatorError::Value { field: "plain_share", index: 0, value, expected });
        }
        let not_negative = |v: f64| v.is_finite() && v >= 0.0;
        let values = [self.fusion.temperature, self.extrapolation_m, self.excess.distance_power];
        check_first("fusion", values.into_iter(), not_negative, "a finite number, zero or above")?;
        let above = |v: f64| v.is_finite() && v > 0.0;
        let usual = [self.excess.usual_novelty, self.excess.usual_distance];
        check_first("excess medians", usual.into_iter(), above, "a finite number above zero")?;
        check_first("sigma_factors", self.sigma_factors.into_iter(), above, "a finite number above zero")
    }
}
