//! Force from a touch's signal: a calibration curve (linear, quadratic or monotone), a gain map that equalises the
//! skin, and the range in which they hold. A reading outside the calibrated range says so. A calibration belongs to
//! one skin and one indenter area, which are saved with it.
//!
//! Forces in newtons, positions in metres in the skin's frame, signals in any one unit.

mod curve;
mod gain;

pub use curve::{Curve, CurveKind};
pub use gain::GainMap;

use serde::{Deserialize, Serialize};

use crate::error::{TouchError, require};

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
}

/// The skin and indenter that a calibration is valid for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationScope {
    /// Name of the skin, as in its file.
    pub skin: String,
    /// Area of the indenter, m^2: signals depend on it.
    pub indenter_area_m2: f64,
    /// Date of calibration, as `2026-01-31`; stored but not interpreted.
    pub date: String,
}

/// A force calibration. Save it with serde, and run [`ForceCalibration::check`] after loading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceCalibration {
    /// Skin, indenter, date.
    pub scope: CalibrationScope,
    /// Force against compensated signal.
    pub curve: Curve,
    /// Gain over the surface, if compensated.
    pub gain: Option<GainMap>,
    /// Range of compensated signals in the calibration.
    pub valid_signal: [f64; 2],
    /// Range of forces in the calibration, newtons.
    pub valid_force_n: [f64; 2],
    /// Compensated signal above which the curve is too flat to distinguish forces, if any.
    pub saturation_signal: Option<f64>,
    /// RMS error of the curve over the samples, newtons.
    pub residual_n: f64,
    /// Number of samples fitted.
    pub samples: usize,
}

/// A force, or the reason why there is no reliable one. Out-of-range readings carry the force at that end of the
/// curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForceReading {
    /// Within the calibrated range, newtons.
    Valid {
        /// The force.
        force_n: f64,
    },
    /// Weaker than the weakest calibrated press.
    BelowRange {
        /// The smallest calibrated force. The true force is probably smaller.
        least_n: f64,
    },
    /// Stronger than the strongest calibrated press.
    AboveRange {
        /// The largest calibrated force. The true force is probably larger.
        most_n: f64,
    },
    /// The skin hardly responds to more force.
    Saturated {
        /// Force at the onset of saturation. The true force is probably larger.
        from_n: f64,
    },
    /// The signal is not a finite number.
    NotFinite,
    /// Not calibrated: estimated from the layer's force law in the skin file, newtons.
    FromLaw {
        /// The force.
        force_n: f64,
        /// Its standard deviation.
        sigma_n: f64,
    },
}

impl ForceReading {
    /// The force, if it is reliable.
    #[must_use]
    pub fn valid_n(self) -> Option<f64> {
        if let Self::Valid { force_n } = self { Some(force_n) } else { None }
    }

    /// The force, or the end of the range that it exceeds ([`ForceReading::range`] says which).
    #[must_use]
    pub fn nearest_n(self) -> Option<f64> {
        match self {
            Self::Valid { force_n } => Some(force_n),
            Self::BelowRange { least_n } => Some(least_n),
            Self::AboveRange { most_n } => Some(most_n),
            Self::Saturated { from_n } => Some(from_n),
            Self::FromLaw { force_n, .. } => Some(force_n),
            Self::NotFinite => None,
        }
    }

    /// Standard deviation, newtons. Known only for forces from the layer's force law.
    #[must_use]
    pub fn sigma_n(self) -> Option<f64> {
        if let Self::FromLaw { sigma_n, .. } = self { Some(sigma_n) } else { None }
    }

    /// Position of the signal in the calibration: `within`, `below`, `above`, `saturated` or `none`; `law` if there
    /// is no calibration and the layer's force law gives the force.
    #[must_use]
    pub fn range(self) -> &'static str {
        match self {
            Self::Valid { .. } => "within",
            Self::BelowRange { .. } => "below",
            Self::AboveRange { .. } => "above",
            Self::Saturated { .. } => "saturated",
            Self::FromLaw { .. } => "law",
            Self::NotFinite => "none",
        }
    }
}

impl ForceCalibration {
    /// Fits a curve to presses, after dividing their signals by the local gain.
    ///
    /// # Errors
    /// Too few samples for the curve, values that are not finite, negative forces or a negative indenter area, a
    /// curve that does not rise over the range of the samples.
    pub fn fit(
        kind: CurveKind,
        samples: &[ForceSample],
        gain: Option<GainMap>,
        scope: CalibrationScope,
    ) -> Result<Self, TouchError> {
        check_samples(samples)?;
        check_area(scope.indenter_area_m2)?;
        let compensate = |s: &ForceSample| s.signal / gain.as_ref().map_or(1.0, |map| map.gain_at(s.position_m));
        let mut points: Vec<(f64, f64)> = samples.iter().map(|s| (compensate(s), s.force_n)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let curve = Curve::fit(kind, &points)?;
        let valid_signal = [points[0].0, points[points.len() - 1].0];
        curve.check_rising(valid_signal)?;
        let squares: f64 = points.iter().map(|(signal, force)| (curve.force_n(*signal) - force).powi(2)).sum();
        Ok(Self {
            saturation_signal: curve.saturation(valid_signal),
            valid_force_n: valid_signal.map(|signal| curve.force_n(signal)),
            residual_n: (squares / points.len() as f64).sqrt(),
            samples: points.len(),
            scope,
            curve,
            gain,
            valid_signal,
        })
    }

    /// The force for a signal at a position.
    #[must_use]
    pub fn read(&self, position_m: [f64; 2], signal: f64) -> ForceReading {
        let signal = signal / self.gain.as_ref().map_or(1.0, |map| map.gain_at(position_m));
        if !signal.is_finite() {
            return ForceReading::NotFinite;
        }
        if signal < self.valid_signal[0] {
            return ForceReading::BelowRange { least_n: self.valid_force_n[0] };
        }
        if let Some(from) = self.saturation_signal
            && signal >= from
        {
            return ForceReading::Saturated { from_n: self.curve.force_n(from) };
        }
        if signal > self.valid_signal[1] {
            return ForceReading::AboveRange { most_n: self.valid_force_n[1] };
        }
        ForceReading::Valid { force_n: self.curve.force_n(signal) }
    }

    /// Checks a loaded calibration, and that it is for this skin.
    ///
    /// # Errors
    /// [`TouchError::OtherSkin`] for another skin; other errors for invalid numbers.
    pub fn check(&self, skin: &str) -> Result<(), TouchError> {
        if self.scope.skin != skin {
            return Err(TouchError::OtherSkin { expected: skin.to_owned(), got: self.scope.skin.clone() });
        }
        check_area(self.scope.indenter_area_m2)?;
        let [low, high] = self.valid_signal;
        require(low.is_finite() && high.is_finite() && low < high, "valid_signal", high, "finite and ascending")?;
        self.curve.check()?;
        self.gain.as_ref().map_or(Ok(()), GainMap::check)?;
        self.curve.check_rising(self.valid_signal)
    }
}

fn check_area(area_m2: f64) -> Result<(), TouchError> {
    require(area_m2.is_finite() && area_m2 > 0.0, "indenter_area_m2", area_m2, "positive and finite")
}

fn check_samples(samples: &[ForceSample]) -> Result<(), TouchError> {
    for (index, sample) in samples.iter().enumerate() {
        let sum = sample.position_m[0] + sample.position_m[1] + sample.force_n + sample.signal;
        if !sum.is_finite() {
            return Err(TouchError::NonFinite { what: "force samples", index, value: sum });
        }
        require(sample.force_n >= 0.0, "force_n", sample.force_n, "zero or more")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
