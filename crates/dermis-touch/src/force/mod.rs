//! Force of a touch from a calibration by presses of known force. Where the layer's law gives a force, the calibration
//! corrects it ([`LawCorrection`]). Elsewhere it is a curve of the touch's signal ([`SignalCurve`]). A reading outside
//! the calibrated range says so. A calibration belongs to one skin and one indenter area, which are saved with it.
//!
//! Forces in newtons, positions in metres in the skin's frame, signals in any one unit.

mod curve;
mod gain;
mod law;
mod signal;

pub use curve::{Curve, CurveKind};
pub use gain::GainMap;
pub use law::LawCorrection;
pub use signal::SignalCurve;

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
    /// Force by the layer's law and its standard deviation, newtons, if the law gives one.
    pub by_law: Option<[f64; 2]>,
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
    /// Correction of the forces by the layer's law, if it states one.
    pub law: Option<LawCorrection>,
    /// Forces of touches without a force by the law; `None` if no curve rises with the signals of the presses.
    pub signal: Option<SignalCurve>,
    /// Range of forces in the calibration, newtons.
    pub valid_force_n: [f64; 2],
    /// Root mean square error, newtons: of presses left out by the law, or of the presses fitted by the curve.
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
        /// Its standard deviation.
        sigma_n: f64,
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
    /// Not calibrated, or outside the calibrated range: estimated from the layer's force law in the skin file, newtons.
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
        if let Self::Valid { force_n, .. } = self { Some(force_n) } else { None }
    }

    /// The force, or the end of the range that it exceeds ([`ForceReading::range`] says which).
    #[must_use]
    pub fn nearest_n(self) -> Option<f64> {
        match self {
            Self::Valid { force_n, .. } => Some(force_n),
            Self::BelowRange { least_n } => Some(least_n),
            Self::AboveRange { most_n } => Some(most_n),
            Self::Saturated { from_n } => Some(from_n),
            Self::FromLaw { force_n, .. } => Some(force_n),
            Self::NotFinite => None,
        }
    }

    /// Standard deviation, newtons; `None` for the end of a range.
    #[must_use]
    pub fn sigma_n(self) -> Option<f64> {
        if let Self::Valid { sigma_n, .. } | Self::FromLaw { sigma_n, .. } = self { Some(sigma_n) } else { None }
    }

    /// Position of the signal in the calibration: `within`, `below`, `above`, `saturated` or `none`; `law` if the
    /// layer's force law gives the force beyond any calibration.
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
        let curve = SignalCurve::fit(kind, samples, gain)?;
        let (valid_force_n, residual_n) = (curve.valid_force_n(), curve.residual_n);
        Ok(Self { scope, law: None, signal: Some(curve), valid_force_n, residual_n, samples: samples.len() })
    }

    /// Fits a correction of the layer's law to the presses that have a force by it. The curve of a calibration without
    /// the law, if there is one, serves touches without a force by the law.
    ///
    /// # Errors
    /// Fewer than two such presses, values that are not finite, forces or an indenter area that are not positive.
    pub fn fit_law(samples: &[ForceSample], curve: Option<Self>, scope: CalibrationScope) -> Result<Self, TouchError> {
        check_samples(samples)?;
        check_area(scope.indenter_area_m2)?;
        let (law, residual_n) = LawCorrection::fit(samples)?;
        let forces_n = || samples.iter().filter(|sample| sample.by_law.is_some()).map(|sample| sample.force_n);
        let valid_force_n = [forces_n().fold(f64::INFINITY, f64::min), forces_n().fold(0.0, f64::max)];
        let signal = curve.and_then(|curve| curve.signal);
        Ok(Self { scope, law: Some(law), signal, valid_force_n, residual_n, samples: forces_n().count() })
    }

    /// The force of a touch with this force by the layer's law (with its standard deviation, newtons), or otherwise with
    /// this signal; `None` if the calibration covers neither.
    #[must_use]
    pub fn read(&self, position_m: [f64; 2], signal: f64, by_law: Option<[f64; 2]>) -> Option<ForceReading> {
        let (Some(law), Some(by_law)) = (&self.law, by_law) else {
            return self.signal.as_ref().map(|curve| curve.read(position_m, signal));
        };
        let [force_n, sigma_n] = law.read(position_m, by_law);
        let [least_n, most_n] = self.valid_force_n;
        Some(match (least_n..=most_n).contains(&force_n) {
            true => ForceReading::Valid { force_n, sigma_n },
            false => ForceReading::FromLaw { force_n, sigma_n },
        })
    }

    /// Radius of the round indenter with the calibration's area, metres, if the calibration corrects the law.
    #[must_use]
    pub fn indenter_m(&self) -> Option<f64> {
        self.law.as_ref().map(|_| (self.scope.indenter_area_m2 / std::f64::consts::PI).sqrt())
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
        self.law.as_ref().map_or(Ok(()), LawCorrection::check)?;
        self.signal.as_ref().map_or(Ok(()), SignalCurve::check)
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
