//! The skin as built, in a calibration.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::Error;
use crate::as_built::Build;
use crate::prepare::Prepared;
use crate::stages::workshop_error::WorkshopError;

/// A skin as built, with the errors of touches that remain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct AsBuilt {
    pub(crate) build: Build,
    pub(crate) errors: WorkshopError,
}

impl AsBuilt {
    /// The model of the skin as built.
    ///
    /// # Errors
    /// A skin that cannot be solved.
    pub(super) fn skin(&self, prepared: &Prepared) -> Result<Prepared, Error> {
        Ok(prepared.as_built(self.build.clone())?.with_errors(Arc::new(self.errors.clone())))
    }
}
