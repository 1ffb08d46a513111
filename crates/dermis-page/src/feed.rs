//! Turns the pipeline's state into what the page shows.

mod damage;

use std::borrow::Cow;
use std::path::Path;

use dermis_device::HostStamp;
use dermis_device::acquire::AcquisitionCounters;
use dermis_learn::scene::{LOWERED, RAISED};
use dermis_live::latency::RecentLatencies;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_touch::guard::GuardReport;
use dermis_touch::health::{ChannelFaultKind, ElectrodeFaultKind, FrameFault};
use dermis_touch::{BaselineState, Touch};

use crate::update::{
    Counter, FaultView, FrameFaultView, OtherPlaceView, SourceState, StageLatency, TareState, TouchPhase, TouchView,
    Update,
};

const MM: f64 = 1e3;
/// Time without frames after which the source counts as waiting, nanoseconds.
const SILENCE_NS: u64 = 1_000_000_000;
/// Minimum time for counting frames before their rate is shown, nanoseconds.
const RATE_NS: u64 = 500_000_000;
/// Maximum number of channel faults to list.
const MOST_CHANNEL_FAULTS: usize = 64;

/// A recording in progress.
#[derive(Debug, Clone, Copy)]
pub struct RecordingView<'a> {
    /// File of the recording.
    pub path: &'a Path,
    /// Number of frames written.
    pub written: u64,
    /// Number of frames that could not be written.
    pub dropped: u64,
}

/// The update, refilled for every frame.
#[derive(Debug)]
pub struct PageFeed {
    update: Update,
    rate: Rate,
    recent: RecentLatencies<5>,
    tared_at_ns: Option<u64>,
    records: usize,
    waiting_since_ns: Option<u64>,
    /// The guard's report on the last frame.
    report: Option<GuardReport>,
}

impl PageFeed {
    /// A feed for a pipeline that hasn't seen a frame.
    pub fn new(pipeline: &Pipeline) -> Self {
        let mut update = Update::default();
        let grid = pipeline.prepared().map.grid();
        (update.image.rows, update.image.cols) = (grid.rows, grid.columns);
        update.image.values = vec![f32::NAN; grid.len()];
        update.latency = pipeline
            .latencies()
            .stages()
            .map(|(stage, _)| StageLatency { stage: Cow::Borrowed(stage), ..StageLatency::default() })
            .to_vec();
        update.counters = ["frames", "dropped", "lost", "damaged", "not recorded", "repeated"]
            .map(|name| Counter {
                name: Cow::Borrowed(name),
                value: 0,
                is_loss: !["frames", "repeated"].contains(&name),
            })
            .to_vec();
        update.state.baseline_age_s = f64::NAN;
        Self {
            update,
            rate: Rate::default(),
            recent: RecentLatencies::default(),
            tared_at_ns: None,
            records: 0,
            waiting_since_ns: None,
            report: None,
        }
    }

    /// The update to show.
    pub fn update(&self) -> &Update {
        &self.update
    }

    /// Sets whether the twin shows touches by itself.
    pub fn demonstrate(&mut self, demonstrates: bool) {
        self.update.state.demonstrates = demonstrates;
    }

    /// Takes over one frame's results. `now_ns` comes from the same monotonic clock in every call, nanoseconds; with a
    /// guard, whose verdicts age by it, from the host's monotonic clock.
    pub fn show(&mut self, output: &SkinFrame<'_>, now_ns: u64) {
        let update = &mut self.update;
        update.frame = output.sequence;
        update.time_ns = output.time_ns;
        update.monotonic_ns = HostStamp::on_system_clock(output.time_ns);
        (update.wall_ns, update.device_time_ns) = (output.wall_ns, output.device_time_ns);
        update.image.values.copy_from_slice(&output.image);
        update.channels.values.clear();
        update.channels.values.extend(output.raw.iter().map(|v| *v as f32));
        update.touches.clear();
        update.touches.extend(output.touches.iter().map(view));
        update.touches.extend(output.ended.iter().map(view));
        update.fps = self.rate.count(now_ns);
        self.waiting_since_ns = None;
        if update.state.source != SourceState::Running {
            update.state.source = SourceState::Running;
        }
        self.show_health(output);
        self.show_classes(output);
        damage::take(&output.damage, &mut self.update.damage);
        self.report = output.guard;
        self.show_guard(now_ns);
    }

