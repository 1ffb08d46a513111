//! A press of known force.

use serde::{Deserialize, Serialize};

/// One press of known force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSample {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Force, newtons.
    pub force_n: f64,
    /// Signal.
    pub signal: f64,
    /// Force by the layer's law and its standard deviation, newtons, if the law gives one.
    pub by_law: Option<[f64; 2]>,
}
