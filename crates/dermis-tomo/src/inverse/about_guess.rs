//! Gauss-Newton about a guess. The prior's mean is the guess, and its standard deviations tell where the guess may be
//! wrong. The model is linearised at the guess, so the image corrects misinterpretations of a first image. A factor
//! common to all voltages is estimated as well, since the body's own conductivity may have changed since the
//! baseline.

use faer::{ColRef, Mat, Side, linalg::solvers::Solve};

use super::error::positive;
use super::nonlinear::{GaussNewton, NonlinearProblem, ReducedChannels, advance, log_jacobian, pivoted_cholesky};
use super::{InverseError, SmoothCovariance};

/// Prior belief about a frame's image.
#[derive(Clone, Copy, Debug)]
pub struct Guess<'a> {
    /// `log(sigma / sigma_rest)` of every inside pixel.
    pub log_conductivity: &'a [f64],
    /// Standard deviation of each.
    pub deviation: &'a [f64],
    /// Standard deviation of the logarithm of the factor common to all voltages.
    pub common_deviation: f64,
}

/// Correlations of the errors of a guess, as a factor with few columns.
#[derive(Clone, Debug)]
pub struct GuessCorrelations {
    factor: Mat<f64>,
}

impl GuessCorrelations {
    /// Correlations with unit variances up to the neglected share; a larger share is faster.
    ///
    /// # Errors
    /// Fails if the share is not positive, or if the correlation length is so short that the factor would have more
    /// than half as many columns as there are pixels.
    pub fn new(covariance: &SmoothCovariance, neglected: f64) -> Result<Self, InverseError> {
        positive("neglected share of the variance", neglected)?;
        let factor = pivoted_cholesky(covariance, neglected).ok_or(InverseError::Singular {
            what: "the factor of a guess's correlations",
            hint: "use a longer correlation length, or neglect more",
        })?;
        Ok(Self { factor })
    }
}

impl NonlinearProblem {
    /// `log(sigma / sigma_rest)` of every inside pixel, from one frame of difference data, about a guess.
    ///
    /// # Errors
    /// As [`NonlinearProblem::solve`]; also fails if the guess has the wrong size.
    pub fn solve_about(
        &self,
        parameters: &GaussNewton,
        channels: &ReducedChannels,
        dv: &[f64],
        guess: &Guess<'_>,
        correlations: &GuessCorrelations,
    ) -> Result<Vec<f64>, InverseError> {
        parameters.check()?;
        let pixels = self.map.inside_count();
        for (what, got) in [
            ("pixels of the guess", guess.log_conductivity.len()),
            ("deviations of the guess", guess.deviation.len()),
            ("correlations of the guess", correlations.factor.nrows()),
        ] {
            if got != pixels {
                return Err(InverseError::Size { what, expected: pixels, got });
            }
        }
        let rank = correlations.factor.ncols();
        let spread =
            Mat::from_fn(pixels, rank, |row, column| guess.deviation[row] * correlations.factor[(row, column)]);
        // The measured values: the data plus the voltages at rest.
        let measured = channels.data(dv)? + &channels.combine * ColRef::from_slice(&self.at_rest.transfers);
        let mut image = guess.log_conductivity.to_vec();
        let mut common = 0.0_f64;
        for _ in 0..parameters.steps {
            let conductivity = self.conductivity(&image);
            let solution = self.model.solve(&conductivity)?;
            let jacobian = log_jacobian(&solution.jacobian(), &self.map, &conductivity);
            let modelled = &channels.combine * ColRef::from_slice(&solution.voltages()) * faer::Scale(common.exp());
            let slope = &channels.combine * (jacobian.as_mat() * &spread) * faer::Scale(common.exp());
            let a = Mat::from_fn(slope.nrows(), rank + 1, |row, column| {
                if column < rank { slope[(row, column)] } else { guess.common_deviation * modelled[row] }
            });
            let moved: Vec<f64> = image.iter().zip(guess.log_conductivity).map(|(now, guess)| now - guess).collect();
            let of_moved = &channels.combine * (jacobian.as_mat() * ColRef::from_slice(&moved));
            let target = &measured - &modelled + of_moved * faer::Scale(common.exp()) + &modelled * faer::Scale(common);
            let mut system = a.transpose() * &a;
            for k in 0..=rank {
                system[(k, k)] += parameters.hyperparameter * parameters.hyperparameter;
            }
            let factor = system.llt(Side::Lower).map_err(|_| InverseError::Singular {
                what: "the system of a Gauss-Newton step about a guess",
                hint: "raise the hyperparameter",
            })?;
            let found = factor.solve(&(a.transpose() * &target));
            let change = &spread * found.subrows(0, rank);
            let next: Vec<f64> = guess.log_conductivity.iter().zip(change.iter()).map(|(guess, c)| guess + c).collect();
            let share = advance(&mut image, &next, parameters);
            common += share * (guess.common_deviation * found[rank] - common);
        }
        Ok(image)
    }
}
