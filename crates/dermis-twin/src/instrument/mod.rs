//! What an instrument makes of true voltages: slow drift, noise, gain, and an analogue-to-digital converter that
//! saturates and rounds; behind them, where wanted, a stepped source, a multiplexer, mains pickup, temperature, the time
//! of a scan, and faults. Seeded: the same seed and the same steps give the same readings.

mod chain;
mod faults;
mod noise;
mod schedule;
mod snr;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};
pub use chain::{DriveSteps, GainRanges, Mains, Multiplexer, Temperature, Timing};
pub use faults::{Fault, FrameFate};
pub use noise::{Drift, Noise};
pub(crate) use schedule::FaultSchedule;
pub use schedule::TimedFault;
pub use snr::{expected_ionic_snr_db, floor_for_ionic_snr_v, snr_db};

use dermis_tomo::eit::Protocol;
use faults::Faults;

/// The converter behind the amplifier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Converter {
    /// Resolution over the whole range, both signs.
    pub bits: u32,
    /// Largest magnitude that it converts, volts after the gain.
    pub range_v: f64,
    /// Amplification before it.
    pub gain: f64,
}

impl Converter {
    /// Volts at the skin between neighbouring codes.
    pub fn step_v(&self) -> f64 {
        self.range_v / self.gain / f64::from(self.bits - 1).exp2()
    }

    /// The value read for a voltage at the skin: the nearest code, two's complement, in volts at the skin.
    pub fn read_v(&self, voltage_v: f64) -> f64 {
        let codes = f64::from(self.bits - 1).exp2();
        let step = self.step_v();
        (voltage_v / step).round().clamp(-codes, codes - 1.0) * step
    }
}

const RIGHT_ANGLE: f64 = std::f64::consts::FRAC_PI_2;

/// Parameters of an instrument.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentOptions {
    /// Noise of every reading.
    pub noise: Noise,
    /// Slow change, where wanted.
    pub drift: Option<Drift>,
    /// Rounding and saturation; `None` (`"none"` in TOML) reads without either.
    #[serde(with = "converter_or_none")]
    pub converter: Option<Converter>,
    /// Steps of the current source.
    pub drive: Option<DriveSteps>,
    /// Multiplexer on the measuring side.
    pub multiplexer: Option<Multiplexer>,
    /// Amplifier ranges before the converter.
    pub gain_ranges: Option<GainRanges>,
    /// Pickup of the mains.
    pub mains: Option<Mains>,
    /// Gain that follows temperature.
    pub temperature: Option<Temperature>,
    /// Time that a scan takes; `None` reads all channels at once.
    pub timing: Option<Timing>,
    /// What of the voltage is reported.
    pub reading: Reading,
    /// Angle by which the demodulator's reference leads: a signed reading is `V cos`, a complex one has `V sin` as its
    /// imaginary part; a rectifier knows nothing of it. Radians, within a right angle.
    pub phase_error_rad: f64,
}

/// What of a voltage an instrument reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reading {
    /// The in-phase voltage with its sign.
    #[default]
    Signed,
    /// Its size only, as behind a rectifier.
    Magnitude,
    /// In-phase and quadrature voltage, each with its noise; the latter is [`Instrument::imaginary_v`]. A resistive skin
    /// has none, so that only the phase error shows there.
    Complex,
}

impl Default for InstrumentOptions {
    fn default() -> Self {
        Self::ideal()
    }
}

impl InstrumentOptions {
    /// An instrument that adds nothing.
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
    /// Negative noise or drift, fewer than 2 or more than 32 bits, a range or gain that is not positive, parts of the
    /// chain that make no sense.
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
}

/// An instrument at work.
#[derive(Clone, Debug)]
pub struct Instrument {
    options: InstrumentOptions,
    random: ChaCha8Rng,
    common: f64,
    channel: Vec<f64>,
    /// Seconds since the first frame.
    time_s: f64,
    /// Last voltage before the converter's multiplexer in the frame before.
    last_v: f64,
    faults: Faults,
    /// Quadrature readings of the last frame, where there are any.
    imaginary_v: Vec<f64>,
}

impl Instrument {
    /// Fresh, without drift so far.
    ///
    /// # Errors
    /// As [`InstrumentOptions::check`].
    pub fn new(options: InstrumentOptions, channel_count: usize, seed: u64) -> Result<Self, TwinError> {
        options.check()?;
        let random = ChaCha8Rng::seed_from_u64(seed);
        let channel = vec![0.0; channel_count];
        let faults = Faults::new(channel_count, seed);
        Ok(Self { options, random, common: 0.0, channel, time_s: 0.0, last_v: 0.0, faults, imaginary_v: Vec::new() })
    }

