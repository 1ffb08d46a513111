//! Figures of merit of reconstructed images: similarity to a known truth ([`icc`], [`rie`], [`ssim`]), the GREIT
//! figures of a single target ([`GreitFigures`]), and the place and width of a peak ([`peak_m`],
//! [`centroid_above_m`], [`spread_width_m`]).
//!
//! Images are row-major with row 0 at the top, `NaN` outside the skin. A pixel that is not finite in either of two
//! compared images takes no part.

mod greit_figures;
mod peak;
mod similarity;
mod structural;

pub use greit_figures::{GreitFigures, Target};
pub use peak::{centroid_above_m, peak_m, position_error_by_centroid_m, position_error_by_peak_m, spread_width_m};
pub use similarity::{icc, rie};
pub use structural::{SsimOptions, SsimWindow, ssim};

use thiserror::Error;

/// Why a figure of merit has no value.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum QualityError {
    /// An image has another number of pixels than the grid or the image that it is compared with.
    #[error("{what}: expected {expected} pixels, got {got}")]
    Length {
        /// Which image.
        what: &'static str,
        /// Pixels expected.
        expected: usize,
        /// Pixels given.
        got: usize,
    },
    /// Nothing is left to compute from.
    #[error("{what}: {reason}")]
    Undefined {
        /// Which figure.
        what: &'static str,
        /// What is missing.
        reason: &'static str,
    },
    /// A parameter outside its range.
    #[error("{field} = {value}: expected {expected}")]
    Value {
        /// Which parameter, with its unit.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        expected: &'static str,
    },
}

fn check_length(what: &'static str, expected: usize, got: usize) -> Result<(), QualityError> {
    if expected == got { Ok(()) } else { Err(QualityError::Length { what, expected, got }) }
}

fn check_positive(field: &'static str, value: f64) -> Result<(), QualityError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(QualityError::Value { field, value, expected: "positive and finite" })
}
