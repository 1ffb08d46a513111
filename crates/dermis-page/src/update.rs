//! The content of the page for one frame: the image, the touches, selected channels, timing and state. These are plain
//! values; an [`Update`] that is kept and refilled for each frame allocates nothing once its vectors have grown.

use std::borrow::Cow;

use dermis_tomo::mesh::Point;
use dermis_touch::guard::{GuardReason, GuardReport};
use serde::Serialize;

use crate::error::UpdateError;

/// Everything that the page shows for one frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Update {
    /// Frame number, counted by the pipeline.
    pub frame: u64,
    /// Host monotonic time of the frame's first byte, nanoseconds.
    pub time_ns: u64,
    /// The same time on the system's monotonic clock, which all processes of a machine share.
    pub monotonic_ns: u64,
    /// The same time on the host's wall clock, nanoseconds since 1970-01-01 UTC.
    pub wall_ns: u64,
    /// The device's own clock, nanoseconds, if it has one.
    pub device_time_ns: Option<u64>,
    /// The reconstructed image.
    pub image: Image,
    /// Touches on the skin; a touch that ended may be listed once with [`TouchPhase::End`].
    pub touches: Vec<TouchView>,
    /// Channel values, all or a selected subset.
    pub channels: ChannelValues,
    /// Frames per second that leave the pipeline.
    pub fps: f32,
    /// Latency of every stage, in pipeline order.
    pub latency: Vec<StageLatency>,
    /// Counters, including losses.
    pub counters: Vec<Counter>,
    /// State of the pipeline.
    pub state: PipelineState,
    /// Faults.
    pub health: HealthView,
    /// A network's result for the frame, if there is one.
    pub classes: Option<ClassImage>,
    /// Damage and baselines, if the skin is watched for damage.
    pub damage: Option<DamageView>,
    /// The guard's verdict, if the skin has a guard.
    pub guard: Option<GuardView>,
}

/// Verdict of the guard.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct GuardView {
    /// The verdict.
    #[cfg_attr(test, schemars(schema_with = "crate::words::guard_verdicts"))]
    pub verdict: &'static str,
    /// Reasons, unless it is `ok`.
    pub reasons: Vec<&'static str>,
    /// Always false: no part of dermis is safety-rated.
    pub safety_rated: bool,
}

impl GuardView {
    /// Shows a guard's report.
    pub fn show(&mut self, report: &GuardReport) {
        self.verdict = report.verdict.name();
        self.reasons.clear();
        self.reasons.extend(report.reasons.iter().map(GuardReason::name));
    }
}

/// Channels and electrodes that are left out; numbers count from 1.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct HealthView {
    /// Fault of whole frames, during which touches are unknown.
    pub frame: Option<FrameFaultView>,
    /// Number of channels left out, including those of faulty electrodes.
    pub left_out: u32,
    /// Faulty electrodes (or coils).
    pub electrodes: Vec<FaultView>,
    /// Channels with faults of their own.
    pub channels: Vec<FaultView>,
}

/// A fault of whole frames.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct FrameFaultView {
    /// Kind of fault.
    #[cfg_attr(test, schemars(schema_with = "crate::words::frame_faults"))]
    pub kind: &'static str,
    /// Seconds since the first frame that showed it.
    pub for_s: f64,
}

/// Damage, and the baselines it is measured against.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DamageView {
    /// All damages, including suspected and healed ones.
    pub list: Vec<DamageRow>,
    /// All baselines used, oldest first; the last one is in use now.
    pub baselines: Vec<BaselineRow>,
    /// Index of the baseline that damage is measured against, from 0.
    pub intact: Option<usize>,
    /// A proposal to take a new baseline.
    pub proposal: Option<ProposalView>,
}

/// One damage. Lengths are millimetres in the skin's frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct DamageRow {
    /// Permanent number of the damage.
    pub id: u64,
    /// State of the damage.
    #[cfg_attr(test, schemars(schema_with = "crate::words::damage_states"))]
    pub state: &'static str,
    /// Centre, x.
    pub x_mm: f64,
    /// Centre, y.
    pub y_mm: f64,
    /// Length of a cut; 0 for a spot.
    pub length_mm: f64,
    /// Direction from +x, counter-clockwise.
    pub direction_deg: f64,
    /// Both ends.
    pub ends_mm: [Point; 2],
    /// Largest drop of the image since the damage began.
    pub depth: f64,
    /// Share that has healed, 0 to 1.
    pub healed: f64,
    /// Seconds since it was first seen.
    pub for_s: f64,
}

