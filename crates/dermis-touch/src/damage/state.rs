//! State of a damage site, and events in its life.

use serde::{Deserialize, Serialize};

/// State of a damage site.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DamageState {
    /// Seen, but not for long enough to be confirmed. No event has reported it yet.
    Suspected,
    /// Confirmed, and seen whenever nothing touches the skin.
    Confirmed,
    /// Something presses on it, or did a moment ago, and hides it in the image.
    Covered,
    /// Less of it is left than before.
    Healing,
    /// Gone, except perhaps for a scar.
    Healed,
}

impl DamageState {
    /// Name of the state in files and streams.
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

/// Position and extent of a damage site: a line segment, or a spot if `length_m` is 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DamageShape {
    /// Centre, in the skin's frame, metres.
    pub centre_m: [f64; 2],
    /// Length, metres, at least 0.
    pub length_m: f64,
    /// Width, metres, at least 0; 0 if it cannot be resolved.
    pub width_m: f64,
    /// Direction, counter-clockwise from +x, radians, above -pi/2 and at most pi/2.
    pub direction_rad: f64,
    /// Standard deviations of the centre in x and y, of length and of direction (metres, metres, metres, radians), if
    /// a model was fitted. `None` if the shape comes from the image alone.
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

    /// Distance of a point from the shape, metres.
    #[must_use]
    pub fn distance_m(&self, point_m: [f64; 2]) -> f64 {
        let (s, c) = self.direction_rad.sin_cos();
        let (dx, dy) = (point_m[0] - self.centre_m[0], point_m[1] - self.centre_m[1]);
        let along = (dx * c + dy * s).abs() - 0.5 * self.length_m;
        (dy * c - dx * s).hypot(along.max(0.0))
    }
}

/// One damage site.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Damage {
    /// Identity; counts up from 1, never reused.
    pub id: u64,
    /// Its current state.
    pub state: DamageState,
    /// Its position and extent.
    pub shape: DamageShape,
    /// Largest drop of the image within it at its worst, image units (relative drop of conductivity).
    pub depth: f64,
    /// Drop of the image integrated over its area at its worst, image units times m^2.
    pub volume_m2: f64,
    /// Share of the worst that is left: 1 if nothing has healed, 0 if nothing is left. Healing progress is
    /// `1 - share`.
    pub share: f64,
    /// Depth over the noise of the averaged image, when it was last measured.
    pub significance: f64,
    /// When it was first seen, nanoseconds on the time axis of the frames.
    pub since_ns: u64,
    /// When it was last seen with nothing touching the skin.
    pub confirmed_ns: u64,
}

impl Damage {
    /// True if it is believed to exist, visible or covered.
    #[must_use]
    pub fn is_open(&self) -> bool {
        matches!(self.state, DamageState::Confirmed | DamageState::Covered | DamageState::Healing)
    }
}

/// An event in the life of a damage site.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DamageEvent {
    /// It has been confirmed.
    Begin(Damage),
    /// It has grown, begun to heal or reopened.
    Update(Damage),
    /// Something presses on it.
    Covered(Damage),
    /// Nothing presses on it any more, and it is visible again.
    Uncovered(Damage),
    /// It is gone, except perhaps for a scar.
    Healed(Damage),
}

impl DamageEvent {
    /// The damage site after the event.
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

    /// Name of the event in files and streams.
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
