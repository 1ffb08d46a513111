//! Force from the height of a touch's peak in the image, by a curve and a gain over the surface.

use serde::{Deserialize, Serialize};

use super::curve::{Curve, CurveKind};
use super::gain::GainMap;
use super::reading::ForceReading;
use super::sample::ForceSample;
use crate::error::{TouchError, require};

/// A curve of the signal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalCurve {
    /// Force against compensated signal.
    pub curve: Curve,
    /// Gain over the surface, if compensated.
    pub gain: Option<GainMap>,
    /// Range of compensated signals in the calibration.
    pub valid_signal: [f64; 2],
    /// Compensated signal above which the curve is too flat to distinguish forces, if any.
    pub saturation_signal: Option<f64>,
    /// Root mean square error of the presses fitted, newtons.
    pub residual_n: f64,
}

impl SignalCurve {
    /// Fits samples.
    pub(super) fn fit(kind: CurveKind, samples: &[ForceSample], gain: Option<GainMap>) -> Result<Self, TouchError> {
        let compensate = |s: &ForceSample| s.signal / gain.as_ref().map_or(1.0, |map| map.gain_at(s.position_m));
        let mut points: Vec<(f64, f64)> = samples.iter().map(|s| (compensate(s), s.force_n)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let curve = Curve::fit(kind, &points)?;
        let valid_signal = [points[0].0, points[points.len() - 1].0];
        curve.check_rising(valid_signal)?;
        let squares: f64 = points.iter().map(|(signal, force)| (curve.force_n(*signal) - force).powi(2)).sum();
        let saturation_signal = curve.saturation(valid_signal);
        let residual_n = (squares / points.len() as f64).sqrt();
        Ok(Self { curve, gain, valid_signal, saturation_signal, residual_n })
    }

    /// Forces at the ends of the range, newtons.
    pub(super) fn valid_force_n(&self) -> [f64; 2] {
        self.valid_signal.map(|signal| self.curve.force_n(signal))
    }

    /// The force for a signal at a position.
    pub(super) fn read(&self, position_m: [f64; 2], signal: f64) -> ForceReading {
        let signal = signal / self.gain.as_ref().map_or(1.0, |map| map.gain_at(position_m));
        let [least_n, most_n] = self.valid_force_n();
        if !signal.is_finite() {
            return ForceReading::NotFinite;
        }
        if signal < self.valid_signal[0] {
            return ForceReading::BelowRange { least_n };
        }
        if let Some(from) = self.saturation_signal
            && signal >= from
        {
            return ForceReading::Saturated { from_n: self.curve.force_n(from) };
        }
        if signal > self.valid_signal[1] {
            return ForceReading::AboveRange { most_n };
        }
        ForceReading::Valid { force_n: self.curve.force_n(signal), sigma_n: self.residual_n }
    }

    /// Checks a loaded curve.
    pub(super) fn check(&self) -> Result<(), TouchError> {
        let [low, high] = self.valid_signal;
        require(low.is_finite() && high.is_finite() && low < high, "valid_signal", high, "finite and ascending")?;
        self.curve.check()?;
        self.gain.as_ref().map_or(Ok(()), GainMap::check)?;
        self.curve.check_rising(self.valid_signal)
    }
}
