//! Records a live pipeline: passes to the recorder, before and after each frame, everything that a replay needs to
//! reproduce the results.

use std::path::{Path, PathBuf};

use dermis_device::{Frame, HostStamp};

use super::events::EventWatch;
use super::{Recorder, RecorderHandle, RecorderStatus, RecordingHead, RecordingStop, SkinView};
use crate::Error;
use dermis_live::output::Output;
use dermis_live::pipeline::Pipeline;

/// Frames that may wait for the disk.
const QUEUE: usize = 1024;

/// Events that a replay carries out.
pub(super) const TARE: &str = "tare";
pub(super) const HYPERPARAMETER: &str = "hyperparameter";

/// A recording of a running pipeline. Nothing here waits for the disk, and no failure of the recording reaches the
/// pipeline.
#[derive(Debug)]
pub struct LiveRecording {
    path: PathBuf,
    handle: RecorderHandle,
    /// Time of the current frame, by the device's clock if it has one, so that a twin running faster than real time
    /// gets as many images per frame as one that doesn't.
    time_ns: u64,
    events: EventWatch,
    failure_told: bool,
}

/// Outcome of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingEnd {
    /// Intended path.
    pub path: PathBuf,
    /// Frames in the recording.
    pub frames: u64,
    /// Frames that were offered but not recorded.
    pub lost: u64,
    /// The error that stopped it, if any; the data written before are in the file with the partial name.
    pub error: Option<String>,
}

impl LiveRecording {
    /// Starts recording to `path`, with at most `images_per_s` images per second (none at 0). If the pipeline already
    /// has a baseline, the recording starts with it.
    ///
    /// # Errors
    /// As for [`Recorder::create`].
    pub fn start(path: &Path, head: &RecordingHead, pipeline: &Pipeline, images_per_s: f64) -> Result<Self, Error> {
        Self::start_with(Recorder::create(path, head)?, pipeline, images_per_s)
    }

    /// Like [`LiveRecording::start`], with an existing recorder, such as a body patch's.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn start_with(mut recorder: Recorder, pipeline: &Pipeline, images_per_s: f64) -> Result<Self, Error> {
        let path = recorder.path().to_owned();
        if images_per_s > 0.0 {
            recorder = recorder.with_view(SkinView::new(pipeline.prepared()).with_images_per_s(images_per_s))?;
        }
        let handle = RecorderHandle::spawn(recorder, QUEUE)?;
        let events = EventWatch::new(&pipeline.prepared().skin);
        let live = Self { path, handle, time_ns: 0, events, failure_told: false };
        live.baseline(pipeline, HostStamp::now().wall_ns);
        Ok(live)
    }

    /// Final path of the recording.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Numbers of frames written and lost.
    pub fn status(&self) -> RecorderStatus {
        self.handle.status()
    }

    /// Records a raw frame; call it before processing. A gap in the sequence numbers is recorded as an event.
    pub fn frame(&mut self, frame: &Frame) {
        let (handle, wall_ns) = (&self.handle, frame.host_wall_ns);
        self.events.frame(frame, |event, detail, values| {
            handle.offer_event(wall_ns, event, detail, values);
        });
        self.time_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
        self.handle.offer(frame);
    }

    /// Records the results of the frame. New faults, recoveries and verdicts of the guard become events. The first frame
    /// also records faults from before the recording, and the state of a search for the readout's circuit.
    pub fn results(&mut self, output: &Output<'_>) {
        self.handle.offer_results(output, self.time_ns);
        let (handle, wall_ns) = (&self.handle, output.wall_ns);
        self.events.results(output, |event, detail, values| {
            handle.offer_event(wall_ns, event, detail, values);
        });
    }

    /// Records the current baseline, if there is one.
    pub fn baseline(&self, pipeline: &Pipeline, wall_ns: u64) {
        if let Some(record) = pipeline.baseline_records().last() {
            let (values, noise_std) = pipeline.baseline();
            self.handle.offer_baseline(wall_ns, record, values, noise_std);
        }
    }

    /// Records that a tare was accepted before the next frame.
    pub fn tare(&self, force: bool, reason: &str) {
        self.event(TARE, reason, &[f64::from(u8::from(force))]);
    }

    /// Records that another lambda applies from the next frame on.
    pub fn hyperparameter(&self, lambda: f64) {
        self.event(HYPERPARAMETER, &format!("lambda {lambda:e}"), &[lambda]);
    }

    /// Records any other event before the next frame: its name, a description and its numbers.
    pub fn event(&self, event: &str, detail: &str, values: &[f64]) {
        self.handle.offer_event(HostStamp::now().wall_ns, event, detail, values);
    }

    /// The error that stopped the recording; returned once.
    pub fn new_failure(&mut self) -> Option<String> {
        let error = self.handle.status().error.filter(|_| !self.failure_told)?;
        self.failure_told = true;
        Some(error)
    }

    /// A handle that ends the recording from elsewhere, even while the recording thread is busy.
    pub fn stop(&self) -> RecordingStop {
        self.handle.stop()
    }

    /// Ends the recording.
    pub fn finish(self) -> RecordingEnd {
        let (path, shared) = (self.path, self.handle.watch());
        match self.handle.finish() {
            Ok(summary) => RecordingEnd { path, frames: summary.frames, lost: summary.dropped, error: None },
            Err(error) => {
                let (frames, lost) = shared();
                RecordingEnd { path, frames, lost, error: Some(error.to_string()) }
            }
        }
    }
}
