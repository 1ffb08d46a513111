//! What the scan engine needs of a board: settings, one reading at a time, and the checks that it can make of itself.

use dermis_wire::Status;

use crate::protocol::Named;

/// What a board is, apart from how it is set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facts {
    /// Make and model, at most 60 bytes.
    pub device: &'static str,
    /// Electrodes (or coils) connected.
    pub electrodes: u8,
    /// Resolution of the converter in bits.
    pub adc_bits: u8,
    /// Readings are magnitudes without a sign.
    pub magnitude: bool,
    /// They are coils: one sends, one receives, and there is no sink and no second one to read against.
    pub coils: bool,
    /// Readings a second that converter and buses give, until a frame has been timed.
    pub readings_per_s: f32,
    /// Whether the drive's frequency can be set; without, it is direct current.
    pub has_frequency: bool,
    /// Whether contact impedances can be measured.
    pub has_impedance: bool,
    /// Protocols that it knows by name; the first is set at the start. Not empty.
    pub protocols: &'static [Named],
}

/// One reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// The converter's counts.
    pub counts: i16,
    /// What happened meanwhile: [`Status::SATURATED`], [`Status::COMPLIANCE`].
    pub status: Status,
}

/// Why a board does not do something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// It cannot take this number.
    BadArgument,
    /// It does not have this command.
    Unknown,
    /// A chip on one of its buses does not answer.
    Bus,
}

/// A board: electrodes (or coils), a source, multiplexers, a converter.
pub trait Board {
    /// What it is.
    fn facts(&self) -> Facts;

    /// Amplitude of the drive current as set, amperes.
    fn amplitude_a(&self) -> f32;

    /// Sets the amplitude as near as it can; what it is then, amperes.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] beyond the source's range.
    fn set_amplitude_a(&mut self, amplitude_a: f32) -> Result<f32, Failure>;

    /// Frequency of the drive as set, hertz; 0 for direct current.
    fn frequency_hz(&self) -> f32 {
        0.0
    }

    /// Sets the frequency as near as it can; what it is then, hertz.
    ///
    /// # Errors
    /// [`Failure::Unknown`] for direct current, [`Failure::BadArgument`] beyond the range, [`Failure::Bus`].
    fn set_frequency_hz(&mut self, _frequency_hz: f32) -> Result<f32, Failure> {
        Err(Failure::Unknown)
    }

    /// Gain as set, by its code: the higher, the more volts a count stands for is divided.
    fn gain(&self) -> u8;

    /// Codes of gain are below this.
    fn gains(&self) -> u8;

    /// Sets the gain.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] for a code that it does not have, [`Failure::Bus`].
    fn set_gain(&mut self, code: u8) -> Result<(), Failure>;

    /// Volts for one count at the present gain.
    fn scale_v(&self) -> f32;

    /// Measures: electrode where the current enters, where it leaves, where the voltage is taken, against which
    /// ([`dermis_wire::NO_ELECTRODE`] for ground). Called again with the same until the reading is there.
    ///
    /// # Errors
    /// `WouldBlock` while it measures; [`Failure::Bus`].
    fn measure(&mut self, measurement: [u8; 4]) -> nb::Result<Reading, Failure>;

    /// Switches the current off.
    ///
    /// # Errors
    /// [`Failure::Bus`].
    fn quiet(&mut self) -> Result<(), Failure>;

    /// Tests itself; how many numbers of `out` it has filled. Which they are, the board's documentation says.
    ///
    /// # Errors
    /// [`Failure::Bus`].
    fn self_test(&mut self, out: &mut [f32]) -> Result<usize, Failure>;

    /// Contact impedance of an electrode, ohm; NaN where it is open.
    ///
    /// # Errors
    /// [`Failure::Unknown`] where it cannot measure them, [`Failure::Bus`].
    fn impedance_ohm(&mut self, _electrode: u8) -> Result<f32, Failure> {
        Err(Failure::Unknown)
    }
}
