//! What is wrong with channels and electrodes.

use serde::Serialize;

/// What is wrong with a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChannelFaultKind {
    /// It goes with its electrode: it uses one that is lost, or is driven or read across a short.
    Electrode,
    /// It contradicts its reciprocal channel, or what the others let expect.
    Inconsistent,
    /// Its noise is several times what it was.
    Noisy,
    /// Its signal has gone, together with that of the channels that share its drive or measuring pair.
    Dead,
    /// It reads the same, frame after frame.
    Stuck,
    /// It stands at the converter's end.
    Saturated,
    /// It has no value.
    Missing,
}

impl ChannelFaultKind {
    /// The kind in a word, as in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Electrode => "electrode",
            Self::Inconsistent => "inconsistent",
            Self::Noisy => "noisy",
            Self::Dead => "dead",
            Self::Stuck => "stuck",
            Self::Saturated => "saturated",
            Self::Missing => "missing",
        }
    }
}

/// What is wrong with an electrode or coil.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ElectrodeFaultKind {
    /// Its channels are lost: no contact, a broken wire, a dead coil or multiplexer line.
    Lost,
    /// It is connected to another one, index from 0; the channels driven or read across the two are lost.
    Shorted {
        /// The other one.
        with: u32,
    },
}

/// A channel that is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ChannelFault {
    /// Index from 0.
    pub channel: u32,
    /// What is wrong.
    pub kind: ChannelFaultKind,
    /// Time of the first frame that showed it, nanoseconds.
    pub since_ns: u64,
    /// Number of that frame.
    pub since_sequence: u64,
}

/// An electrode that is blamed for its channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ElectrodeFault {
    /// Index from 0.
    pub electrode: u32,
    /// What is wrong.
    pub kind: ElectrodeFaultKind,
    /// Time of the first frame that showed it, nanoseconds.
    pub since_ns: u64,
    /// Number of that frame.
    pub since_sequence: u64,
}

/// What is wrong with frames as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameFaultKind {
    /// Every channel reads what it read in the frame before, to the last bit, though the channels have noise.
    Frozen,
    /// Most channels stand at the same largest magnitude: the end of the converter's range.
    Saturated,
    /// The frame is the resting frame with the other sign.
    Flipped,
    /// The readings are far larger than any press makes them.
    OutOfRange,
    /// The readings have gone: what is left is a small share of the resting frame, or noise.
    Blank,
}

impl FrameFaultKind {
    /// The kind in a word, as in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Frozen => "frozen",
            Self::Saturated => "saturated",
            Self::Flipped => "flipped",
            Self::OutOfRange => "out-of-range",
            Self::Blank => "blank",
        }
    }
}

/// A fault of all channels together. Nobody knows what touches the skin while it lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct FrameFault {
    /// What is wrong.
    pub kind: FrameFaultKind,
    /// Time of the first frame that showed it, nanoseconds.
    pub since_ns: u64,
    /// Number of that frame.
    pub since_sequence: u64,
}

/// What is known to be broken, both lists in the order of their indices.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Health<'a> {
    /// What is wrong with the frames as a whole. While there is something, touches are unknown: none are reported, and
    /// that says nothing of whether the skin is touched.
    pub frame: Option<FrameFault>,
    /// Channels left out.
    pub channels: &'a [ChannelFault],
    /// Electrodes blamed.
    pub electrodes: &'a [ElectrodeFault],
}

impl Health<'_> {
    /// True where nothing is.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.frame.is_none() && self.channels.is_empty() && self.electrodes.is_empty()
    }
}
