//! What is known of a damage, and what happened to it.

use serde::{Deserialize, Serialize};

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
    /// Share of the worst that is left: 1 for a damage that has not healed, 0 where nothing is left. Its healing has
    /// come `1 - share` of the way.
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
