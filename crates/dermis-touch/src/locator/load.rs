//! The load of a touch. The amplitude of a frame follows the load by a power law whose factor varies over the skin,
//! ln a = c0 + c1 ln F + g(x, y) + e, with g a Gaussian process. It is solved for F at the located position.

use faer::Mat;

use super::error::LocatorError;
use super::regression::{correlations, inverse_covariance};

/// Noise variances tried, relative to the variance of g; left-out examples choose.
const NOISE_RATIOS: [f64; 4] = [0.03, 0.1, 0.3, 1.0];

/// The fitted law over the map.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LoadLaw {
    /// c1: the exponent.
    pub exponent: f64,
    /// c0 + g at every map position.
    pub log_factor: Vec<f64>,
    /// Relative error of the load at left-out examples.
    pub relative_error: f64,
}

impl LoadLaw {
    /// Fits the law. `None` if the loads do not vary or the amplitude does not grow with them. `summary` reduces the
    /// errors of left-out examples to the relative error of the load.
    pub(super) fn fit(
        map: &[[f64; 2]],
        positions: &[[f64; 2]],
        amplitudes: &[f64],
        loads: &[f64],
        length_m: f64,
        summary: fn(&[f64]) -> f64,
    ) -> Result<Option<Self>, LocatorError> {
        let log_load: Vec<f64> = loads.iter().map(|v| v.ln()).collect();
        let log_amplitude: Vec<f64> = amplitudes.iter().map(|v| v.ln()).collect();
        let mean = log_load.iter().sum::<f64>() / log_load.len() as f64;
        if log_load.iter().all(|v| (v - mean).abs() < 1e-6) {
            return Ok(None);
        }
        let mut best: Option<Self> = None;
        for ratio in NOISE_RATIOS {
            let inverse = inverse_covariance(positions, &vec![ratio; loads.len()], length_m)?;
            let Some((trend, alpha)) = generalised_least_squares(&inverse, &log_load, &log_amplitude) else { continue };
            let left_out = alpha.iter().enumerate().map(|(i, a)| (a / inverse[(i, i)] / trend[1]).abs());
            let relative_error = summary(&left_out.collect::<Vec<_>>());
            if best.as_ref().is_none_or(|b| relative_error < b.relative_error) {
                let to_map = correlations(map, positions, length_m);
                let g = |p: usize| (0..alpha.len()).map(|i| to_map[(p, i)] * alpha[i]).sum::<f64>();
                let log_factor = (0..map.len()).map(|p| trend[0] + g(p)).collect();
                best = Some(Self { exponent: trend[1], log_factor, relative_error });
            }
        }
        Ok(best)
    }
}

/// RMS of values.
pub(super) fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Trend (c0, c1) by generalised least squares, and K^-1 times the residual. `None` unless the exponent exceeds zero
/// by two standard errors.
fn generalised_least_squares(inverse: &Mat<f64>, x: &[f64], y: &[f64]) -> Option<([f64; 2], Vec<f64>)> {
    let n = x.len();
    let apply = |v: &dyn Fn(usize) -> f64| -> Vec<f64> {
        (0..n).map(|i| (0..n).map(|j| inverse[(i, j)] * v(j)).sum()).collect()
    };
    let dot = |a: &[f64], b: &dyn Fn(usize) -> f64| (0..n).map(|i| a[i] * b(i)).sum::<f64>();
    let (k1, kx) = (apply(&|_| 1.0), apply(&|i| x[i]));
    let (s11, s1x, sxx) = (dot(&k1, &|_| 1.0), dot(&k1, &|i| x[i]), dot(&kx, &|i| x[i]));
    let (s1y, sxy) = (dot(&k1, &|i| y[i]), dot(&kx, &|i| y[i]));
    let determinant = s11 * sxx - s1x * s1x;
    if determinant <= 1e-12 * s11 * sxx {
        return None;
    }
    let slope = (s11 * sxy - s1x * s1y) / determinant;
    let trend = [(sxx * s1y - s1x * sxy) / determinant, slope];
    let rest = |i: usize| y[i] - trend[0] - trend[1] * x[i];
    let alpha = apply(&rest);
    let variance = dot(&alpha, &rest) / (n as f64 - 2.0).max(1.0);
    let standard_error = (variance * s11 / determinant).sqrt();
    (slope > 2.0 * standard_error).then_some((trend, alpha))
}
