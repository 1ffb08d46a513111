//! Commands from a host to a device, and the replies.

use crate::List;

/// Special electrode number in a measurement: the instrument's reference instead of an electrode.
pub const NO_ELECTRODE: u8 = 0xff;

/// A command with the tag that its reply will carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request<'a> {
    /// Arbitrary number, chosen by the host, which counts up.
    pub tag: u16,
    /// The command.
    pub command: Command<'a>,
}

/// A command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command<'a> {
    /// Code 0. Part of a list of measurements; the list takes effect once its last part has arrived.
    Protocol {
        /// Index of the first measurement of this part.
        first: u16,
        /// Number of measurements in the whole list.
        total: u16,
        /// Per measurement: electrode where the current enters, electrode where it leaves, electrode where the
        /// voltage is taken, and its reference electrode; counted from 0, or [`NO_ELECTRODE`].
        measurements: List<'a, [u8; 4]>,
    },
    /// Code 1. One of the device's named protocols.
    ProtocolName(&'a str),
    /// Code 2. Amplitude of the drive current, amperes.
    Amplitude(f32),
    /// Code 3. Frequency of the drive, hertz.
    Frequency(f32),
    /// Code 4. Gain, as the device's own code; 255 lets the device choose.
    Gain(u8),
    /// Code 5. Frames per second.
    Rate(f32),
    /// Code 6. Starts the stream of frames.
    Start,
    /// Code 7. Stops the stream of frames.
    Stop,
    /// Code 8. Takes one frame.
    SingleShot,
    /// Code 9. Runs a self-test; the reply holds the device's measurements.
    SelfTest,
    /// Code 10. Measures contact impedances; the reply holds one magnitude per electrode, ohms, NaN for open
    /// electrodes.
    ElectrodeImpedance,
}

impl Command<'_> {
    /// Number of commands; all codes are below it.
    pub const COUNT: u8 = 11;

    /// The code on the line, which is also the bit in [`Describe::commands`](crate::Describe::commands).
    pub fn code(&self) -> u8 {
        match self {
            Self::Protocol { .. } => 0,
            Self::ProtocolName(_) => 1,
            Self::Amplitude(_) => 2,
            Self::Frequency(_) => 3,
            Self::Gain(_) => 4,
            Self::Rate(_) => 5,
            Self::Start => 6,
            Self::Stop => 7,
            Self::SingleShot => 8,
            Self::SelfTest => 9,
            Self::ElectrodeImpedance => 10,
        }
    }
}

/// Outcome of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplyStatus {
    /// Code 0. Done.
    Done,
    /// Code 1. The device does not have this command.
    Unknown,
    /// Code 2. The device cannot accept this number or name.
    BadArgument,
    /// Code 3. The device is busy.
    Busy,
    /// Code 4. The device tried and failed.
    Failed,
}

impl ReplyStatus {
    /// The code on the line.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The status for a code.
    pub fn from_code(code: u8) -> Option<Self> {
        [Self::Done, Self::Unknown, Self::BadArgument, Self::Busy, Self::Failed]
            .into_iter()
            .find(|status| status.code() == code)
    }
}

/// The reply to a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply<'a> {
    /// Tag of the command.
    pub tag: u16,
    /// Code of the command.
    pub command: u8,
    /// Outcome.
    pub status: ReplyStatus,
    /// The value that was set (amplitude, frequency or rate: one number, as close to the request as the device can
    /// get), or the measured values.
    pub values: List<'a, f32>,
}
