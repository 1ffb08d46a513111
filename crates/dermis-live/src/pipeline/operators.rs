//! State of operators built in the background.

use crate::Error;
use crate::beside::Beside;
use crate::imager::NewOperator;

/// Operators for other hyperparameters.
#[derive(Debug)]
pub(super) struct Operators {
    /// The lambda of the operator being built.
    pub making: Option<f64>,
    pub coming: Beside<Result<NewOperator, Error>>,
    /// The last lambda requested while another operator is being built.
    pub next: Option<f64>,
    /// Frames that waited for operators of an earlier model.
    waited: u64,
}

impl Operators {
    /// No operator in progress, and this many frames that waited before.
    pub fn after(waited: u64) -> Self {
        Self { making: None, coming: Beside::new(), next: None, waited }
    }

    pub fn waits(&self) -> u64 {
        self.waited + self.coming.waits()
    }
}
