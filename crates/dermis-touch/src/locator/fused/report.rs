//! A fused locator's report on itself.

use super::fusion::Fusion;
use crate::locator::data::LeaveOneOut;
use crate::locator::posterior::quantile;
use crate::plane::distance;
use crate::statistics::median;

/// Distances between true and located positions of left-out examples.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accuracy {
    /// Median distance, metres.
    pub median_m: f64,
    /// Distance that nine in ten stay below, metres.
    pub p90_m: f64,
}

impl Accuracy {
    /// Accuracy of located positions against the true ones.
    pub(super) fn of(found_m: impl Iterator<Item = [f64; 2]>, truth_m: &[[f64; 2]]) -> Self {
        let errors: Vec<f64> = found_m.zip(truth_m).map(|(a, b)| distance(a, *b)).collect();
        Self { median_m: median(&errors), p90_m: quantile(&errors, 0.9) }
    }
}

/// Use of additional prior information.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorUse {
    /// True if it is part of the locator.
    pub used: bool,
    /// Gain in the left-out examples' mean log predictive density. If it is below zero, the information did harm and
    /// was not used.
    pub gain: f64,
}

/// Accuracy of a [`FusedLocator`](super::FusedLocator), judged on each example by the others, and the parts it uses.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FusedReport {
    /// Examples as located by both experts together: all of them, or the landmarks if there are very many.
    pub left_out: LeaveOneOut,
    /// Accuracy of the forward expert alone.
    pub forward: Accuracy,
    /// Accuracy of the inverse expert alone.
    pub inverse: Accuracy,
    /// Accuracy of both together.
    pub fused: Accuracy,
    /// True if the forward expert is used.
    pub forward_used: bool,
    /// True if the inverse expert is used.
    pub inverse_used: bool,
    /// True if the forward expert sees companded frames.
    pub companded: bool,
    /// Use of physics, if it was given.
    pub physics: Option<PriorUse>,
    /// Use of another skin's map, if one was given.
    pub sister_map: Option<PriorUse>,
    /// Use of another skin's covariance between channels, if one was given.
    pub sister_covariance: Option<PriorUse>,
    /// Use of rotational symmetry, if another skin was given that has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sister_turn: Option<PriorUse>,
    /// Correlation of the map with that of an earlier session, if examples of one were given: 0 if they have nothing in
    /// common, 1 if the skin has not changed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resemblance: Option<f64>,
    /// Indices of examples that the others strongly contradict. Check whether their positions were recorded
    /// correctly.
    pub doubtful: Vec<usize>,
    /// True if the doubtful examples were excluded from the fit.
    pub doubtful_left_out: bool,
}

impl FusedReport {
    /// Which experts a combination uses: (forward, inverse).
    pub(super) fn experts(fusion: &Fusion) -> (bool, bool) {
        (fusion.temperature > 0.0, fusion.doublings.is_some())
    }
}
