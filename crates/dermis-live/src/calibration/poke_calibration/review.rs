//! Findings about the pokes of a calibration.

use dermis_touch::locator::SessionDrift;
use serde::{Deserialize, Serialize};

use super::start::StartReview;

/// Findings about the pokes, other than their locations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PokeReview {
    /// Number of pokes excluded because they repeat another one exactly, value by value.
    pub repeated: usize,
    /// Channels that read the same in every poke, or nothing.
    pub dead_channels: Vec<u32>,
    /// Drift over the session, if the pokes are in the order they were made and numerous enough.
    pub drift: Option<SessionDrift>,
    /// Channels excluded because they jump while nothing touches the skin. Determined only if each poke has its own
    /// baseline.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unsound_channels: Vec<u32>,
    /// Scatter of each channel over these baselines, without jumps, in the unit of the readings; 0 for a channel that
    /// never read anything.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rest_scatter: Vec<f64>,
    /// Use of an earlier calibration, if one was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<StartReview>,
}
