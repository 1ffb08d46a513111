//! Parameters of an instrument.

use serde::{Deserialize, Serialize};

use super::chain::{DriveSteps, GainRanges, Mains, Multiplexer, Temperature, Timing};
use super::converter::{Converter, converter_or_none};
use super::noise::{Drift, Noise};
use crate::error::{TwinError, check, check_positive};

const RIGHT_ANGLE: f64 = std::f64::consts::FRAC_PI_2;

/// Parameters of an instrument.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentOptions {
    /// Noise of every reading.
    pub noise: Noise,
    /// Slow drift, if any.
    pub drift: Option<Drift>,
    /// Rounding and saturation; with `None` (`"none"` in TOML) there is neither.
    #[serde(with = "converter_or_none")]
    pub converter: Option<Converter>,
    /// Steps of the current source.
    pub drive: Option<DriveSteps>,
    /// Multiplexer on the measurement side.
    pub multiplexer: Option<Multiplexer>,
    /// Amplifier ranges in front of the converter.
    pub gain_ranges: Option<GainRanges>,
    /// Mains pickup.
    pub mains: Option<Mains>,
    /// Gain that depends on temperature.
    pub temperature: Option<Temperature>,
    /// Timing of a scan; with `None` all channels are read at once.
    pub timing: Option<Timing>,
    /// Part of the voltage that is reported.
    pub reading: Reading,
    /// Phase lead of the demodulator's reference, radians, within a right angle. A signed reading is `V cos`, a
    /// complex one also has `V sin` as its imaginary part; a rectifier is unaffected.
    pub phase_error_rad: f64,
}

/// Part of a voltage that an instrument reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reading {
    /// The in-phase voltage, with its sign.
    #[default]
    Signed,
    /// The magnitude only, as behind a rectifier.
    Magnitude,
    /// In-phase and quadrature voltage, each with its own noise; the latter is
    /// [`Instrument::imaginary_v`](super::Instrument::imaginary_v). A resistive skin has no quadrature, so it only
    /// shows the phase error.
    Complex,
}

impl Default for InstrumentOptions {
    fn default() -> Self {
        Self::ideal()
    }
}

impl InstrumentOptions {
    /// An instrument without errors.
    pub fn ideal() -> Self {
        Self {
            noise: Noise { floor_v: 0.0, proportional: 0.0 },
            drift: None,
            converter: None,
            drive: None,
            multiplexer: None,
            gain_ranges: None,
            mains: None,
            temperature: None,
            timing: None,
            reading: Reading::Signed,
            phase_error_rad: 0.0,
        }
    }

    /// Checks the parameters.
    ///
    /// # Errors
    /// Negative noise or drift, fewer than 2 or more than 32 bits, a range or gain that is not positive, or invalid
    /// parts of the chain.
    pub fn check(&self) -> Result<(), TwinError> {
        check("noise floor_v", self.noise.floor_v, 0.0, f64::MAX, "zero or more, finite")?;
        check("noise proportional", self.noise.proportional, 0.0, f64::MAX, "zero or more, finite")?;
        if let Some(drift) = self.drift {
            check("drift common_per_sqrt_s", drift.common_per_sqrt_s, 0.0, f64::MAX, "zero or more, finite")?;
            check("drift channel_per_sqrt_s", drift.channel_per_sqrt_s, 0.0, f64::MAX, "zero or more, finite")?;
        }
        if let Some(converter) = self.converter {
            check("converter bits", f64::from(converter.bits), 2.0, 32.0, "2 to 32")?;
            check_positive("converter range_v", converter.range_v)?;
            check_positive("converter gain", converter.gain)?;
        }
        check("phase_error_rad", self.phase_error_rad, -RIGHT_ANGLE, RIGHT_ANGLE, "within a right angle")?;
        self.check_chain()
    }

    /// Checks the parts between skin and converter.
    fn check_chain(&self) -> Result<(), TwinError> {
        if let Some(drive) = self.drive {
            check_positive("drive wanted_a", drive.wanted_a)?;
            check_positive("drive step_a", drive.step_a)?;
            check("drive most_a", drive.most_a, drive.step_a, f64::MAX, "one step or more, finite")?;
        }
        if let Some(mux) = self.multiplexer {
            check("multiplexer on_resistance_ohm", mux.on_resistance_ohm, 0.0, f64::MAX, "zero or more, finite")?;
            check_positive("multiplexer input_resistance_ohm", mux.input_resistance_ohm)?;
            check("multiplexer input_capacitance_f", mux.input_capacitance_f, 0.0, f64::MAX, "zero or more, finite")?;
            check("multiplexer crosstalk", mux.crosstalk, 0.0, 0.5, "0 to 0.5")?;
        }
        if let Some(ranges) = self.gain_ranges {
            check("gain_ranges factor", ranges.factor, 1.0 + 1e-9, 1e6, "above 1, at most 1e6")?;
            check("gain_ranges count", f64::from(ranges.count), 1.0, 16.0, "1 to 16")?;
        }
        if let Some(mains) = self.mains {
            check("mains amplitude_v", mains.amplitude_v, 0.0, f64::MAX, "zero or more, finite")?;
            check_positive("mains frequency_hz", mains.frequency_hz)?;
            check("mains phase_rad", mains.phase_rad, f64::MIN, f64::MAX, "finite")?;
        }
        if let Some(t) = self.temperature {
            check("temperature coefficient_per_k", t.coefficient_per_k, f64::MIN, f64::MAX, "finite")?;
            check("temperature rise_k", t.rise_k, f64::MIN, f64::MAX, "finite")?;
            check_positive("temperature warm_up_s", t.warm_up_s)?;
            check("temperature swing_k", t.swing_k, f64::MIN, f64::MAX, "finite")?;
            check_positive("temperature swing_period_s", t.swing_period_s)?;
        }
        self.timing.as_ref().map_or(Ok(()), Timing::check)
    }

    /// Applies rectifier, amplifier range and converter.
    pub(super) fn convert(&self, voltage_v: f64) -> f64 {
        let voltage_v = if self.reading == Reading::Magnitude { voltage_v.abs() } else { voltage_v };
        let Some(converter) = self.converter else { return voltage_v };
        let full_scale_v = converter.range_v / converter.gain;
        let extra = self.gain_ranges.map_or(1.0, |ranges| ranges.gain(voltage_v.abs(), full_scale_v));
        Converter { gain: converter.gain * extra, ..converter }.read_v(voltage_v)
    }
}
