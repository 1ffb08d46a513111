//! Offline images starting from a network's classification of a frame. Its probabilities give an initial conductivity
//! and its uncertainty. Gauss-Newton steps linearised there fit the part of the data that this guess leaves
//! unexplained ([`dermis_tomo::inverse::NonlinearProblem::solve_about`]).

use dermis_learn::scene::{LOWERED, RAISED};
use dermis_tomo::inverse::{GaussNewton, Guess, GuessCorrelations, SmoothCovariance};
use rayon::prelude::*;

use super::refine::{Refiner, absent};
use crate::Error;
use crate::prepare::Prepared;

/// Log conductivity contrast of regions that certainly conduct better or worse than the liquid: a factor of 20.
const CONTRAST: f64 = 3.0;
/// Minimum variance of a pixel's log conductivity, however certain the network is.
const LEAST_VARIANCE: f64 = 0.01;
/// Correlation length of the guess's error, as a share of half the skin's width, and the share of its variance that
/// the factor of the correlations may neglect.
const LENGTH: f64 = 0.1;
const NEGLECTED: f64 = 0.01;
/// Standard deviation of the log conductivity of the liquid between baseline and frame: it warms up, and objects
/// raise its level.
const COMMON_DEVIATION: f64 = 0.04;
/// Two steps; lambda sets how far weighted data may be from the model.
const STEPS: GaussNewton = GaussNewton { steps: 2, hyperparameter: 0.17, largest_step: 1.5, limit: 4.0 };

/// Refines frames starting from a network's probabilities.
#[derive(Debug)]
pub(crate) struct GuessRefiner {
    refiner: Refiner,
    correlations: GuessCorrelations,
}

impl GuessRefiner {
    /// Uses the problem of a refiner.
    ///
    /// # Errors
    /// Pixels too coarse for the correlations.
    pub(crate) fn new(prepared: &Prepared, refiner: Refiner) -> Result<Self, Error> {
        let length_m = LENGTH * prepared.half_width_m();
        let covariance = SmoothCovariance::new(&prepared.basis.positions, length_m, None)?;
        Ok(Self { refiner, correlations: GuessCorrelations::new(&covariance, NEGLECTED)? })
    }

    /// For each difference frame (model volts, `NaN` where missing) and its probabilities (classes x pixels), a
    /// row-major image of `log(sigma / sigma at rest)`, polarity included, 0 outside.
    ///
    /// # Errors
    /// As [`Refiner::images`].
    pub(crate) fn images(
        &mut self,
        differences: &[Vec<f64>],
        probabilities: &[Vec<f32>],
    ) -> Result<Vec<Vec<f32>>, Error> {
        self.refiner.reduce(differences)?;
        let refiner = &self.refiner;
        let image = |(frame, probabilities): (&Vec<f64>, &Vec<f32>)| {
            let (mean, deviation) = guess(probabilities, refiner.pixels, &refiner.inside);
            let guess = Guess { log_conductivity: &mean, deviation: &deviation, common_deviation: COMMON_DEVIATION };
            let channels = &refiner.reduced[&absent(frame)];
            let found = refiner.problem.solve_about(&STEPS, channels, frame, &guess, &self.correlations)?;
            let mut image = vec![0.0; refiner.pixels];
            for (&pixel, value) in refiner.inside.iter().zip(found) {
                image[pixel as usize] = (refiner.polarity * value) as f32;
            }
            Ok::<_, Error>(image)
        };
        differences.par_iter().zip(probabilities).map(image).collect()
    }
}

/// Mean and standard deviation of the log conductivity of inside pixels that have one of three values.
fn guess(probabilities: &[f32], pixels: usize, inside: &[u32]) -> (Vec<f64>, Vec<f64>) {
    let of_class = |class: u8, pixel: u32| f64::from(probabilities[usize::from(class) * pixels + pixel as usize]);
    inside
        .iter()
        .map(|&pixel| {
            let (lowered, raised) = (of_class(LOWERED, pixel), of_class(RAISED, pixel));
            let mean = raised - lowered;
            let variance = CONTRAST * CONTRAST * (lowered + raised - mean * mean).max(0.0);
            (CONTRAST * mean, (variance + LEAST_VARIANCE).sqrt())
        })
        .unzip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_guess_is_as_certain_as_the_network() {
        // Three pixels, the second outside: the first certainly lowered, the third raised or background with equal
        // probability.
        let (mean, deviation) = guess(&[0.0, 1.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5], 3, &[0, 2]);
        assert_eq!(mean, [-3.0, 1.5]);
        assert!((deviation[0] - 0.1).abs() < 1e-12 && (deviation[1] - (2.25_f64 + 0.01).sqrt()).abs() < 1e-12);
    }
}
