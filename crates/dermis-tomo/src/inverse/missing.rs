//! Going on without some channels, without rebuilding the operator. With `S = J P J' + lambda^2 W^-1` and `S^-1` kept,
//! the operator without the channels M equals the full one applied to a frame whose missing values are replaced by
//! their conditional expectation, `dv_M = -((S^-1)_MM)^-1 (S^-1)_Mr dv_r` (block inversion of S). Only the small
//! matrix `(S^-1)_MM` is factored.

use faer::{Mat, Side, linalg::solvers::Solve};

use super::{InverseError, Operator};

/// Fills missing channels of difference frames so that the full operator gives the image without them.
#[derive(Clone, Debug)]
pub struct MissingChannels {
    missing: Vec<u32>,
    /// missing x channels; columns of missing channels are zero.
    fill: Mat<f64>,
}

impl MissingChannels {
    /// Prepares the filling for a set of missing channels, in any order, repetitions allowed.
    ///
    /// # Errors
    /// A channel that does not exist, all channels missing, or a numerically singular block.
    pub fn new(operator: &Operator, missing: &[u32]) -> Result<Self, InverseError> {
        let channels = operator.data_precision.nrows();
        let mut missing = missing.to_vec();
        missing.sort_unstable();
        missing.dedup();
        if let Some(&channel) = missing.iter().find(|&&channel| channel as usize >= channels) {
            return Err(InverseError::Size { what: "missing channel index", expected: channels, got: channel as usize });
        }
        if missing.len() == channels {
            return Err(InverseError::NoChannels { channels });
        }
        let precision = &operator.data_precision;
        let at = |k: usize| missing[k] as usize;
        let block = Mat::from_fn(missing.len(), missing.len(), |row, column| precision[(at(row), at(column))]);
        let mut fill = Mat::from_fn(missing.len(), channels, |row, column| -precision[(at(row), column)]);
        for &channel in &missing {
            fill.col_mut(channel as usize).fill(0.0);
        }
        if !missing.is_empty() {
            let factor = block.llt(Side::Lower).map_err(|_| InverseError::Singular {
                what: "the block of the missing channels",
                hint: "raise the hyperparameter",
            })?;
            fill = factor.solve(&fill);
        }
        Ok(Self { missing, fill })
    }

    /// The missing channels, sorted.
    pub fn channels(&self) -> &[u32] {
        &self.missing
    }

    /// Replaces the missing values of a difference frame; the others must be finite.
    pub fn fill_in(&self, frame: &mut [f64]) {
        for &channel in &self.missing {
            frame[channel as usize] = 0.0;
        }
        // Column by column, as the matrix is stored; the columns of the missing channels are zero, so that what is
        // written back does not depend on the order.
        let mut filled = [0.0; 64];
        for (chunk_index, chunk) in self.missing.chunks(filled.len()).enumerate() {
            let first = chunk_index * filled.len();
            let sums = &mut filled[..chunk.len()];
            sums.fill(0.0);
            for (column, &value) in frame.iter().enumerate() {
                if value != 0.0 && !self.is_missing(column) {
                    for (row, sum) in sums.iter_mut().enumerate() {
                        *sum += self.fill[(first + row, column)] * value;
                    }
                }
            }
            for (channel, sum) in chunk.iter().zip(sums.iter()) {
                frame[*channel as usize] = *sum;
            }
        }
    }

    fn is_missing(&self, channel: usize) -> bool {
        self.missing.binary_search(&(channel as u32)).is_ok()
    }
}
