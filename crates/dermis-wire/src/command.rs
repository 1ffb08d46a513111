//! What a host may ask of a device, and the answer.

use crate::List;

/// In a measurement of a protocol: no electrode but the instrument's reference.
pub const NO_ELECTRODE: u8 = 0xff;

/// A command with the tag that its reply will carry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request<'a> {
    /// Any number; the host counts.
    pub tag: u16,
    /// What to do.
    pub command: Command<'a>,
}

/// What to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command<'a> {
    /// Code 0. Part of a list of measurements; the list counts once its last part has come.
    Protocol {
        /// Index of the first measurement of this part.
        first: u16,
        /// Measurements of the whole list.
        total: u16,
        /// Electrode where the current enters, where it leaves, where the voltage is taken, against which: from 0, or
        /// [`NO_ELECTRODE`].
        measurements: List<'a, [u8; 4]>,
    },
    /// Code 1. One of the protocols that the device knows by name.
    ProtocolName(&'a str),
    /// Code 2. Amplitude of the drive current, amperes.
    Amplitude(f32),
    /// Code 3. Frequency of the drive, hertz.
    Frequency(f32),
    /// Code 4. Gain by the device's own code; 255 leaves the choice to the device.
    Gain(u8),
    /// Code 5. Frames a second.
    Rate(f32),
    /// Code 6. Let frames flow.
    Start,
    /// Code 7. No more frames.
    Stop,
    /// Code 8. One frame.
    SingleShot,
    /// Code 9. Test yourself; the reply holds what the device measured of itself.
    SelfTest,
    /// Code 10. Measure contact impedances; the reply holds one magnitude an electrode, ohms, NaN where open.
    ElectrodeImpedance,
}

impl Command<'_> {
    /// Number of commands; codes are below.
    pub const COUNT: u8 = 11;

    /// Its code on the line, and its bit in [`Describe::commands`](crate::Describe::commands).
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

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplyStatus {
    /// Code 0. Done.
    Done,
    /// Code 1. The device does not have this command.
    Unknown,
    /// Code 2. A number or name that it cannot take.
    BadArgument,
    /// Code 3. Not now.
    Busy,
    /// Code 4. It tried and failed.
    Failed,
}

impl ReplyStatus {
    /// Its code on the line.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// By its code.
    pub fn from_code(code: u8) -> Option<Self> {
        [Self::Done, Self::Unknown, Self::BadArgument, Self::Busy, Self::Failed]
            .into_iter()
            .find(|status| status.code() == code)
    }
}

/// The answer to a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reply<'a> {
    /// Tag of the command.
    pub tag: u16,
    /// Code of the command.
    pub command: u8,
    /// How it ended.
    pub status: ReplyStatus,
    /// What was set (amplitude, frequency, rate: one number, as near to what was asked as the device can), or measured.
    pub values: List<'a, f32>,
}
