//! Figures of merit of reconstructed images: similarity to a known truth ([`icc`], [`rie`], [`ssim`]), the GREIT
//! figures of a single target ([`GreitFigures`]), and the position and width of a peak ([`peak_m`],
//! [`centroid_above_m`], [`spread_width_m`]).
//!
//! Images are row-major with row 0 at the top, `NaN` outside the skin. In comparisons, pixels that are not finite in
//! both images are ignored.

mod error;
mod greit_figures;
mod peak;
mod similarity;
mod structural;

pub use error::QualityError;
pub use greit_figures::{GreitFigures, Target};
pub use peak::{centroid_above_m, peak_m, position_error_by_centroid_m, position_error_by_peak_m, spread_width_m};
pub use similarity::{icc, rie};
pub use structural::{SsimOptions, SsimWindow, ssim};
