//! Deviation of each channel from its prediction by the others: `e_c = (Q dv)_c / Q_cc` with
//! `Q = (J P J' + lambda^2 W^-1)^-1`, the inverse covariance of difference data under prior and noise. It equals
//! `dv_c` minus its conditional mean given all other channels (Rue and Held, Gaussian Markov Random Fields, 2005, eq.
//! 2.5 and 2.6), the leave-one-out residual of the linear model, and costs one product with a channels x channels
//! matrix.

use faer::{Mat, MatRef};
use pulp::Arch;

use super::{DataPrecision, Operator};

/// The leave-one-out residuals of an operator, computed frame by frame.
#[derive(Clone, Debug)]
pub struct LeaveOneOutResidual {
    /// `Q_cj / Q_cc`, column by column.
    matrix: Vec<f32>,
    channels: usize,
    sums: Vec<f32>,
}

impl LeaveOneOutResidual {
    /// Builds the residuals from the operator with all channels. `None` if the operator does not store Q (more
    /// channels than unknowns), which would be the largest matrix of all.
    pub fn new(operator: &Operator) -> Option<Self> {
        let precision: MatRef<'_, f64> = match &operator.data_precision {
            DataPrecision::Whole(matrix) => matrix.as_ref(),
            DataPrecision::Implied { .. } => return None,
        };
        let channels = precision.nrows();
        let entry = |column: usize, row: usize| (precision[(row, column)] / precision[(row, row)]) as f32;
        let matrix = (0..channels * channels).map(|k| entry(k / channels.max(1), k % channels.max(1))).collect();
        Some(Self { matrix, channels, sums: vec![0.0; channels] })
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Writes the residuals of a difference frame. All values must be finite; missing channels must be filled in, and
    /// their residuals come out as 0. Both slices must have one value per channel. Allocates nothing.
    pub fn of(&mut self, difference: &[f64], residuals: &mut [f64]) {
        self.sums.fill(0.0);
        Arch::new().dispatch(|| {
            for (column, value) in self.matrix.chunks_exact(self.channels.max(1)).zip(difference) {
                let value = *value as f32;
                self.sums.iter_mut().zip(column).for_each(|(sum, entry)| *sum += entry * value);
            }
        });
        residuals.iter_mut().zip(&self.sums).for_each(|(residual, sum)| *residual = f64::from(*sum));
    }

    /// Standard deviation of each residual, given the noise standard deviation of each channel.
    pub fn deviations(&self, noise: &[f64]) -> Vec<f64> {
        let scaled = Mat::from_fn(self.channels, self.channels.min(noise.len()), |row, column| {
            f64::from(self.matrix[column * self.channels + row]) * noise[column]
        });
        scaled.row_iter().map(|row| row.norm_l2()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inverse::{LinearProblem, MissingChannels, PriorMatrix, Weighting};

    #[test]
    fn a_residual_is_what_filling_in_the_channel_would_change() {
        let jacobian =
            Mat::from_fn(20, 30, |row, column| ((row * 7 + column * column * 3 + row * column) as f64).sin());
        let weights = Weighting::Diagonal((0..20).map(|k| 1.0 + f64::from(k)).collect());
        let prior = PriorMatrix::Diagonal((1..31).map(f64::from).collect());
        let operator = LinearProblem::new(jacobian.as_ref(), weights, prior).unwrap().operator(0.7).unwrap();
        let frame: Vec<f64> = (0..20).map(|k| (f64::from(k) * 1.3).cos()).collect();
        let mut residuals = vec![0.0; 20];
        let mut unexplained = LeaveOneOutResidual::new(&operator).unwrap();
        unexplained.of(&frame, &mut residuals);
        for channel in [0_u32, 7, 19] {
            let mut filled = frame.clone();
            MissingChannels::new(&operator, &[channel]).unwrap().fill_in(&mut filled);
            let expected = frame[channel as usize] - filled[channel as usize];
            // Single-precision sums of a few hundred terms.
            let found = residuals[channel as usize];
            assert!((found - expected).abs() < 1e-4 * expected.abs().max(1.0), "{channel}: {found} {expected}");
        }
        // With noise on channel 3 alone, its residual has that deviation and channel 4's has its share of it.
        let mut noise = vec![0.0; 20];
        noise[3] = 2.0;
        let deviations = unexplained.deviations(&noise);
        let mut unit = vec![0.0; 20];
        unit[3] = 2.0;
        unexplained.of(&unit, &mut residuals);
        assert!((deviations[3] - 2.0).abs() < 1e-6);
        assert!((deviations[4] - residuals[4].abs()).abs() < 1e-5);
    }

    #[test]
    fn an_operator_that_would_lose_precision_is_refused() {
        let jacobian = Mat::from_fn(12, 5, |row, column| ((row * 7 + column * 3) as f64).sin());
        let prior = PriorMatrix::Diagonal(vec![1.0; 5]);
        let problem = LinearProblem::new(jacobian.as_ref(), Weighting::Identity, prior).unwrap();
        assert!(LeaveOneOutResidual::new(&problem.operator(1.0).unwrap()).is_none());
    }
}
