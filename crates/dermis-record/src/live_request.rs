//! Commands from outside to a running pipeline, such as a tare from a viewer. They are carried out between two frames
//! and answered.

use dermis_live::pipeline::Pipeline;

use super::live_feed::{HYPERPARAMETER, TARE};

/// A command to a running pipeline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LiveCommand {
    /// Take a new baseline: [`Pipeline::tare`].
    Tare {
        /// Take it even while something touches the skin.
        force: bool,
    },
    /// Change lambda: [`Pipeline::set_hyperparameter`].
    Hyperparameter(f64),
}

impl LiveCommand {
    /// Carries out the command between two frames and reports it through `tell`, which gets an event's name, a
    /// description and its numbers, and passes them to all feeds. `by` names the requester, for the recording. The text
    /// says what was done.
    ///
    /// # Errors
    /// The reason, if the pipeline refuses the command.
    pub fn carry_out(
        self,
        by: &str,
        pipeline: &mut Pipeline,
        mut tell: impl FnMut(&str, &str, &[f64]),
    ) -> Result<String, String> {
        match self {
            Self::Tare { force } => match pipeline.tare(force, by) {
                Ok(frames) => {
                    tell(TARE, by, &[f64::from(u8::from(force))]);
                    Ok(format!("taring over {frames} frames"))
                }
                Err(error) => {
                    tell("tare-refused", &error.to_string(), &[]);
                    Err(format!("tare refused: {error}"))
                }
            },
            Self::Hyperparameter(lambda) => match pipeline.set_hyperparameter(lambda) {
                Ok(()) => {
                    tell(HYPERPARAMETER, &format!("lambda {lambda:e}"), &[lambda]);
                    Ok(format!("hyperparameter {lambda:.3e}"))
                }
                Err(error) => Err(format!("hyperparameter refused: {error}")),
            },
        }
    }
}

type Answer = Box<dyn FnOnce(Result<String, String>) + Send>;

/// A command with a way to answer it. If it is dropped, the answer is that the run has ended.
pub struct LiveRequest {
    command: LiveCommand,
    by: &'static str,
    answer: Option<Answer>,
}

impl std::fmt::Debug for LiveRequest {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("LiveRequest").field("command", &self.command).field("by", &self.by).finish_non_exhaustive()
    }
}

impl LiveRequest {
    /// A request of `by`, such as `requested in Foxglove`; `answer` is called once, and must not block.
    pub fn new(
        command: LiveCommand,
        by: &'static str,
        answer: impl FnOnce(Result<String, String>) + Send + 'static,
    ) -> Self {
        Self { command, by, answer: Some(Box::new(answer)) }
    }

    /// Carries out the command between two frames, reports it like [`LiveCommand::carry_out`], and answers.
    pub fn carry_out(self, pipeline: &mut Pipeline, tell: impl FnMut(&str, &str, &[f64])) {
        let done = self.command.carry_out(self.by, pipeline, tell);
        self.answer(done);
    }

    /// Answers without carrying out the command.
    pub fn refuse(self, reason: impl Into<String>) {
        self.answer(Err(reason.into()));
    }

    fn answer(mut self, done: Result<String, String>) {
        if let Some(answer) = self.answer.take() {
            answer(done);
        }
    }
}

impl Drop for LiveRequest {
    fn drop(&mut self) {
        if let Some(answer) = self.answer.take() {
            answer(Err("the run has ended".to_owned()));
        }
    }
}
