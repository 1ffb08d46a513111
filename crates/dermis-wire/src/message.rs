//! The messages of version 1 but for commands and replies. Offsets and codes are in the book's chapter on the wire.

use crate::{Element, List, Numbers, Reply, Request};

/// Kind of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Host to device: who are you?
    Hello,
    /// Device to host: this is what I am.
    Describe,
    /// Host to device: do this.
    Command,
    /// Device to host: done, or why not.
    Reply,
    /// Device to host: readings.
    Frame,
    /// Device to host: some of a frame's readings.
    Part,
}

impl Kind {
    /// Its code on the line.
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

    /// By its code.
    pub fn from_code(code: u8) -> Option<Self> {
        [Self::Hello, Self::Describe, Self::Command, Self::Reply, Self::Frame, Self::Part]
            .into_iter()
            .find(|kind| kind.code() == code)
    }
}

/// A message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Message<'a> {
    /// Who are you?
    Hello(Hello),
    /// This is what I am.
    Describe(Describe<'a>),
    /// Do this.
    Command(Request<'a>),
    /// Done, or why not.
    Reply(Reply<'a>),
    /// Readings.
    Frame(Frame<'a>),
    /// Some of a frame's readings.
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

/// The host's first words; the device answers with [`Describe`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hello {
    /// Any number but 0; the answer carries it, so that an old answer is not taken for the new one.
    pub nonce: u32,
    /// Lowest version that the host speaks.
    pub lowest_version: u8,
    /// Highest version that the host speaks.
    pub highest_version: u8,
}

/// What a device is and how it is set. Sent in answer to [`Hello`], when the device has started (unasked, so that the
/// host learns of a reset), and before the first frame that is made otherwise than described last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Describe<'a> {
    /// That of the hello; 0 where nobody asked.
    pub nonce: u32,
    /// A number that differs with every start of the device (a count in flash, or random bits); 0 where it has none.
    pub boot: u32,
    /// Electrodes that it drives and measures.
    pub electrodes: u16,
    /// Readings in each frame.
    pub channels: u16,
    /// What a reading is made of.
    pub element: Element,
    /// Resolution of the converter in bits; 0 where it does not apply.
    pub adc_bits: u8,
    /// What is special about the readings, and whether frames are flowing.
    pub features: Features,
    /// Commands that it obeys: bit n for [`Command::code`](crate::Command::code) n.
    pub commands: u32,
    /// Frames a second as set.
    pub frames_per_s: f32,
    /// Most frames a second with this protocol; 0 where unknown.
    pub most_frames_per_s: f32,
    /// Amplitude of the drive current, amperes; 0 where unknown.
    pub amplitude_a: f32,
    /// Frequency of the drive, hertz; 0 for direct current or unknown.
    pub frequency_hz: f32,
    /// Make and model.
    pub device: &'a str,
    /// Serial number.
    pub serial: &'a str,
    /// Version of its firmware.
    pub firmware: &'a str,
    /// Measurement protocol as set.
    pub protocol: &'a str,
    /// Names of the protocols that it knows, separated by commas.
    pub protocols: &'a str,
}

impl<'a> Describe<'a> {
    /// Names of the protocols that it knows.
    pub fn protocol_names(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        self.protocols.split(',').map(str::trim).filter(|name| !name.is_empty())
    }
}

macro_rules! bits {
    ($(#[$doc:meta])* $name:ident($word:ty) { $($(#[$bit_doc:meta])* $bit:ident = $value:expr,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub struct $name(
            /// The bits as on the line; unknown ones are kept.
            pub $word,
        );

        impl $name {
            $($(#[$bit_doc])* pub const $bit: Self = Self(1 << $value);)*

            /// True if every bit of `other` is set.
            pub fn has(self, other: Self) -> bool {
                self.0 & other.0 == other.0
            }

            /// With the bits of `other` set too.
            pub fn with(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }
        }
    };
}

bits! {
    /// What is special about a device's readings.
    Features(u8) {
        /// Frames are flowing.
        RUNNING = 0,
        /// Frames have an imaginary part.
        COMPLEX = 1,
        /// Readings are magnitudes without a sign.
        MAGNITUDE = 2,
        /// Frames state a time for every channel.
        CHANNEL_TIMES = 3,
        /// Frames come in parts, as [`Part`](crate::Part).
        PARTS = 4,
    }
}

bits! {
    /// What happened while a frame was taken.
    Status(u16) {
        /// A reading met the converter's limits.
        SATURATED = 0,
        /// The current source met its voltage limit.
        COMPLIANCE = 1,
        /// Frames before this one were skipped because the line or the device was too slow; the sequence number counts
        /// them.
        OVERRUN = 2,
        /// Taken in answer to a single shot.
        SINGLE = 3,
        /// Readings are a test pattern.
        TEST = 4,
        /// The gain has changed since the frame before.
        GAIN_CHANGED = 5,
    }
}

/// One frame of readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    /// Counts frames taken since the device started, wrapping; frames that were not sent count too.
    pub sequence: u32,
    /// The device's clock at the frame's first reading, nanoseconds since an origin of its choice.
    pub device_time_ns: u64,
    /// What happened meanwhile.
    pub status: Status,
    /// The device's code of the gain at which the frame was taken; information only, `scale` has it in it.
    pub gain: u8,
    /// Volts for one count; 1 where readings are volts.
    pub scale: f32,
    /// Readings in the protocol's order, the real part where there are two.
    pub values: Numbers<'a>,
    /// Imaginary parts: as many, of the same element.
    pub imaginary: Option<Numbers<'a>>,
    /// Time of each reading after `device_time_ns`, nanoseconds: as many as readings.
    pub channel_times_ns: Option<List<'a, u32>>,
}

/// Readings `first` and following of a frame that is sent in parts, by a device that does not hold a whole one.
///
/// Parts come in order, each beginning where the one before ended; one with `first` 0 begins a frame, and begins it
/// anew where another of the same number was not finished. The frame is whole with the part that ends at `total`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part<'a> {
    /// Index of the part's first reading in the frame.
    pub first: u16,
    /// Readings of the whole frame.
    pub total: u16,
    /// The readings: number of the frame, time of the part's first reading, what happened during this part, gain and
    /// scale of this part.
    pub readings: Frame<'a>,
}
