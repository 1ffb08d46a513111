//! The skin as it was built: its differences from its file, learned from its baseline and from pokes at known
//! positions.
//!
//! The file's `[tolerances]` are the prior: positions and widths of electrodes, contact impedances and a smooth random
//! conductivity, all normal with known deviations. Baseline and pokes condition it. The result is a skin whose model is
//! used in place of the file's, and what remains unknown is the covariance of its touches.

mod build;
mod errors;
mod fit;
mod from_baseline;
mod spots;

pub use build::Build;
pub(crate) use errors::{RADIUS_UNKNOWN, places};
pub(crate) use fit::{BuildFit, Built};
pub use from_baseline::from_rest;
pub(crate) use from_baseline::{is_off, is_wanted, learns_from_rest};
pub(crate) use spots::{LOAD, PARAMETERS, RADIUS, Spots};