    /// Shows the verdict of the last frame at this time; returns true if that changes what is shown.
    fn show_guard(&mut self, now_ns: u64) -> bool {
        let Some(report) = self.report.map(|report| report.at(now_ns)) else {
            return self.update.guard.take().is_some();
        };
        let shown = self.update.guard.get_or_insert_default();
        let is_new = shown.verdict != report.verdict.name();
        shown.show(&report);
        is_new
    }

    fn show_classes(&mut self, output: &SkinFrame<'_>) {
        let Some(seen) = &output.classes else {
            self.update.classes = None;
            return;
        };
        let (shown, seen) = (self.update.classes.get_or_insert_default(), &seen.classes);
        (shown.rows, shown.cols) = (seen.rows, seen.columns);
        for (values, class) in [(&mut shown.lowered, LOWERED), (&mut shown.raised, RAISED)] {
            values.clear();
            values.extend_from_slice(seen.of_class(class).unwrap_or_default());
        }
        shown.novelty = seen.novelty.unwrap_or(f32::NAN);
        shown.falls_back = seen.falls_back;
    }

    fn show_health(&mut self, output: &SkinFrame<'_>) {
        let health = &mut self.update.health;
        let for_s = |since_ns: u64| output.time_ns.saturating_sub(since_ns) as f64 * 1e-9;
        let of_frame = |fault: FrameFault| FrameFaultView { kind: fault.kind.name(), for_s: for_s(fault.since_ns) };
        health.frame = output.health.frame.map(of_frame);
        health.left_out = output.health.channels.len() as u32;
        health.electrodes.clear();
        health.electrodes.extend(output.health.electrodes.iter().map(|fault| {
            let (kind, with) = match fault.kind {
                ElectrodeFaultKind::Lost => ("lost", None),
                ElectrodeFaultKind::Shorted { with } => ("shorted", Some(with + 1)),
            };
            FaultView { number: fault.electrode + 1, kind, with, for_s: for_s(fault.since_ns) }
        }));
        health.channels.clear();
        let own = output.health.channels.iter().filter(|fault| fault.kind != ChannelFaultKind::Electrode);
        health.channels.extend(own.take(MOST_CHANNEL_FAULTS).map(|fault| FaultView {
            number: fault.channel + 1,
            kind: fault.kind.name(),
            with: None,
            for_s: for_s(fault.since_ns),
        }));
    }

    /// Registers that no frame has come until `now_ns`; returns true if this is new and should be shown. `problem` is
    /// the source's own explanation.
    pub fn wait(&mut self, problem: Option<String>, now_ns: u64) -> bool {
        let since_ns = *self.waiting_since_ns.get_or_insert(now_ns);
        let is_new_verdict = self.show_guard(now_ns);
        let source = match problem {
            Some(reason) => SourceState::Lost { reason },
            None if now_ns.saturating_sub(since_ns) < SILENCE_NS => return is_new_verdict,
            None => SourceState::Waiting { reason: "connected, but no frames arrive".into() },
        };
        let changed = self.update.state.source != source;
        if changed {
            self.update.state.source = source;
            self.update.fps = 0.0;
        }
        changed || is_new_verdict
    }

    /// Takes over the losses and the state of the recording.
    pub fn count(&mut self, lost: AcquisitionCounters, recording: Option<RecordingView<'_>>) {
        let (not_recorded, state) = match &recording {
            Some(recording) => (recording.dropped, Some(recording.written)),
            None => (0, None),
        };
        let values =
            [self.update.counters[0].value + 1, lost.dropped, lost.lost, lost.bad, not_recorded, lost.repeated];
        self.update.counters.iter_mut().zip(values).for_each(|(counter, value)| counter.value = value);
        self.update.state.recorded_frames = state.unwrap_or(0);
        match recording {
            Some(RecordingView { path, .. }) if self.update.state.recording.is_none() => {
                self.update.state.recording = Some(path.display().to_string());
            }
            None => self.update.state.recording = None,
            _ => {}
        }
    }