    /// Tells it which electrodes its channels use, which faults of electrodes need.
    ///
    /// # Errors
    /// A protocol with another number of channels.
    pub fn with_protocol(mut self, protocol: &Protocol) -> Result<Self, TwinError> {
        self.faults.set_protocol(protocol)?;
        Ok(self)
    }

    /// Tells it which coils its channels use, which faults of coils need.
    ///
    /// # Errors
    /// Pairs of another number than its channels.
    pub fn with_coils(mut self, pairs: &Protocol) -> Result<Self, TwinError> {
        self.faults.set_coils(pairs)?;
        Ok(self)
    }

    /// The parameters.
    pub fn options(&self) -> &InstrumentOptions {
        &self.options
    }

    /// Replaces the faults; none makes it sound again.
    ///
    /// # Errors
    /// Channels, electrodes or coils that do not exist, probabilities outside 0 to 1, faults of electrodes without a protocol.
    pub fn set_faults(&mut self, faults: Vec<Fault>) -> Result<(), TwinError> {
        self.faults.set(faults)
    }

    /// The faults it has.
    pub fn faults(&self) -> &[Fault] {
        self.faults.list()
    }

    /// Checks faults without taking them on.
    ///
    /// # Errors
    /// As [`Instrument::set_faults`].
    pub fn check_faults(&self, faults: &[Fault]) -> Result<(), TwinError> {
        self.faults.check_all(faults)
    }

    /// What became of the last frame. Whoever passes frames on leaves dropped ones out.
    pub fn frame_fate(&self) -> FrameFate {
        self.faults.fate()
    }

    /// Quadrature readings of the last frame, volts; empty unless the instrument reads complex.
    pub fn imaginary_v(&self) -> &[f64] {
        &self.imaginary_v
    }

    /// True time from one frame to the next, seconds; 0 where channels take no time.
    pub fn frame_period_s(&self) -> f64 {
        self.options.timing.map_or(0.0, |timing| timing.frame_period_s(self.channel.len()))
    }

    /// When a channel is read after the frame's start, seconds; the skew inside a frame.
    pub fn channel_time_s(&self, channel: usize) -> f64 {
        self.options.timing.map_or(0.0, |timing| timing.channel_time_s(channel))
    }

    /// Turns true voltages into readings, in place, `dt_s` seconds after the last.
    pub fn read(&mut self, dt_s: f64, voltages_v: &mut [f64]) {
        self.time_s += dt_s;
        self.scale(dt_s, voltages_v);
        let full_scale_v = self.options.converter.map_or(1.0, |converter| converter.range_v / converter.gain);
        self.faults.of_electrodes(full_scale_v, voltages_v);
        if let Some(multiplexer) = self.options.multiplexer {
            let last_v = voltages_v.last().copied().unwrap_or(0.0);
            let settling_s = self.options.timing.map_or(f64::INFINITY, |timing| timing.settling_s);
            multiplexer.pass(settling_s, self.last_v, voltages_v);
            self.last_v = last_v;
        }
        let (sine, cosine) = self.options.phase_error_rad.sin_cos();
        self.imaginary_v.clear();
        if self.options.reading == Reading::Complex {
            self.imaginary_v.extend(voltages_v.iter().map(|voltage| *voltage * sine));
        }
        if self.options.reading != Reading::Magnitude {
            voltages_v.iter_mut().for_each(|voltage| *voltage *= cosine);
        }
        let mut imaginary_v = std::mem::take(&mut self.imaginary_v);
        self.digitise(voltages_v);
        self.digitise(&mut imaginary_v);
        self.faults.of_frames(voltages_v, &mut imaginary_v);
        self.imaginary_v = imaginary_v;
    }

    /// Noise, pickup and converter.
    fn digitise(&mut self, voltages_v: &mut [f64]) {
        for (channel, voltage) in voltages_v.iter_mut().enumerate() {
            *voltage += self.options.noise.deviation_v(*voltage) * normal(&mut self.random);
            if let Some(mains) = self.options.mains {
                let delay_s = self.options.timing.map_or(0.0, |timing| timing.channel_time_s(channel));
                *voltage += mains.at_v(self.time_s + delay_s);
            }
            *voltage = self.options.convert(*voltage);
        }
    }

