//! Errors that the electronics add to a reading: noise, converter, multiplexer. A named preset; each number can be
//! overridden. Only twins use this, not hardware or recordings.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;

/// The table `[backend.electronics]`. Missing values come from the preset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Electronics {
    /// Source of the numbers that are not given.
    pub preset: Preset,
    /// Noise of a reading at 0 V, microvolts: standard deviation, referred to the skin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_uv: Option<f64>,
    /// Noise proportional to the reading: standard deviation divided by the reading. 10^(-SNR/20) for an SNR given in
    /// dB as an amplitude ratio.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise_share: Option<f64>,
    /// Resolution of the converter over its whole range, both signs, bits; 0 for an ideal converter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub converter_bits: Option<u32>,
    /// Full scale of the converter at the skin without further gain, millivolts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub full_scale_mv: Option<f64>,
    /// Number of amplifier ranges, each with twice the gain of the one before. Every reading uses the largest gain
    /// that it fits in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_ranges: Option<u32>,
    /// Step of the current source, microamperes; 0 for a continuous source.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_step_ua: Option<f64>,
    /// Maximum current of the source, microamperes, if it has steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub largest_current_ua: Option<f64>,
    /// On-resistance of the measuring multiplexer, ohm; 0 for no multiplexer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub on_resistance_ohm: Option<f64>,
    /// Input resistance behind the multiplexer, megohm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_resistance_mohm: Option<f64>,
    /// Input capacitance behind the multiplexer, picofarads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input_capacitance_pf: Option<f64>,
    /// Crosstalk: share of the difference from each neighbour in scan order that couples into a channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crosstalk: Option<f64>,
    /// Settling time of a channel before conversion, microseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settling_us: Option<f64>,
    /// Conversion time, microseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conversion_us: Option<f64>,
    /// Random walk of the gain common to all channels: relative deviation after one second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift_per_sqrt_s: Option<f64>,
    /// Random walk of each channel's own gain: relative deviation after one second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel_drift_per_sqrt_s: Option<f64>,
    /// Mains voltage picked up by every channel, microvolts: amplitude at the skin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mains_uv: Option<f64>,
    /// Mains frequency, 50 or 60 Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mains_hz: Option<f64>,
}

/// Named presets of electronics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Scaled to the skin: noise and converter relative to its largest resting voltage, as good as the published
    /// instrument for that kind of layer.
    #[default]
    Auto,
    /// Ideal electronics: adds no errors.
    Ideal,
    /// A 14-bit converter with 125 mV full scale at the skin, 29 uV of noise plus 3e-4 of the reading. Fitted to the
    /// two extremes in the paper on the self-healing sandwich (22.7 dB at 0.4 mV, 67.0 dB at 87.9 mV).
    RedPitaya,
    /// An industrial tomograph, 16 frames per second with 208 channels each. Its SNR of 59.7 dB, as an amplitude
    /// ratio, is noise of 1.03e-3 of the reading.
    #[serde(rename = "wastewater-16")]
    Wastewater16,
    /// A 64-channel multiplexer of 400 ohm, a current source with steps of 2.6 uA up to 40 uA, a 16-bit converter at
    /// 860 samples per second in five ranges from 4.096 V, 20 uV of noise plus 1e-4 of the reading.
    #[serde(rename = "multiplexer-64")]
    Multiplexer64,
    /// The eight-coil instrument: ranged channel by channel, 16 bits, 83 dB.
    #[serde(rename = "mit-8")]
    Mit8,
    /// The sixteen-coil instrument: the same with 50 dB.
    #[serde(rename = "mit-16")]
    Mit16,
}

/// Electronics with every number set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElectronicsNumbers {
    /// Noise at 0 V, volts.
    pub noise_v: f64,
    /// Noise proportional to the reading.
    pub noise_share: f64,
    /// Bits, and full scale at the skin without further gain, volts.
    pub converter: Option<(u32, f64)>,
    /// Number of ranges, each with twice the gain of the one before; at least 1.
    pub gain_ranges: u32,
    /// Step and maximum of the source, amperes.
    pub current_steps_a: Option<[f64; 2]>,
    /// The multiplexer.
    pub multiplexer: Option<MultiplexerNumbers>,
    /// Settling and conversion times of a channel, seconds.
    pub timing_s: Option<[f64; 2]>,
    /// Random walk of the gain after one second: common, and per channel.
    pub drift_per_sqrt_s: [f64; 2],
    /// Mains pickup: amplitude (volts) and frequency (hertz).
    pub mains: Option<[f64; 2]>,
}

