//! The locator of a calibration: with two experts, or with one in files written by an earlier version.

use dermis_touch::locator::{
    FusedLocator, FusedScratch, LeaveOneOut, Located, Locator, LocatorError, LocatorScratch, SuggestedPoke,
};

/// Locates single touches.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum PlaceLocator {
    /// With one expert.
    Single(Box<Locator>),
    /// With two experts.
    Fused(Box<FusedLocator>),
}

/// Working memory of a locator.
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

    /// Locates the touch in a frame of difference data. Scratch memory of the other kind is replaced.
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
