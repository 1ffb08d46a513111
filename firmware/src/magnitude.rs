//! The induction backend of paper E. A synthesiser makes the sine. One programmable amplifier sets the current in the
//! sending coil, another the gain after the receiving coil. A precision rectifier and a filter form the mean, which a
//! converter reads. Relay banks with line decoders select the coils, so a reading is the magnitude of one pair's
//! coupling.
//!
//! The paper describes the chain but names no chips. Chosen here: an AD9833 (driver crate `ad983x`), two
//! amplifiers of the MCP6S2x family, whose two-byte SPI commands are from their data sheet (Microchip, DS21117), an
//! ADS1115, and decoders with four address lines each.

use ad983x::marker::Ad9833Ad9837;
use ad983x::{Ad983x, FrequencyRegister};
use dermis_wire::NO_ELECTRODE;
use embedded_hal::delay::DelayNs;
use embedded_hal::digital::OutputPin;
use embedded_hal::i2c::I2c;
use embedded_hal::spi::SpiDevice;

use crate::board::{Board, Facts, Failure, Reading};
use crate::converter::{Converter, Input, READINGS_PER_S};
use crate::protocol::Named;

/// Maximum number of coils that four address lines can select.
pub const MOST_COILS: u8 = 16;
/// Gains of the amplifiers, by code.
pub const GAINS: [u8; 8] = [1, 2, 4, 5, 8, 10, 16, 32];
/// Amplifier instruction that writes the gain.
const WRITE_GAIN: u8 = 0x40;
/// Bits of the synthesiser's phase accumulator.
const PHASE_BITS: u32 = 28;
/// Frequency range of the instrument, hertz.
pub const BAND_HZ: [f32; 2] = [1e3, 100e3];
/// Range code of the converter: 2.048 V.
const RANGE: u8 = 2;
/// Ratio of a sine's amplitude to the mean of its magnitude.
const AMPLITUDE_OVER_MEAN: f32 = core::f32::consts::FRAC_PI_2;

/// Properties of the circuit around the chips.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chain {
    /// Coils connected.
    pub coils: u8,
    /// Clock of the synthesiser, hertz.
    pub clock_hz: f32,
    /// Amplitude of a coil's current at gain 1 of the sending amplifier, amperes.
    pub current_a: f32,
    /// Time from switching to the conversion, for relays and filter, microseconds.
    pub settling_us: u32,
}

/// The address lines of one decoder, lowest bit first.
#[derive(Debug)]
pub struct AddressLines<P>(pub [P; 4]);

impl<P: OutputPin> AddressLines<P> {
    fn select(&mut self, coil: u8) -> Result<(), Failure> {
        for (bit, line) in self.0.iter_mut().enumerate() {
            line.set_state((coil >> bit & 1 == 1).into()).map_err(|_| Failure::Bus)?;
        }
        Ok(())
    }
}

/// The parts on the buses.
pub struct Parts<G, T, R, I, P, Q, D> {
    /// The synthesiser.
    pub synthesiser: G,
    /// The amplifier of the sending coil.
    pub sending: T,
    /// The amplifier of the receiving coil.
    pub receiving: R,
    /// The converter.
    pub i2c: I,
    /// The decoder of the sending coils.
    pub sender: AddressLines<P>,
    /// The decoder of the receiving coils.
    pub receiver: AddressLines<Q>,
    /// A timer.
    pub delay: D,
}

/// The board.
pub struct Magnitude<G, T, R, I, P, Q, D> {
    synthesiser: Ad983x<G, Ad9833Ad9837>,
    sending: T,
    receiving: R,
    converter: Converter<I>,
    sender: AddressLines<P>,
    receiver: AddressLines<Q>,
    delay: D,
    chain: Chain,
    /// Phase step of the synthesiser, and whether it is running.
    step: u32,
    runs: bool,
    /// Codes of both gains.
    sending_gain: u8,
    receiving_gain: u8,
    /// The current measurement.
    measuring: Option<[u8; 4]>,
}

impl<G: SpiDevice, T: SpiDevice, R: SpiDevice, I: I2c, P: OutputPin, Q: OutputPin, D: DelayNs>
    Magnitude<G, T, R, I, P, Q, D>
{
    /// A board at 20 kHz with both amplifiers at gain 1.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] for fewer than 2 or more than 16 coils or a clock too slow for the frequency range;
    /// [`Failure::Bus`] if a chip doesn't answer.
    pub fn new(parts: Parts<G, T, R, I, P, Q, D>, chain: Chain) -> Result<Self, Failure> {
        // With fewer than four steps per period it would no longer be a sine.
        let reaches = chain.clock_hz >= 4.0 * BAND_HZ[1] && chain.clock_hz.is_finite();
        if !(2..=MOST_COILS).contains(&chain.coils) || !reaches {
            return Err(Failure::BadArgument);
        }
        let Parts { synthesiser, sending, receiving, i2c, sender, receiver, delay } = parts;
        let mut board = Self {
            synthesiser: Ad983x::new_ad9833(synthesiser),
            sending,
            receiving,
            converter: Converter::new(i2c)?,
            sender,
            receiver,
            delay,
            chain,
            step: 0,
            runs: false,
            sending_gain: 0,
            receiving_gain: 0,
            measuring: None,
        };
        board.converter.set_gain(RANGE)?;
        board.synthesiser.reset().map_err(|_| Failure::Bus)?;
        board.set_frequency_hz(20e3)?;
        board.amplify(0)?;
        board.set_gain(0)?;
        Ok(board)
    }

    fn amplify(&mut self, code: u8) -> Result<(), Failure> {
        self.sending.write(&[WRITE_GAIN, code]).map_err(|_| Failure::Bus)?;
        self.sending_gain = code;
        Ok(())
    }

    fn discard(&mut self) -> Result<(), Failure> {
        self.measuring = None;
        self.converter.discard(&mut self.delay)
    }

    fn run(&mut self) -> Result<(), Failure> {
        if !self.runs {
            self.synthesiser.enable().map_err(|_| Failure::Bus)?;
            self.runs = true;
        }
        Ok(())
    }

    fn select(&mut self, [sends, _, receives, _]: [u8; 4]) -> Result<(), Failure> {
        self.sender.select(sends)?;
        self.receiver.select(receives)?;
        self.delay.delay_us(self.chain.settling_us);
        Ok(())
    }

    /// Reading of the first pair of coils, volts at the coil.
    fn first_pair_v(&mut self) -> Result<f32, Failure> {
        self.select([0, NO_ELECTRODE, 1, NO_ELECTRODE])?;
        let reading = self.converter.wait(Input::Single, &mut self.delay)?;
        Ok(f32::from(reading.counts) * self.scale_v())
    }
}

