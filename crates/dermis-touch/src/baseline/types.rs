//! What a baseline is told and tells: its rules, its state, what changed it and where it came from.

use serde::{Deserialize, Serialize};

/// Whether drift is followed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DriftCompensation {
    /// The baseline changes only by tare.
    Off,
    /// The baseline follows the raw values while the skin is free.
    Exponential {
        /// Time constant tau, seconds, above 0: a step in the raw values has faded to 1/e after it. A touch too weak to
        /// be reported as load fades with it too.
        time_constant_s: f64,
        /// The baseline stays frozen for so long after a load has gone, seconds, at least 0: the material relaxes.
        settle_s: f64,
    },
    /// The baseline follows a change of all channels by the same share, and nothing else, while the skin is free.
    Uniform {
        /// Time constant tau, seconds, above 0.
        time_constant_s: f64,
        /// As for [`DriftCompensation::Exponential`].
        settle_s: f64,
    },
}

/// Rules of a [`Baseline`](super::Baseline).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaselineParams {
    /// Frames of the start-up baseline. At least 1; from 8 on it shrugs off outliers and a short touch.
    pub startup_frames: usize,
    /// Drift compensation.
    pub drift: DriftCompensation,
}

impl Default for BaselineParams {
    /// 32 frames; drift followed with 60 s, 2 s after release.
    fn default() -> Self {
        Self { startup_frames: 32, drift: DriftCompensation::Exponential { time_constant_s: 60.0, settle_s: 2.0 } }
    }
}

/// Whether the skin is touched in a frame, as judged by the caller (from contacts of its image, say).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Load {
    /// Nothing touches it.
    Free,
    /// Something does.
    Touched,
}

/// What a tare does about load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TareGuard {
    /// Refused while touched, and called off when a touch begins during it.
    RefuseUnderLoad,
    /// Carried out whatever the load; recorded as forced.
    Force,
}

/// How far the baseline is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BaselineState {
    /// Gathering start-up frames; nothing is compensated yet.
    Starting {
        /// Frames gathered.
        have: usize,
        /// Frames needed.
        want: usize,
    },
    /// In use.
    Ready,
    /// In use, while a tare gathers frames for the next one.
    Taring {
        /// Frames gathered.
        have: usize,
        /// Frames needed.
        want: usize,
    },
}

/// What [`Baseline::learn`](super::Baseline::learn) changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BaselineChange {
    /// Nothing, or only drift.
    None,
    /// The start-up baseline is there.
    Started,
    /// A tare is done.
    Tared,
    /// A tare was called off because a touch began.
    TareCancelled,
}

/// Where a baseline came from.
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
    /// The skin at rest with a damage that was found, so that touches are found beside it.
    Damage,
}

/// When and why the baseline was set.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReferenceRecord {
    /// Time of the frame that completed it, nanoseconds.
    pub time_ns: u64,
    /// Frames that it is the mean of; 0 when given.
    pub frames: usize,
    /// Where it came from.
    pub origin: ReferenceOrigin,
    /// The caller's reason; empty at start-up.
    pub reason: String,
}
