//! Calibrated skins. Pokes at known positions give a measured Jacobian, on which images are made, and a locator,
//! which locates single touches. Skins whose readout circuit is known only in kind calibrate themselves.

mod calibrated_imager;
mod circuit_fit;
mod circuit_search;
mod matched;
mod placement_finder;
mod poke_calibration;
mod poke_check;
mod pokes;
mod self_calibrated;

pub use calibrated_imager::CalibratedImager;
pub(crate) use calibrated_imager::{check_wiring, learnt_finder};
pub use circuit_fit::{CLEAR_BY, CircuitFit, CircuitNews, RunnerUp, TRUSTED_SCORE, circuit_words};
pub(crate) use circuit_search::{check_searchable, find_circuit_while};
pub use circuit_search::{find_circuit, relative_changes};
pub use matched::MatchedFinder;
pub use placement_finder::{LearntFinder, PlacementFinder};
pub(crate) use poke_calibration::{AsBuilt, differences_of};
pub use poke_calibration::{
    Calibration, CalibrationOptions, PokeFrames, PokeGroup, PokeReview, StartReview, StartUse, set_channels,
};
pub(crate) use pokes::load_shares;
pub use pokes::{LoadQuantity, Pokes, read_pokes};
pub(crate) use self_calibrated::SelfCalibrated;
