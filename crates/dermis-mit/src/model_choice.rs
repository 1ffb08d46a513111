//! One body anywhere near coils, with the model that is valid there: its multipoles if all wire is outside the sphere
//! around it, edge elements otherwise.

use crate::array::CoilArray;
use crate::edge::{Material, Order, Shape, Source, SymmetricBody};
use crate::error::MitError;
use crate::polarizability::Polarizability;
use crate::sphere::skin_depth_m;
use crate::vector::{Complex, scaled};

/// The model used for a body's change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BodyModel {
    /// By [`Polarizability::change_h`]: microseconds.
    Multipoles,
    /// Second-order edge elements on their own mesh: seconds.
    EdgeElements,
}

/// Changes of mutual inductance of all pairs of an array due to one body centred at `centre_m`, henries, and the
/// model used. `body` is the body's tau at this frequency from [`crate::edge::body_tau`]; if wire reaches into the
/// sphere around it, the body is solved again with `shape` and `material`.
///
/// # Errors
/// Invalid materials, sizes or frequencies. The caller must exclude wire inside the body itself.
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