    /// Takes over the pipeline's state, and its latencies in the ten seconds up to `now_ns`.
    pub fn describe(&mut self, pipeline: &Pipeline, now_ns: u64) {
        let state = &mut self.update.state;
        state.tare = match pipeline.baseline_state() {
            BaselineState::Starting { have, want } | BaselineState::Taring { have, want } => {
                TareState::Taring { frames_left: want.saturating_sub(have) as u32 }
            }
            BaselineState::Ready => TareState::Tared,
        };
        if pipeline.baseline_records().len() != self.records {
            self.records = pipeline.baseline_records().len();
            self.tared_at_ns = Some(self.update.time_ns);
        }
        let age_ns = self.tared_at_ns.map(|since| self.update.time_ns.saturating_sub(since));
        state.baseline_age_s = age_ns.map_or(f64::NAN, |ns| ns as f64 * 1e-9);
        state.hyperparameter = pipeline.hyperparameter().unwrap_or(f64::NAN);
        let histograms = pipeline.latencies().stages().map(|(_, histogram)| histogram);
        if let Some(quantiles_us) = self.recent.quantiles_us(histograms, now_ns) {
            for (shown, of_stage) in self.update.latency.iter_mut().zip(quantiles_us) {
                [shown.p50_us, shown.p99_us] = of_stage;
            }
        }
    }

    /// Registers that the source has ended.
    pub fn end(&mut self) {
        self.update.state.source = SourceState::Ended;
    }

    /// A line with frames per second, touches, latencies and losses.
    pub fn status(&self) -> String {
        let total = self.update.latency.last();
        format!(
            "{:.1} frames/s, {} touches, latency p50 {:.0} us, p99 {:.0} us, lost {}",
            self.update.fps,
            self.update.touches.len(),
            total.map_or(f64::NAN, |stage| stage.p50_us),
            total.map_or(f64::NAN, |stage| stage.p99_us),
            self.update.counters.iter().filter(|counter| counter.is_loss).map(|counter| counter.value).sum::<u64>()
        )
    }
}

/// Frame rate over about the last second.
#[derive(Debug, Default)]
struct Rate {
    since_ns: Option<u64>,
    frames: u32,
    per_s: f32,
}

impl Rate {
    fn count(&mut self, now_ns: u64) -> f32 {
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        self.frames += 1;
        let elapsed_ns = now_ns.saturating_sub(since_ns);
        if elapsed_ns > RATE_NS {
            self.per_s = self.frames as f32 / (elapsed_ns as f32 * 1e-9);
            (self.since_ns, self.frames) = (Some(now_ns), 0);
        }
        self.per_s
    }
}

fn view(touch: &Touch) -> TouchView {
    TouchView {
        id: touch.id,
        phase: match touch.phase {
            dermis_touch::TouchPhase::Begin => TouchPhase::Begin,
            dermis_touch::TouchPhase::Move => TouchPhase::Move,
            dermis_touch::TouchPhase::End => TouchPhase::End,
        },
        x_mm: touch.position_m[0] * MM,
        y_mm: touch.position_m[1] * MM,
        amplitude: touch.amplitude,
        area_mm2: touch.area_m2 * MM * MM,
        sigma_x_mm: touch.covariance_m2[0][0].max(0.0).sqrt() * MM,
        sigma_y_mm: touch.covariance_m2[1][1].max(0.0).sqrt() * MM,
        force_n: touch.force.and_then(|force| force.nearest_n()),
        force_range: touch.force.map(|force| force.range()),
        other: touch.other_place.map(|other| OtherPlaceView {
            x_mm: other.position_m[0] * MM,
            y_mm: other.position_m[1] * MM,
            probability: other.probability,
        }),
    }
}
