//! Damage told from touch. Touches are fast and raise the image of a skin against its intact reference; damage lowers it
//! and stays. [`DamageMonitor`] watches that image with the touches of each frame and keeps a [`Damage`] for every
//! place that stays low: found only while nothing touches, kept while something presses on it, and followed as it heals.

mod monitor;
mod region;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

use crate::error::{TouchError, require};

pub use monitor::{ClassProbabilities, DamageFrame, DamageMonitor};

/// What is known of a damage now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DamageState {
    /// Seen, but not for long enough to be believed. Reported in no event yet.
    Suspected,
    /// Believed, and seen whenever nothing touches the skin.
    Confirmed,
    /// Something presses on it, or did a moment ago: the image shows that and not the damage.
    Covered,
    /// Less of it is left than there was.
    Healing,
    /// Nothing, or only a scar, is left of it.
    Healed,
}

impl DamageState {
    /// The word for it in files and streams.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Suspected => "suspected",
            Self::Confirmed => "confirmed",
            Self::Covered => "covered",
            Self::Healing => "healing",
            Self::Healed => "healed",
        }
    }
}

/// Where a damage lies: the segment of a line, or a spot where `length_m` is 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DamageShape {
    /// Its middle, in the skin's frame, metres.
    pub centre_m: [f64; 2],
    /// Its length, metres, at least 0.
    pub length_m: f64,
    /// Its width, metres, at least 0; 0 where it cannot be told from none.
    pub width_m: f64,
    /// Its direction from +x counter-clockwise, radians, above -pi/2 and at most pi/2.
    pub direction_rad: f64,
    /// Standard deviations of the middle in x and y, of length and direction (metres, metres, metres, radians), where a
    /// model was fitted; none where the image alone tells.
    pub deviations: Option<[f64; 4]>,
}

impl DamageShape {
    /// Both ends, metres.
    #[must_use]
    pub fn ends_m(&self) -> [[f64; 2]; 2] {
        let (s, c) = self.direction_rad.sin_cos();
        let half = 0.5 * self.length_m;
        let [x, y] = self.centre_m;
        [[x - half * c, y - half * s], [x + half * c, y + half * s]]
    }

    /// Distance of a point from it, metres.
    #[must_use]
    pub fn distance_m(&self, point_m: [f64; 2]) -> f64 {
        let (s, c) = self.direction_rad.sin_cos();
        let (dx, dy) = (point_m[0] - self.centre_m[0], point_m[1] - self.centre_m[1]);
        let along = (dx * c + dy * s).abs() - 0.5 * self.length_m;
        (dy * c - dx * s).hypot(along.max(0.0))
    }
}

/// One damage.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Damage {
    /// Identity; counts up from 1, never used twice.
    pub id: u64,
    /// What is known of it now.
    pub state: DamageState,
    /// Where it lies.
    pub shape: DamageShape,
    /// Largest drop of the image within it when it was at its worst, image units (relative drop of conductivity).
    pub depth: f64,
    /// Drop of the image summed over its area when it was at its worst, image units times m^2.
    pub volume_m2: f64,
    /// Share of the worst that is left: 1 for a damage that has not healed, 0 where nothing is left. Its healing has come
    /// `1 - share` of the way.
    pub share: f64,
    /// Depth over the noise of the averaged image when it was last measured.
    pub significance: f64,
    /// When it was first seen, nanoseconds on the frames' axis.
    pub since_ns: u64,
    /// When it was last seen with nothing touching the skin.
    pub confirmed_ns: u64,
}

impl Damage {
    /// True where it is believed to be there, seen or covered.
    #[must_use]
    pub fn is_open(&self) -> bool {
        matches!(self.state, DamageState::Confirmed | DamageState::Covered | DamageState::Healing)
    }
}

/// Something that happened to a damage.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DamageEvent {
    /// It is believed from now on.
    Begin(Damage),
    /// It has grown, has begun to heal or has opened again.
    Update(Damage),
    /// Something presses on it.
    Covered(Damage),
    /// Nothing presses on it any more, and it is seen again.
    Uncovered(Damage),
    /// Nothing, or only a scar, is left of it.
    Healed(Damage),
}

impl DamageEvent {
    /// The damage as it is after the event.
    #[must_use]
    pub fn damage(&self) -> &Damage {
        match self {
            Self::Begin(damage)
            | Self::Update(damage)
            | Self::Covered(damage)
            | Self::Uncovered(damage)
            | Self::Healed(damage) => damage,
        }
    }

    /// The word for it in files and streams.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Begin(_) => "begin",
            Self::Update(_) => "update",
            Self::Covered(_) => "covered",
            Self::Uncovered(_) => "uncovered",
            Self::Healed(_) => "healed",
        }
    }
}

/// Thresholds and times of a [`DamageMonitor`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DamageParams {
    /// Damage is suspected below minus this many standard deviations of the averaged image. Above 0.
    pub begin_sigma: f64,
    /// No damage is shallower than this, image units. Above 0.
    pub smallest_depth: f64,
    /// Nor shallower than this part of the largest rise in the image: below stand side lobes. From 0 to 1.
    pub lobe_share: f64,
    /// Nothing is judged for so long after a touch, seconds: the material relaxes. At least 0.
    pub settle_s: f64,
    /// What is seen for so long in free frames is believed, seconds. At least 0.
    pub confirm_s: f64,
    /// Time constant of the mean over free frames, seconds. Above 0.
    pub average_s: f64,
    /// Below this share of its worst a damage is healing. From `healed_share` to 1.
    pub healing_share: f64,
    /// Below this it is healed. From 0 to 1.
    pub healed_share: f64,
    /// A touch covers what lies within its radius and so much more, metres. At least 0.
    pub reach_m: f64,
    /// Standard deviation, along an axis, of the region that a damage of no extent makes in the image, metres. At least 0.
    pub point_spread_m: f64,
    /// At most so many damages are kept, from 1 to 16.
    pub most: usize,
}

impl Default for DamageParams {
    /// For a skin of the size of a hand at 10 to 1,000 frames a second.
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
