//! The main loop over frames. Frames from a feed (recording, instrument or list) go through a pipeline, commands are
//! executed between frames, and an observer receives the results.

use std::ops::ControlFlow;

use dermis_device::{Frame, HostStamp};
use dermis_touch::ReferenceRecord;

use crate::Error;
use crate::pipeline::Pipeline;
use crate::skin_frame::SkinFrame;

/// A command to execute between two frames.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Make the mean of the next frames the baseline: [`Pipeline::tare`].
    Tare {
        /// Also while something touches the skin.
        force: bool,
        /// The reason, for the record.
        reason: String,
    },
    /// Change lambda: [`Pipeline::set_hyperparameter`].
    Hyperparameter(f64),
    /// Restore an earlier baseline: [`Pipeline::restore_baseline`].
    RestoreBaseline {
        /// Record of the baseline.
        record: ReferenceRecord,
        /// Its values, one per channel.
        values: Vec<f64>,
        /// Noise of the channels at rest.
        noise_std: Vec<f64>,
    },
}

/// The next item from a feed.
#[derive(Debug)]
pub enum Next<'a> {
    /// A frame, and the host's monotonic clock at its processing if that is not the current time.
    Frame(&'a Frame, Option<u64>),
    /// A command to execute before the next frame.
    Command(Command),
    /// Nothing to do for the moment.
    Idle,
    /// There will be no more frames.
    End,
}

/// A source of frames and commands.
pub trait Feed {
    /// Error of the feed or the pipeline.
    type Error: From<Error>;

    /// Waits briefly for the next item.
    ///
    /// # Errors
    /// No further frame can be obtained.
    fn next(&mut self) -> Result<Next<'_>, Self::Error>;
}

/// Observes frames and their results. All methods except the first have defaults.
pub trait Observer<F: Feed> {
    /// Receives the results of a frame. The run stops if this returns a break.
    ///
    /// # Errors
    /// Any error ends the run.
    fn result(&mut self, output: &SkinFrame<'_>) -> Result<ControlFlow<()>, F::Error>;

    /// Called before the feed is asked for the next item; may command the pipeline. False ends the run.
    ///
    /// # Errors
    /// Any error ends the run.
    fn between(&mut self, _pipeline: &mut Pipeline) -> Result<bool, F::Error> {
        Ok(true)
    }

    /// Receives a frame before it is processed.
    ///
    /// # Errors
    /// Any error ends the run.
    fn before(&mut self, _frame: &Frame) -> Result<(), F::Error> {
        Ok(())
    }

    /// Receives the pipeline after a frame's results. `renewed` is true if this frame completed a new baseline.
    ///
    /// # Errors
    /// Any error ends the run.
    fn after(&mut self, _feed: &F, _pipeline: &Pipeline, _renewed: bool) -> Result<(), F::Error> {
        Ok(())
    }

    /// Called when there is nothing to do for the moment.
    ///
    /// # Errors
    /// Any error ends the run.
    fn idle(&mut self, _feed: &F) -> Result<(), F::Error> {
        Ok(())
    }
}

/// A closure that takes results is an observer.
impl<F: Feed, C: FnMut(&SkinFrame<'_>) -> Result<ControlFlow<()>, F::Error>> Observer<F> for C {
    fn result(&mut self, output: &SkinFrame<'_>) -> Result<ControlFlow<()>, F::Error> {
        self(output)
    }
}

/// Progress of a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Frames processed.
    pub frames: u64,
    /// Frames missing between them, according to their numbers.
    pub missing: u64,
    /// Commands that the pipeline refused.
    pub refused: u64,
}

/// Runs frames through a pipeline.
#[derive(Debug)]
pub struct Driver<'a> {
    pipeline: &'a mut Pipeline,
    progress: Progress,
    last_sequence: Option<u64>,
}

impl<'a> Driver<'a> {
    /// A driver for this pipeline.
    pub fn new(pipeline: &'a mut Pipeline) -> Self {
        Self { pipeline, progress: Progress::default(), last_sequence: None }
    }

    /// Runs a feed until it ends or the observer stops.
    ///
    /// # Errors
    /// Errors of the feed, the pipeline and the observer. Refused commands are only counted, except for baselines
    /// that cannot be restored.
    pub fn run<F: Feed>(&mut self, feed: &mut F, observer: &mut impl Observer<F>) -> Result<Progress, F::Error> {
        while observer.between(self.pipeline)? {
            let (flow, renewed) = match feed.next()? {
                Next::Frame(frame, now_ns) => self.step(frame, now_ns, observer)?,
                Next::Command(command) => {
                    self.obey(&command)?;
                    continue;
                }
                Next::Idle => {
                    observer.idle(feed)?;
                    continue;
                }
                Next::End => break,
            };
            observer.after(feed, self.pipeline, renewed)?;
            if flow.is_break() {
                break;
            }
        }
        Ok(self.progress)
    }

    /// Processes one frame. Returns whether to stop, and whether there is a new baseline.
    fn step<F: Feed>(
        &mut self,
        frame: &Frame,
        now_ns: Option<u64>,
        observer: &mut impl Observer<F>,
    ) -> Result<(ControlFlow<()>, bool), F::Error> {
        let missing = self.last_sequence.map_or(0, |last| frame.sequence.saturating_sub(last).saturating_sub(1));
        self.progress.missing += missing;
        self.last_sequence = Some(frame.sequence);
        observer.before(frame)?;
        let baselines = self.pipeline.baseline_records().len();
        let now_ns = now_ns.unwrap_or_else(|| HostStamp::now().monotonic_ns);
        let flow = observer.result(&self.pipeline.process(frame, now_ns)?)?;
        self.progress.frames += 1;
        Ok((flow, self.pipeline.baseline_records().len() > baselines))
    }

    /// Executes a command. A refused one is counted.
    ///
    /// # Errors
    /// A baseline that does not match the skin.
    fn obey(&mut self, command: &Command) -> Result<(), Error> {
        let refused = match command {
            Command::Tare { force, reason } => self.pipeline.tare(*force, reason).is_err(),
            Command::Hyperparameter(lambda) => self.pipeline.set_hyperparameter(*lambda).is_err(),
            Command::RestoreBaseline { record, values, noise_std } => {
                self.pipeline.restore_baseline(record.clone(), values, noise_std)?;
                false
            }
        };
        self.progress.refused += u64::from(refused);
        Ok(())
    }
}

/// A feed of frames from a list, each processed at its own time.
#[derive(Debug)]
pub struct FrameList<I> {
    frames: I,
    frame: Frame,
}

impl<I: Iterator<Item = Frame>> FrameList<I> {
    /// A feed of these frames.
    pub fn new(frames: impl IntoIterator<IntoIter = I>) -> Self {
        Self { frames: frames.into_iter(), frame: Frame::default() }
    }
}

impl<I: Iterator<Item = Frame>> Feed for FrameList<I> {
    type Error = Error;

    fn next(&mut self) -> Result<Next<'_>, Error> {
        let Some(frame) = self.frames.next() else { return Ok(Next::End) };
        self.frame = frame;
        Ok(Next::Frame(&self.frame, Some(self.frame.host_monotonic_ns)))
    }
}
