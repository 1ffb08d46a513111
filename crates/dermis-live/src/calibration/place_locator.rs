//! The locator of a calibration: of two experts, or of one in files that an earlier version wrote.

use dermis_touch::locator::{
    FusedLocator, FusedScratch, LeaveOneOut, Located, Locator, LocatorError, LocatorScratch, SuggestedPoke,
};

/// What places single touches.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum PlaceLocator {
    /// Of one expert.
    Single(Box<Locator>),
    /// Of two.
    Fused(Box<FusedLocator>),
}

/// Its memory between frames.
#[derive(Clone, Debug)]
pub(super) enum PlaceScratch {
    Single(Box<LocatorScratch>),
    Fused(Box<FusedScratch>),
}

impl PlaceLocator {
    pub fn channels(&self) -> usize {
        match self {
            Self::Single(locator) => locator.channels(),
            Self::Fused(locator) => locator.channels(),
        }
    }

    pub fn leave_one_out(&self) -> &LeaveOneOut {
        match self {
            Self::Single(locator) => locator.leave_one_out(),
            Self::Fused(locator) => &locator.report().left_out,
        }
    }

    pub fn suggest_pokes(&self, count: usize) -> Result<Vec<SuggestedPoke>, LocatorError> {
        match self {
            Self::Single(locator) => locator.suggest_pokes(count),
            Self::Fused(locator) => locator.suggest_pokes(count),
        }
    }

    /// Memory for [`PlaceLocator::locate`].
    pub fn scratch(&self) -> PlaceScratch {
        match self {
            Self::Single(locator) => PlaceScratch::Single(Box::new(locator.scratch())),
            Self::Fused(locator) => PlaceScratch::Fused(Box::new(locator.scratch())),
        }
    }

    /// Locates the touch behind a frame of difference data; memory of the other kind is replaced.
    pub fn locate(&self, frame: &[f64], scratch: &mut PlaceScratch) -> Result<Located, LocatorError> {
        match (self, &mut *scratch) {
            (Self::Single(locator), PlaceScratch::Single(scratch)) => locator.predict_into(frame, scratch),
            (Self::Fused(locator), PlaceScratch::Fused(scratch)) => locator.predict_into(frame, scratch),
            _ => {
                *scratch = self.scratch();
                self.locate(frame, scratch)
            }
        }
    }
}
