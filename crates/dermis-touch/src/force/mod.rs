//! Force of a touch from a calibration by presses of known force. Where the layer's law gives a force, the calibration
//! corrects it ([`LawCorrection`]). Elsewhere it is a curve of the touch's signal ([`SignalCurve`]). A reading outside
//! the calibrated range says so. A calibration belongs to one skin and one indenter area, which are saved with it.
//!
//! Forces in newtons, positions in metres in the skin's frame, signals in any unit, as long as it is the same.

mod curve;
mod gain;
mod law;
mod reading;
mod sample;
mod signal;

pub use curve::{Curve, CurveKind};
pub use gain::GainMap;
pub use law::LawCorrection;
pub use reading::ForceReading;
pub use sample::ForceSample;
pub use signal::SignalCurve;

use serde::{Deserialize, Serialize};

use crate::error::{TouchError, require};

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

    /// Fits a correction of the layer's law to the presses that have a force by it. Touches without such a force use
    /// the curve of `curve`, a calibration without the law, if there is one.
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

    /// Marks this calibration as made on a twin. Presses on a twin cannot show how far the law is off on the real skin,
    /// so forces stay at least as uncertain as by the law alone.
    #[must_use]
    pub fn of_twin(mut self) -> Self {
        if let Some(law) = &mut self.law {
            law.spread = law.spread.max(1.0);
        }
        self
    }

    /// Force of a touch, from its force by the layer's law (with standard deviation, newtons) if known, otherwise from
    /// its signal; `None` if the calibration covers neither.
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
