//! The interface of every sink, which takes one [`SkinFrame`] per frame, and touches in the units used by files and
//! streams.

use dermis_live::skin_frame::SkinFrame;
use dermis_touch::{LoadQuantity, PlaceHypothesis, Touch, TouchLoad};

use crate::Error;

/// Totals of a sink.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Summary {
    /// Frames accepted.
    pub frames: u64,
    /// Lines, rows or images written.
    pub written: u64,
}

/// A receiver of results, frame by frame.
pub trait Sink: Send {
    /// Takes the results of one frame.
    ///
    /// # Errors
    /// The results could not be written; the sink must not be used any more.
    fn accept(&mut self, output: &SkinFrame<'_>) -> Result<(), Error>;

    /// Writes whatever is left and gives files their final names. Further calls have no effect.
    ///
    /// # Errors
    /// If this fails, no file has been put under its final name; a file that was there before stays.
    fn finish(&mut self) -> Result<Summary, Error>;
}

/// Conversion from metres to millimetres, and from square metres, for output.
const MM_PER_M: f64 = 1e3;
const MM2_PER_M2: f64 = 1e6;

/// A touch as written to files and streams.
pub(super) struct TouchRow {
    pub(super) x_mm: f64,
    pub(super) y_mm: f64,
    pub(super) amplitude: f64,
    pub(super) area_mm2: f64,
    pub(super) sigma_x_mm: f64,
    pub(super) sigma_y_mm: f64,
}

impl TouchRow {
    pub(super) fn new(touch: &Touch) -> Self {
        Self {
            x_mm: touch.position_m[0] * MM_PER_M,
            y_mm: touch.position_m[1] * MM_PER_M,
            amplitude: touch.amplitude,
            area_mm2: touch.area_m2 * MM2_PER_M2,
            sigma_x_mm: touch.covariance_m2[0][0].sqrt() * MM_PER_M,
            sigma_y_mm: touch.covariance_m2[1][1].sqrt() * MM_PER_M,
        }
    }
}

/// Names of a load and its standard deviation in tables and lines.
pub(super) fn load_names(quantity: LoadQuantity) -> [&'static str; 2] {
    match quantity {
        LoadQuantity::DepthM => ["depth_mm", "sigma_depth_mm"],
        LoadQuantity::ForceN => ["poke_force_n", "sigma_poke_force_n"],
    }
}

/// A load and its standard deviation in the units of [`load_names`].
pub(super) fn load_numbers(load: &TouchLoad) -> [f64; 2] {
    let unit = match load.quantity {
        LoadQuantity::DepthM => MM_PER_M,
        LoadQuantity::ForceN => 1.0,
    };
    [unit * load.value, unit * load.sigma]
}

/// An alternative position, millimetres, and its probability.
pub(super) fn other_numbers(other: PlaceHypothesis) -> [f64; 3] {
    let [x_m, y_m] = other.position_m;
    [MM_PER_M * x_m, MM_PER_M * y_m, other.probability]
}
