//! Operation without some channels, without rebuilding the operator. With `S = J P J' + lambda^2 W^-1` and its stored
//! inverse, the operator without the channels M equals the full operator applied to a frame whose missing values are
//! replaced by their conditional expectation, `dv_M = -((S^-1)_MM)^-1 (S^-1)_Mr dv_r` (block inversion of S). Only
//! the small matrix `(S^-1)_MM` is factored.

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::{Llt, Solve};
use faer::{Accum, Mat, Par, Side};

use super::{InverseError, Operator};

/// Ridges to try in turn on the diagonal, as shares of the largest entry.
const RIDGES: [f64; 6] = [0.0, 1e-13, 1e-10, 1e-7, 1e-4, 1e-1];
/// Number of operator rows processed at a time.
const ROWS_AT_ONCE: usize = 64;

/// Fills in missing channels of difference frames so that the full operator gives the image without them.
#[derive(Clone, Debug)]
pub struct MissingChannels {
    missing: Vec<u32>,
    present: Vec<u32>,
    /// Missing x present channels.
    fill: Mat<f64>,
}

impl MissingChannels {
    /// Prepares a set of missing channels, in any order, with repetitions allowed. The cost is that of factoring a
    /// matrix of the missing channels and solving it for the present ones, so it never exceeds the cost of the full
    /// operator.
    ///
    /// # Errors
    /// A channel that does not exist, all channels missing, or a numerically singular block.
    pub fn new(operator: &Operator, missing: &[u32]) -> Result<Self, InverseError> {
        let channels = operator.matrix.ncols();
        let mut missing = missing.to_vec();
        missing.sort_unstable();
        missing.dedup();
        if let Some(&channel) = missing.iter().find(|&&channel| channel as usize >= channels) {
            return Err(InverseError::Size {
                what: "missing channel index",
                expected: channels,
                got: channel as usize,
            });
        }
        if missing.len() == channels {
            return Err(InverseError::NoChannels { channels });
        }
        let present: Vec<u32> = (0..channels as u32).filter(|c| missing.binary_search(c).is_err()).collect();
        let precision = operator.precision_rows(&missing);
        let entry = |row: usize, channel: u32| precision[(row, channel as usize)];
        let block = Mat::from_fn(missing.len(), missing.len(), |row, column| entry(row, missing[column]));
        let mut fill = Mat::from_fn(missing.len(), present.len(), |row, column| -entry(row, present[column]));
        if !missing.is_empty() {
            factor(block)?.solve_in_place(&mut fill);
        }
        Ok(Self { missing, present, fill })
    }

    /// The missing channels, sorted.
    pub fn channels(&self) -> &[u32] {
        &self.missing
    }

    /// Standard deviation of each unknown in the image without these channels, given the noise standard deviation of
    /// each channel: that of `X_r + X_M F`, where F fills in the missing channels.
    pub fn noise_deviation(&self, operator: &Operator, noise: &[f64]) -> Vec<f32> {
        let matrix = &operator.matrix;
        // Single precision suffices for noise, and takes half the time. Process a block of rows at a time, so that
        // freshly written values are still in the cache when read.
        let fill = Mat::from_fn(self.missing.len(), self.present.len(), |row, column| self.fill[(row, column)] as f32);
        let mut deviation = Vec::with_capacity(matrix.nrows());
        let mut block = Mat::zeros(ROWS_AT_ONCE, self.present.len());
        let mut missing = Mat::zeros(ROWS_AT_ONCE, self.missing.len());
        for start in (0..matrix.nrows()).step_by(ROWS_AT_ONCE) {
            let rows = ROWS_AT_ONCE.min(matrix.nrows() - start);
            let take = |to: &mut Mat<f32>, channels: &[u32]| {
                for (column, &channel) in channels.iter().enumerate() {
                    let from = &matrix.col_as_slice(channel as usize)[start..start + rows];
                    to.col_as_slice_mut(column).iter_mut().zip(from).for_each(|(to, from)| *to = *from as f32);
                }
            };
            take(&mut block, &self.present);
            take(&mut missing, &self.missing);
            matmul(&mut block, Accum::Add, &missing, &fill, 1.0, Par::Seq);
            let mut variance = [0.0; ROWS_AT_ONCE];
            for (column, &channel) in block.col_iter().zip(&self.present) {
                let sigma = noise[channel as usize] as f32;
                variance.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += (value * sigma).powi(2));
            }
            deviation.extend(variance[..rows].iter().map(|sum: &f32| sum.sqrt()));
        }
        deviation
    }

    /// Fills in the missing values of a difference frame; the other values must be finite.
    pub fn fill_in(&self, frame: &mut [f64]) {
        for &channel in &self.missing {
            frame[channel as usize] = 0.0;
        }
        // Column by column, as the matrix is stored.
        for (column, &channel) in self.present.iter().enumerate() {
            let value = frame[channel as usize];
            for (&target, &weight) in self.missing.iter().zip(self.fill.col(column).iter()) {
                frame[target as usize] += weight * value;
            }
        }
    }
}

