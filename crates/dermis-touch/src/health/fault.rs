//! Faults of channels, electrodes and frames.

use std::borrow::Cow;

use serde::Serialize;

/// Kind of fault of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChannelFaultKind {
    /// Caused by an electrode: the channel uses a lost one, or is driven or read across a short.
    Electrode,
    /// Contradicts its reciprocal channel, or the value expected from the other channels.
    Inconsistent,
    /// Its noise is several times its earlier value.
    Noisy,
    /// Its signal has vanished, together with those of the channels that share its drive or measuring pair.
    Dead,
    /// Reads the same value, frame after frame.
    Stuck,
    /// Is at the converter's limit.
    Saturated,
    /// Has no value.
    Missing,
}

impl ChannelFaultKind {
    /// Name of the kind, as in files.
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

/// Kind of fault of an electrode or coil.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ElectrodeFaultKind {
    /// Its channels are lost: no contact, a broken wire, a dead coil or multiplexer line.
    Lost,
    /// Connected to another electrode. The channels driven or read across the two are lost.
    Shorted {
        /// The other electrode, index from 0.
        with: u32,
    },
}

/// An excluded channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ChannelFault {
    /// Index from 0.
    pub channel: u32,
    /// Kind of fault.
    pub kind: ChannelFaultKind,
    /// Time of the first frame that showed the fault, nanoseconds.
    pub since_ns: u64,
    /// Sequence number of that frame.
    pub since_sequence: u64,
}

/// An electrode held responsible for its channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ElectrodeFault {
    /// Index from 0.
    pub electrode: u32,
    /// Kind of fault.
    pub kind: ElectrodeFaultKind,
    /// Time of the first frame that showed the fault, nanoseconds.
    pub since_ns: u64,
    /// Sequence number of that frame.
    pub since_sequence: u64,
}

/// Kind of fault of whole frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameFaultKind {
    /// Every channel repeats its value of the previous frame to the last bit, although the channels have noise.
    Frozen,
    /// Most channels are at the same largest magnitude: the converter's limit.
    Saturated,
    /// The frame is the resting frame with opposite sign.
    Flipped,
    /// The readings are far larger than any press could make them.
    OutOfRange,
    /// The readings have vanished: only a small share of the resting frame, or noise, is left.
    Blank,
}

impl FrameFaultKind {
    /// Name of the kind, as in files.
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

/// A fault of all channels together. While it lasts, touches cannot be determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct FrameFault {
    /// Kind of fault.
    pub kind: FrameFaultKind,
    /// Time of the first frame that showed the fault, nanoseconds.
    pub since_ns: u64,
    /// Sequence number of that frame.
    pub since_sequence: u64,
}

/// All known faults; both lists are in index order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Health<'a> {
    /// Fault of whole frames. While there is one, touches are unknown: none are reported, but the skin may be
    /// touched.
    pub frame: Option<FrameFault>,
    /// Excluded channels.
    pub channels: Cow<'a, [ChannelFault]>,
    /// Faulty electrodes.
    pub electrodes: Cow<'a, [ElectrodeFault]>,
}

impl Health<'_> {
    /// The same faults, in memory of their own.
    #[must_use]
    pub fn into_owned(self) -> Health<'static> {
        let Health { frame, channels, electrodes } = self;
        Health { frame, channels: Cow::Owned(channels.into_owned()), electrodes: Cow::Owned(electrodes.into_owned()) }
    }

    /// True if no fault is known.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.frame.is_none() && self.channels.is_empty() && self.electrodes.is_empty()
    }
}
