//! Evidence for one more press: the drop of the residual relative to its scale.
//!
//! For Gaussian errors, the log-likelihood ratio of k + 1 presses to k is half the drop of the weighted sum of
//! squares. Errors are more than noise; their scale is estimated from the residual of the fit with k + 1 presses, as
//! in the F test (Seber and Wild, Nonlinear Regression, 2003, section 5.3). Without a press, the errors are noise and
//! drift, which are independent between channels. Errors of a press's model are not: they come in about
//! [`MODEL_SHAPES`] shapes, so readings that share a shape count as one.

use crate::press::{Cost, MOST_MODEL_ERROR};

/// Number of independent shapes of the model error. On twins of gels, foams and liquids, a single press leaves up to
/// 0.003 of its energy, of which a further press can explain at most three quarters.
const MODEL_SHAPES: f64 = 16.0;
/// Excess of the mean square over 1 that pure noise may have: the uncertainty of noise estimated from 32 frames at
/// rest.
const NOISE_UNKNOWN: f64 = 0.3;

/// Thresholds on the evidence of a press, in standard deviations: the square root of twice the log-likelihood ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Threshold for a new press.
    pub begin: f64,
    /// Threshold for a press that was there in the last frame.
    pub hold: f64,
}

impl Evidence {
    /// Standard deviations by which `more` presses explain a frame better than `fewer`. `is_first` is true if `fewer`
    /// is no press.
    pub fn of(fewer: &Cost, more: &Cost, is_first: bool) -> f64 {
        let correlated = if is_first { 1.0 } else { Self::readings_per_shape(more) };
        let drop = (fewer.residual - more.residual) / Self::scale(more, correlated);
        drop.max(0.0).sqrt()
    }

    /// Inflation of the squared standard deviations by errors beyond the noise.
    fn scale(cost: &Cost, correlated: f64) -> f64 {
        1.0 + correlated * Self::beyond_noise(cost)
    }

    fn readings_per_shape(cost: &Cost) -> f64 {
        (cost.freedom / MODEL_SHAPES).max(1.0)
    }

    /// Mean square of the errors beyond the noise, from the fit's residual, but at least the known error of its
    /// model.
    fn beyond_noise(cost: &Cost) -> f64 {
        Self::left_beyond_noise(cost).max(cost.model_error / cost.freedom)
    }

    fn left_beyond_noise(cost: &Cost) -> f64 {
        (cost.residual / cost.freedom - 1.0 - NOISE_UNKNOWN).max(0.0)
    }

    /// Inflation of the squared standard deviations by what the fit has left, as if it were noise.
    pub(crate) fn left_scale(cost: &Cost) -> f64 {
        1.0 + Self::left_beyond_noise(cost)
    }

    /// Residual of a fit, with the part beyond the noise multiplied by the number of readings that share one shape of
    /// the model error.
    pub(crate) fn left_in_shapes(cost: &Cost) -> f64 {
        cost.freedom * (1.0 + Self::readings_per_shape(cost) * Self::left_beyond_noise(cost))
    }

    /// Further inflation for positions. The residual beyond the noise counts as correlated error of the model, up to
    /// what presses usually leave.
    pub(crate) fn place_scale(cost: &Cost) -> f64 {
        let by_model = Self::left_beyond_noise(cost).min(MOST_MODEL_ERROR * cost.model_error / cost.freedom);
        1.0 + (Self::readings_per_shape(cost) - 1.0) * by_model / Self::left_scale(cost)
    }

    /// How much more model errors weigh than the same number of independent errors.
    pub(crate) fn correlation(cost: &Cost) -> f64 {
        Self::model_scale(cost) / Self::scale(cost, 1.0)
    }

    /// Inflation of the squared standard deviations by errors of a press's model.
    pub(crate) fn model_scale(cost: &Cost) -> f64 {
        Self::scale(cost, Self::readings_per_shape(cost))
    }
}