/// A multiplexer on the measurement side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MultiplexerNumbers {
    /// On-resistance.
    pub on_resistance_ohm: f64,
    /// Input resistance behind the multiplexer.
    pub input_resistance_ohm: f64,
    /// Input capacitance behind the multiplexer, farads.
    pub input_capacitance_f: f64,
    /// Share of the difference from the neighbours that couples in.
    pub crosstalk: f64,
}

/// Adds no errors.
const IDEAL: ElectronicsNumbers = ElectronicsNumbers {
    noise_v: 0.0,
    noise_share: 0.0,
    converter: None,
    gain_ranges: 1,
    current_steps_a: None,
    multiplexer: None,
    timing_s: None,
    drift_per_sqrt_s: [0.0; 2],
    mains: None,
};

impl Preset {
    fn numbers(self, kind: &str, largest_v: f64) -> ElectronicsNumbers {
        let ranged = |snr_db: f64| ElectronicsNumbers {
            noise_share: 10_f64.powf(-snr_db / 20.0),
            converter: Some((16, 5.0 / 4.0)),
            gain_ranges: 16,
            ..IDEAL
        };
        match self {
            Self::Ideal => IDEAL,
            Self::RedPitaya => ElectronicsNumbers {
                noise_v: 2.898e-5,
                noise_share: 2.972e-4,
                converter: Some((14, 1.0 / 8.0)),
                ..IDEAL
            },
            Self::Wastewater16 => {
                let channel_s = 1.0 / (16.0 * 208.0);
                ElectronicsNumbers {
                    noise_share: 10_f64.powf(-59.7 / 20.0),
                    timing_s: Some([0.5 * channel_s; 2]),
                    ..IDEAL
                }
            }
            Self::Multiplexer64 => ElectronicsNumbers {
                noise_v: 20e-6,
                noise_share: 1e-4,
                converter: Some((16, 4.096)),
                gain_ranges: 5,
                current_steps_a: Some([2.6e-6, 40e-6]),
                multiplexer: Some(MultiplexerNumbers {
                    on_resistance_ohm: 400.0,
                    input_resistance_ohm: 1e7,
                    input_capacitance_f: 20e-12,
                    crosstalk: 0.0,
                }),
                timing_s: Some([1e-5, 1.0 / 860.0]),
                ..IDEAL
            },
            Self::Mit8 => ranged(83.0),
            Self::Mit16 => ranged(50.0),
            Self::Auto => {
                // Headroom of 40 % above the largest channel.
                let full_scale_v = 1.4 * largest_v;
                match kind {
                    "liquid" => Self::Wastewater16.numbers(kind, largest_v),
                    "elements" => ElectronicsNumbers { converter: Some((16, full_scale_v)), ..ranged(70.0) },
                    "patches" => ElectronicsNumbers {
                        noise_v: 2e-4 * largest_v,
                        noise_share: 1e-4,
                        converter: Some((16, full_scale_v)),
                        ..IDEAL
                    },
                    _ => ElectronicsNumbers {
                        noise_v: 3.3e-4 * largest_v,
                        noise_share: 3e-4,
                        converter: Some((14, full_scale_v)),
                        ..IDEAL
                    },
                }
            }
        }
    }
}

