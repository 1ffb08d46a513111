//! One body anywhere near coils, by the model that holds there: its multipoles where all wire lies outside the sphere
//! around it, edge elements where some does not.

use crate::array::CoilArray;
use crate::edge::{Material, Order, Shape, Source, SymmetricBody};
use crate::error::MitError;
use crate::polarizability::Polarizability;
use crate::sphere::skin_depth_m;
use crate::vector::{Complex, scaled};

/// The model that a body's change was computed by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyModel {
    /// By [`Polarizability::change_h`]: microseconds.
    Multipoles,
    /// By edge elements of second order on a mesh of its own: seconds.
    EdgeElements,
}

/// Changes of mutual inductance, henries, of all pairs of an array by one body with its middle at `centre_m`, and how
/// they were computed. `body` is the body's tau at this frequency, of [`crate::edge::body_tau`]; where wire reaches
/// into the sphere around it, the body is solved anew as `shape` and `material` say.
///
/// # Errors
/// Materials, sizes or frequencies that make no sense. Wire inside the body itself is for the caller to exclude.
pub fn body_changes_h(
    array: &CoilArray,
    body: &Polarizability,
    (shape, material): (&Shape, &Material),
    centre_m: [f64; 3],
    frequency_hz: f64,
) -> Result<(Vec<Complex>, BodyModel), MitError> {
    if array.coils().iter().all(|coil| coil.distance_m(centre_m) > body.radius_m) {
        return Ok((body.changes_h(array, centre_m), BodyModel::Multipoles));
    }
    let depth_m = skin_depth_m(material.conductivity_s_per_m, material.relative_permeability, frequency_hz)?;
    let mesh = shape.mesh(&shape.grading(depth_m))?.octant()?;
    let system = SymmetricBody::new(&mesh, &[*material], frequency_hz, Order::Second)?;
    let coils: Vec<_> = array.coils().iter().map(|coil| coil.clone().moved(scaled(centre_m, -1.0))).collect();
    let sources: Vec<&dyn Source> = coils.iter().map(|coil| coil as &dyn Source).collect();
    let changes = system.changes_h(&sources)?;
    Ok((array.pairs().iter().map(|&[m, n]| changes[m * coils.len() + n]).collect(), BodyModel::EdgeElements))
}
