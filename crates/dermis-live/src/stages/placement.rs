//! The position of a frame's single touch according to a calibration.

use dermis_touch::{PlaceHypothesis, TouchLoad};

/// A second touch of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondTouch {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Strength relative to the first, 0 to 1.
    pub share: f64,
}

/// The position of a touch according to a calibration, replacing the image's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Its covariance, m^2.
    pub covariance_m2: [[f64; 2]; 2],
    /// Strength in typical pokes at that position; `None` leaves it to the image.
    pub amplitude: Option<f64>,
    /// Depth or force of the press, if the calibration's pokes had depths or forces.
    pub load: Option<TouchLoad>,
    /// The frame is unlike any single touch in the training data. If the image shows several contacts, use those.
    pub doubtful: bool,
    /// The position is unknown. Not reported as a touch when the model locates touches and sees none.
    pub vague: bool,
    /// Another possible position, if the frame cannot decide.
    pub other_place: Option<PlaceHypothesis>,
    /// The second touch, if the frame shows two. The position above is then the stronger one's.
    pub second: Option<SecondTouch>,
}
