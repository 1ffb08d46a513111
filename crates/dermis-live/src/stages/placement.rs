//! The positions of a frame's touches according to a calibration.

use dermis_tomo::mesh::Point;
use dermis_touch::locator::MOST_TOUCHES;
use dermis_touch::{PlaceHypothesis, TouchLoad};

/// Maximum number of touches in a frame other than the strongest.
pub const MOST_FURTHER: usize = MOST_TOUCHES - 1;

/// Another touch of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FurtherTouch {
    /// Position, metres.
    pub position_m: Point,
    /// Its covariance, m^2.
    pub covariance_m2: [[f64; 2]; 2],
    /// Strength relative to the first.
    pub share: f64,
    /// Depth or force, if the calibration's pokes had depths or forces.
    pub load: Option<TouchLoad>,
}

/// The position of a touch according to a calibration, replacing the image's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position, metres.
    pub position_m: Point,
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
    /// The other touches, if the frame shows several. The position above is then the strongest one's.
    pub further: [Option<FurtherTouch>; MOST_FURTHER],
}
