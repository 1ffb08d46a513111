//! The one loop over frames: what comes from a feed, a recording, an instrument or a list, goes through a pipeline;
//! commands are carried out between frames, and an observer is shown what came of them.

use std::ops::ControlFlow;

use dermis_device::{Frame, HostStamp};
use dermis_touch::ReferenceRecord;

use crate::Error;
use crate::output::Output;
use crate::pipeline::Pipeline;

/// What is commanded between two frames.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Take the mean of the next frames as the baseline: [`Pipeline::tare`].
    Tare {
        /// Also while something touches the skin.
        force: bool,
        /// Why, for the record.
        reason: String,
    },
    /// Use another lambda: [`Pipeline::set_hyperparameter`].
    Hyperparameter(f64),
    /// Go on from a baseline that was in use before: [`Pipeline::restore_baseline`].
    RestoreBaseline {
        /// Its record.
        record: ReferenceRecord,
        /// One value a channel.
        values: Vec<f64>,
        /// Noise of the channels at rest.
        noise_std: Vec<f64>,
    },
}

/// What comes next from a feed.
#[derive(Debug)]
pub enum Next<'a> {
    /// A frame, and the host's monotonic clock at its processing, where that is not the clock's own time.
    Frame(&'a Frame, Option<u64>),
    /// What is commanded before the next frame.
    Command(Command),
    /// Nothing to run for the moment.
    Idle,
    /// There will be no more.
    End,
}

/// Where frames come from.
pub trait Feed {
    /// What can go wrong there, and in the pipeline.
    type Error: From<Error>;

    /// Waits a moment for what comes next.
    ///
    /// # Errors
    /// No further frame can be had.
    fn next(&mut self) -> Result<Next<'_>, Self::Error>;
}

/// Sees frames and what comes of them. All methods but the first may be left as they are.
pub trait Observer<F: Feed> {
    /// The results of a frame; the run breaks off where it says so.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn result(&mut self, output: &Output<'_>) -> Result<ControlFlow<()>, F::Error>;

    /// Before the feed is asked for what comes next: anything may be commanded. False ends the run.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn between(&mut self, _pipeline: &mut Pipeline) -> Result<bool, F::Error> {
        Ok(true)
    }

    /// A frame before anything is made of it.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn before(&mut self, _frame: &Frame) -> Result<(), F::Error> {
        Ok(())
    }

    /// The pipeline after a frame whose results were shown; `renewed` where a new baseline stands since.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn after(&mut self, _feed: &F, _pipeline: &Pipeline, _renewed: bool) -> Result<(), F::Error> {
        Ok(())
    }

    /// Nothing comes for the moment.
    ///
    /// # Errors
    /// Whatever ends the run.
    fn idle(&mut self, _feed: &F) -> Result<(), F::Error> {
        Ok(())
    }
}

/// A closure that takes results is an observer.
impl<F: Feed, C: FnMut(&Output<'_>) -> Result<ControlFlow<()>, F::Error>> Observer<F> for C {
    fn result(&mut self, output: &Output<'_>) -> Result<ControlFlow<()>, F::Error> {
        self(output)
    }
}

/// How far a run came.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Frames run.
    pub frames: u64,
    /// Frames that are missing between them, by their numbers.
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
    /// Through this pipeline.
    pub fn new(pipeline: &'a mut Pipeline) -> Self {
        Self { pipeline, progress: Progress::default(), last_sequence: None }
    }

    /// Runs what a feed has until it ends or the observer breaks off.
    ///
    /// # Errors
    /// Those of the feed, the pipeline and the observer. Commands that are refused are counted, but for baselines that
    /// cannot be restored.
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

    /// Runs one frame; whether to break off, and whether a new baseline stands.
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

    /// Carries out a command; one that is refused is counted.
    ///
    /// # Errors
    /// A baseline that does not fit the skin.
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
    /// Of these frames.
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
