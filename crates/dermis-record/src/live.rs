//! Records a live pipeline: passes to the recorder, before and after each frame, everything that a replay needs to
//! reproduce the results.

use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};

use super::live_feed::LiveFeed;
use super::{Recorder, RecordingHead, SkinView};
use crate::Error;
use dermis_live::pipeline::Pipeline;

/// Frames that may wait for the disk.
const QUEUE: usize = 1024;

/// A recording of a running pipeline, fed like any [`LiveFeed`]. Nothing here waits for the disk, and no failure of the
/// recording reaches the pipeline.
#[derive(Debug)]
pub struct LiveRecording {
    path: PathBuf,
    feed: LiveFeed,
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
    /// An I/O error.
    pub fn start_with(mut recorder: Recorder, pipeline: &Pipeline, images_per_s: f64) -> Result<Self, Error> {
        let path = recorder.path().to_owned();
        if images_per_s > 0.0 {
            recorder = recorder.with_view(SkinView::new(pipeline.prepared()).with_images_per_s(images_per_s))?;
        }
        let feed = LiveFeed::start(recorder, &path.display().to_string(), QUEUE, pipeline)?;
        Ok(Self { path, feed, failure_told: false })
    }

    /// Final path of the recording.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The error that stopped the recording; returned once.
    pub fn new_failure(&mut self) -> Option<String> {
        let error = self.feed.status().error.filter(|_| !self.failure_told)?;
        self.failure_told = true;
        Some(error)
    }

    /// Ends the recording.
    pub fn finish(self) -> RecordingEnd {
        let path = self.path;
        match self.feed.finish() {
            Ok(summary) => RecordingEnd { path, frames: summary.frames, lost: summary.dropped, error: None },
            Err((error, [frames, lost])) => RecordingEnd { path, frames, lost, error: Some(error.to_string()) },
        }
    }
}

impl Deref for LiveRecording {
    type Target = LiveFeed;

    fn deref(&self) -> &LiveFeed {
        &self.feed
    }
}

impl DerefMut for LiveRecording {
    fn deref_mut(&mut self) -> &mut LiveFeed {
        &mut self.feed
    }
}