/// Factors a block of S^-1. S^-1 is positive definite, but if the hyperparameter is so small that S can hardly be
/// inverted, rounding may hide that. Then the smallest sufficient ridge is added to the diagonal.
fn factor(mut block: Mat<f64>) -> Result<Llt<f64>, InverseError> {
    let largest = (0..block.nrows()).map(|row| block[(row, row)].abs()).fold(0.0, f64::max);
    for share in RIDGES {
        (0..block.nrows()).for_each(|row| block[(row, row)] += share * largest);
        if let Ok(factor) = block.llt(Side::Lower) {
            return Ok(factor);
        }
    }
    Err(InverseError::Singular { what: "the block of the missing channels", hint: "raise the hyperparameter" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inverse::{LinearProblem, PriorMatrix, Weighting};

    #[test]
    fn filling_in_gives_the_image_of_the_remaining_channels_however_many_are_missing() {
        let value = |row: usize, column: usize| ((row * 7 + column * column * 3 + row * column) as f64).sin();
        // Fewer unknowns than are processed at a time, and more.
        let jacobians = [9, ROWS_AT_ONCE + 9].map(|unknowns| Mat::from_fn(20, unknowns, value));
        // Independent noise per channel, and correlated noise.
        let shared = |share: f64| {
            Mat::from_fn(20, 20, |a, b| if a == b { 1.0 / (1.0 + a as f64) } else { share / (20.0 + (a + b) as f64) })
        };
        jacobians.iter().for_each(|jacobian| [0.0, 0.1].iter().for_each(|&share| check(jacobian, &shared(share))));
    }

    fn check(jacobian: &Mat<f64>, covariance: &Mat<f64>) {
        let weighting = |channels: &[usize]| {
            let block = Mat::from_fn(channels.len(), channels.len(), |a, b| covariance[(channels[a], channels[b])]);
            if covariance[(0, 1)] == 0.0 {
                Weighting::Diagonal((0..channels.len()).map(|k| 1.0 / block[(k, k)]).collect())
            } else {
                Weighting::from_covariance(block.as_ref()).unwrap()
            }
        };
        let unknowns = jacobian.ncols();
        let prior = || PriorMatrix::Diagonal((0..unknowns).map(|k| 1.0 + k as f64 % 9.0).collect());
        let full = LinearProblem::new(jacobian.as_ref(), weighting(&Vec::from_iter(0..20)), prior()).unwrap();
        let operator = full.operator(0.7).unwrap();
        let frame: Vec<f64> = (0..20).map(|k| (k as f64 * 1.3).cos()).collect();
        for count in [1, 10, 19] {
            // 7 and 20 are coprime, so the channels are distinct and scattered.
            let missing: Vec<u32> = (0..count).map(|k| (k * 7 % 20) as u32).collect();
            let mut filled = frame.clone();
            missing.iter().for_each(|&channel| filled[channel as usize] = f64::NAN);
            MissingChannels::new(&operator, &missing).unwrap().fill_in(&mut filled);
            let found = operator.apply(&filled).unwrap();
            let present: Vec<usize> = (0..20).filter(|&channel| !missing.contains(&(channel as u32))).collect();
            let rows = Mat::from_fn(present.len(), unknowns, |row, column| jacobian[(present[row], column)]);
            let some = weighting(&present);
            let data: Vec<f64> = present.iter().map(|&channel| frame[channel]).collect();
            let expected = LinearProblem::new(rows.as_ref(), some, prior()).unwrap().operator(0.7).unwrap();
            for (a, b) in found.iter().zip(expected.apply(&data).unwrap()) {
                assert!((a - b).abs() < 1e-10, "{count} missing: {a} {b}");
            }
            let noise: Vec<f64> = (0..20).map(|k| 0.1 + 0.01 * k as f64).collect();
            let left = MissingChannels::new(&operator, &missing).unwrap().noise_deviation(&operator, &noise);
            for (row, found) in left.iter().enumerate() {
                let variance = |(k, c): (usize, &usize)| (expected.matrix[(row, k)] * noise[*c]).powi(2);
                let expected: f64 = present.iter().enumerate().map(variance).sum::<f64>().sqrt();
                // Single precision, and some cancellation.
                assert!((f64::from(*found) - expected).abs() < 1e-5 * expected, "{count} missing: {found} {expected}");
            }
        }
    }

    #[test]
    fn channels_can_be_missing_however_small_the_hyperparameter_is() {
        // More channels than unknowns: without a hyperparameter, S has no inverse.
        let jacobian = Mat::from_fn(20, 9, |row, column| ((row * 7 + column * column * 3 + row * column) as f64).sin());
        let prior = PriorMatrix::Diagonal(vec![1.0; 9]);
        let problem = LinearProblem::new(jacobian.as_ref(), Weighting::Identity, prior).unwrap();
        for lambda in [1e-6, 1e-7, 1e-8, 1e-9, 1e-12] {
            let Ok(operator) = problem.operator(lambda) else { continue };
            for missing in [&[3_u32][..], &[0, 1, 2, 3, 4, 5, 6], &[1, 3, 5, 7, 9, 11, 13, 15, 17, 19]] {
                let missing = MissingChannels::new(&operator, missing).unwrap();
                let mut frame = vec![1.0; 20];
                missing.fill_in(&mut frame);
                assert!(frame.iter().all(|value| value.is_finite()), "{lambda:e}: {frame:?}");
            }
        }
    }
}
