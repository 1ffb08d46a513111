//! The converter of both boards, an ADS1115 on I2C, read once per measurement through the driver crate `ads1x1x`.
//! Ranges, in volts to either side, and conversion time are from its data sheet (Texas Instruments, SBAS444).

use ads1x1x::{Ads1x1x, DataRate16Bit, FullScaleRange, TargetAddr, channel, ic, mode};
use dermis_wire::Status;
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

use crate::board::{Failure, Reading};

/// Full scale of each gain code, volts, widest first.
pub const RANGES_V: [f32; 6] = [6.144, 4.096, 2.048, 1.024, 0.512, 0.256];
/// Highest rate, conversions per second.
pub const CONVERSIONS_PER_S: f32 = 860.0;
/// Readings per second achieved over a 400 kHz bus: each takes a start, at least two polls and the result.
pub const READINGS_PER_S: f32 = 600.0;
/// Maximum number of polls of the converter, 50 us apart, before giving up.
const MOST_LOOKS: u32 = 200;
/// Full scale in counts.
const COUNTS: f32 = 32_768.0;

/// Inputs to compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Input {
    /// Input 0 against ground.
    Single,
    /// Input 0 against input 1.
    Differential,
}

/// An ADS1115 making single conversions.
pub struct Converter<I> {
    chip: Ads1x1x<I, ic::Ads1115, ic::Resolution16Bit, mode::OneShot>,
    gain: u8,
    /// Input of the current conversion.
    pending: Option<Input>,
}

impl<I: I2c> Converter<I> {
    /// The chip with its address pin at ground, at its highest rate, in the second-widest range.
    ///
    /// # Errors
    /// [`Failure::Bus`] if it doesn't answer.
    pub fn new(i2c: I) -> Result<Self, Failure> {
        let mut converter = Self { chip: Ads1x1x::new_ads1115(i2c, TargetAddr::default()), gain: 0, pending: None };
        converter.chip.set_data_rate(DataRate16Bit::Sps860).map_err(|_| Failure::Bus)?;
        converter.set_gain(1)?;
        Ok(converter)
    }

    /// Current range: its index in [`RANGES_V`].
    pub fn gain(&self) -> u8 {
        self.gain
    }

    /// Sets the range.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] for an unknown code, [`Failure::Bus`].
    pub fn set_gain(&mut self, code: u8) -> Result<(), Failure> {
        let range = match code {
            0 => FullScaleRange::Within6_144V,
            1 => FullScaleRange::Within4_096V,
            2 => FullScaleRange::Within2_048V,
            3 => FullScaleRange::Within1_024V,
            4 => FullScaleRange::Within0_512V,
            5 => FullScaleRange::Within0_256V,
            _ => return Err(Failure::BadArgument),
        };
        self.chip.set_full_scale_range(range).map_err(|_| Failure::Bus)?;
        self.gain = code;
        Ok(())
    }

    /// Volts per count.
    pub fn scale_v(&self) -> f32 {
        RANGES_V[usize::from(self.gain)] / COUNTS
    }

    /// Starts a conversion, or polls the current one.
    ///
    /// # Errors
    /// `WouldBlock` until it has ended; [`Failure::Bus`].
    pub fn read(&mut self, input: Input) -> nb::Result<Reading, Failure> {
        let counts = match input {
            Input::Single => self.chip.read(channel::SingleA0),
            Input::Differential => self.chip.read(channel::DifferentialA0A1),
        };
        self.pending = None;
        match counts {
            Ok(counts) => {
                let clipped = counts == i16::MAX || counts == i16::MIN;
                Ok(Reading { counts, status: if clipped { Status::SATURATED } else { Status::default() } })
            }
            Err(nb::Error::WouldBlock) => {
                self.pending = Some(input);
                Err(nb::Error::WouldBlock)
            }
            Err(nb::Error::Other(_)) => Err(nb::Error::Other(Failure::Bus)),
        }
    }

    /// Makes a reading and waits for it.
    ///
    /// # Errors
    /// [`Failure::Bus`], also if the conversion doesn't end.
    pub fn wait(&mut self, input: Input, delay: &mut impl DelayNs) -> Result<Reading, Failure> {
        for _ in 0..MOST_LOOKS {
            match self.read(input) {
                Err(nb::Error::WouldBlock) => delay.delay_us(50),
                Err(nb::Error::Other(failure)) => return Err(failure),
                Ok(reading) => return Ok(reading),
            }
        }
        Err(Failure::Bus)
    }

    /// Waits for a conversion that is no longer wanted, so that its result isn't taken for the next one's.
    ///
    /// # Errors
    /// As for [`Converter::wait`].
    pub fn discard(&mut self, delay: &mut impl DelayNs) -> Result<(), Failure> {
        match self.pending {
            Some(input) => self.wait(input, delay).map(|_| ()),
            None => Ok(()),
        }
    }
}
