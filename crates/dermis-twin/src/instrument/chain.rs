//! Parts of the chain between skin and converter: stepped current source, multiplexer, gain ranges, mains pickup,
//! temperature, and scan timing.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

use crate::error::{TwinError, check};

/// A current source limited to multiples of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveSteps {
    /// Requested amplitude, to which the true voltages belong, amperes.
    pub wanted_a: f64,
    /// Step, amperes.
    pub step_a: f64,
    /// Maximum amplitude, amperes.
    pub most_a: f64,
}

impl DriveSteps {
    /// Actual amplitude: the nearest multiple of the step that the source can produce, amperes.
    pub fn actual_a(&self) -> f64 {
        // The margin accepts a maximum amplitude that is a whole number of steps.
        let most = (self.most_a / self.step_a + 1e-9).floor();
        (self.wanted_a / self.step_a).round().min(most) * self.step_a
    }
}

/// The analogue multiplexer on the measurement side. Its on-resistance R and the converter's input divide the voltage
/// by `1 + R / input_resistance_ohm`; the input capacitance C retains a share `exp(-settling / (R C))` of the
/// previous channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Multiplexer {
    /// On-resistance, ohm.
    pub on_resistance_ohm: f64,
    /// Input resistance behind the multiplexer, ohm.
    pub input_resistance_ohm: f64,
    /// Capacitance behind the multiplexer, farads.
    pub input_capacitance_f: f64,
    /// Share of the difference from each neighbour in scan order that couples into a channel.
    pub crosstalk: f64,
}

impl Multiplexer {
    /// Share of the voltage transmitted.
    pub fn transmission(&self) -> f64 {
        1.0 / (1.0 + self.on_resistance_ohm / self.input_resistance_ohm)
    }

    /// Share of the previous channel's voltage left after settling.
    pub fn residue(&self, settling_s: f64) -> f64 {
        let constant_s = self.on_resistance_ohm * self.input_capacitance_f;
        if constant_s > 0.0 { (-settling_s / constant_s).exp() } else { 0.0 }
    }

    /// Output of the multiplexer, in place, channels in scan order. The first channel follows `last_v`, the last
    /// channel of the previous frame.
    pub(super) fn pass(&self, settling_s: f64, last_v: f64, voltages_v: &mut [f64]) {
        let (transmission, residue) = (self.transmission(), self.residue(settling_s));
        let (mut before, mut kept) = (last_v, last_v);
        for index in 0..voltages_v.len() {
            let own = voltages_v[index];
            let after = voltages_v.get(index + 1).copied().unwrap_or(own);
            let coupled = transmission * (own + self.crosstalk * (before - own + after - own));
            kept = coupled + residue * (kept - coupled);
            (before, voltages_v[index]) = (own, kept);
        }
    }
}

/// Amplifier ranges: `count` gains, each `factor` times the one before, starting at the converter's own gain. Every
/// reading uses the largest gain that its magnitude fits in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GainRanges {
    /// Ratio of successive gains, above 1.
    pub factor: f64,
    /// Number of ranges, 1 to 16.
    pub count: u32,
}

impl GainRanges {
    /// Extra gain for a magnitude, where `full_scale_v` is the range without extra gain.
    pub fn gain(&self, magnitude_v: f64, full_scale_v: f64) -> f64 {
        let gains = (1..self.count).map(|range| self.factor.powi(range as i32));
        gains.take_while(|gain| magnitude_v * gain < full_scale_v).last().unwrap_or(1.0)
    }
}

/// Mains voltage picked up by every channel, `amplitude sin(2 pi f t + phase)` at the channel's own time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mains {
    /// Amplitude, referred to the skin, volts.
    pub amplitude_v: f64,
    /// Frequency, 50 or 60 Hz.
    pub frequency_hz: f64,
    /// Phase at time 0, radians.
    pub phase_rad: f64,
}

impl Mains {
    /// Voltage at a time.
    pub fn at_v(&self, time_s: f64) -> f64 {
        self.amplitude_v * (TAU * self.frequency_hz * time_s + self.phase_rad).sin()
    }
}

/// Gain that depends on temperature: warm-up after power-on, and slow swings of the room temperature.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Temperature {
    /// Relative change of every voltage per kelvin.
    pub coefficient_per_k: f64,
    /// Final temperature rise of the warm-up, kelvin.
    pub rise_k: f64,
    /// Time constant of the warm-up, seconds.
    pub warm_up_s: f64,
    /// Amplitude of the swing, kelvin.
    pub swing_k: f64,
    /// Period of the swing, seconds.
    pub swing_period_s: f64,
}

impl Temperature {
    /// Temperature above the start, kelvin: `rise (1 - exp(-t / warm_up)) + swing sin(2 pi t / period)`.
    pub fn above_start_k(&self, time_s: f64) -> f64 {
        self.rise_k * (1.0 - (-time_s / self.warm_up_s).exp())
            + self.swing_k * (TAU * time_s / self.swing_period_s).sin()
    }
}

/// Timing of a scan, one channel after another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Settling time after switching to a channel, seconds.
    pub settling_s: f64,
    /// Conversion time of a channel, seconds.
    pub conversion_s: f64,
    /// Remaining time of a frame (transfer), seconds.
    pub frame_overhead_s: f64,
}

impl Timing {
    /// Time from the start of one frame to the next.
    pub fn frame_period_s(&self, channels: usize) -> f64 {
        channels as f64 * (self.settling_s + self.conversion_s) + self.frame_overhead_s
    }

    /// Midpoint of a channel's conversion, relative to the start of the frame.
    pub fn channel_time_s(&self, channel: usize) -> f64 {
        channel as f64 * (self.settling_s + self.conversion_s) + self.settling_s + 0.5 * self.conversion_s
    }

    pub(super) fn check(&self) -> Result<(), TwinError> {
        let expected = "zero or more, finite";
        check("timing settling_s", self.settling_s, 0.0, f64::MAX, expected)?;
        check("timing conversion_s", self.conversion_s, 0.0, f64::MAX, expected)?;
        check("timing frame_overhead_s", self.frame_overhead_s, 0.0, f64::MAX, expected)
    }
}
