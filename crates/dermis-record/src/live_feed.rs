//! Hands on everything from a live pipeline, before and after each frame: raw frames, touches, images, baselines and
//! events. A recording keeps it; viewers show it.

use dermis_device::{Frame, HostStamp};
use dermis_touch::damage::DamageEvent;
use dermis_touch::guard::{GuardReason, GuardReport, GuardVerdict};

use super::live_writer::LiveWriter;
use super::{RecorderHandle, RecorderStatus, RecordingStop, RecordingSummary};
use crate::Error;
use dermis_live::output::Output;
use dermis_live::pipeline::Pipeline;
use dermis_live::stages::health::HealthWatch;

/// Events that a replay carries out.
pub(super) const TARE: &str = "tare";
pub(super) const HYPERPARAMETER: &str = "hyperparameter";

/// Event of missing frames, whose number comes with it.
pub(super) const GAP: &str = "gap";

/// The feed from a running pipeline to a recording or a viewer, through a bounded queue. Nothing here waits, and no
/// failure behind the queue reaches the pipeline.
#[derive(Debug)]
pub struct LiveFeed {
    handle: RecorderHandle,
    last_sequence: Option<u64>,
    /// Time of the current frame, by the device's clock if it has one, so that a twin running faster than real time
    /// gets as many images per frame as one that doesn't.
    time_ns: u64,
    health: HealthWatch,
    /// The guard's last verdict that was handed on.
    verdict: Option<GuardVerdict>,
}

impl LiveFeed {
    /// Starts a feed with a queue of `capacity` frames; `name` is only used in messages. If the pipeline already has a
    /// baseline, the feed starts with it.
    ///
    /// # Errors
    /// [`Error::Io`] if the operating system refuses a thread.
    pub(super) fn start(
        writer: impl LiveWriter,
        name: &str,
        capacity: usize,
        pipeline: &Pipeline,
    ) -> Result<Self, Error> {
        let handle = RecorderHandle::spawn_writer(writer, name, capacity)?;
        let health = HealthWatch::new(&pipeline.prepared().skin);
        let feed = Self { handle, last_sequence: None, time_ns: 0, health, verdict: None };
        feed.baseline(pipeline, HostStamp::now().wall_ns);
        Ok(feed)
    }

    /// Numbers of frames taken and dropped.
    pub fn status(&self) -> RecorderStatus {
        self.handle.status()
    }

    /// Hands on a raw frame; call it before processing. A gap in the sequence numbers becomes an event.
    pub fn frame(&mut self, frame: &Frame) {
        let missing = self.last_sequence.map_or(0, |last| frame.sequence.saturating_sub(last).saturating_sub(1));
        if missing > 0 {
            let detail = format!("{missing} frames missing before frame {}", frame.sequence);
            self.handle.offer_event(frame.host_wall_ns, GAP, &detail, &[missing as f64]);
        }
        self.last_sequence = Some(frame.sequence);
        self.time_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
        self.handle.offer(frame);
    }

    /// Hands on the results of the frame. New faults, recoveries and verdicts of the guard become events. The first
    /// frame also brings faults from before the start, and the state of a search for the readout's circuit.
    pub fn results(&mut self, output: &Output<'_>) {
        self.handle.offer_results(output, self.time_ns);
        for event in output.damage.events {
            let (name, detail, values) = damage_event(event);
            self.handle.offer_event(output.wall_ns, name, &detail, &values);
        }
        for change in self.health.changes(output.health) {
            self.handle.offer_event(output.wall_ns, change.event, &change.detail, &change.numbers);
        }
        if let Some(report) = output.guard.filter(|report| self.verdict != Some(report.verdict)) {
            self.verdict = Some(report.verdict);
            self.handle.offer_event(output.wall_ns, "guard", &verdict_text(&report), &[output.sequence as f64]);
        }
        if let Some(news) = output.circuit {
            let numbers = [news.fit.score_before, news.fit.score, news.fit.frames as f64];
            self.handle.offer_event(output.wall_ns, "circuit", &news.describe(), &numbers);
        }
    }

    /// Hands on the current baseline, if there is one.
    pub fn baseline(&self, pipeline: &Pipeline, wall_ns: u64) {
        if let Some(record) = pipeline.baseline_records().last() {
            let (values, noise_std) = pipeline.baseline();
            self.handle.offer_baseline(wall_ns, record, values, noise_std, pipeline.hyperparameter());
        }
    }

    /// Tells that a tare was accepted before the next frame.
    pub fn tare(&self, force: bool, reason: &str) {
        self.event(TARE, reason, &[f64::from(u8::from(force))]);
    }

    /// Tells that another lambda applies from the next frame on.
    pub fn hyperparameter(&self, lambda: f64) {
        self.event(HYPERPARAMETER, &format!("lambda {lambda:e}"), &[lambda]);
    }

    /// Hands on any other event before the next frame: its name, a description and its numbers.
    pub fn event(&self, event: &str, detail: &str, values: &[f64]) {
        self.handle.offer_event(HostStamp::now().wall_ns, event, detail, values);
    }

    /// A handle that ends the feed from elsewhere, even while its thread is busy.
    pub fn stop(&self) -> RecordingStop {
        self.handle.stop()
    }

    /// Ends the feed. An error comes with the numbers of frames saved and lost.
    pub(super) fn finish(self) -> Result<RecordingSummary, (Error, [u64; 2])> {
        let counts = self.handle.watch();
        self.handle.finish().map_err(|error| {
            let (safe, lost) = counts();
            (error, [safe, lost])
        })
    }
}

/// A guard's verdict with its reasons: `stop: force`.
fn verdict_text(report: &GuardReport) -> String {
    let reasons: Vec<&str> = report.reasons.iter().map(GuardReason::name).collect();
    let name = report.verdict.name();
    if reasons.is_empty() { name.to_owned() } else { format!("{name}: {}", reasons.join(", ")) }
}

/// The fields of a damage event: its name, a description, and id, x, y, length (metres), direction (radians), depth
/// and remaining share.
fn damage_event(event: &DamageEvent) -> (&'static str, String, [f64; 7]) {
    let damage = event.damage();
    let shape = &damage.shape;
    let [x, y] = shape.centre_m;
    let name = match event {
        DamageEvent::Begin(_) => "damage-begin",
        DamageEvent::Update(_) => "damage-update",
        DamageEvent::Covered(_) => "damage-covered",
        DamageEvent::Uncovered(_) => "damage-uncovered",
        DamageEvent::Healed(_) => "damage-healed",
    };
    let values = [damage.id as f64, x, y, shape.length_m, shape.direction_rad, damage.depth, damage.share];
    (name, dermis_live::stages::damage::describe(event), values)
}
