//! The measures that tactile laboratories report: limit of detection, minimum discernible distance, hysteresis,
//! repeatability and drift. Each is a plain function of numbers that an experiment has collected.
//!
//! Standard deviations are those of a sample (divided by count - 1). Loads may be forces (N) or pressures (Pa): results
//! come in the unit that goes in.

mod cycle;
mod detection;
mod distance;
mod statistics;

pub use cycle::{Drift, Hysteresis, Repeatability, drift, hysteresis, repeatability};
pub use detection::{
    DETECTION_FACTOR, DETECTION_FRAMES, DetectionLimit, NoiseLevel, detection_limit, frame_difference_rms,
    smallest_detected_load,
};
pub use distance::{crossing_distance_m, minimum_discernible_distance_m, pearson};

pub(crate) use statistics::require_finite;
