//! The covariance between channels: the covariance of the regression's residuals, shrunk to its diagonal and combined
//! with a prior from another skin of the family.

use faer::{Mat, Side};

use super::error::LocatorError;

/// Prior on the covariance between channels from another skin of the family, in the coordinates of the regression:
/// the mode of an inverse Wishart prior worth `examples` pokes. Only its shape matters, not its scale.
#[derive(Debug, Clone)]
pub(super) struct ChannelPrior {
    pub covariance: Mat<f64>,
    pub examples: f64,
}

/// Cholesky factor of the residual covariance between channels, shrunk to its diagonal, with `least` added to the
/// diagonal.
pub(super) fn channel_factor(
    residual: &Mat<f64>,
    alpha: &Mat<f64>,
    shrinkage: f64,
    least: f64,
    prior: Option<&ChannelPrior>,
) -> Result<Mat<f64>, LocatorError> {
    let (n, c) = (residual.nrows() as f64, residual.ncols());
    let sample = residual.transpose() * alpha;
    let trace: f64 = (0..c).map(|k| sample[(k, k)]).sum::<f64>() / n;
    let floor = 1e-3 * trace / c as f64;
    let prior_trace = prior.map_or(0.0, |p| (0..c).map(|k| p.covariance[(k, k)]).sum::<f64>());
    let prior = prior.filter(|_| prior_trace > 0.0);
    let worth = prior.map_or(0.0, |p| p.examples);
    let covariance = Mat::from_fn(c, c, |i, j| {
        let expected = prior.map_or(0.0, |p| p.covariance[(i, j)] * worth * trace / prior_trace);
        let value = ((sample[(i, j)] + sample[(j, i)]) * 0.5 + expected) / (n + worth);
        if i == j { value + shrinkage * floor + least } else { (1.0 - shrinkage) * value }
    });
    let what = "covariance between channels";
    Ok(covariance.llt(Side::Lower).map_err(|_| LocatorError::Singular { what })?.L().to_owned())
}
