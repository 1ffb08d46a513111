//! `dermis record`: acquire into a file, without a page. The frames also go through the pipeline, whose images, touches and
//! baselines stand beside them in the recording.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis::acquire::{Acquisition, Next};
use dermis::pipeline::Pipeline;
use dermis::record::{LiveRecording, SkinView};
use dermis_device::{Frame, HostStamp};

use super::run::source;
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis record healing-square --speed 0 --frames 150 --out press.mcap
  dermis record healing-square --speed 0 --frames 40 --images-per-s 0 --out raw.mcap

Without a source, the skin's digital twin is recorded. The file is called press.partial.mcap until it is whole; what a crash
leaves of it opens like any other recording, and `dermis recover` makes it whole. Exit code 3: frames were lost, and how many
was said.";

/// Frames that may wait between source and pipeline.
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
    /// Stop after so many frames.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    /// Stop after so many seconds.
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Images and point clouds for viewers, at most so many a second; 0 for none. Raw frames are never thinned out.
    #[arg(long, value_name = "N", default_value_t = SkinView::IMAGES_PER_S)]
    images_per_s: f64,
}

impl Arguments {
    /// Records until the frames or seconds are over, the source ends, the disk is full or the user interrupts.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        for (name, value) in [("--seconds", self.seconds), ("--images-per-s", Some(self.images_per_s))] {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value >= 0.0)) {
                return Err(UsageError(format!("{name} {value}: expected a number that is not negative")).into());
            }
        }
        let (opened, mut pipeline, head) = self.input.open()?;
        let mut recording = LiveRecording::start(&self.out, &head, &pipeline, self.images_per_s)?;
        let mut acquisition = Acquisition::spawn(opened.source, QUEUE, opened.wait);
        let outcome = self.follow(&mut acquisition, &mut pipeline, &mut recording);
        let end = recording.finish();
        let counters = acquisition.counters();
        drop(acquisition);
        writeln!(out, "{}: {} frames, {} lost", end.path.display(), end.frames, counters.total() + end.lost)?;
        if let Some(error) = &end.error {
            tracing::error!("the recording is not whole: {error}");
        }
        outcome?;
        Ok(Outcome::of_frames(counters, end.lost, end.error.is_some()))
    }

    fn follow(
        &self,
        acquisition: &mut Acquisition,
        pipeline: &mut Pipeline,
        recording: &mut LiveRecording,
    ) -> anyhow::Result<()> {
        let interrupted = Arc::new(AtomicBool::new(false));
        let raised = interrupted.clone();
        // Interrupted, the recording is finished as at its end.
        ctrlc::set_handler(move || raised.store(true, Ordering::Relaxed))?;
        let until = self.seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        let begun = Instant::now();
        let mut done = 0;
        while !interrupted.load(Ordering::Relaxed)
            && self.frames.is_none_or(|most| done < most)
            && until.is_none_or(|until| begun.elapsed() < until)
            && recording.new_failure().is_none()
        {
            match acquisition.next(Duration::from_millis(50)).map_err(dermis::Error::from)? {
                Next::Idle => {}
                Next::End => break,
                Next::Frame(frame) => {
                    process(&frame, pipeline, recording)?;
                    acquisition.recycle(frame);
                    done += 1;
                }
            }
        }
        Ok(())
    }
}

/// Records a frame before anything is made of it, then what was made of it.
fn process(frame: &Frame, pipeline: &mut Pipeline, recording: &mut LiveRecording) -> anyhow::Result<()> {
    recording.frame(frame);
    let before = pipeline.baseline_records().len();
    let output = pipeline.process(frame, HostStamp::now().monotonic_ns)?;
    recording.results(&output);
    if pipeline.baseline_records().len() > before {
        recording.baseline(pipeline, frame.host_wall_ns);
    }
    Ok(())
}
