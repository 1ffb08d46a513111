//! What a fused locator says about itself.

use super::fusion::Fusion;
use crate::locator::data::LeaveOneOut;
use crate::locator::posterior::quantile;
use crate::typical::median;

/// Distances between true and found places of left-out examples.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accuracy {
    /// Median distance in metres.
    pub median_m: f64,
    /// Distance that nine in ten stay below, in metres.
    pub p90_m: f64,
}

impl Accuracy {
    /// Of places found against the true ones.
    pub(super) fn of(found_m: impl Iterator<Item = [f64; 2]>, truth_m: &[[f64; 2]]) -> Self {
        let errors: Vec<f64> = found_m.zip(truth_m).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).collect();
        Self { median_m: median(&errors), p90_m: quantile(&errors, 0.9) }
    }
}

/// Whether something given beside the pokes was made use of.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorUse {
    /// Whether it is part of the locator.
    pub used: bool,
    /// By how much the left-out examples' mean log predictive density is higher with it than without; below zero it did
    /// harm and was left out.
    pub gain: f64,
}

/// How good a [`FusedLocator`](super::FusedLocator) is, judged on each example by the others, and what it uses.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FusedReport {
    /// Examples as both experts together locate them: all of them, or the landmarks where there are very many.
    pub left_out: LeaveOneOut,
    /// The forward expert alone.
    pub forward: Accuracy,
    /// The inverse expert alone.
    pub inverse: Accuracy,
    /// Both together.
    pub fused: Accuracy,
    /// Whether the forward expert takes part.
    pub forward_used: bool,
    /// Whether the inverse expert takes part.
    pub inverse_used: bool,
    /// Whether the forward expert sees companded frames.
    pub companded: bool,
    /// What physics brought, where it was given.
    pub physics: Option<PriorUse>,
    /// What the map of another skin brought, where one was given.
    pub sister_map: Option<PriorUse>,
    /// What the covariance between channels of another skin brought, where one was given.
    pub sister_covariance: Option<PriorUse>,
    /// What it brought that the skin looks the same when it is turned, where another skin was given that does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sister_turn: Option<PriorUse>,
    /// Indices of examples that the others contradict by far: look whether their positions were written down right.
    pub doubtful: Vec<usize>,
    /// Whether the doubtful ones took no part in the fit.
    pub doubtful_left_out: bool,
}

impl FusedReport {
    /// Which experts a way of joining uses: (forward, inverse).
    pub(super) fn experts(fusion: &Fusion) -> (bool, bool) {
        (fusion.temperature > 0.0, fusion.doublings.is_some())
    }
}
