//! Random errors of a reading: white noise `sd^2 = floor^2 + (proportional V)^2` (amplifier, and current source or
//! demodulator), and a slow random walk of the gain, common and per channel.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// White noise of a reading, independent between channels and frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Standard deviation at 0 V, volts at the skin.
    pub floor_v: f64,
    /// Standard deviation proportional to the voltage, per volt.
    pub proportional: f64,
}

impl Noise {
    /// The noise with these signal-to-noise ratios (dB, [`super::snr_db`]) at these two voltages, given the rounding
    /// error `step^2 / 12` of a converter. `None` if no noise matches (the floor would be imaginary).
    pub fn through(low: (f64, f64), high: (f64, f64), converter_step_v: f64) -> Option<Self> {
        let variance = |(voltage, db): (f64, f64)| voltage * voltage * 10_f64.powf(-db / 10.0);
        let squares = (high.0 * high.0, low.0 * low.0);
        let proportional = (variance(high) - variance(low)) / (squares.0 - squares.1);
        let floor = variance(low) - proportional * squares.1 - converter_step_v * converter_step_v / 12.0;
        (proportional >= 0.0 && floor >= 0.0).then(|| Self { floor_v: floor.sqrt(), proportional: proportional.sqrt() })
    }

    /// Standard deviation of a reading at this voltage.
    pub fn deviation_v(&self, voltage_v: f64) -> f64 {
        self.floor_v.hypot(self.proportional * voltage_v)
    }
}

/// Slow random walk of the gain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Common to all channels (temperature of sheet and source): relative deviation after one second.
    pub common_per_sqrt_s: f64,
    /// Independent for each channel (contacts, multiplexers): relative deviation after one second.
    pub channel_per_sqrt_s: f64,
}

/// A number from the standard normal distribution.
pub(super) fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::Converter;

    #[test]
    fn noise_passes_through_both_ends() {
        let converter = Converter { bits: 14, range_v: 1.0, gain: 8.0 };
        let noise = Noise::through((0.4e-3, 22.7), (87.9e-3, 67.0), converter.step_v()).unwrap();
        for (voltage_v, db) in [(0.4e-3, 22.7), (87.9e-3, 67.0_f64)] {
            let variance = noise.deviation_v(voltage_v).powi(2) + converter.step_v().powi(2) / 12.0;
            assert!((10.0 * (voltage_v * voltage_v / variance).log10() - db).abs() < 1e-9, "{voltage_v}");
        }
        assert!(Noise::through((0.4e-3, 22.7), (87.9e-3, 90.0), converter.step_v()).is_none());
    }
}
