//! Frames as a matrix, their match with the templates, and the signs of their channels.

use faer::{Mat, MatRef, Side};

use super::super::InverseError;

/// Minimum number of calibration frames. With 20, position errors are about a third larger than with hundreds; with
/// 10 they can double.
pub const LEAST_CALIBRATION_FRAMES: usize = 20;

const SIGN_ITERATIONS: usize = 30;

pub(super) struct Peak {
    pub(super) place: usize,
    pub(super) score: f64,
    pub(super) amplitude: f64,
}

impl Peak {
    pub(super) fn of(scores: &Mat<f64>, norms: &Norms, frame: usize) -> Self {
        let column = scores.col(frame);
        let better = |best: usize, place: usize| if column[place] > column[best] { place } else { best };
        let place = (0..column.nrows()).fold(0, better);
        let template = norms.place(place, frame);
        let amplitude = if template > 0.0 { column[place] * norms.frame[frame] / template } else { 0.0 };
        Self { place, score: column[place], amplitude }
    }
}

pub(super) struct Norms {
    /// Squared norms of the weighted templates, places x frames, or one column for all frames.
    pub(super) template: Mat<f64>,
    /// Norms of the weighted frames.
    pub(super) frame: Vec<f64>,
}

impl Norms {
    pub(super) fn place(&self, place: usize, frame: usize) -> f64 {
        self.template[(place, if self.template.ncols() == 1 { 0 } else { frame })].max(0.0).sqrt()
    }
}

/// Scaled frames as columns.
pub(super) struct Batch {
    /// Channels x frames, 0 where missing.
    pub(super) values: Mat<f64>,
    /// Channels x frames, 1 or 0.
    pub(super) present: Mat<f64>,
    pub(super) complete: bool,
}

impl Batch {
    pub(super) fn new<F: AsRef<[f64]>>(frames: &[F], scale: &[f64]) -> Self {
        let value = |channel: usize, frame: usize| frames[frame].as_ref()[channel];
        let present = Mat::from_fn(scale.len(), frames.len(), |c, f| f64::from(!value(c, f).is_nan()));
        let usable = |c: usize, f: usize| scale[c] > 0.0 && present[(c, f)] > 0.0;
        let values =
            Mat::from_fn(scale.len(), frames.len(), |c, f| if usable(c, f) { value(c, f) / scale[c] } else { 0.0 });
        let complete = present.col_iter().all(|column| column.iter().all(|&p| p > 0.0));
        Self { values, present, complete }
    }
}

pub(super) fn sign(value: f64) -> f64 {
    if value < 0.0 { -1.0 } else { 1.0 }
}

pub(super) fn check_not_infinite(frame: &[f64]) -> Result<(), InverseError> {
    match frame.iter().position(|value| value.is_infinite()) {
        Some(index) => {
            let (what, expected) = ("channel", "finite, or NaN where missing");
            Err(InverseError::Value { what, index: Some(index), value: frame[index], expected })
        }
        None => Ok(()),
    }
}

/// RMS of each channel over the frames that contain it; also checks the frames.
pub(super) fn channel_scale(frames: &[Vec<f64>], channels: usize) -> Result<Vec<f64>, InverseError> {
    let (mut sums, mut counts, mut useful) = (vec![0.0; channels], vec![0usize; channels], 0);
    for frame in frames {
        if frame.len() != channels {
            let (what, got) = ("channels of a calibration frame", frame.len());
            return Err(InverseError::Size { what, expected: channels, got });
        }
        check_not_infinite(frame)?;
        useful += usize::from(frame.iter().any(|value| value.abs() > 0.0));
        for (channel, value) in frame.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
            sums[channel] += value * value;
            counts[channel] += 1;
        }
    }
    if useful < LEAST_CALIBRATION_FRAMES {
        return Err(InverseError::TooFewFrames { needed: LEAST_CALIBRATION_FRAMES, useful, given: frames.len() });
    }
    Ok(sums.iter().zip(&counts).map(|(sum, &count)| (sum / count.max(1) as f64).sqrt()).collect())
}

pub(super) fn row_rms(matrix: MatRef<'_, f64>) -> Vec<f64> {
    let square = |row: faer::RowRef<'_, f64>| row.iter().map(|v| v * v).sum::<f64>();
    matrix.row_iter().map(|row| (square(row) / matrix.ncols() as f64).sqrt()).collect()
}

pub(super) fn scale_rows(matrix: MatRef<'_, f64>, factors: &[f64]) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |row, column| factors[row] * matrix[(row, column)])
}

/// Signs for which the templates (channels x places) agree best with the second moments of the data (channels x
/// frames).
pub(super) fn synchronised_signs(
    templates: MatRef<'_, f64>,
    data: MatRef<'_, f64>,
    voltages: &[f64],
) -> Result<Vec<f64>, InverseError> {
    let (observed, modelled) = (data * data.transpose(), templates * templates.transpose());
    let entries = data.ncols() as f64 * templates.ncols() as f64;
    let agreement = Mat::from_fn(observed.nrows(), observed.ncols(), |row, column| {
        let (low, high) = (row.max(column), row.min(column));
        if row == column { 0.0 } else { observed[(low, high)] * modelled[(low, high)] / entries }
    });
    let decomposition = agreement.self_adjoint_eigen(Side::Lower).map_err(|_| InverseError::Singular {
        what: "the agreement of channels (its eigenvectors were not found)",
        hint: "look for channels of vastly different scale",
    })?;
    // Eigenvalues are in ascending order.
    let leading = decomposition.U().col(agreement.ncols() - 1);
    let mut signs: Vec<f64> = leading.iter().map(|&component| sign(component)).collect();
    for _ in 0..SIGN_ITERATIONS {
        let next = &agreement * faer::ColRef::from_slice(&signs);
        signs = next.iter().map(|&component| sign(component)).collect();
    }
    let common = sign(signs.iter().zip(voltages).map(|(s, v)| s * v.abs()).sum());
    Ok(signs.into_iter().map(|s| common * s).collect())
}
