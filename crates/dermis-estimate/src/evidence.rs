//! Whether one more press is there: the drop of the residual over its scale.
//!
//! For Gaussian errors the logarithm of the likelihood ratio of k + 1 presses to k is half the drop of the weighted sum of
//! squares. Errors are not only the noise: what is left of the fit with k + 1 presses tells their scale, as in the F test
//! (Seber and Wild, Nonlinear Regression, 2003, section 5.3). Without a press, errors are noise and drift, which are
//! independent between channels. Errors of a press's own model are not: they come in about [`MODEL_SHAPES`] shapes, so
//! readings that share one count as one.

use crate::press::Cost;

/// Independent shapes of the model's errors. One press on twins of gels, foams and liquids leaves up to 0.003 of its
/// energy, of which a further press can explain at most three quarters.
const MODEL_SHAPES: f64 = 16.0;
/// What the mean square of pure noise may exceed 1 by, because 32 frames at rest tell it to that.
const NOISE_UNKNOWN: f64 = 0.3;

/// Thresholds on the evidence of a press, in standard deviations: the square root of twice the log-likelihood ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// For a new press.
    pub begin: f64,
    /// For one that was there in the last frame.
    pub hold: f64,
}

impl Evidence {
    /// Standard deviations by which `more` presses explain a frame better than `fewer`; `is_first` where `fewer` is
    /// none.
    pub fn of(fewer: &Cost, more: &Cost, is_first: bool) -> f64 {
        let correlated = if is_first { 1.0 } else { Self::readings_per_shape(more) };
        let drop = (fewer.residual - more.residual) / Self::scale(more, correlated);
        drop.max(0.0).sqrt()
    }

    /// What squared standard deviations are multiplied by for errors beyond the noise.
    fn scale(cost: &Cost, correlated: f64) -> f64 {
        1.0 + correlated * Self::beyond_noise(cost)
    }

    fn readings_per_shape(cost: &Cost) -> f64 {
        (cost.freedom / MODEL_SHAPES).max(1.0)
    }

    /// Mean square of the errors beyond the noise: what the fit leaves, and at least what its model is known to leave.
    fn beyond_noise(cost: &Cost) -> f64 {
        let left = cost.residual / cost.freedom - 1.0 - NOISE_UNKNOWN;
        left.max(cost.model_error / cost.freedom).max(0.0)
    }

    /// By how much errors of the model weigh more than as many independent ones.
    pub(crate) fn correlation(cost: &Cost) -> f64 {
        Self::model_scale(cost) / Self::scale(cost, 1.0)
    }

    /// The same for errors of a press's model.
    pub(crate) fn model_scale(cost: &Cost) -> f64 {
        Self::scale(cost, Self::readings_per_shape(cost))
    }
}
