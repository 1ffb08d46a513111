//! Means, standard deviations and lines of numbers collected in an experiment.

use crate::error::{TouchError, require};

/// Checks that every value is finite.
pub(crate) fn require_finite(what: &'static str, values: &[f64]) -> Result<(), TouchError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(TouchError::NonFinite { what, index, value: values[index] }),
    }
}

/// Least-squares line `intercept + slope x`: (intercept, slope).
pub(crate) fn line(x: &[f64], y: &[f64]) -> Result<(f64, f64), TouchError> {
    let count = x.len() as f64;
    require(x.len() >= 2, "points of a line", count, "at least 2")?;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / count, y.iter().sum::<f64>() / count);
    let square: f64 = x.iter().map(|x| (x - mean_x).powi(2)).sum();
    require(square > 0.0, "spread of a line's abscissas", square, "above 0: they are all equal")?;
    let slope = x.iter().zip(y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / square;
    Ok((mean_y - slope * mean_x, slope))
}

/// Mean and sample standard deviation; the deviation of fewer than two values is NaN.
pub(crate) fn mean_std(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, if values.len() < 2 { f64::NAN } else { (square / (count - 1.0)).sqrt() })
}
