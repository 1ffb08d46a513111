//! W, the inverse noise covariance of the channels, stored as its square root so that data and Jacobian can be
//! whitened.

use faer::{Mat, MatMut, MatRef, Side};

use super::error::positive;
use super::{InverseError, check_finite};

/// Weight of each channel.
#[derive(Clone, Debug)]
pub enum Weighting {
    /// Equal weights.
    Identity,
    /// The diagonal of W: 1 / variance of each channel.
    Diagonal(Vec<f64>),
    /// Lower Cholesky factor of the full noise covariance.
    Full(Mat<f64>),
}

impl Weighting {
    /// Builds weights from the noise standard deviation of each channel. Channels without a finite, positive one get
    /// the largest of the others.
    ///
    /// # Errors
    /// No channel has a usable standard deviation.
    pub fn from_standard_deviations(deviations: &[f64]) -> Result<Self, InverseError> {
        let usable = |d: &f64| d.is_finite() && *d > 0.0;
        let largest = deviations.iter().copied().filter(usable).fold(0.0, f64::max);
        if largest == 0.0 {
            return Err(InverseError::Value {
                what: "noise standard deviation",
                index: None,
                value: largest,
                expected: "positive for at least one channel",
            });
        }
        let weights = deviations.iter().map(|d| if usable(d) { d.powi(-2) } else { largest.powi(-2) });
        Ok(Self::Diagonal(weights.collect()))
    }

    /// Builds weights from a full noise covariance (channels x channels).
    ///
    /// # Errors
    /// Not square, not finite, or not positive definite (shrink it towards its diagonal first).
    pub fn from_covariance(covariance: MatRef<'_, f64>) -> Result<Self, InverseError> {
        if covariance.nrows() != covariance.ncols() {
            return Err(InverseError::Size {
                what: "columns of the noise covariance",
                expected: covariance.nrows(),
                got: covariance.ncols(),
            });
        }
        for column in 0..covariance.ncols() {
            let values: Vec<f64> = covariance.col(column).iter().copied().collect();
            check_finite("noise covariance", &values)?;
        }
        let factor = covariance.llt(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the noise covariance",
            hint: "use more frames than channels, or shrink it toward its diagonal",
        })?;
        Ok(Self::Full(factor.L().to_owned()))
    }

    /// Builds weights from reciprocity: swapping drive and measurement must give the same transfer impedance, so the
    /// difference within such a pair shows the error of both channels. `partner[i]` holds the reciprocal channel of `i`
    /// and the factor that makes the two comparable (see `Protocol::reciprocal_channels`); channels without a partner
    /// get the median error. `floor` is the minimum standard deviation, in the unit of the voltages.
    ///
    /// # Errors
    /// Lists of different length, a floor that is not positive, or non-finite voltages.
    pub fn from_reciprocity(
        voltages: &[f64],
        partner: &[Option<(u32, f64)>],
        floor: f64,
    ) -> Result<Self, InverseError> {
        if voltages.len() != partner.len() {
            return Err(InverseError::Size {
                what: "reciprocal partners",
                expected: voltages.len(),
                got: partner.len(),
            });
        }
        positive("floor of the reciprocity error", floor)?;
        let error = |channel: usize| {
            let (other, ratio) = partner[channel]?;
            let difference = (voltages[channel] - ratio * voltages[other as usize]).abs();
            difference.is_finite().then_some((difference / std::f64::consts::SQRT_2).max(floor))
        };
        let errors: Vec<Option<f64>> = (0..voltages.len()).map(error).collect();
        let mut known: Vec<f64> = errors.iter().flatten().copied().collect();
        known.sort_by(f64::total_cmp);
        let median = known.get(known.len() / 2).copied().unwrap_or(floor);
        Self::from_standard_deviations(&errors.into_iter().map(|e| e.unwrap_or(median)).collect::<Vec<_>>())
    }

    /// Checks size and values.
    pub(super) fn check(&self, channels: usize) -> Result<(), InverseError> {
        let got = match self {
            Weighting::Identity => channels,
            Weighting::Diagonal(weights) => {
                check_finite("weight", weights)?;
                if let Some(index) = weights.iter().position(|w| *w < 0.0) {
                    let value = weights[index];
                    return Err(InverseError::Value {
                        what: "weight",
                        index: Some(index),
                        value,
                        expected: "zero or positive",
                    });
                }
                weights.len()
            }
            Weighting::Full(factor) => factor.nrows(),
        };
        if got == channels { Ok(()) } else { Err(InverseError::Size { what: "weights", expected: channels, got }) }
    }

    /// Square root of a channel's weight, if there is one weight per channel.
    pub(super) fn root(&self, channel: usize) -> f64 {
        match self {
            Weighting::Diagonal(weights) => weights[channel].sqrt(),
            _ => 1.0,
        }
    }

    /// `W^1/2 A` in place, where rows are channels.
    pub(super) fn whiten(&self, a: MatMut<'_, f64>) {
        match self {
            Weighting::Identity => {}
            Weighting::Diagonal(weights) => {
                // Channel by channel: rows are contiguous in the matrices passed here.
                for (row, weight) in a.row_iter_mut().zip(weights) {
                    let root = weight.sqrt();
                    row.iter_mut().for_each(|value| *value *= root);
                }
            }
            Weighting::Full(factor) => factor.solve_lower(a),
        }
    }

    /// `(W^1/2)' A` in place: the adjoint of [`Weighting::whiten`].
    pub(super) fn whiten_adjoint(&self, a: MatMut<'_, f64>) {
        match self {
            Weighting::Full(factor) => factor.solve_upper_of_transpose(a),
            _ => self.whiten(a),
        }
    }
}

trait Triangular {
    fn solve_lower(&self, a: MatMut<'_, f64>);
    fn solve_upper_of_transpose(&self, a: MatMut<'_, f64>);
}

impl Triangular for Mat<f64> {
    fn solve_lower(&self, a: MatMut<'_, f64>) {
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(self.as_ref(), a, faer::Par::Seq);
    }

    fn solve_upper_of_transpose(&self, a: MatMut<'_, f64>) {
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(self.transpose(), a, faer::Par::Seq);
    }
}
