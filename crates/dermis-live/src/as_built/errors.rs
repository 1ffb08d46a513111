//! Errors of touches that remain on a skin whose errors are known only with a covariance.

use dermis_tomo::mesh::Outline;
use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use super::spots::{LOAD, PARAMETERS, RADIUS};
use crate::stages::workshop_error::WorkshopError;

/// Approximate number of positions at which errors are tabulated.
const PLACES: f64 = 120.0;
/// Prior standard deviation of the logarithm of the radius.
pub(crate) const RADIUS_UNKNOWN: f64 = 0.5;

/// A grid of positions inside the outline, and their spacing.
pub(crate) fn places(outline: &Outline) -> (Vec<[f64; 2]>, f64) {
    let (low, high) = outline.bounds_m();
    let spacing_m = (outline.area_m2() / PLACES).sqrt();
    let count = |axis: usize| ((high[axis] - low[axis]) / spacing_m).ceil().max(1.0) as usize;
    let at = |axis: usize, k: usize| low[axis] + (k as f64 + 0.5) * (high[axis] - low[axis]) / count(axis) as f64;
    let all = (0..count(1)).flat_map(|row| (0..count(0)).map(move |column| [column, row]));
    let places =
        all.map(|[column, row]| [at(0, column), at(1, row)]).filter(|place| outline.contains(*place)).collect();
    (places, spacing_m)
}

/// Tabulates errors. `responses` has [`PARAMETERS`] columns per position: a spot of load 1 and its derivatives, in
/// volts. `changes(place)` is the change of the spot's response there by each independent error (columns), of
/// deviation 1. `uniform` is the response to a uniform change. `law` is the variance of the relative load by the
/// contact law.
pub(crate) fn error_table(
    (places_m, spacing_m): (Vec<[f64; 2]>, f64),
    responses: MatRef<'_, f64>,
    uniform: &[f64],
    law: f64,
    changes: impl Fn(usize) -> Mat<f64> + Sync,
) -> WorkshopError {
    let squares = (0..places_m.len())
        .map(|place| {
            let changes = changes(place);
            let channels = changes.nrows();
            let first = PARAMETERS * place;
            let derivatives = Mat::from_fn(channels, PARAMETERS + 1, |c, k| {
                if k < PARAMETERS { responses[(c, first + k)] } else { uniform[c] }
            });
            apparent(&derivatives, &changes)
        })
        .collect();
    WorkshopError { places_m, spacing_m, squares, misfit_2: 1.0, law }
}

/// Variances of x^2, x y, y^2 (m^2) and of the relative strength that the changes make in a fit with these derivatives,
/// and the share of the energy that remains.
fn apparent(derivatives: &Mat<f64>, changes: &Mat<f64>) -> [f64; 5] {
    let channels = changes.nrows().max(1) as f64;
    let mut normal = derivatives.transpose() * derivatives;
    normal[(RADIUS, RADIUS)] += changes.squared_norm_l2() / channels / (RADIUS_UNKNOWN * RADIUS_UNKNOWN);
    let size = normal.nrows();
    // Scale the columns, whose units differ widely.
    let units: Vec<f64> = (0..size).map(|k| normal[(k, k)].sqrt().max(f64::MIN_POSITIVE)).collect();
    let scaled = Mat::from_fn(size, size, |a, b| normal[(a, b)] / (units[a] * units[b]));
    let Ok(factor) = scaled.llt(Side::Lower) else { return [0.0; 5] };
    let right = derivatives.transpose() * changes;
    let right = Mat::from_fn(size, right.ncols(), |a, b| right[(a, b)] / units[a]);
    let solved = factor.solve(&right);
    let found = Mat::from_fn(size, solved.ncols(), |a, b| solved[(a, b)] / units[a]);
    let product = |a: usize, b: usize| (0..found.ncols()).map(|k| found[(a, k)] * found[(b, k)]).sum::<f64>();
    let left = changes - derivatives * &found;
    let share = left.squared_norm_l2() / derivatives.col(LOAD).squared_norm_l2().max(f64::MIN_POSITIVE);
    let strength = product(LOAD, LOAD) + 4.0 * product(LOAD, RADIUS) + 4.0 * product(RADIUS, RADIUS);
    [product(0, 0), product(0, 1), product(1, 1), strength, share]
}