impl Electronics {
    /// All numbers, for a layer of this kind and its largest resting voltage.
    pub fn numbers(&self, kind: &str, largest_v: f64) -> ElectronicsNumbers {
        let mut numbers = self.preset.numbers(kind, largest_v);
        let set = |value: Option<f64>, factor: f64, into: &mut f64| {
            if let Some(value) = value {
                *into = factor * value;
            }
        };
        set(self.noise_uv, 1e-6, &mut numbers.noise_v);
        set(self.noise_share, 1.0, &mut numbers.noise_share);
        if self.converter_bits.is_some() || self.full_scale_mv.is_some() {
            let (bits, full_scale_v) = numbers.converter.unwrap_or((16, 1.4 * largest_v));
            let bits = self.converter_bits.unwrap_or(bits);
            let full_scale_v = self.full_scale_mv.map_or(full_scale_v, |mv| 1e-3 * mv);
            numbers.converter = (bits > 0).then_some((bits, full_scale_v));
        }
        numbers.gain_ranges = self.gain_ranges.unwrap_or(numbers.gain_ranges);
        if self.current_step_ua.is_some() || self.largest_current_ua.is_some() {
            let [step, most] = numbers.current_steps_a.unwrap_or([1e-6, 1.0]);
            let step = self.current_step_ua.map_or(step, |ua| 1e-6 * ua);
            let most = self.largest_current_ua.map_or(most, |ua| 1e-6 * ua);
            numbers.current_steps_a = (step > 0.0).then_some([step, most]);
        }
        if self.on_resistance_ohm.is_some() || numbers.multiplexer.is_some() {
            let mut multiplexer = numbers.multiplexer.unwrap_or(MultiplexerNumbers {
                on_resistance_ohm: 0.0,
                input_resistance_ohm: 1e9,
                input_capacitance_f: 0.0,
                crosstalk: 0.0,
            });
            set(self.on_resistance_ohm, 1.0, &mut multiplexer.on_resistance_ohm);
            set(self.input_resistance_mohm, 1e6, &mut multiplexer.input_resistance_ohm);
            set(self.input_capacitance_pf, 1e-12, &mut multiplexer.input_capacitance_f);
            set(self.crosstalk, 1.0, &mut multiplexer.crosstalk);
            numbers.multiplexer = (multiplexer.on_resistance_ohm > 0.0).then_some(multiplexer);
        }
        if self.settling_us.is_some() || self.conversion_us.is_some() {
            let [settling, conversion] = numbers.timing_s.unwrap_or([0.0; 2]);
            let settling = self.settling_us.map_or(settling, |us| 1e-6 * us);
            numbers.timing_s = Some([settling, self.conversion_us.map_or(conversion, |us| 1e-6 * us)]);
        }
        set(self.drift_per_sqrt_s, 1.0, &mut numbers.drift_per_sqrt_s[0]);
        set(self.channel_drift_per_sqrt_s, 1.0, &mut numbers.drift_per_sqrt_s[1]);
        if let Some(amplitude) = self.mains_uv.filter(|amplitude| *amplitude > 0.0) {
            numbers.mains = Some([1e-6 * amplitude, self.mains_hz.unwrap_or(50.0)]);
        }
        numbers
    }

    pub(crate) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let ranges = [
            ("noise_uv", self.noise_uv, 0.0, 1e9),
            ("noise_share", self.noise_share, 0.0, 1.0),
            ("full_scale_mv", self.full_scale_mv, 1e-6, 1e9),
            ("current_step_ua", self.current_step_ua, 0.0, 1e6),
            ("largest_current_ua", self.largest_current_ua, 1e-3, 1e9),
            ("on_resistance_ohm", self.on_resistance_ohm, 0.0, 1e9),
            ("input_resistance_mohm", self.input_resistance_mohm, 1e-6, 1e9),
            ("input_capacitance_pf", self.input_capacitance_pf, 0.0, 1e9),
            ("crosstalk", self.crosstalk, 0.0, 0.5),
            ("settling_us", self.settling_us, 0.0, 1e6),
            ("conversion_us", self.conversion_us, 0.0, 1e6),
            ("drift_per_sqrt_s", self.drift_per_sqrt_s, 0.0, 1.0),
            ("channel_drift_per_sqrt_s", self.channel_drift_per_sqrt_s, 0.0, 1.0),
            ("mains_uv", self.mains_uv, 0.0, 1e9),
            ("mains_hz", self.mains_hz, 1.0, 1e3),
        ];
        for (name, value, low, high) in ranges {
            if let Some(value) = value {
                checker.within(&format!("backend.electronics.{name}"), value, low, high)?;
            }
        }
        if let Some(bits) = self.converter_bits.filter(|bits| *bits != 0) {
            checker.count("backend.electronics.converter_bits", bits as usize, 2, 32)?;
        }
        checker.count("backend.electronics.gain_ranges", self.gain_ranges.unwrap_or(1) as usize, 1, 16)
    }
}
