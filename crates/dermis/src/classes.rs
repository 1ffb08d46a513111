//! The network's word on every frame of the live pipeline: classes of the pixels beside the image.

use dermis_learn::Model;

use crate::Error;
use crate::learning::{Classes, Classifier};
use crate::prepare::Prepared;

/// A network with the classes of the last frame.
#[derive(Debug)]
pub(crate) struct ClassStage {
    classifier: Classifier,
    classes: Classes,
    is_current: bool,
}

impl ClassStage {
    pub(crate) fn new(prepared: &Prepared, model: &Model) -> Result<Self, Error> {
        let grid = prepared.map.grid();
        let classes = Classes::new(grid.rows, grid.columns);
        Ok(Self { classifier: Classifier::new(prepared, model)?, classes, is_current: false })
    }

    /// Classifies difference data (model volts, `NaN` where missing).
    pub(crate) fn see(&mut self, difference: &[f64]) -> Result<(), Error> {
        self.is_current = false;
        if difference.iter().any(|value| value.is_finite()) {
            self.classifier.classify(difference, &mut self.classes)?;
            self.is_current = true;
        }
        Ok(())
    }

    /// Nothing was seen.
    pub(crate) fn forget(&mut self) {
        self.is_current = false;
    }

    /// Of the last frame, if anything was seen in it.
    pub(crate) fn classes(&self) -> Option<&Classes> {
        self.is_current.then_some(&self.classes)
    }
}