/// One baseline.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct BaselineRow {
    /// Origin.
    pub origin: &'static str,
    /// Reason for taking it.
    pub reason: String,
    /// Seconds since it was taken.
    pub age_s: f64,
}

/// A proposal to take a new baseline.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct ProposalView {
    /// Reason for the proposal.
    #[cfg_attr(test, schemars(schema_with = "crate::words::proposal_reasons"))]
    pub reason: &'static str,
    /// Seconds since the skin came to rest, or since the reason has been known.
    pub for_s: f64,
    /// Distance of the readings from the baseline, in standard deviations of the channels.
    pub offset_sigma: f64,
}

/// Classes of the pixels, as probabilities.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClassImage {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// `rows * cols` probabilities of lowered conductivity: damage.
    pub lowered: Vec<f32>,
    /// `rows * cols` probabilities of raised conductivity: compression.
    pub raised: Vec<f32>,
    /// Distance of the frame from the network's training data; above 1.5 the frame is unlike them. NaN if unknown.
    pub novelty: f32,
    /// True if thresholds on the image replaced the network.
    pub falls_back: bool,
}

/// One fault.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct FaultView {
    /// Number of the electrode or channel.
    pub number: u32,
    /// Kind of fault.
    #[cfg_attr(test, schemars(schema_with = "crate::words::faults"))]
    pub kind: &'static str,
    /// The other electrode of a short.
    pub with: Option<u32>,
    /// Seconds since the first frame that showed it.
    pub for_s: f64,
}

/// An image: row-major, row 0 at the top (+y), NaN outside the skin, more positive where pressed harder.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Image {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// `rows * cols` values in the unit the scene states.
    pub values: Vec<f32>,
}

/// Values of channels, in the unit the scene states.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ChannelValues {
    /// Channel index (0-based) of each value; empty if `values` holds every channel in order.
    pub indices: Vec<u32>,
    /// The values; NaN if missing.
    pub values: Vec<f32>,
}

/// Phase of a touch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum TouchPhase {
    /// First frame of the touch.
    #[default]
    Begin,
    /// Any later frame with the touch on the skin.
    Move,
    /// First frame without it.
    End,
}

/// One touch. Positions are in the skin's frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct TouchView {
    /// Permanent number of the touch.
    pub id: u64,
    /// Phase.
    pub phase: TouchPhase,
    /// Position along x, millimetres.
    pub x_mm: f64,
    /// Position along y, millimetres.
    pub y_mm: f64,
    /// Amplitude in the image's unit.
    pub amplitude: f64,
    /// Area above half of the peak, square millimetres.
    pub area_mm2: f64,
    /// Standard deviation of `x_mm`; NaN if unknown.
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub sigma_x_mm: f64,
    /// Standard deviation of `y_mm`; NaN if unknown.
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub sigma_y_mm: f64,
    /// Normal force, newtons, if a calibration gives one.
    pub force_n: Option<f64>,
    /// Position of `force_n` in its calibration, which ends there if below, above or saturated; `law`: from the law in
    /// the skin file.
    #[cfg_attr(test, schemars(schema_with = "crate::words::force_ranges"))]
    pub force_range: Option<&'static str>,
    /// An alternative position, if the calibration cannot decide.
    pub other: Option<OtherPlaceView>,
}

/// An alternative position of a touch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct OtherPlaceView {
    /// Position along x, millimetres.
    pub x_mm: f64,
    /// Position along y, millimetres.
    pub y_mm: f64,
    /// Probability that the touch is here instead.
    pub probability: f64,
}

/// Latency of one stage, microseconds.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct StageLatency {
    /// Name of the stage.
    pub stage: Cow<'static, str>,
    /// Median.
    pub p50_us: f64,
    /// 99th percentile.
    pub p99_us: f64,
}

