//! Passes everything from a live pipeline to a recording or a viewer, before and after each frame: raw frames, touches,
//! images, baselines and events.

use dermis_device::{Frame, HostStamp};

use super::events::EventWatch;
use super::live_writer::LiveWriter;
use super::{RecorderHandle, RecorderStatus, RecordingStop, RecordingSummary};
use crate::Error;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;

/// Events that a replay carries out.
pub(super) const TARE: &str = "tare";
pub(super) const HYPERPARAMETER: &str = "hyperparameter";

/// The feed from a running pipeline to a recording or a viewer, through a bounded queue. Nothing here waits, and no
/// failure behind the queue reaches the pipeline.
#[derive(Debug)]
pub struct LiveFeed {
    handle: RecorderHandle,
    /// Time of the current frame, by the device's clock if it has one, so that a twin running faster than real time
    /// gets as many images per frame as one that doesn't.
    time_ns: u64,
    events: EventWatch,
}

impl LiveFeed {
    /// Starts a feed with a queue of `capacity` frames; `name` is only used in messages. If the pipeline already has a
    /// baseline, the feed starts with it.
    ///
    /// # Errors
    /// An I/O error if the operating system refuses a thread.
    pub(super) fn start(
        writer: impl LiveWriter,
        name: &str,
        capacity: usize,
        pipeline: &Pipeline,
    ) -> Result<Self, Error> {
        let handle = RecorderHandle::spawn_writer(writer, name, capacity)?;
        let events = EventWatch::new(&pipeline.prepared().skin);
        let feed = Self { handle, time_ns: 0, events };
        feed.baseline(pipeline, HostStamp::now().wall_ns);
        Ok(feed)
    }

    /// Numbers of frames taken and dropped.
    pub fn status(&self) -> RecorderStatus {
        self.handle.status()
    }

    /// Passes on a raw frame; call it before processing. A gap in the sequence numbers becomes an event.
    pub fn frame(&mut self, frame: &Frame) {
        let (handle, wall_ns) = (&self.handle, frame.host_wall_ns);
        self.events.frame(frame, |event, detail, values| {
            handle.offer_event(wall_ns, event, detail, values);
        });
        self.time_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
        self.handle.offer(frame);
    }

    /// Passes on the results of the frame. New faults, recoveries and verdicts of the guard become events. The first
    /// frame also reports faults from before the start, and the state of a search for the readout's circuit.
    pub fn results(&mut self, output: &SkinFrame<'_>) {
        self.handle.offer_results(output, self.time_ns);
        let (handle, wall_ns) = (&self.handle, output.wall_ns);
        self.events.results(output, |event, detail, values| {
            handle.offer_event(wall_ns, event, detail, values);
        });
    }

    /// Passes on the current baseline, if there is one.
    pub fn baseline(&self, pipeline: &Pipeline, wall_ns: u64) {
        if let Some(record) = pipeline.baseline_records().last() {
            let (values, noise_std) = pipeline.baseline();
            self.handle.offer_baseline(wall_ns, record, values, noise_std, pipeline.hyperparameter());
        }
    }

    /// Reports that a tare was accepted before the next frame.
    pub fn tare(&self, force: bool, reason: &str) {
        self.event(TARE, reason, &[f64::from(u8::from(force))]);
    }

    /// Reports that another lambda applies from the next frame on.
    pub fn hyperparameter(&self, lambda: f64) {
        self.event(HYPERPARAMETER, &format!("lambda {lambda:e}"), &[lambda]);
    }

    /// Passes on any other event before the next frame: its name, a description and its numbers.
    pub fn event(&self, event: &str, detail: &str, values: &[f64]) {
        self.handle.offer_event(HostStamp::now().wall_ns, event, detail, values);
    }

    /// A handle that ends the feed from elsewhere, even while its thread is busy.
    pub fn stop(&self) -> RecordingStop {
        self.handle.stop()
    }

    /// Ends the feed. An error is returned with the numbers of frames saved and lost.
    pub(super) fn finish(self) -> Result<RecordingSummary, (Error, [u64; 2])> {
        let counts = self.handle.watch();
        self.handle.finish().map_err(|error| {
            let (safe, lost) = counts();
            (error, [safe, lost])
        })
    }
}
