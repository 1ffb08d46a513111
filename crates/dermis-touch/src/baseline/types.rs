//! Parameters, states, changes and records of a baseline.

use serde::{Deserialize, Serialize};

/// How drift is followed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DriftCompensation {
    /// The baseline changes only by tare.
    Off,
    /// The baseline follows the raw values while nothing touches the skin.
    Exponential {
        /// Time constant tau, seconds, above 0: the time after which a step in the raw values has decayed to 1/e. A
        /// touch too weak to be reported as load decays with it.
        time_constant_s: f64,
        /// How long the baseline stays frozen after a load is removed, while the material relaxes. Seconds, at least
        /// 0.
        settle_s: f64,
    },
    /// The baseline follows only changes of all channels by the same share, while nothing touches the skin.
    Uniform {
        /// Time constant tau, seconds, above 0.
        time_constant_s: f64,
        /// As for [`DriftCompensation::Exponential`].
        settle_s: f64,
    },
}

/// Parameters of a [`Baseline`](super::Baseline).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaselineParams {
    /// Number of frames in the start-up baseline, at least 1. With 8 or more it is robust to outliers and a short
    /// touch.
    pub startup_frames: usize,
    /// Drift compensation.
    pub drift: DriftCompensation,
}

impl Default for BaselineParams {
    /// 32 frames; drift followed with a time constant of 60 s, from 2 s after release.
    fn default() -> Self {
        Self { startup_frames: 32, drift: DriftCompensation::Exponential { time_constant_s: 60.0, settle_s: 2.0 } }
    }
}

/// Load on the skin in a frame, as judged by the caller, for example from the contacts in its image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Load {
    /// Nothing touches the skin.
    Free,
    /// Something touches the skin.
    Touched,
}

/// How a tare treats load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TareGuard {
    /// The tare is refused while touched, and cancelled if a touch begins during it.
    RefuseUnderLoad,
    /// The tare proceeds whatever the load, and is recorded as forced.
    Force,
    /// As `Force`, but the tare is cancelled if the readings change during it by more than noise: something moves.
    Still,
}

/// Progress of start-up or tare.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BaselineState {
    /// Collecting start-up frames; nothing is compensated yet.
    Starting {
        /// Frames collected.
        have: usize,
        /// Frames needed.
        want: usize,
    },
    /// In use.
    Ready,
    /// In use, while a tare collects frames for the next baseline.
    Taring {
        /// Frames collected.
        have: usize,
        /// Frames needed.
        want: usize,
    },
}

/// The effect of one call of [`Baseline::learn`](super::Baseline::learn).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BaselineChange {
    /// Nothing changed, except perhaps by drift.
    None,
    /// The start-up baseline is complete.
    Started,
    /// A tare is complete.
    Tared,
    /// A tare was cancelled because a touch began.
    TareCancelled,
}

/// Origin of a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReferenceOrigin {
    /// The first frames.
    Startup,
    /// A tare.
    Tare,
    /// A tare that was forced.
    ForcedTare,
    /// Values given by the caller.
    Given,
    /// The skin at rest with known damage, so that touches are measured relative to the damaged skin.
    Damage,
}

/// When and why the baseline was set.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReferenceRecord {
    /// Time of the frame that completed it, nanoseconds.
    pub time_ns: u64,
    /// Number of frames averaged; 0 if given by the caller.
    pub frames: usize,
    /// Its origin.
    pub origin: ReferenceOrigin,
    /// The caller's reason; empty at start-up.
    pub reason: String,
}
