//! The load of a touch, as estimated by a calibration with pokes of known depth or force.

use serde::{Deserialize, Serialize};

/// Quantity in which the load of pokes was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadQuantity {
    /// Depth of indentation, metres.
    DepthM,
    /// Force, newtons.
    ForceN,
}

/// The load of a touch, in the quantity that the calibration's pokes were measured in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TouchLoad {
    /// Depth or force.
    pub quantity: LoadQuantity,
    /// Value in metres or newtons.
    pub value: f64,
    /// Standard deviation of `value`, in its unit.
    pub sigma: f64,
}