impl<G: SpiDevice, T: SpiDevice, R: SpiDevice, I: I2c, P: OutputPin, Q: OutputPin, D: DelayNs> Board
    for Magnitude<G, T, R, I, P, Q, D>
{
    fn facts(&self) -> Facts {
        Facts {
            device: "dermis magnitude chain with AD9833 and ADS1115",
            electrodes: self.chain.coils,
            adc_bits: 16,
            magnitude: true,
            coils: true,
            readings_per_s: 1.0 / (1.0 / READINGS_PER_S + self.chain.settling_us as f32 * 1e-6),
            has_frequency: true,
            has_impedance: false,
            protocols: &[Named::HigherCoils],
        }
    }

    fn amplitude_a(&self) -> f32 {
        self.chain.current_a * f32::from(GAINS[usize::from(self.sending_gain)])
    }

    /// Uses the nearest gain of the amplifier.
    fn set_amplitude_a(&mut self, amplitude_a: f32) -> Result<f32, Failure> {
        let most_a = self.chain.current_a * f32::from(GAINS[GAINS.len() - 1]);
        if !(amplitude_a > 0.0 && amplitude_a <= most_a * 1.001) {
            return Err(Failure::BadArgument);
        }
        let error = |code: u8| (f32::from(GAINS[usize::from(code)]) * self.chain.current_a - amplitude_a).abs();
        let nearest = (0..GAINS.len() as u8).fold(0, |best, code| if error(code) < error(best) { code } else { best });
        self.amplify(nearest)?;
        Ok(self.amplitude_a())
    }

    fn frequency_hz(&self) -> f32 {
        self.step as f32 * (self.chain.clock_hz / (1u32 << PHASE_BITS) as f32)
    }

    fn set_frequency_hz(&mut self, frequency_hz: f32) -> Result<f32, Failure> {
        if !(BAND_HZ[0]..=BAND_HZ[1]).contains(&frequency_hz) {
            return Err(Failure::BadArgument);
        }
        let step = (frequency_hz / self.chain.clock_hz * (1u32 << PHASE_BITS) as f32 + 0.5) as u32;
        self.synthesiser.set_frequency(FrequencyRegister::F0, step).map_err(|_| Failure::Bus)?;
        self.step = step;
        Ok(self.frequency_hz())
    }

    fn gain(&self) -> u8 {
        self.receiving_gain
    }

    fn gains(&self) -> u8 {
        GAINS.len() as u8
    }

    fn set_gain(&mut self, code: u8) -> Result<(), Failure> {
        if usize::from(code) >= GAINS.len() {
            return Err(Failure::BadArgument);
        }
        self.receiving.write(&[WRITE_GAIN, code]).map_err(|_| Failure::Bus)?;
        self.receiving_gain = code;
        Ok(())
    }

    /// In volts of amplitude at the receiving coil.
    fn scale_v(&self) -> f32 {
        self.converter.scale_v() * AMPLITUDE_OVER_MEAN / f32::from(GAINS[usize::from(self.receiving_gain)])
    }

    fn measure(&mut self, measurement: [u8; 4]) -> nb::Result<Reading, Failure> {
        if self.measuring != Some(measurement) {
            self.discard()?;
            self.run()?;
            self.select(measurement)?;
            self.measuring = Some(measurement);
        }
        let result = self.converter.read(Input::Single);
        if !matches!(result, Err(nb::Error::WouldBlock)) {
            self.measuring = None;
        }
        result
    }

    fn quiet(&mut self) -> Result<(), Failure> {
        self.discard()?;
        self.runs = false;
        self.synthesiser.disable().map_err(|_| Failure::Bus)
    }

    /// Voltage at coil 2 with the synthesiser off, then with coil 1 sending at the current amplitude, volts; and the
    /// ratio of the readings at gains 2 and 1 of the sending amplifier, which is 2 for a linear chain.
    fn self_test(&mut self, out: &mut [f32]) -> Result<usize, Failure> {
        let before = self.sending_gain;
        self.quiet()?;
        let silent_v = self.first_pair_v()?;
        self.run()?;
        let present_v = self.first_pair_v()?;
        self.amplify(0)?;
        let single_v = self.first_pair_v()?;
        self.amplify(1)?;
        let double_v = self.first_pair_v()?;
        self.amplify(before)?;
        self.quiet()?;
        let found = [silent_v, present_v, (double_v - silent_v) / (single_v - silent_v)];
        let count = found.len().min(out.len());
        out[..count].copy_from_slice(&found[..count]);
        Ok(count)
    }
}
