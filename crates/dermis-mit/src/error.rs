//! What can be wrong with coils, bodies and frequencies.

use thiserror::Error;

use dermis_tomo::sparse::SparseError;

/// Why a magnetic problem could not be set up or solved.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum MitError {
    /// A record of a body that could not be understood.
    #[error("{what}: {reason}")]
    Record {
        /// Which.
        what: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A number that makes no sense.
    #[error("{field} = {value}: expected {expected}")]
    Value {
        /// What it stands for, with its unit.
        field: &'static str,
        /// The number.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// A fit was asked for with parameters that make no sense.
    #[error(transparent)]
    Fit(#[from] dermis_tomo::least_squares::Error),
    /// Counts that disagree.
    #[error("{what}: expected {expected}, got {got}")]
    Count {
        /// What was counted.
        what: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        got: usize,
    },
    /// Two coils that reach into each other.
    #[error(
        "coils {first} and {second} overlap: {distance_m} m apart, expected {needed_m} m, or layers {layers_m} m apart"
    )]
    CoilsOverlap {
        /// Number of one, from 1.
        first: usize,
        /// Number of the other, from 1.
        second: usize,
        /// Between their centres.
        distance_m: f64,
        /// Sum of their half widths.
        needed_m: f64,
        /// Sum of their half heights: coils at heights that differ by as much may lie over each other.
        layers_m: f64,
    },
    /// A shield that is not below the coils.
    #[error("shield z_m = {z_m}: expected finite and below the coils' lowest wire at {lowest_m} m")]
    ShieldNotBelow {
        /// Height of the shield.
        z_m: f64,
        /// Height of the lowest wire.
        lowest_m: f64,
    },
    /// A place of a coil that is not a number.
    #[error("place of coil {coil}: {value} m, expected finite")]
    CoilPlace {
        /// Number of the coil, from 1.
        coil: usize,
        /// The coordinate.
        value: f64,
    },
    /// A coil that is not round about a vertical axis, where only such a coil will do.
    #[error("the coil at {centre_m:?} m is not made of loops about a vertical axis")]
    NotRound {
        /// Its middle.
        centre_m: [f64; 3],
    },
    /// Wire inside the sphere around a body, where multipoles do not hold.
    #[error(
        "body {body}, its centre at {} mm: wire of coil {coil} is {:.2} mm away, and the sphere around the body has a radius of {:.2} mm; let bodies rest higher or travel less, or make them smaller",
        in_mm(position_m), 1e3 * distance_m, 1e3 * radius_m
    )]
    WireInside {
        /// Number of the body, from 1.
        body: usize,
        /// Its centre.
        position_m: [f64; 3],
        /// Number of the coil, from 1.
        coil: usize,
        /// Distance of the nearest wire from the centre.
        distance_m: f64,
        /// Radius of the sphere around the body.
        radius_m: f64,
    },
    /// Wire in a layer of voxels, or too near to it.
    #[error("voxel {voxel}: wire of coil {coil} is {distance_m} m from one of its points, which resolve {least_m} m")]
    WireInVoxel {
        /// Number of the voxel, from 1.
        voxel: usize,
        /// Number of the coil, from 1.
        coil: usize,
        /// Distance of the nearest wire from a point of the quadrature.
        distance_m: f64,
        /// What the points of a voxel resolve.
        least_m: f64,
    },
    /// Bodies whose spheres reach into each other.
    #[error("bodies {first} and {second} are {distance_m} m apart, their spheres need {needed_m} m")]
    BodiesOverlap {
        /// Number of one, from 1.
        first: usize,
        /// Number of the other, from 1.
        second: usize,
        /// Between their centres.
        distance_m: f64,
        /// Sum of their radii.
        needed_m: f64,
    },
    /// A height outside the table that was made.
    #[error("body {body}: height {height_m} m is outside the table, {low_m} to {high_m} m")]
    OutsideTable {
        /// Number of the body, from 1.
        body: usize,
        /// Its height.
        height_m: f64,
        /// Lowest height tabulated.
        low_m: f64,
        /// Highest height tabulated.
        high_m: f64,
    },
    /// A finite-element system could not be factored.
    #[error("the finite-element system: {0}")]
    System(#[from] SparseError),
    /// A mesh that would need more memory than may be used.
    #[error("{0}")]
    OutOfMemory(#[from] dermis_tomo::memory::OutOfMemory),
    /// An iteration that did not come to its end.
    #[error(
        "field not found after {iterations} iterations: residual {residual:e} of the source, expected {tolerance:e}"
    )]
    NotConverged {
        /// Iterations made.
        iterations: usize,
        /// Norm of the residual over that of the source.
        residual: f64,
        /// What was to be reached.
        tolerance: f64,
    },
}

/// A number that must be finite and above zero.
pub(crate) fn positive(field: &'static str, value: f64) -> Result<(), MitError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(MitError::Value { field, value, expected: "positive and finite" })
}

/// A frequency that this physics (quasi-static, whole windings) serves.
pub(crate) fn frequency(value_hz: f64) -> Result<(), MitError> {
    if (1.0..=1e6).contains(&value_hz) {
        return Ok(());
    }
    Err(MitError::Value { field: "frequency_hz", value: value_hz, expected: "1 Hz to 1 MHz" })
}

/// A place in millimetres, to a hundredth.
fn in_mm(place_m: &[f64; 3]) -> String {
    let [x, y, z] = place_m.map(|value| 1e3 * value);
    format!("({x:.2}, {y:.2}, {z:.2})")
}
