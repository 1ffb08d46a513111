//! The resistance backend of paper P (Sánchez-Delgado et al., Intelligent Service Robotics 17, 2024): a 64-channel
//! analogue multiplexer with an on-chip current source, on SPI, and a 16-bit converter on I2C. Four of the 64
//! electrodes are connected at a time: to the source, to its ground, and to the two analogue outputs, which lead to
//! the converter's inputs 0 and 1.
//!
//! The paper names the chip (swmux of IMS CHIPS) and its specifications, but gives no register map. The five bytes of
//! [`Selection::bytes`] are therefore an assumption, and the only place to change for another chip.

use dermis_wire::{NO_ELECTRODE, Status};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use embedded_hal::spi::SpiDevice;

use crate::board::{Board, Facts, Failure, Reading};
use crate::converter::{Converter, Input, RANGES_V, READINGS_PER_S};
use crate::protocol::{MOST_ELECTRODES, Named};

/// A step of the current source, amperes.
pub const STEP_A: f32 = 2.6e-6;
/// Maximum number of steps of the current source: 39 uA, just below its limit of 40 uA.
pub const MOST_STEPS: u8 = 15;
/// Largest current that can be requested, amperes.
const MOST_A: f32 = 40e-6;
/// Fastest clock of the multiplexer, Hz.
pub const MOST_CLOCK_HZ: u32 = 10_000_000;
/// Voltage at an electrode at which the source, on a 3.3 V supply, stops regulating.
const COMPLIANCE_V: f32 = 3.0;
/// Time from switching to the conversion. 400 ohm of the switches and 20 pF of an input settle to 16 bits in 0.1 us;
/// cables take longer.
const SETTLING_NS: u32 = 10_000;
/// Range code for self-checks.
const FINE: u8 = 5;
/// Range code that shows an open electrode.
const WIDE: u8 = 1;
/// Number of readings for the converter's own noise.
const NOISE_READINGS: u16 = 16;

/// Connections of the multiplexer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selection {
    /// Steps of the current source.
    pub steps: u8,
    /// Electrodes at the source, its ground, and the outputs 0 and 1; [`NO_ELECTRODE`] leaves a line open.
    pub lines: [u8; 4],
}

impl Selection {
    /// The bytes sent over SPI, which take effect when the chip is deselected: the current steps, then one byte each
    /// for source, ground, output 0 and output 1, with the electrode, and bit 7 set if the line is closed.
    pub fn bytes(self) -> [u8; 5] {
        let line = |electrode: u8| if electrode == NO_ELECTRODE { 0 } else { 0x80 | (electrode & 0x3f) };
        let [source, sink, positive, negative] = self.lines.map(line);
        [self.steps, source, sink, positive, negative]
    }
}

/// The board.
pub struct Mux64<S, I, D> {
    spi: S,
    converter: Converter<I>,
    delay: D,
    electrodes: u8,
    steps: u8,
    /// The current measurement.
    measuring: Option<[u8; 4]>,
}

impl<S: SpiDevice, I: I2c, D: DelayNs> Mux64<S, I, D> {
    /// A board with this number of electrodes, at most [`MOST_ELECTRODES`]. It starts at the highest current step and
    /// in the second-widest range.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] for fewer than 2 or more than 64 electrodes; [`Failure::Bus`] if the converter
    /// doesn't answer.
    pub fn new(spi: S, i2c: I, delay: D, electrodes: u8) -> Result<Self, Failure> {
        if !(2..=MOST_ELECTRODES).contains(&electrodes) {
            return Err(Failure::BadArgument);
        }
        Ok(Self { spi, converter: Converter::new(i2c)?, delay, electrodes, steps: MOST_STEPS, measuring: None })
    }

    fn select(&mut self, steps: u8, lines: [u8; 4]) -> Result<(), Failure> {
        self.spi.write(&Selection { steps, lines }.bytes()).map_err(|_| Failure::Bus)?;
        self.delay.delay_ns(SETTLING_NS);
        Ok(())
    }

    fn discard(&mut self) -> Result<(), Failure> {
        self.measuring = None;
        self.converter.discard(&mut self.delay)
    }

    /// Voltage between the outputs at this number of current steps.
    fn volts(&mut self, steps: u8, lines: [u8; 4]) -> Result<f32, Failure> {
        self.select(steps, lines)?;
        let reading = self.converter.wait(input(lines), &mut self.delay)?;
        Ok(f32::from(reading.counts) * self.converter.scale_v())
    }

    /// Acts in another range, then restores the one that was set.
    fn in_range<T>(&mut self, gain: u8, act: impl FnOnce(&mut Self) -> Result<T, Failure>) -> Result<T, Failure> {
        self.discard()?;
        let before = self.converter.gain();
        self.converter.set_gain(gain)?;
        let result = act(self);
        self.converter.set_gain(before)?;
        self.quiet()?;
        result
    }

