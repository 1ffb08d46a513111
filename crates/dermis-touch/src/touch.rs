//! A touch in one frame, and what happened to it.

use serde::{Deserialize, Serialize};

use crate::contact::ContactSign;
use crate::force::ForceReading;
use crate::hypotheses::PlaceHypothesis;
use crate::touch_load::TouchLoad;

/// Where a touch is in its life.
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

/// What a touch's values in this frame rest on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Observation {
    /// A contact of its own.
    Measured,
    /// A contact shared with other touches: position, amplitude and area are the contact's, not the touch's share of
    /// it.
    Merged,
    /// Nothing: position, amplitude and area are those last seen.
    Missed,
}

/// One touch in one frame. Positions are in the skin's frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Touch {
    /// Identity, from 1 up, in the order of beginning.
    pub id: u64,
    /// Begin, move or end.
    pub phase: TouchPhase,
    /// What the values rest on.
    pub observation: Observation,
    /// Above or below the background.
    pub sign: ContactSign,
    /// Position as measured in the contact.
    pub position_m: [f64; 2],
    /// Covariance of `position_m`, m^2: from the image's noise (the contact's) and, on the diagonal, from what the
    /// model has wrong, where that is known. Zero without either.
    pub covariance_m2: [[f64; 2]; 2],
    /// Position after the Kalman filter; predicted where nothing was seen.
    pub filtered_position_m: [f64; 2],
    /// Velocity after the Kalman filter, m/s. Zero in the frame of the first contact.
    pub velocity_m_per_s: [f64; 2],
    /// The contact's amplitude (not negative), filtered if so configured; image units.
    pub amplitude: f64,
    /// The contact's area, m^2.
    pub area_m2: f64,
    /// The contact's force, where a calibration has read one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<ForceReading>,
    /// The contact's fitted radius, metres, where a forward model placed it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_m: Option<f64>,
    /// The contact's depth or force, where a calibration by pokes has read one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub load: Option<TouchLoad>,
    /// Where else the touch may be, with the probability that it is there instead: where presses at two places far
    /// apart would read about the same. `position_m` is the more probable place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub other_place: Option<PlaceHypothesis>,
    /// Frames since its first contact, that frame included; so the touch begins at `min_age_frames` or later.
    pub age_frames: u32,
    /// Time of its first contact, nanoseconds.
    pub begin_time_ns: u64,
    /// Time of this frame, nanoseconds.
    pub time_ns: u64,
}

/// What happened to a touch in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TouchEvent {
    /// It is there for the first time.
    Begin(Touch),
    /// It is still there, whether it moved or not.
    Move(Touch),
    /// It has gone; its position is the last one seen.
    End(Touch),
}

impl TouchEvent {
    /// The touch that the event is about.
    #[must_use]
    pub fn touch(&self) -> &Touch {
        match self {
            Self::Begin(touch) | Self::Move(touch) | Self::End(touch) => touch,
        }
    }
}
