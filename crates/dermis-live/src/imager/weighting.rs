//! The weights of channels and the prior of pixels for the operator, and whether either depends on measurements.

use dermis_skin::{HyperparameterChoice, WeightChoice};
use dermis_tomo::inverse::{PriorMatrix, Weighting};
use dermis_tomo::mesh::distance;
use faer::MatRef;

use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// True if neither weights nor hyperparameter depend on measurements, so that the operator can be built before any
/// exist.
pub fn operator_needs_no_baseline(prepared: &Prepared) -> bool {
    let rule = matches!(
        prepared.skin.imaging.hyperparameter,
        HyperparameterChoice::Number(_) | HyperparameterChoice::Relative(_) | HyperparameterChoice::NoiseFigure(_)
    );
    weights_need_no_baseline(prepared) && rule && prepared.skin.backend.circuit.is_none()
}

/// True if the weights, and with them the whole problem except its hyperparameter, follow from the skin file.
pub(crate) fn weights_need_no_baseline(prepared: &Prepared) -> bool {
    matches!(prepared.skin.imaging.weights, WeightChoice::Identity | WeightChoice::FloorAndShare { .. })
}

/// The weights according to the skin file, from this reference if they are measured.
pub(crate) fn weighting(prepared: &Prepared, reference: &Reference) -> Result<Weighting, Error> {
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    let from_variances = |variances: Vec<f64>| Weighting::Diagonal(variances.iter().map(|v| 1.0 / v).collect());
    Ok(match &prepared.skin.imaging.weights {
        WeightChoice::Identity => Weighting::Identity,
        WeightChoice::FloorAndShare { floor, share } => {
            let variance = |v: &f64| (floor * largest).powi(2) + (share * v).powi(2);
            from_variances(prepared.voltages.iter().map(variance).collect())
        }
        WeightChoice::Measured { floor } => {
            let variance = |sigma: &f64| sigma * sigma + (floor * largest).powi(2);
            from_variances(reference.noise.iter().map(variance).collect())
        }
        WeightChoice::MeasuredFull => match &reference.covariance {
            Some(matrix) => {
                let size = prepared.channels();
                Weighting::from_covariance(MatRef::from_row_major_slice(matrix, size, size))?
            }
            None => {
                return Err(Error::Frames {
                    what: "baseline for imaging.weights = \"measured-full\"".into(),
                    expected: "at least 16 frames without missing values".into(),
                    got: "fewer, or some values missing".into(),
                });
            }
        },
        WeightChoice::Reciprocity { floor } => {
            let volts: Vec<f64> = reference.baseline.iter().zip(&reference.scale).map(|(b, s)| b * s).collect();
            Weighting::from_reciprocity(&volts, &prepared.protocol.reciprocal_channels(), floor * largest)?
        }
    })
}

/// The prior according to the skin file. A prior that depends on the sensitivity of pixels gets the sensitivity of a
/// small spot per area: the pixel and its neighbours. A single pixel may be cut off by the rim or lie under an
/// electrode, where no channel is sensitive, and must not be allowed larger values because of that.
pub(crate) fn prior_matrix(prepared: &Prepared, weighting: &Weighting) -> Result<PriorMatrix, Error> {
    let (jacobian, areas) = (&prepared.jacobian, prepared.map.pixel_measures());
    let mut spot_areas = areas.to_vec();
    for &[a, b] in &prepared.basis.neighbours {
        let (a, b) = (a as usize, b as usize);
        spot_areas[a] += areas[b];
        spot_areas[b] += areas[a];
    }
    let pixel_area = prepared.map.grid().pixel_m.powi(2);
    let scale: Vec<f64> = spot_areas.iter().map(|area| pixel_area / area).collect();
    // One channel at a time, as the Jacobian is stored.
    let mut spots = vec![0.0; jacobian.values.len()];
    for channel in 0..jacobian.rows {
        let (row, spots) = (jacobian.row(channel), &mut spots[channel * jacobian.columns..][..jacobian.columns]);
        spots.copy_from_slice(row);
        for &[a, b] in &prepared.basis.neighbours {
            spots[a as usize] += row[b as usize];
            spots[b as usize] += row[a as usize];
        }
        spots.iter_mut().zip(&scale).for_each(|(value, scale)| *value *= scale);
    }
    let spots = MatRef::from_row_major_slice(&spots, jacobian.rows, jacobian.columns);
    Ok(prepared.prior().matrix(spots, weighting, &prepared.basis)?)
}

/// Difference data of a small touch at the centre of the skin, for the noise figure.
pub(crate) fn central_touch(prepared: &Prepared) -> Vec<f64> {
    let (low, high) = prepared.body.outline.bounds_m();
    let middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
    let radius = 0.05 * (high[0] - low[0]).min(high[1] - low[1]);
    let touched: Vec<bool> =
        prepared.basis.positions.iter().map(|p| distance([p[0], p[1]], middle) <= radius).collect();
    (0..prepared.channels())
        .map(|c| prepared.jacobian.row(c).iter().zip(&touched).map(|(j, t)| if *t { 0.1 * j } else { 0.0 }).sum())
        .collect()
}
