//! A touch in one frame.

use serde::{Deserialize, Serialize};

use crate::contact::ContactSign;
use crate::contact::TouchLoad;
use crate::force::ForceReading;
use crate::hypotheses::PlaceHypothesis;

/// Phase of a touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TouchPhase {
    /// Its first frame.
    Begin,
    /// Any frame between.
    Move,
    /// Its last frame, in which it is no longer on the skin.
    End,
}

/// Source of a touch's values in this frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Observation {
    /// Its own contact.
    Measured,
    /// A contact shared with other touches. Position, amplitude and area are the contact's, not the touch's share of
    /// it.
    Merged,
    /// Not seen. Position, amplitude and area are the last ones measured.
    Missed,
}

/// One touch in one frame. Positions are in the skin's frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Touch {
    /// Identity, counting up from 1 in order of beginning.
    pub id: u64,
    /// Begin, move or end.
    pub phase: TouchPhase,
    /// Source of the values.
    pub observation: Observation,
    /// Sign of the contact.
    pub sign: ContactSign,
    /// Position as measured in the contact.
    pub position_m: [f64; 2],
    /// Covariance of `position_m`, m^2: from the image's noise (the contact's) plus, on the diagonal, from model
    /// error if that is known. Zero without either.
    pub covariance_m2: [[f64; 2]; 2],
    /// Position after the Kalman filter; predicted if the touch was not seen.
    pub filtered_position_m: [f64; 2],
    /// Velocity after the Kalman filter, m/s. Zero in the frame of the first contact.
    pub velocity_m_per_s: [f64; 2],
    /// The contact's amplitude (not negative), filtered if so configured; image units.
    pub amplitude: f64,
    /// The contact's area, m^2. Sandwiches fit it; on other skins, it is the area of the image above half its peak.
    pub area_m2: f64,
    /// The contact's force, if a calibration has estimated one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<ForceReading>,
    /// The contact's fitted radius, metres, if a forward model located it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_m: Option<f64>,
    /// The contact's depth or force, if a calibration by pokes has estimated one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub load: Option<TouchLoad>,
    /// Another possible position, with the probability that the touch is there instead. Given if presses at two
    /// distant positions would read about the same. `position_m` is the more probable one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub other_place: Option<PlaceHypothesis>,
    /// Frames since its first contact, including that one. A touch therefore begins at `min_age_frames` or later.
    pub age_frames: u32,
    /// Time of its first contact, nanoseconds.
    pub begin_time_ns: u64,
    /// Time of this frame, nanoseconds.
    pub time_ns: u64,
}

impl Touch {
    /// The fitted radius, or else the radius of a disc of the touch's area, metres; `None` if neither is known.
    pub fn footprint_radius_m(&self) -> Option<f64> {
        let radius_m = self.radius_m.unwrap_or((self.area_m2 / std::f64::consts::PI).sqrt());
        (radius_m.is_finite() && radius_m > 0.0).then_some(radius_m)
    }
}
