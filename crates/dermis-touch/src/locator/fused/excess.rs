//! How much a frame unlike the pokes widens the posterior: the variance is multiplied by
//!
//! e = max(1, q / q')^1.5 (d / d')^b,
//!
//! with q the misfit at the best position, d the inverse expert's distance to the nearest poke, and q', d' their
//! medians over the left-out examples. b is the power that predicts the left-out examples best. They say little about
//! the power of the misfit, which matters on a skin that has changed since the pokes, and when several touches share a
//! frame.

use crate::locator::posterior::{ONE_SIGMA, SELECTION_MARGIN, Trial, log_student, weighted_quantile};
use crate::statistics::median;

/// Power of the misfit. A skin measured before and after damage, in both directions, has 43 % of the errors inside one
/// sigma without it after 1,000 pokes, 52 % with the power 1, 58 % with 1.5 and 63 % with 2. Checked on 35 other
/// changed skins: seven measured skins with 10 to 40 % of another skin's frames, or with channel gains that scatter by
/// 15 or 30 %. With 1.5, between 50 and 89 % are inside, and mean likelihoods are within 0.04 of the best.
const MISFIT_POWER: f64 = 1.5;
/// Powers tried of the distance, the default first.
const DISTANCE_POWERS: [f64; 4] = [0.0, 0.25, 0.5, 1.0];
/// Gain in total log score that a power above zero must bring: Akaike's penalty for one parameter, plus the logarithm
/// of the number of powers tried. Without it, fifty pokes choose one by chance.
const MARGIN: f64 = SELECTION_MARGIN + 1.386_294;
/// Limits of the ratios, beyond which left-out examples give no information.
const LIMITS: (f64, f64) = (0.1, 30.0);

/// How far a frame is from the pokes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unlike {
    /// Misfit over the 95 % quantile of left-out examples.
    pub novelty: f64,
    /// Distance to the nearest example over the usual one, squared; 1 without the inverse expert.
    pub distance: f64,
}

/// A frame's misfit over that of left-out pokes, at least 1.
pub(super) fn misfit_ratio(misfit: f64, usual: f64) -> f64 {
    (misfit / usual).clamp(1.0, LIMITS.1)
}

/// The law of the widening. Earlier versions stored a power of the misfit as well.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Excess {
    /// Medians over left-out examples.
    pub usual_novelty: f64,
    pub usual_distance: f64,
    /// b.
    pub distance_power: f64,
}

impl Default for Excess {
    fn default() -> Self {
        Self { usual_novelty: 1.0, usual_distance: 1.0, distance_power: 0.0 }
    }
}

impl Excess {
    /// Factor on the posterior's variance.
    pub(super) fn of(&self, frame: Unlike) -> f64 {
        let distance = (frame.distance / self.usual_distance).clamp(LIMITS.0, LIMITS.1);
        misfit_ratio(frame.novelty, self.usual_novelty).powf(MISFIT_POWER) * distance.powf(self.distance_power)
    }

    /// The law that predicts left-out examples best.
    pub(super) fn choose(trials: &[Trial], frames: &[Unlike]) -> Self {
        let usual =
            |value: fn(&Unlike) -> f64| median(&frames.iter().map(value).collect::<Vec<f64>>()).max(f64::MIN_POSITIVE);
        let plain = Self {
            usual_novelty: usual(|frame| frame.novelty),
            usual_distance: usual(|frame| frame.distance),
            ..Self::default()
        };
        let mut best = (plain.score(trials, frames), plain);
        for distance_power in &DISTANCE_POWERS[1..] {
            let candidate = Self { distance_power: *distance_power, ..plain };
            let score = candidate.score(trials, frames) - MARGIN;
            if score > best.0 {
                best = (score, candidate);
            }
        }
        best.1
    }

    /// Log density of the true positions with sigmas scaled to 68 %, without constants.
    fn score(&self, trials: &[Trial], frames: &[Unlike]) -> f64 {
        let errors: Vec<(f64, f64, f64)> = trials
            .iter()
            .zip(frames)
            .flat_map(|(trial, frame)| {
                let excess = self.of(*frame);
                [0, 1].map(|axis| (trial.error_m[axis], (excess * trial.variance_m2[axis]).sqrt(), trial.weight))
            })
            .collect();
        let ratios = errors.iter().map(|(error, sigma, weight)| ((error / sigma).abs(), *weight)).collect();
        let factor = weighted_quantile(ratios, ONE_SIGMA).max(1e-3);
        errors.iter().map(|(error, sigma, weight)| weight * log_student(*error, sigma * factor)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::locator::posterior::tests::normals;

    /// Trials whose error variance grows with the distance to a power.
    fn trials(power: f64) -> (Vec<Trial>, Vec<Unlike>) {
        let numbers = normals(600);
        let frames: Vec<Unlike> =
            (0..200).map(|i| Unlike { novelty: 0.5, distance: 0.3 + 0.7 * (i % 20) as f64 / 20.0 }).collect();
        let trial = |i: usize| {
            let sigma_m = 1e-3 * frames[i].distance.powf(0.5 * power);
            let error_m = [sigma_m * numbers[2 * i], sigma_m * numbers[2 * i + 1]];
            Trial { error_m, variance_m2: [1e-6; 2], unexplained: 0.0, weight: 1.0 }
        };
        ((0..200).map(trial).collect(), frames)
    }

    #[test]
    fn the_widening_by_distance_follows_left_out_errors() {
        let (with, frames) = trials(1.5);
        assert_eq!(Excess::choose(&with, &frames).distance_power, 1.0);
        let (without, frames) = trials(0.0);
        assert_eq!(Excess::choose(&without, &frames).distance_power, 0.0);
    }

    #[test]
    fn a_frame_unlike_the_pokes_is_widened_and_one_more_like_them_is_not_narrowed() {
        let excess = Excess { usual_novelty: 0.5, ..Excess::default() };
        assert_eq!(excess.of(Unlike { novelty: 2.0, distance: 1.0 }), 8.0);
        assert_eq!(excess.of(Unlike { novelty: 0.25, distance: 1.0 }), 1.0);
    }
}