/// One counter.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Counter {
    /// Name of the counter.
    pub name: Cow<'static, str>,
    /// Current count.
    pub value: u64,
    /// True if any value above zero means lost data.
    pub is_loss: bool,
}

/// State of the pipeline's source.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum SourceState {
    /// Frames arrive.
    #[default]
    Running,
    /// Connected but silent, or connecting.
    Waiting {
        /// Reason for waiting.
        reason: String,
    },
    /// The connection is lost.
    Lost {
        /// Reason for the loss.
        reason: String,
    },
    /// The recording has ended.
    Ended,
}

/// State of the baseline.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum TareState {
    /// No baseline yet.
    #[default]
    None,
    /// A baseline is being averaged.
    Taring {
        /// Number of frames still needed.
        frames_left: u32,
    },
    /// A baseline is in use.
    Tared,
}

/// State of the pipeline.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct PipelineState {
    /// The source.
    pub source: SourceState,
    /// The baseline.
    pub tare: TareState,
    /// Seconds since the baseline was taken; NaN without one.
    #[cfg_attr(test, schemars(with = "Option<f64>"))]
    pub baseline_age_s: f64,
    /// File being recorded to, if any.
    pub recording: Option<String>,
    /// Frames recorded to that file.
    pub recorded_frames: u64,
    /// Hyperparameter in use (the lambda of the skin's prior).
    pub hyperparameter: f64,
    /// True while the twin shows its demonstration.
    pub demonstrates: bool,
}

impl PipelineState {
    fn copy_from(&mut self, other: &PipelineState) {
        if self.source != other.source {
            self.source = other.source.clone();
        }
        self.tare = other.tare;
        self.baseline_age_s = other.baseline_age_s;
        self.recording.clone_from(&other.recording);
        self.recorded_frames = other.recorded_frames;
        self.hyperparameter = other.hyperparameter;
        self.demonstrates = other.demonstrates;
    }
}

impl ClassImage {
    fn copy_from(&mut self, other: &Self) {
        (self.rows, self.cols) = (other.rows, other.cols);
        self.lowered.clone_from(&other.lowered);
        self.raised.clone_from(&other.raised);
        (self.novelty, self.falls_back) = (other.novelty, other.falls_back);
    }
}

impl Update {
    /// Copies `other` into `self`, reusing every allocation that is large enough.
    pub fn copy_from(&mut self, other: &Update) {
        self.frame = other.frame;
        self.time_ns = other.time_ns;
        (self.monotonic_ns, self.wall_ns) = (other.monotonic_ns, other.wall_ns);
        self.device_time_ns = other.device_time_ns;
        self.image.rows = other.image.rows;
        self.image.cols = other.image.cols;
        self.image.values.clone_from(&other.image.values);
        self.touches.clone_from(&other.touches);
        self.channels.indices.clone_from(&other.channels.indices);
        self.channels.values.clone_from(&other.channels.values);
        self.fps = other.fps;
        self.latency.clone_from(&other.latency);
        self.counters.clone_from(&other.counters);
        self.state.copy_from(&other.state);
        self.health.frame = other.health.frame;
        self.health.left_out = other.health.left_out;
        self.health.electrodes.clone_from(&other.health.electrodes);
        self.health.channels.clone_from(&other.health.channels);
        match (&mut self.classes, &other.classes) {
            (Some(own), Some(other)) => own.copy_from(other),
            (own, other) => own.clone_from(other),
        }
        self.damage.clone_from(&other.damage);
        self.guard.clone_from(&other.guard);
    }

    /// Checks that the image fills its grid and that channel indices match the values.
    ///
    /// # Errors
    /// [`UpdateError::ImageShape`] or [`UpdateError::ChannelShape`] with the sizes found.
    pub fn check(&self) -> Result<(), UpdateError> {
        let Image { rows, cols, ref values } = self.image;
        let side = usize::from(u16::MAX);
        if rows > side || cols > side || rows * cols != values.len() {
            return Err(UpdateError::ImageShape { frame: self.frame, rows, cols, values: values.len() });
        }
        let ChannelValues { indices, values } = &self.channels;
        if !indices.is_empty() && indices.len() != values.len() {
            return Err(UpdateError::ChannelShape { frame: self.frame, indices: indices.len(), values: values.len() });
        }
        Ok(())
    }
}
