//! Settings in a skin file for turning images into touches.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;

/// Settings for turning images into touches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TouchSettings {
    /// Touches begin above this many standard deviations of the image noise.
    pub begin_sigma: f64,
    /// Touches end below this many standard deviations of the image noise.
    pub hold_sigma: f64,
    /// Peaks below this share of the strongest one count as side lobes.
    pub side_lobe_share: f64,
    /// Minimum amplitude (relative conductivity change) of a touch.
    pub smallest_amplitude: f64,
    /// Minimum duration of a touch, frames.
    pub least_frames: u32,
    /// Also find changes of the opposite sign (tanks).
    pub both_signs: bool,
    /// Channel noise to assume if none was measured, as a share of the largest voltage.
    pub assumed_noise_share: f64,
    /// Size of a touch assumed in calibration and localisation: standard deviation of a Gaussian, relative to half
    /// the shorter side of the skin.
    pub relative_size: f64,
    /// Position error that noise does not explain, mm.
    pub position_floor_mm: f64,
    /// Standard deviation of each coordinate due to model error, mm. The sigma of every touch combines it with noise.
    /// Default: a share of half the shorter side. A calibration by pokes has its own value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model_error_mm: Option<f64>,
    /// Ignored: presses on a sandwich are fitted through the layer's law of contact. Accepted as `refine` is.
    #[serde(default, skip_serializing)]
    #[schemars(skip)]
    pub(crate) contact_s_per_m2: Option<f64>,
    /// Ignored: the forward model places touches on every skin. Accepted so that files that still have it open.
    #[serde(default, skip_serializing)]
    #[schemars(skip)]
    pub(crate) refine: Option<bool>,
    /// Sheets, liquids and patches: maximum share of a frame that a fit may leave unexplained beyond the noise. Above
    /// it, touches keep their positions from the image. 1 accepts any fit.
    pub most_unexplained: f64,
    /// Elements above coils: contacts whose elements are at most this many cells apart are one press that moves
    /// several elements, placed by their forces. With 0, every moving element is a touch of its own.
    pub join_cells: f64,
    /// Time constant of the drift compensation, seconds; 0 switches it off. It pauses during a touch.
    pub drift_time_constant_s: f64,
}

impl Default for TouchSettings {
    fn default() -> Self {
        Self {
            begin_sigma: 5.0,
            hold_sigma: 3.0,
            side_lobe_share: 0.4,
            smallest_amplitude: 0.0,
            least_frames: 2,
            both_signs: false,
            assumed_noise_share: 1e-4,
            relative_size: 0.1,
            contact_s_per_m2: None,
            position_floor_mm: 2.0,
            model_error_mm: None,
            refine: None,
            most_unexplained: 1.0,
            join_cells: 0.0,
            drift_time_constant_s: 60.0,
        }
    }
}

impl TouchSettings {
    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        checker.within("touch.hold_sigma", self.hold_sigma, 1e-3, 1e6)?;
        if !(self.begin_sigma >= self.hold_sigma && self.begin_sigma <= 1e6) {
            let value = format!("{} with hold_sigma = {}", self.begin_sigma, self.hold_sigma);
            return Err(checker.refused("touch.begin_sigma", value, "begin_sigma >= hold_sigma, at most 1e6"));
        }
        checker.within("touch.side_lobe_share", self.side_lobe_share, 0.0, 1.0)?;
        checker.within("touch.smallest_amplitude", self.smallest_amplitude, 0.0, 1e6)?;
        checker.count("touch.least_frames", self.least_frames as usize, 1, 1_000_000)?;
        checker.within("touch.assumed_noise_share", self.assumed_noise_share, 1e-12, 0.999)?;
        checker.within("touch.relative_size", self.relative_size, 1e-3, 10.0)?;
        checker.within("touch.position_floor_mm", self.position_floor_mm, 1e-6, 1e4)?;
        if let Some(error) = self.model_error_mm {
            checker.within("touch.model_error_mm", error, 0.0, 1e4)?;
        }
        checker.within("touch.most_unexplained", self.most_unexplained, 0.0, 1.0)?;
        checker.within("touch.join_cells", self.join_cells, 0.0, 100.0)?;
        checker.within("touch.drift_time_constant_s", self.drift_time_constant_s, 0.0, 1e9)
    }
}
