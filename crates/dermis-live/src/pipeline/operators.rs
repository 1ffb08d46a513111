//! What is kept of operators that are made beside the stream.

use crate::Error;
use crate::beside::Beside;
use crate::imager::NewOperator;

/// Operators for other hyperparameters.
#[derive(Debug)]
pub(super) struct Operators {
    /// The lambda of the one that is being made.
    pub making: Option<f64>,
    pub coming: Beside<Result<NewOperator, Error>>,
    /// What was asked for last, while another one is being made.
    pub next: Option<f64>,
    /// Frames that have waited for operators of a model that is no longer in use.
    waited: u64,
}

impl Operators {
    /// None is being made; so many frames have waited before.
    pub fn after(waited: u64) -> Self {
        Self { making: None, coming: Beside::new(), next: None, waited }
    }

    pub fn waits(&self) -> u64 {
        self.waited + self.coming.waits()
    }
}
