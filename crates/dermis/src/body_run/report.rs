//! Reports of a running body: each frame of each patch, and the health table.

use dermis_body::SpatialTouch;
use dermis_touch::Touch;

use super::joints::JointSnapshot;
use super::loads::NetWrench;

/// One frame of one patch.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Debug)]
pub struct PatchReport {
    /// Number of the patch.
    pub patch: usize,
    /// The device's frame number.
    pub sequence: u64,
    /// Time of the frame on the host's monotonic clock, shared by all patches, nanoseconds.
    pub time_ns: u64,
    /// False while the first frames make the baseline.
    pub is_ready: bool,
    /// Touches on the patch.
    pub touches: Vec<TouchInFrames>,
    /// Joint values used to place the frame.
    pub joints: JointSnapshot,
    /// Net wrench on the patch's link from all patches on it, in the link's frame about its origin.
    pub on_link: NetWrench,
    /// Net wrench on the body, in the root's frame about its origin.
    pub on_body: NetWrench,
    /// The frame as a JSON line, if requested.
    pub line: Vec<u8>,
}

/// A touch in every frame of reference.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Copy, Debug)]
pub struct TouchInFrames {
    /// The touch on its flattened skin.
    pub touch: Touch,
    /// The touch in the patch's frame.
    pub in_patch: SpatialTouch,
    /// The touch in the link's frame.
    pub in_link: SpatialTouch,
    /// The touch in the root's frame; `None` while joint values are unknown or stale.
    pub in_root: Option<SpatialTouch>,
}

/// State of a patch.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PatchState {
    /// No baseline yet.
    Starting,
    /// Frames arrive and are processed.
    Running,
    /// No frame has come for longer than the skin's rate allows.
    Silent,
    /// Its source has ended, or it has run the requested number of frames.
    Ended,
    /// It failed, for this reason.
    Failed(String),
}

impl PatchState {
    /// The state in one word.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Running => "running",
            Self::Silent => "silent",
            Self::Ended => "ended",
            Self::Failed(_) => "failed",
        }
    }
}

/// One row of the health table.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Debug, PartialEq)]
pub struct PatchHealth {
    /// Name of the patch.
    pub patch: String,
    /// State of the patch.
    pub state: PatchState,
    /// Frames processed.
    pub frames: u64,
    /// Frames lost on the way.
    pub lost: u64,
    /// Frames that arrived damaged.
    pub damaged: u64,
    /// Frames dropped because processing fell behind.
    pub dropped: u64,
    /// Reports dropped because their queue was full.
    pub unread: u64,
    /// Frames that are not in the recording.
    pub not_recorded: u64,
    /// Frames that live viewers did not get because of load.
    pub not_shown: u64,
    /// Reason why recording the patch stopped.
    pub recording_problem: Option<String>,
    /// Touches in the last frame.
    pub touches: usize,
    /// Channels excluded because of faults.
    pub channels_left_out: usize,
    /// 99th percentile of the time from a frame's first byte to its touches over the last ten seconds, milliseconds.
    pub latency_p99_ms: f64,
    /// Reason for missing frames.
    pub problem: Option<String>,
}
