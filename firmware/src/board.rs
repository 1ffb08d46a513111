//! The interface of a board to the scan engine: settings, single readings, and self-checks.

use dermis_wire::Status;

use crate::protocol::Named;

/// Fixed properties of a board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facts {
    /// Make and model, at most 60 bytes.
    pub device: &'static str,
    /// Electrodes (or coils) connected.
    pub electrodes: u8,
    /// Resolution of the converter in bits.
    pub adc_bits: u8,
    /// True if readings are magnitudes without sign.
    pub magnitude: bool,
    /// True for coils: one sends and one receives, without a sink or a second one to read against.
    pub coils: bool,
    /// Readings per second supported by converter and buses, used until a frame has been timed.
    pub readings_per_s: f32,
    /// True if the drive frequency can be set; otherwise the drive is direct current.
    pub has_frequency: bool,
    /// True if contact impedances can be measured.
    pub has_impedance: bool,
    /// Protocols known by name, at least one; the first is set at start-up.
    pub protocols: &'static [Named],
}

/// One reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// The converter's counts.
    pub counts: i16,
    /// Events during the reading: [`Status::SATURATED`], [`Status::COMPLIANCE`].
    pub status: Status,
}

/// Reason for refusing an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// The argument is out of range.
    BadArgument,
    /// The board doesn't support the command.
    Unknown,
    /// A chip on a bus doesn't answer.
    Bus,
}

/// A board: electrodes (or coils), a source, multiplexers, a converter.
pub trait Board {
    /// Fixed properties.
    fn facts(&self) -> Facts;

    /// Current setting of the drive amplitude, amperes.
    fn amplitude_a(&self) -> f32;

    /// Sets the nearest possible amplitude and returns it, amperes.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] beyond the source's range.
    fn set_amplitude_a(&mut self, amplitude_a: f32) -> Result<f32, Failure>;

    /// Current setting of the drive frequency, hertz; 0 for direct current.
    fn frequency_hz(&self) -> f32 {
        0.0
    }

    /// Sets the nearest possible frequency and returns it, hertz.
    ///
    /// # Errors
    /// [`Failure::Unknown`] for direct current, [`Failure::BadArgument`] beyond the range, [`Failure::Bus`].
    fn set_frequency_hz(&mut self, _frequency_hz: f32) -> Result<f32, Failure> {
        Err(Failure::Unknown)
    }

    /// Current gain code. A higher code means fewer volts per count.
    fn gain(&self) -> u8;

    /// Number of gain codes.
    fn gains(&self) -> u8;

    /// Sets the gain.
    ///
    /// # Errors
    /// [`Failure::BadArgument`] for an unknown code, [`Failure::Bus`].
    fn set_gain(&mut self, code: u8) -> Result<(), Failure>;

    /// Volts per count at the current gain.
    fn scale_v(&self) -> f32;

    /// Measures with four electrodes: current in, current out, voltage and its reference ([`dermis_wire::NO_ELECTRODE`]
    /// for ground). Call it again with the same arguments until the reading is ready.
    ///
    /// # Errors
    /// `WouldBlock` while it is measuring; [`Failure::Bus`].
    fn measure(&mut self, measurement: [u8; 4]) -> nb::Result<Reading, Failure>;

    /// Switches the current off.
    ///
    /// # Errors
    /// [`Failure::Bus`].
    fn quiet(&mut self) -> Result<(), Failure>;

    /// Tests itself and returns the number of values filled in `out`. The board's documentation explains them.
    ///
    /// # Errors
    /// [`Failure::Bus`].
    fn self_test(&mut self, out: &mut [f32]) -> Result<usize, Failure>;

    /// Contact impedance of an electrode, ohms; NaN if it is open.
    ///
    /// # Errors
    /// [`Failure::Unknown`] if the board cannot measure it, [`Failure::Bus`].
    fn impedance_ohm(&mut self, _electrode: u8) -> Result<f32, Failure> {
        Err(Failure::Unknown)
    }
}
