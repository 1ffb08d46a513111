//! The messages of version 1 except commands and replies. The book's chapter on the wire lists offsets and codes.

use crate::{Element, List, Numbers, Reply, Request};

/// Kind of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Host to device: asks for a description.
    Hello,
    /// Device to host: description and settings.
    Describe,
    /// Host to device: a command.
    Command,
    /// Device to host: outcome of a command.
    Reply,
    /// Device to host: readings of a frame.
    Frame,
    /// Device to host: part of a frame's readings.
    Part,
}

impl Kind {
    /// The code on the line.
    pub fn code(self) -> u8 {
        match self {
            Self::Describe => 0x01,
            Self::Reply => 0x02,
            Self::Frame => 0x03,
            Self::Part => 0x04,
            Self::Hello => 0x11,
            Self::Command => 0x12,
        }
    }

    /// The kind for a code.
    pub fn from_code(code: u8) -> Option<Self> {
        [Self::Hello, Self::Describe, Self::Command, Self::Reply, Self::Frame, Self::Part]
            .into_iter()
            .find(|kind| kind.code() == code)
    }
}

/// A message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Message<'a> {
    /// Asks for a description.
    Hello(Hello),
    /// Description and settings.
    Describe(Describe<'a>),
    /// A command.
    Command(Request<'a>),
    /// Outcome of a command.
    Reply(Reply<'a>),
    /// Readings of a frame.
    Frame(Frame<'a>),
    /// Part of a frame's readings.
    Part(Part<'a>),
}

impl Message<'_> {
    /// Kind of the message.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Hello(_) => Kind::Hello,
            Self::Describe(_) => Kind::Describe,
            Self::Command(_) => Kind::Command,
            Self::Reply(_) => Kind::Reply,
            Self::Frame(_) => Kind::Frame,
            Self::Part(_) => Kind::Part,
        }
    }
}

/// The host's first message; the device answers with [`Describe`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hello {
    /// Any number except 0. The answer repeats it, so an old answer is not mistaken for the new one.
    pub nonce: u32,
    /// Lowest version supported by the host.
    pub lowest_version: u8,
    /// Highest version supported by the host.
    pub highest_version: u8,
}

/// Description and settings of a device. Sent in answer to [`Hello`], after a start of the device (unsolicited, so
/// that the host notices a reset), and before the first frame with different settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Describe<'a> {
    /// Nonce of the hello; 0 if unsolicited.
    pub nonce: u32,
    /// A number that changes with every start of the device (a count in flash, or random bits); 0 if the device has
    /// none.
    pub boot: u32,
    /// Number of electrodes.
    pub electrodes: u16,
    /// Number of readings in each frame.
    pub channels: u16,
    /// Type of the readings.
    pub element: Element,
    /// Resolution of the converter, bits; 0 if not applicable.
    pub adc_bits: u8,
    /// Properties of the readings, and whether frames are being sent.
    pub features: Features,
    /// Supported commands: bit n for [`Command::code`](crate::Command::code) n.
    pub commands: u32,
    /// Current rate, frames per second.
    pub frames_per_s: f32,
    /// Maximum rate with this protocol, frames per second; 0 if unknown.
    pub most_frames_per_s: f32,
    /// Amplitude of the drive current, amperes; 0 if unknown.
    pub amplitude_a: f32,
    /// Frequency of the drive, hertz; 0 for direct current or if unknown.
    pub frequency_hz: f32,
    /// Make and model.
    pub device: &'a str,
    /// Serial number.
    pub serial: &'a str,
    /// Firmware version.
    pub firmware: &'a str,
    /// Current measurement protocol.
    pub protocol: &'a str,
    /// Names of the supported protocols, separated by commas.
    pub protocols: &'a str,
}

impl<'a> Describe<'a> {
    /// Names of the supported protocols.
    pub fn protocol_names(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.protocols.split(',').map(str::trim).filter(|name| !name.is_empty())
    }
}

macro_rules! bits {
    ($(#[$doc:meta])* $name:ident($word:ty) { $($(#[$bit_doc:meta])* $bit:ident = $value:expr,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub struct $name(
            /// The bits as on the line, including unknown ones.
            pub $word,
        );

        impl $name {
            $($(#[$bit_doc])* pub const $bit: Self = Self(1 << $value);)*

            /// True if every bit of `other` is set.
            pub fn has(self, other: Self) -> bool {
                self.0 & other.0 == other.0
            }

            /// Adds the bits of `other`.
            pub fn with(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }
        }
    };
}

bits! {
    /// Properties of a device's readings.
    Features(u8) {
        /// Frames are being sent.
        RUNNING = 0,
        /// Frames have an imaginary part.
        COMPLEX = 1,
        /// Readings are magnitudes without a sign.
        MAGNITUDE = 2,
        /// Frames include a time for every channel.
        CHANNEL_TIMES = 3,
        /// Frames are sent in parts, as [`Part`](crate::Part).
        PARTS = 4,
    }
}

bits! {
    /// Events during a frame.
    Status(u16) {
        /// A reading reached the converter's limits.
        SATURATED = 0,
        /// The current source reached its voltage limit.
        COMPLIANCE = 1,
        /// Frames before this one were skipped because the line or the device was too slow. The sequence number
        /// includes them.
        OVERRUN = 2,
        /// Taken for a single-shot command.
        SINGLE = 3,
        /// Readings are a test pattern.
        TEST = 4,
        /// The gain has changed since the previous frame.
        GAIN_CHANGED = 5,
    }
}

/// One frame of readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    /// Number of frames taken since the device started, including unsent ones; wraps around.
    pub sequence: u32,
    /// The device's clock at the first reading of the frame, nanoseconds since an arbitrary origin.
    pub device_time_ns: u64,
    /// Events during the frame.
    pub status: Status,
    /// Gain of the frame, as the device's own code; for information only, since `scale` includes it.
    pub gain: u8,
    /// Volts per count; 1 if readings are volts.
    pub scale: f32,
    /// Readings in the protocol's order; the real part of complex readings.
    pub values: Numbers<'a>,
    /// Imaginary parts, with the same length and type as `values`.
    pub imaginary: Option<Numbers<'a>>,
    /// Time of each reading after `device_time_ns`, nanoseconds; one per reading.
    pub channel_times_ns: Option<List<'a, u32>>,
}

/// Part of the readings of a frame, starting at `first`, from a device that cannot hold a whole frame.
///
/// Parts arrive in order, each starting where the previous one ended. A part with `first` 0 starts a frame, or
/// restarts an unfinished frame with the same number. The frame is complete with the part that ends at `total`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part<'a> {
    /// Index of the part's first reading in the frame.
    pub first: u16,
    /// Number of readings in the whole frame.
    pub total: u16,
    /// The readings. Number of the frame, time of the part's first reading, and events, gain and scale of this part.
    pub readings: Frame<'a>,
}
