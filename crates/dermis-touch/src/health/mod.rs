//! Health of channels and electrodes, frame by frame: readings that are missing, frozen, at the converter's end, gone to
//! zero, noisy, or that contradict what the others say. Channels are judged first; an electrode (or coil) is blamed when
//! the channels that use it agree.
//!
//! The yardstick that no touch can move is reciprocity: swapping drive and measurement leaves a transfer impedance as it
//! is, pressed or not (Geselowitz, IEEE Trans. Biomed. Eng. 18 (1971) 38), so that what two reciprocal channels differ
//! by beyond their noise is a fault of the instrument. Channels without such a partner are compared with what the others
//! let expect under the linear model, far more generously, since touches are not small.

mod channel_state;
mod electrode_faults;
mod monitor;
mod start;
mod wiring;

#[cfg(test)]
mod tests;

use serde::Serialize;

pub use monitor::HealthMonitor;
pub use start::HealthReference;
pub use wiring::Wiring;

/// Frames over which evidence is summed: a fault is recognised within as many.
pub const HEALTH_WINDOW: usize = 10;

/// Limits of a [`HealthMonitor`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HealthParams {
    /// A squared deviation (in units of its variance) counts up to this.
    pub most_per_frame: f32,
    /// A channel is bad when the squared deviations of the last ten frames come to this. Of Gaussian noise their sum is
    /// chi-squared with 10 degrees of freedom, which exceeds 120 once in 10^20 times; noise 3.5 times as large as usual
    /// reaches it on average.
    pub bad_sum: f32,
    /// Reciprocal channels may differ by this share of their change: gains differ.
    pub share_of_change: f64,
    /// And by so many times what both have changed by since the frame before: they are read at different moments.
    pub share_of_motion: f64,
    /// And by this share of their resting value, for slow drift of gains.
    pub share_of_rest: f64,
    /// Channels without partner may differ from what the others let expect by this share of their resting value.
    pub unpartnered_share_of_rest: f64,
    /// And by so many times the median change of all channels.
    pub unpartnered_changes: f64,
    /// A reading below this share of its resting value is gone.
    pub dead_share: f64,
    /// Share of the channels of a drive, of a measuring pair or of an electrode that must be gone at once.
    pub dead_agreement: f64,
    /// Chance at which a run of equal readings is taken for a frozen channel.
    pub stuck_chance: f64,
    /// An electrode is blamed when this share of its channels is bad.
    pub blame_share: f64,
    /// And acquitted when no more than this share is.
    pub acquit_share: f64,
    /// A bad channel is taken back after so many frames in a row without fault.
    pub clean_frames: u32,
    /// The converter's end, in the unit of the readings, where known.
    pub full_scale: Option<f64>,
}

impl Default for HealthParams {
    fn default() -> Self {
        Self {
            most_per_frame: 36.0,
            bad_sum: 120.0,
            share_of_change: 0.1,
            share_of_motion: 2.0,
            share_of_rest: 0.005,
            unpartnered_share_of_rest: 0.25,
            unpartnered_changes: 4.0,
            dead_share: 0.05,
            dead_agreement: 0.8,
            stuck_chance: 1e-12,
            blame_share: 0.7,
            acquit_share: 0.3,
            clean_frames: 50,
            full_scale: None,
        }
    }
}

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

/// What is known to be broken, both lists in the order of their indices.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Health<'a> {
    /// Channels left out.
    pub channels: &'a [ChannelFault],
    /// Electrodes blamed.
    pub electrodes: &'a [ElectrodeFault],
}

impl Health<'_> {
    /// True where nothing is.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.channels.is_empty() && self.electrodes.is_empty()
    }
}
