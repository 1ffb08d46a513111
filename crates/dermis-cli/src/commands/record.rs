//! `dermis record`: acquires frames into a file, without a page. The frames also go through the pipeline, and its
//! images, touches and baselines are recorded with them.

use std::io::Write;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis_device::Frame;
use dermis_device::acquire::Acquisition;
use dermis_live::driver::{Driver, Observer};
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::{LiveRecording, SkinView};

use super::acquired::AcquiredFrames;
use super::run::source;
use crate::exit::{Outcome, UsageError};
use crate::interrupt;

const EXAMPLE: &str = "\
Examples:
  dermis record healing-square --speed 0 --frames 150 --out press.mcap
  dermis record healing-square --speed 0 --frames 40 --images-per-s 0 \\
      --out raw.mcap

Without a source, the skin's digital twin is recorded. The file is called press.partial.mcap until it is complete. If \
a crash leaves it so, it opens like any other recording, and `dermis recover` completes it. Exit code 3: frames were \
lost; their number is printed.";

/// Frames that may queue between source and pipeline.
const QUEUE: usize = 1024;

/// Arguments of `dermis record`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    input: source::InputArguments,
    /// The recording; an existing one is not overwritten.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
    /// Stop after this many frames.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    /// Stop after this many seconds.
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Largest rate of images and point clouds for viewers, per second; 0 for none. Raw frames are always recorded in
    /// full.
    #[arg(long, value_name = "N", default_value_t = SkinView::IMAGES_PER_S)]
    images_per_s: f64,
}

impl Arguments {
    /// Records until the requested frames or seconds are reached, the source ends, the disk is full or the user
    /// interrupts.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        for (name, value) in [("--seconds", self.seconds), ("--images-per-s", Some(self.images_per_s))] {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value >= 0.0)) {
                return Err(UsageError(format!("{name} {value}: expected 0 or a positive number")).into());
            }
        }
        let (opened, mut pipeline, head) = self.input.open()?;
        // From here on a signal ends the recording cleanly.
        interrupt::begin();
        let mut recording = LiveRecording::start(&self.out, &head, &pipeline, self.images_per_s)?;
        interrupt::protect(recording.stop());
        let mut acquisition = Acquisition::spawn(opened.source, QUEUE, opened.wait);
        let outcome = self.follow(&mut acquisition, &mut pipeline, &mut recording);
        let end = recording.finish();
        let (counters, incomplete) = (acquisition.counters(), acquisition.incomplete());
        drop(acquisition);
        writeln!(out, "{}: {} frames, {} lost", end.path.display(), end.frames, counters.total() + end.lost)?;
        if let Some(error) = &end.error {
            tracing::error!("the recording is incomplete: {error}");
        }
        outcome?;
        Ok(Outcome::of_frames(counters, incomplete.as_deref(), end.lost, end.error.is_some()))
    }

    fn follow(
        &self,
        acquisition: &mut Acquisition,
        pipeline: &mut Pipeline,
        recording: &mut LiveRecording,
    ) -> anyhow::Result<()> {
        // An interrupted recording is finished like any other.
        let interrupted = interrupt::begin();
        let until = self.seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        let begun = Instant::now();
        let mut frames = AcquiredFrames::new(acquisition, Duration::from_millis(50));
        let mut observer = Recorded { recording, interrupted, begun, until, left: self.frames, wall_ns: 0 };
        Driver::new(pipeline).run(&mut frames, &mut observer)?;
        Ok(())
    }
}

/// Records each frame, then its results, until there are enough.
struct Recorded<'a> {
    recording: &'a mut LiveRecording,
    interrupted: &'static AtomicBool,
    begun: Instant,
    until: Option<Duration>,
    /// Frames left to record.
    left: Option<u64>,
    /// Wall-clock time of the current frame.
    wall_ns: u64,
}

impl Observer<AcquiredFrames<'_>> for Recorded<'_> {
    fn between(&mut self, _pipeline: &mut Pipeline) -> anyhow::Result<bool> {
        Ok(!self.interrupted.load(Ordering::Relaxed)
            && self.left != Some(0)
            && self.until.is_none_or(|until| self.begun.elapsed() < until)
            && self.recording.new_failure().is_none())
    }

    fn before(&mut self, frame: &Frame) -> anyhow::Result<()> {
        self.wall_ns = frame.host_wall_ns;
        self.left = self.left.map(|left| left.saturating_sub(1));
        self.recording.frame(frame);
        Ok(())
    }

    fn result(&mut self, output: &SkinFrame<'_>) -> anyhow::Result<ControlFlow<()>> {
        self.recording.results(output);
        Ok(ControlFlow::Continue(()))
    }

    fn after(&mut self, _feed: &AcquiredFrames<'_>, pipeline: &Pipeline, renewed: bool) -> anyhow::Result<()> {
        if renewed {
            self.recording.baseline(pipeline, self.wall_ns);
        }
        Ok(())
    }
}
