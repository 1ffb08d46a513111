//! Errors of coils, bodies and frequencies.

use thiserror::Error;

use dermis_tomo::sparse::SparseError;

/// Reasons why a magnetic problem cannot be set up or solved.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum MitError {
    /// A record of a body that cannot be parsed.
    #[error("{what}: {reason}")]
    Record {
        /// Name of the record.
        what: String,
        /// The problem.
        reason: String,
    },
    /// An invalid number.
    #[error("{field} = {value}: expected {expected}")]
    Value {
        /// Name of the quantity, with its unit.
        field: &'static str,
        /// The number.
        value: f64,
        /// Expected values.
        expected: &'static str,
    },
    /// A fit with invalid parameters.
    #[error(transparent)]
    Fit(#[from] dermis_tomo::least_squares::Error),
    /// Counts that disagree.
    #[error("{what}: expected {expected}, got {got}")]
    Count {
        /// The items counted.
        what: &'static str,
        /// Expected count.
        expected: usize,
        /// Actual count.
        got: usize,
    },
    /// Two overlapping coils.
    #[error(
        "coils {first} and {second} overlap: {distance_m} m apart, expected {needed_m} m, or layers {layers_m} m apart"
    )]
    CoilsOverlap {
        /// Number of the first coil, from 1.
        first: usize,
        /// Number of the second coil, from 1.
        second: usize,
        /// Distance between their centres.
        distance_m: f64,
        /// Sum of their half widths.
        needed_m: f64,
        /// Sum of their half heights; with this difference in height the coils may lie above each other.
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
    /// A coil position that is not finite.
    #[error("place of coil {coil}: {value} m, expected finite")]
    CoilPlace {
        /// Number of the coil, from 1.
        coil: usize,
        /// The coordinate.
        value: f64,
    },
    /// A coil that is not round about a vertical axis, where that is required.
    #[error("the coil at {centre_m:?} m is not made of loops about a vertical axis")]
    NotRound {
        /// Centre of the coil.
        centre_m: [f64; 3],
    },
    /// Wire inside the sphere around a body, where multipoles are not valid.
    #[error(
        "body {body}, its centre at {} mm: wire of coil {coil} is {:.2} mm away, and the sphere around the body has a radius of {:.2} mm; let bodies rest higher or travel less, or make them smaller",
        in_mm(position_m), 1e3 * distance_m, 1e3 * radius_m
    )]
    WireInside {
        /// Number of the body, from 1.
        body: usize,
        /// Centre of the body.
        position_m: [f64; 3],
        /// Number of the coil, from 1.
        coil: usize,
        /// Distance of the nearest wire from the centre.
        distance_m: f64,
        /// Radius of the sphere around the body.
        radius_m: f64,
    },
    /// Wire in a layer of voxels, or too close to it.
    #[error("voxel {voxel}: wire of coil {coil} is {distance_m} m from one of its points, which resolve {least_m} m")]
    WireInVoxel {
        /// Number of the voxel, from 1.
        voxel: usize,
        /// Number of the coil, from 1.
        coil: usize,
        /// Distance of the nearest wire from a quadrature point.
        distance_m: f64,
        /// Minimum distance that the points of a voxel resolve.
        least_m: f64,
    },
    /// Bodies with overlapping spheres.
    #[error("bodies {first} and {second} are {distance_m} m apart, their spheres need {needed_m} m")]
    BodiesOverlap {
        /// Number of the first body, from 1.
        first: usize,
        /// Number of the second body, from 1.
        second: usize,
        /// Distance between their centres.
        distance_m: f64,
        /// Sum of their radii.
        needed_m: f64,
    },
    /// A height outside the computed table.
    #[error("body {body}: height {height_m} m is outside the table, {low_m} to {high_m} m")]
    OutsideTable {
        /// Number of the body, from 1.
        body: usize,
        /// Height of the body.
        height_m: f64,
        /// Minimum height in the table.
        low_m: f64,
        /// Maximum height in the table.
        high_m: f64,
    },
    /// A finite-element system could not be factored.
    #[error("the finite-element system: {0}")]
    System(#[from] SparseError),
    /// A mesh that would need more memory than allowed.
    #[error("{0}")]
    OutOfMemory(#[from] dermis_tomo::memory::OutOfMemory),
    /// An iteration that did not converge.
    #[error(
        "field not found after {iterations} iterations: residual {residual:e} of the source, expected {tolerance:e}"
    )]
    NotConverged {
        /// Number of iterations made.
        iterations: usize,
        /// Norm of the residual relative to the source.
        residual: f64,
        /// Required relative residual.
        tolerance: f64,
    },
}

/// Checks that a number is finite and above zero.
pub(crate) fn positive(field: &'static str, value: f64) -> Result<(), MitError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(MitError::Value { field, value, expected: "positive and finite" })
}

/// Checks that a frequency is in the range of this physics (quasi-static, lumped windings).
pub(crate) fn frequency(value_hz: f64) -> Result<(), MitError> {
    if (1.0..=1e6).contains(&value_hz) {
        return Ok(());
    }
    Err(MitError::Value { field: "frequency_hz", value: value_hz, expected: "1 Hz to 1 MHz" })
}

/// Formats a position in millimetres, to a hundredth.
fn in_mm(place_m: &[f64; 3]) -> String {
    let [x, y, z] = place_m.map(|value| 1e3 * value);
    format!("({x:.2}, {y:.2}, {z:.2})")
}