    /// Everything that multiplies: random walk, current steps, temperature.
    fn scale(&mut self, dt_s: f64, voltages_v: &mut [f64]) {
        if let Some(drift) = self.options.drift {
            let root = dt_s.sqrt();
            self.common += drift.common_per_sqrt_s * root * normal(&mut self.random);
            for (voltage, channel) in voltages_v.iter_mut().zip(&mut self.channel) {
                *channel += drift.channel_per_sqrt_s * root * normal(&mut self.random);
                *voltage *= 1.0 + self.common + *channel;
            }
        }
        let drive = self.options.drive.map_or(1.0, |drive| drive.actual_a() / drive.wanted_a);
        let warm = |t: Temperature| 1.0 + t.coefficient_per_k * t.above_start_k(self.time_s);
        let factor = drive * self.options.temperature.map_or(1.0, warm);
        voltages_v.iter_mut().for_each(|voltage| *voltage *= factor);
    }
}

impl InstrumentOptions {
    /// Rectifier, amplifier range and converter.
    fn convert(&self, voltage_v: f64) -> f64 {
        let voltage_v = if self.reading == Reading::Magnitude { voltage_v.abs() } else { voltage_v };
        let Some(converter) = self.converter else { return voltage_v };
        let full_scale_v = converter.range_v / converter.gain;
        let extra = self.gain_ranges.map_or(1.0, |ranges| ranges.gain(voltage_v.abs(), full_scale_v));
        Converter { gain: converter.gain * extra, ..converter }.read_v(voltage_v)
    }
}

/// A converter as a table, none as the word `"none"` or left out: TOML has no null.
mod converter_or_none {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Converter;

    #[derive(Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Word {
        None,
    }

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    enum Written {
        Word(Word),
        Table(Converter),
    }

    pub fn serialize<S: Serializer>(converter: &Option<Converter>, serializer: S) -> Result<S::Ok, S::Error> {
        converter.map_or(Written::Word(Word::None), Written::Table).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Converter>, D::Error> {
        Ok(match Written::deserialize(deserializer)? {
            Written::Word(Word::None) => None,
            Written::Table(converter) => Some(converter),
        })
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

#[cfg(test)]
mod chain_tests;

#[cfg(test)]
mod tests {
    use super::*;

    const CONVERTER: Converter = Converter { bits: 14, range_v: 1.0, gain: 8.0 };

    fn noisy() -> InstrumentOptions {
        let noise = Noise { floor_v: 2.9e-5, proportional: 3e-4 };
        InstrumentOptions { noise, converter: Some(CONVERTER), ..InstrumentOptions::ideal() }
    }

    #[test]
    fn readings_are_codes_and_saturate() {
        let converter = Converter { bits: 8, range_v: 1.0, gain: 2.0 };
        let step = 0.5 / 128.0;
        assert_eq!(converter.step_v(), step);
        assert_eq!(converter.read_v(10.4 * step), 10.0 * step);
        assert_eq!(converter.read_v(9.0), 127.0 * step);
        assert_eq!(converter.read_v(-9.0), -128.0 * step);
        let mut instrument = Instrument::new(noisy(), 1, 1).unwrap();
        let converter = CONVERTER;
        for _ in 0..100 {
            let mut reading = [0.0123];
            instrument.read(0.02, &mut reading);
            let code = reading[0] / converter.step_v();
            assert_eq!(code, code.round());
        }
    }

    #[test]
    fn drift_wanders_as_the_root_of_time() {
        let drift = Drift { common_per_sqrt_s: 0.0, channel_per_sqrt_s: 1e-3 };
        let options = InstrumentOptions { drift: Some(drift), ..InstrumentOptions::ideal() };
        let mut instrument = Instrument::new(options, 4000, 5).unwrap();
        let mut voltages = vec![1.0; 4000];
        for _ in 0..10 {
            voltages.fill(1.0);
            instrument.read(0.9, &mut voltages);
        }
        let variance = voltages.iter().map(|v| (v - 1.0).powi(2)).sum::<f64>() / 4000.0;
        // 9 s: a deviation of 3e-3; 4,000 samples give it within 5 % (4.5 standard errors).
        assert!((variance.sqrt() / 3e-3 - 1.0).abs() < 0.05, "{variance:e}");
    }

    #[test]
    fn nonsense_is_refused() {
        let bits = Converter { bits: 1, ..CONVERTER };
        let options = InstrumentOptions { converter: Some(bits), ..noisy() };
        assert!(Instrument::new(options, 3, 0).is_err());
        let noise = Noise { floor_v: -1.0, proportional: 0.0 };
        assert!(Instrument::new(InstrumentOptions { noise, ..noisy() }, 3, 0).is_err());
    }
}
