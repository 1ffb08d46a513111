//! Thresholds and times for finding damage and following its healing.

use serde::{Deserialize, Serialize};

use crate::error::{TouchError, require};

/// Thresholds and times of a [`DamageMonitor`](super::DamageMonitor).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DamageParams {
    /// Damage is suspected below minus this many standard deviations of the averaged image. Above 0.
    pub begin_sigma: f64,
    /// Minimum depth of damage, image units. Above 0.
    pub smallest_depth: f64,
    /// Minimum depth of damage as a share of the largest rise in the image; shallower dips are side lobes. From 0 to
    /// 1.
    pub lobe_share: f64,
    /// Pause after a touch before damage is judged, while the material relaxes, seconds. At least 0.
    pub settle_s: f64,
    /// Damage is confirmed after it has been seen in free frames for this long, seconds. At least 0.
    pub confirm_s: f64,
    /// Time constant of the mean over free frames, seconds. Above 0.
    pub average_s: f64,
    /// Damage is healing below this share of its worst. From `healed_share` to 1.
    pub healing_share: f64,
    /// Damage is healed below this share of its worst. From 0 to 1.
    pub healed_share: f64,
    /// A touch covers damage within its radius plus this margin, metres. At least 0.
    pub reach_m: f64,
    /// Standard deviation, along an axis, of the region that point-like damage makes in the image, metres. At least
    /// 0.
    pub point_spread_m: f64,
    /// Maximum number of damage sites kept, from 1 to 16.
    pub most: usize,
}

impl Default for DamageParams {
    /// Suits a skin the size of a hand at 10 to 1,000 frames a second.
    fn default() -> Self {
        Self {
            begin_sigma: 8.0,
            smallest_depth: 0.05,
            lobe_share: 0.5,
            settle_s: 0.4,
            confirm_s: 1.5,
            average_s: 0.4,
            healing_share: 0.8,
            healed_share: 0.2,
            reach_m: 5e-3,
            point_spread_m: 5e-3,
            most: 16,
        }
    }
}

impl DamageParams {
    /// Checks every field against its range.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] naming the field.
    pub fn validate(&self) -> Result<(), TouchError> {
        let above = |value: f64| value.is_finite() && value > 0.0;
        let least = |value: f64| value.is_finite() && value >= 0.0;
        require(above(self.begin_sigma), "begin_sigma", self.begin_sigma, "finite and above 0")?;
        require(above(self.smallest_depth), "smallest_depth", self.smallest_depth, "finite and above 0")?;
        require((0.0..=1.0).contains(&self.lobe_share), "lobe_share", self.lobe_share, "from 0 to 1")?;
        require(least(self.settle_s), "settle_s", self.settle_s, "finite and at least 0")?;
        require(least(self.confirm_s), "confirm_s", self.confirm_s, "finite and at least 0")?;
        require(above(self.average_s), "average_s", self.average_s, "finite and above 0")?;
        require((0.0..=1.0).contains(&self.healed_share), "healed_share", self.healed_share, "from 0 to 1")?;
        let healing = (self.healed_share..=1.0).contains(&self.healing_share);
        require(healing, "healing_share", self.healing_share, "from healed_share to 1")?;
        require(least(self.reach_m), "reach_m", self.reach_m, "finite and at least 0")?;
        require(least(self.point_spread_m), "point_spread_m", self.point_spread_m, "finite and at least 0")?;
        require((1..=16).contains(&self.most), "most", self.most as f64, "1 to 16")
    }
}