    /// Offset and peak-to-peak noise of the converter with both inputs at one electrode and no current, volts.
    fn noise_v(&mut self) -> Result<[f32; 2], Failure> {
        let (mut sum, mut least, mut most) = (0.0, f32::INFINITY, f32::NEG_INFINITY);
        for _ in 0..NOISE_READINGS {
            let volts = self.volts(0, [NO_ELECTRODE, 0, 0, 0])?;
            (sum, least, most) = (sum + volts, least.min(volts), most.max(volts));
        }
        Ok([sum / f32::from(NOISE_READINGS), most - least])
    }

    /// Mean and largest resistance of the ground switches, ohms, measured with the current entering and leaving at
    /// the same electrode.
    fn switches_ohm(&mut self) -> Result<[f32; 2], Failure> {
        let current_a = f32::from(MOST_STEPS) * STEP_A;
        let (mut sum, mut most) = (0.0, 0.0_f32);
        for electrode in 0..self.electrodes {
            let ohm = self.volts(MOST_STEPS, [electrode, electrode, electrode, NO_ELECTRODE])? / current_a;
            (sum, most) = (sum + ohm, most.max(ohm));
        }
        Ok([sum / f32::from(self.electrodes), most])
    }

    /// Voltage between a driven electrode and one without current, divided by the current; NaN if the source reaches
    /// its limit with either of two electrodes as sink.
    fn contact_ohm(&mut self, electrode: u8) -> Result<f32, Failure> {
        let after = |step: u8| ((u16::from(electrode) + u16::from(step)) % u16::from(self.electrodes)) as u8;
        let (sinks, quiet) = ([after(1), after(2)], after(3));
        for sink in sinks {
            let total_v = self.volts(MOST_STEPS, [electrode, sink, electrode, NO_ELECTRODE])?;
            if total_v < COMPLIANCE_V {
                let contact_v = self.volts(MOST_STEPS, [electrode, sink, electrode, quiet])?;
                return Ok(contact_v / (f32::from(MOST_STEPS) * STEP_A));
            }
        }
        Ok(f32::NAN)
    }
}

fn input(lines: [u8; 4]) -> Input {
    if lines[3] == NO_ELECTRODE { Input::Single } else { Input::Differential }
}

impl<S: SpiDevice, I: I2c, D: DelayNs> Board for Mux64<S, I, D> {
    fn facts(&self) -> Facts {
        Facts {
            device: "dermis mux-64 with ADS1115",
            electrodes: self.electrodes,
            adc_bits: 16,
            magnitude: false,
            coils: false,
            readings_per_s: READINGS_PER_S,
            has_frequency: false,
            // The check needs two electrodes as sinks and one without current.
            has_impedance: self.electrodes >= 4,
            protocols: &[Named::AdjacentSink, Named::AdjacentGround, Named::Adjacent],
        }
    }

    fn amplitude_a(&self) -> f32 {
        f32::from(self.steps) * STEP_A
    }

    fn set_amplitude_a(&mut self, amplitude_a: f32) -> Result<f32, Failure> {
        if !(0.0..=MOST_A).contains(&amplitude_a) {
            return Err(Failure::BadArgument);
        }
        self.steps = ((amplitude_a / STEP_A + 0.5) as u8).min(MOST_STEPS);
        Ok(self.amplitude_a())
    }

    fn gain(&self) -> u8 {
        self.converter.gain()
    }

    fn gains(&self) -> u8 {
        RANGES_V.len() as u8
    }

    fn set_gain(&mut self, code: u8) -> Result<(), Failure> {
        self.discard()?;
        self.converter.set_gain(code)
    }

    fn scale_v(&self) -> f32 {
        self.converter.scale_v()
    }

    fn measure(&mut self, measurement: [u8; 4]) -> nb::Result<Reading, Failure> {
        if self.measuring != Some(measurement) {
            self.discard()?;
            self.select(self.steps, measurement)?;
            self.measuring = Some(measurement);
        }
        let result = self.converter.read(input(measurement));
        if !matches!(result, Err(nb::Error::WouldBlock)) {
            self.measuring = None;
        }
        let mut reading = result?;
        if f32::from(reading.counts) * self.scale_v() >= COMPLIANCE_V {
            reading.status = reading.status.with(Status::COMPLIANCE);
        }
        Ok(reading)
    }

    fn quiet(&mut self) -> Result<(), Failure> {
        self.discard()?;
        self.select(0, [NO_ELECTRODE; 4])
    }

    /// Offset and peak-to-peak noise of the converter, volts; mean and largest resistance of the multiplexer's ground
    /// switches, ohms.
    fn self_test(&mut self, out: &mut [f32]) -> Result<usize, Failure> {
        let found = self.in_range(FINE, |board| {
            let ([offset, noise], [mean, most]) = (board.noise_v()?, board.switches_ohm()?);
            Ok([offset, noise, mean, most])
        })?;
        let count = found.len().min(out.len());
        out[..count].copy_from_slice(&found[..count]);
        Ok(count)
    }

    /// Between the driven electrode and one without current: the contact, and the skin's spreading resistance close
    /// to it.
    fn impedance_ohm(&mut self, electrode: u8) -> Result<f32, Failure> {
        if electrode >= self.electrodes || self.electrodes < 4 {
            return Err(Failure::BadArgument);
        }
        self.in_range(WIDE, |board| board.contact_ohm(electrode))
    }
}
