//! Calibrated skins: pokes at known positions make a measured Jacobian, on which images are made, and a locator, which
//! places single touches. Skins whose readout circuit is known only in kind calibrate themselves.

mod calibrated_imager;
mod matched;
mod placement_finder;
mod poke_calibration;
mod pokes;
mod self_calibrated;

pub use calibrated_imager::CalibratedImager;
pub use matched::MatchedFinder;
pub use placement_finder::{LearntFinder, PlacementFinder};
pub use poke_calibration::Calibration;
pub use pokes::{LoadQuantity, Pokes, read_pokes};
