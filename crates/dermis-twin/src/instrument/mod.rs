//! Effect of an instrument on true voltages: slow drift, noise, gain, and an analogue-to-digital converter that
//! saturates and rounds. Optional parts are a stepped source, a multiplexer, mains pickup, temperature, scan timing
//! and faults. Seeded: the same seed and steps give the same readings.

mod chain;
mod converter;
mod faults;
mod noise;
mod options;
mod schedule;
mod snr;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::error::TwinError;
pub use chain::{DriveSteps, GainRanges, Mains, Multiplexer, Temperature, Timing};
pub use converter::Converter;
pub use faults::{Fault, FrameFate};
pub use noise::{Drift, Noise};
pub use options::{InstrumentOptions, Reading};
pub(crate) use schedule::FaultSchedule;
pub use schedule::TimedFault;
pub use snr::{expected_ionic_snr_db, floor_for_ionic_snr_v, snr_db};

use dermis_tomo::eit::Protocol;
use faults::Faults;
use noise::normal;

/// An instrument in operation.
#[derive(Clone, Debug)]
pub struct Instrument {
    options: InstrumentOptions,
    random: ChaCha8Rng,
    common: f64,
    channel: Vec<f64>,
    /// Seconds since the first frame.
    time_s: f64,
    /// Last voltage of the previous frame, in front of the converter's multiplexer.
    last_v: f64,
    faults: Faults,
    /// Quadrature readings of the last frame, if any.
    imaginary_v: Vec<f64>,
}

impl Instrument {
    /// A new instrument without drift.
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

    /// Sets the electrodes used by its channels, which electrode faults need.
    ///
    /// # Errors
    /// A protocol with a different number of channels.
    pub fn with_protocol(mut self, protocol: &Protocol) -> Result<Self, TwinError> {
        self.faults.set_protocol(protocol)?;
        Ok(self)
    }

    /// Sets the coils used by its channels, which coil faults need.
    ///
    /// # Errors
    /// A number of pairs that differs from its channels.
    pub fn with_coils(mut self, pairs: &Protocol) -> Result<Self, TwinError> {
        self.faults.set_coils(pairs)?;
        Ok(self)
    }

    /// The parameters.
    pub fn options(&self) -> &InstrumentOptions {
        &self.options
    }

    /// Replaces the faults; an empty list repairs the instrument.
    ///
    /// # Errors
    /// Channels, electrodes or coils that do not exist, probabilities outside 0 to 1, or electrode faults without a
    /// protocol.
    pub fn set_faults(&mut self, faults: Vec<Fault>) -> Result<(), TwinError> {
        self.faults.set(faults)
    }

    /// The current faults.
    pub fn faults(&self) -> &[Fault] {
        self.faults.list()
    }

    /// Checks faults without applying them.
    ///
    /// # Errors
    /// As [`Instrument::set_faults`].
    pub fn check_faults(&self, faults: &[Fault]) -> Result<(), TwinError> {
        self.faults.check_all(faults)
    }

    /// Fate of the last frame. Callers that forward frames must skip dropped ones.
    pub fn frame_fate(&self) -> FrameFate {
        self.faults.fate()
    }

    /// Quadrature readings of the last frame, volts; empty unless the instrument reads complex.
    pub fn imaginary_v(&self) -> &[f64] {
        &self.imaginary_v
    }

    /// Actual time from one frame to the next, seconds; 0 if channels take no time.
    pub fn frame_period_s(&self) -> f64 {
        self.options.timing.map_or(0.0, |timing| timing.frame_period_s(self.channel.len()))
    }

    /// Reading time of a channel relative to the start of the frame, seconds: the skew within a frame.
    pub fn channel_time_s(&self, channel: usize) -> f64 {
        self.options.timing.map_or(0.0, |timing| timing.channel_time_s(channel))
    }

    /// Converts true voltages to readings in place, `dt_s` seconds after the previous frame.
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

    /// Applies noise, pickup and converter.
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

    /// Applies all factors: random walk, current steps, temperature.
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
        // After 9 s, a deviation of 3e-3; 4,000 samples determine it within 5 % (4.5 standard errors).
        assert!((variance.sqrt() / 3e-3 - 1.0).abs() < 0.05, "{variance:e}");
    }

    #[test]
    fn bad_input_is_refused() {
        let bits = Converter { bits: 1, ..CONVERTER };
        let options = InstrumentOptions { converter: Some(bits), ..noisy() };
        assert!(Instrument::new(options, 3, 0).is_err());
        let noise = Noise { floor_v: -1.0, proportional: 0.0 };
        assert!(Instrument::new(InstrumentOptions { noise, ..noisy() }, 3, 0).is_err());
    }
}
