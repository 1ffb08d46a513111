//! State of a locator, as plain arrays that can be stored and are checked when read back.

use super::data::{Hyperparameters, LeaveOneOut};
use super::error::{LocatorError, check_finite, check_first, check_length, check_positions};
use super::load::LoadLaw;
use super::posterior::Spread;

/// Format version; a locator with a different version is rejected.
pub const LOCATOR_VERSION: u32 = 1;

/// The stored form of a [`Locator`](super::Locator).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LocatorState {
    pub version: u32,
    /// Map positions, metres.
    pub positions_m: Vec<[f64; 2]>,
    /// Median distance between neighbouring map positions, metres.
    pub spacing_m: f64,
    /// Weight of each channel.
    pub weights: Vec<f64>,
    /// Mean square of each channel of the unit frames.
    pub energy: Vec<f64>,
    /// Number of whitened coordinates.
    pub rank: usize,
    /// Transform from channels to whitened coordinates: `rank` rows of channels.
    pub transform: Vec<f32>,
    /// Whitened signatures: a row of `rank` values for each map position.
    pub signatures: Vec<f32>,
    /// Remaining variance of each signature.
    pub variance: Vec<f64>,
    /// Median amplitude of the examples; the noise is relative to it.
    pub median_amplitude: f64,
    /// 95 % quantile of the misfit of left-out examples.
    pub usual_misfit: f64,
    /// Exponent of the likelihood in the posterior.
    pub temperature: f64,
    /// Factor on the posterior's standard deviations.
    pub sigma_factor: f64,
    /// Standard deviation that a wholly unexplained map adds, metres.
    pub extrapolation_m: f64,
    pub hyperparameters: Hyperparameters,
    /// Noise variance of each example.
    pub example_noise: Vec<f64>,
    pub load: Option<LoadLaw>,
    pub report: LeaveOneOut,
}

impl LocatorState {
    /// Rejects a state whose arrays do not match or hold values no fit produces.
    pub(super) fn check(&self) -> Result<(), LocatorError> {
        if self.version != LOCATOR_VERSION {
            return Err(LocatorError::Version { expected: LOCATOR_VERSION, got: self.version });
        }
        let (positions, channels, examples) = (self.positions_m.len(), self.weights.len(), self.report.examples.len());
        for (field, got) in [("positions_m", positions), ("weights", channels), ("rank", self.rank)] {
            if got == 0 {
                return Err(LocatorError::Count { field, got, expected: "at least 1" });
            }
        }
        check_length("energy", channels, self.energy.len())?;
        check_length("transform", product(self.rank, channels)?, self.transform.len())?;
        check_length("signatures", product(self.rank, positions)?, self.signatures.len())?;
        check_length("variance", positions, self.variance.len())?;
        check_length("example_noise", examples, self.example_noise.len())?;
        check_positions("positions_m", &self.positions_m)?;
        check_single("transform", &self.transform)?;
        check_single("signatures", &self.signatures)?;
        check_not_negative("weights", &self.weights)?;
        check_not_negative("energy", &self.energy)?;
        check_above_zero("variance", &self.variance)?;
        check_above_zero("example_noise", &self.example_noise)?;
        for (field, value) in [
            ("spacing_m", self.spacing_m),
            ("median_amplitude", self.median_amplitude),
            ("usual_misfit", self.usual_misfit),
            ("temperature", self.temperature),
            ("sigma_factor", self.sigma_factor),
        ] {
            check_above_zero(field, &[value])?;
        }
        check_not_negative("extrapolation_m", &[self.extrapolation_m])?;
        check_hyperparameters(&self.hyperparameters)?;
        for example in &self.report.examples {
            check_finite("report position_m", &example.position_m)?;
        }
        if let Some(law) = &self.load {
            check_length("load.log_factor", positions, law.log_factor.len())?;
            check_finite("load.log_factor", &law.log_factor)?;
            check_above_zero("load.exponent", &[law.exponent])?;
            check_not_negative("load.relative_error", &[law.relative_error])?;
        }
        Ok(())
    }

    /// The rule that turns the posterior into sigma.
    pub(super) fn spread(&self) -> Spread {
        Spread { factor: self.sigma_factor, extrapolation_m: self.extrapolation_m }
    }
}

/// Rejects hyperparameters that are out of range.
pub(super) fn check_hyperparameters(hyper: &Hyperparameters) -> Result<(), LocatorError> {
    check_above_zero("length_m", &[hyper.length_m])?;
    check_above_zero("noise", &[hyper.noise])?;
    if !(hyper.shrinkage > 0.0 && hyper.shrinkage <= 1.0) {
        let expected = "a number above 0 and up to 1";
        return Err(LocatorError::Value { field: "shrinkage", index: 0, value: hyper.shrinkage, expected });
    }
    Ok(())
}

fn product(a: usize, b: usize) -> Result<usize, LocatorError> {
    a.checked_mul(b).ok_or(LocatorError::Count { field: "rank", got: a, expected: "a number of whitened coordinates" })
}

fn check_single(field: &'static str, values: &[f32]) -> Result<(), LocatorError> {
    check_first(field, values.iter().map(|v| f64::from(*v)), f64::is_finite, "a finite number")
}

fn check_not_negative(field: &'static str, values: &[f64]) -> Result<(), LocatorError> {
    check_first(field, values.iter().copied(), |v| v.is_finite() && v >= 0.0, "a finite number, zero or above")
}

fn check_above_zero(field: &'static str, values: &[f64]) -> Result<(), LocatorError> {
    check_first(field, values.iter().copied(), |v| v.is_finite() && v > 0.0, "a finite number above zero")
}
