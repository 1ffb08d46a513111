//! Parameters for tracking contacts as touches.

use serde::{Deserialize, Serialize};

use crate::contact::Contact;
use crate::error::{TouchError, require};

/// Which position of a contact is tracked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PositionSource {
    /// [`Contact::centroid_m`].
    #[default]
    Centroid,
    /// [`Contact::peak_m`].
    Peak,
}

impl PositionSource {
    /// This position of `contact`, metres.
    #[must_use]
    pub fn of(self, contact: &Contact) -> [f64; 2] {
        match self {
            Self::Centroid => contact.centroid_m,
            Self::Peak => contact.peak_m,
        }
    }
}

/// Parameters of a [`Tracker`](crate::Tracker). Frames are those given to
/// [`Tracker::update`](crate::Tracker::update); speeds and times are in seconds of its time axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackerParams {
    /// Number of strong contacts with which a touch begins. At least 1.
    pub min_age_frames: u32,
    /// Maximum number of frames a touch may be missed before it ends. 0 ends it with the first frame without it.
    pub max_missed_frames: u32,
    /// Maximum number of frames that touches stay merged; then only the oldest continues.
    pub max_merged_frames: u32,
    /// Maximum number of consecutive frames that touches stay merged while their contact is known to be a single
    /// touch. 0 never merges a touch into such a contact.
    pub max_merged_single_frames: u32,
    /// Gate on the Mahalanobis distance of a contact from a touch's prediction. Above 0.
    pub gate_sigma: f64,
    /// Gate on the distance of a contact from a touch's prediction, metres. Above 0.
    pub gate_max_m: f64,
    /// A vanished touch may merge with a visible contact within this many of that contact's radii. At least 0; 0
    /// never merges.
    pub merge_radii: f64,
    /// Standard deviation added to every measured position, metres, for errors other than noise. Above 0.
    pub position_floor_m: f64,
    /// Spectral density of a touch's acceleration, m^2/s^3: (change of speed)^2 over the time it takes. At least 0.
    pub acceleration_density_m2_per_s3: f64,
    /// Standard deviation of a new touch's speed, m/s. At least 0.
    pub initial_speed_m_per_s: f64,
    /// For this long after merging, touches are expected to continue at their velocity; later, to reappear where they
    /// merged. Seconds, at least 0.
    pub velocity_memory_s: f64,
    /// Time constant of a first-order filter on the amplitude, seconds, above 0; `None` leaves it unfiltered.
    pub amplitude_time_constant_s: Option<f64>,
    /// Which position is tracked.
    pub position: PositionSource,
}

impl Default for TrackerParams {
    /// Suits a skin the size of a hand at 10 to 1,000 frames a second.
    fn default() -> Self {
        Self {
            min_age_frames: 2,
            max_missed_frames: 3,
            max_merged_frames: 50,
            max_merged_single_frames: 6,
            gate_sigma: 4.0,
            gate_max_m: 0.04,
            merge_radii: 1.5,
            position_floor_m: 0.002,
            acceleration_density_m2_per_s3: 0.1,
            initial_speed_m_per_s: 0.3,
            velocity_memory_s: 1.5,
            amplitude_time_constant_s: None,
            position: PositionSource::Centroid,
        }
    }
}

impl TrackerParams {
    /// Checks every field against its range.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] naming the field.
    pub fn validate(&self) -> Result<(), TouchError> {
        let above = |name, x: f64| require(x.is_finite() && x > 0.0, name, x, "finite and above 0");
        let at_least = |name, x: f64| require(x.is_finite() && x >= 0.0, name, x, "finite and at least 0");
        require(self.min_age_frames > 0, "min_age_frames", f64::from(self.min_age_frames), "at least 1")?;
        above("gate_sigma", self.gate_sigma)?;
        above("gate_max_m", self.gate_max_m)?;
        at_least("merge_radii", self.merge_radii)?;
        above("position_floor_m", self.position_floor_m)?;
        at_least("acceleration_density_m2_per_s3", self.acceleration_density_m2_per_s3)?;
        at_least("initial_speed_m_per_s", self.initial_speed_m_per_s)?;
        at_least("velocity_memory_s", self.velocity_memory_s)?;
        self.amplitude_time_constant_s.map_or(Ok(()), |tau| above("amplitude_time_constant_s", tau))
    }
}
