//! The measures that tactile laboratories report: limit of detection, minimum discernible distance, hysteresis,
//! repeatability and drift. Each is a plain function of numbers collected in an experiment.
//!
//! Standard deviations are sample standard deviations (divided by count - 1). Loads may be forces (N) or pressures
//! (Pa); results are in the unit of the input.

mod cycle;
mod detection;
mod distance;

pub use cycle::{Drift, Hysteresis, Repeatability, drift, hysteresis, repeatability};
pub use detection::{
    DETECTION_FACTOR, DETECTION_FRAMES, DetectionLimit, NoiseLevel, detection_limit, frame_difference_rms,
    smallest_detected_load,
};
pub use distance::{crossing_distance_m, minimum_discernible_distance_m, pearson};
