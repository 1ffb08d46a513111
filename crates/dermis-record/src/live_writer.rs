//! The receiving end of the queue behind a live pipeline: a recording, or a server for viewers. All calls come from the
//! queue's thread, and messages have the definitions in [`super::schema`].

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use dermis_device::Frame;
use dermis_live::skin_frame::SkinFrame;
use dermis_touch::{ReferenceRecord, Touch};

use super::view::SkinView;
use super::writer::{Recorder, RecordingSummary};
use crate::Error;

/// The touches of a frame, in reused memory.
#[derive(Debug, Default)]
pub(super) struct TouchBatch {
    pub(super) wall_ns: u64,
    pub(super) sequence: u64,
    pub(super) time_ns: u64,
    pub(super) touches: Vec<Touch>,
    pub(super) ended: Vec<Touch>,
}

impl TouchBatch {
    /// True if the frame has touches or one ended in it.
    pub(super) fn is_due(output: &SkinFrame<'_>) -> bool {
        !output.touches.is_empty() || !output.ended.is_empty()
    }

    /// Replaces the content with the touches of a frame.
    pub(super) fn fill(&mut self, output: &SkinFrame<'_>) {
        (self.wall_ns, self.sequence, self.time_ns) = (output.wall_ns, output.sequence, output.time_ns);
        self.touches.clear();
        self.touches.extend_from_slice(&output.touches);
        self.ended.clear();
        self.ended.extend_from_slice(&output.ended);
    }
}

/// A baseline that came into use.
#[derive(Debug)]
pub(super) struct BaselineNews {
    pub(super) wall_ns: u64,
    pub(super) record: ReferenceRecord,
    pub(super) values: Vec<f64>,
    pub(super) noise_std: Vec<f64>,
    /// Lambda of the images made with it, if known. In a recording, the skin file states it.
    #[cfg_attr(not(feature = "foxglove"), allow(dead_code, reason = "viewers alone read it"))]
    pub(super) hyperparameter: Option<f64>,
}

/// A receiver of everything that a live pipeline produces. An error ends it.
pub(super) trait LiveWriter: Send + 'static {
    /// The view used for images; `None` if it takes no images.
    fn view(&self) -> Option<&SkinView>;

    /// Shares the count of frames that didn't fit into the queue; called before the first message.
    fn watch(&mut self, _dropped: &Arc<AtomicU64>) {}

    /// A raw frame, before it is processed.
    fn frame(&mut self, frame: &Frame) -> Result<(), Error>;

    /// The touches of a frame that has any, or in which one ended.
    fn touches(&mut self, batch: &TouchBatch) -> Result<(), Error>;

    /// A frame's image, row-major with `NaN` outside the skin.
    fn image(&mut self, wall_ns: u64, image: &[f32]) -> Result<(), Error>;

    /// A baseline.
    fn baseline(&mut self, news: &BaselineNews) -> Result<(), Error>;

    /// An event: its name, a description and its numbers.
    fn event(&mut self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> Result<(), Error>;

    /// Called when nothing has come for a while.
    fn rest(&mut self) -> Result<(), Error>;

    /// Frames taken, and how many of them survive the end of the process.
    fn taken_and_safe(&self) -> [u64; 2];

    /// Called after the last message; `dropped` frames didn't fit into the queue.
    fn finish(self, dropped: u64) -> Result<RecordingSummary, Error>;
}

impl LiveWriter for Recorder {
    fn view(&self) -> Option<&SkinView> {
        Recorder::view(self)
    }

    fn frame(&mut self, frame: &Frame) -> Result<(), Error> {
        self.write_frame(frame)
    }

    fn touches(&mut self, batch: &TouchBatch) -> Result<(), Error> {
        let TouchBatch { wall_ns, sequence, time_ns, touches, ended } = batch;
        self.write_touches(*wall_ns, *sequence, *time_ns, touches, ended)?;
        self.write_touch_points(*wall_ns, touches)
    }

    fn image(&mut self, wall_ns: u64, image: &[f32]) -> Result<(), Error> {
        self.write_image(wall_ns, image)
    }

    fn baseline(&mut self, news: &BaselineNews) -> Result<(), Error> {
        self.write_baseline(news.wall_ns, &news.record, &news.values, &news.noise_std)
    }

    fn event(&mut self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> Result<(), Error> {
        self.write_event(wall_ns, event, detail, values)
    }

    fn rest(&mut self) -> Result<(), Error> {
        self.flush_if_due()
    }

    fn taken_and_safe(&self) -> [u64; 2] {
        [self.frames(), self.safe_frames()]
    }

    fn finish(self, dropped: u64) -> Result<RecordingSummary, Error> {
        Recorder::finish(self, dropped)
    }
}
