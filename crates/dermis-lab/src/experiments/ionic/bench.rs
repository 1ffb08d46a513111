//! Items shared by the experiments of the ionic skin.

use crate::report::{Kind, Row};

pub(super) const SKIN: &str = "ionic-disc";
/// Diameter of the disc that presses.
pub(super) const DIAMETER_MM: f64 = 20.0;

pub(super) fn row(quantity: impl Into<String>, unit: &'static str, paper: Option<f64>, here: f64, kind: Kind) -> Row {
    Row { quantity: quantity.into(), unit, paper, here, kind }
}
