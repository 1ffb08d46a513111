//! The linear equations of a fit of presses on plates.

use dermis_tomo::least_squares::NormalEquations;

use super::model::{Made, PlateModel, SizePrior};
use super::pressure::{OF_PRESS, Pressed};
use super::weighing::Weighing;

/// Places of the logarithms of pressure and radius among the parameters of a press.
pub(super) const LOG_PRESSURE: usize = 2;
pub(super) const LOG_RADIUS: usize = 3;

/// Whitened derivatives of the channels with respect to the parameters of each press, one column after the other.
pub(super) fn whitened_columns(
    model: &PlateModel,
    weighing: &Weighing,
    presses: &[Pressed],
    contacts: &[Made],
) -> Vec<Vec<f64>> {
    let whitened = |column: &Vec<f64>| {
        let mut whitened = Vec::new();
        weighing.whitening.apply(column, &mut whitened);
        whitened
    };
    model.derivatives(presses, contacts).iter().map(whitened).collect()
}

/// The normal equations of these columns and a residual, with the prior of the presses.
pub(super) fn set_equations(
    columns: &[Vec<f64>],
    residual: &[f64],
    prior: &SizePrior,
    presses: &[Pressed],
    equations: &mut NormalEquations,
) {
    let n = columns.len();
    let NormalEquations { normal, right } = equations;
    for a in 0..n {
        right[a] = dot(&columns[a], residual);
        for b in 0..=a {
            let value = dot(&columns[a], &columns[b]);
            (normal[a * n + b], normal[b * n + a]) = (value, value);
        }
    }
    for (k, press) in presses.iter().enumerate() {
        let priors = [LOG_PRESSURE, LOG_RADIUS].into_iter().zip(prior.off(press)).zip(prior.deviations);
        for ((parameter, off), deviation) in priors {
            let at = OF_PRESS * k + parameter;
            normal[at * n + at] += deviation.powi(-2);
            right[at] -= off / deviation;
        }
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
