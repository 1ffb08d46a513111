//! A Jacobian measured by poking: difference frames at known positions, interpolated over the image grid channel by
//! channel with Gaussian kernel ridge regression, `j(x) = k(x)' (K + eta I)^-1 D` with
//! `K_ij = exp(-|x_i - x_j|^2 / 2 l^2)`. Far from all pokes it tends to zero, so nothing is made up where the skin
//! was never touched.

use faer::{Mat, Side, linalg::solvers::Solve};

use super::{InverseError, check_finite};
use crate::eit::Jacobian;
use crate::mesh::Point;

/// Relative noise variance of the interpolation.
const NOISE: f64 = 0.05;

/// A measured Jacobian, and how well it predicts left-out pokes.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredJacobian {
    /// Channels x positions.
    pub jacobian: Jacobian,
    /// Correlation length chosen, metres.
    pub length_m: f64,
    /// RMS error of a left-out poke's frame predicted from the others, relative to its size.
    pub leave_one_out: f64,
}

impl MeasuredJacobian {
    /// Interpolates `frames` (one per poke, each divided by its load) measured at `pokes_m` to `targets_m`. The
    /// correlation length is the one in `lengths_m` with the smallest closed-form leave-one-out error.
    ///
    /// # Errors
    /// Fewer than 3 pokes, lists of different length, frames of different length, or non-finite values.
    pub fn interpolate(
        frames: &[Vec<f64>],
        pokes_m: &[Point],
        targets_m: &[Point],
        lengths_m: &[f64],
    ) -> Result<Self, InverseError> {
        let (pokes, channels) = (frames.len(), frames.first().map_or(0, Vec::len));
        if pokes < 3 || lengths_m.is_empty() {
            return Err(InverseError::Size {
                what: "pokes for a measured Jacobian (at least)",
                expected: 3,
                got: pokes,
            });
        }
        if pokes_m.len() != pokes {
            return Err(InverseError::Size { what: "positions of pokes", expected: pokes, got: pokes_m.len() });
        }
        for frame in frames {
            if frame.len() != channels {
                return Err(InverseError::Size { what: "channels of a poke", expected: channels, got: frame.len() });
            }
            check_finite("channel of a poke", frame)?;
        }
        let data = Mat::from_fn(pokes, channels, |poke, channel| frames[poke][channel]);
        let mut best: Option<(f64, f64, Mat<f64>)> = None;
        for &length in lengths_m {
            let (error, coefficients) = fit(&data, pokes_m, length)?;
            if best.as_ref().is_none_or(|best| error < best.0) {
                best = Some((error, length, coefficients));
            }
        }
        let (leave_one_out, length_m, coefficients) = match best {
            Some(best) => best,
            None => return Err(InverseError::Size { what: "lengths to choose from", expected: 1, got: 0 }),
        };
        let cross = Mat::from_fn(pokes, targets_m.len(), |p, t| kernel(pokes_m[p], targets_m[t], length_m));
        let product = coefficients.transpose() * &cross;
        let columns = targets_m.len();
        let values =
            (0..channels).flat_map(|c| (0..columns).map(move |t| (c, t))).map(|(c, t)| product[(c, t)]).collect();
        Ok(Self { jacobian: Jacobian { rows: channels, columns, values }, length_m, leave_one_out })
    }
}

fn kernel(a: Point, b: Point, length: f64) -> f64 {
    (-0.5 * ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)) / (length * length)).exp()
}

/// Leave-one-out error from `r_i = alpha_i / (K^-1)_ii`, and the coefficients alpha.
fn fit(data: &Mat<f64>, pokes_m: &[Point], length: f64) -> Result<(f64, Mat<f64>), InverseError> {
    let pokes = pokes_m.len();
    let gram =
        Mat::from_fn(pokes, pokes, |a, b| kernel(pokes_m[a], pokes_m[b], length) + if a == b { NOISE } else { 0.0 });
    let factor = gram.llt(Side::Lower).map_err(|_| InverseError::Singular {
        what: "the kernel matrix of the pokes",
        hint: "give a positive correlation length",
    })?;
    let inverse = factor.solve(Mat::<f64>::identity(pokes, pokes));
    let coefficients = factor.solve(data);
    let (mut error, mut size) = (0.0, 0.0);
    for channel in 0..data.ncols() {
        for poke in 0..pokes {
            error += (coefficients[(poke, channel)] / inverse[(poke, poke)]).powi(2);
            size += data[(poke, channel)].powi(2);
        }
    }
    Ok(((error / size.max(f64::MIN_POSITIVE)).sqrt(), coefficients))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_field_is_recovered_between_pokes() {
        let field = |p: Point| vec![(20.0 * p[0]).sin() + 0.5, (15.0 * p[1]).cos() - 20.0 * p[0] * p[1]];
        let pokes: Vec<Point> = (0..64).map(|k| [(k % 8) as f64 * 0.02 - 0.07, (k / 8) as f64 * 0.02 - 0.07]).collect();
        let frames: Vec<Vec<f64>> = pokes.iter().map(|p| field(*p)).collect();
        let targets = [[0.003, -0.014], [0.031, 0.027], [-0.045, 0.012]];
        let measured = MeasuredJacobian::interpolate(&frames, &pokes, &targets, &[0.02, 0.04, 0.08]).unwrap();
        for (t, target) in targets.iter().enumerate() {
            for (c, expected) in field(*target).into_iter().enumerate() {
                // The ridge of 0.05 shrinks the field by a few percent where pokes are sparse.
                assert!((measured.jacobian.row(c)[t] - expected).abs() < 0.08, "{c} {t}");
            }
        }
        assert!(measured.leave_one_out < 0.2, "{}", measured.leave_one_out);
    }

    #[test]
    fn too_few_pokes_are_refused() {
        let error = MeasuredJacobian::interpolate(&[vec![1.0]], &[[0.0, 0.0]], &[[0.0, 0.0]], &[0.01]).unwrap_err();
        assert_eq!(error.to_string(), "pokes for a measured Jacobian (at least): expected 3, got 1");
    }
}
