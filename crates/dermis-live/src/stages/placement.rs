//! The place that a calibration gives the single touch of a frame.

use dermis_touch::{PlaceHypothesis, TouchLoad};

/// A second touch of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondTouch {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// How strong it is, relative to the first, 0 to 1.
    pub share: f64,
}

/// Where a touch lies according to a calibration, in place of the image's own position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Its covariance, m^2.
    pub covariance_m2: [[f64; 2]; 2],
    /// How strong it is, in typical pokes at that place; `None` leaves that to the image.
    pub amplitude: Option<f64>,
    /// How deep or hard it is pressed, where the calibration's pokes had depths or forces.
    pub load: Option<TouchLoad>,
    /// The frame is unlike any single touch that was learnt: where the image shows several contacts, they are believed.
    pub doubtful: bool,
    /// Where it is nobody can tell: that is no touch where the model places touches and sees none.
    pub vague: bool,
    /// Where else the touch may be, where the frame does not tell.
    pub other_place: Option<PlaceHypothesis>,
    /// The frame is of two touches; the position is that of the stronger.
    pub second: Option<SecondTouch>,
}
