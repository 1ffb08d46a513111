//! How much a frame unlike the pokes widens the posterior: the variance is multiplied by
//!
//! e = (q / q')^a (d / d')^b,
//!
//! with q the misfit at the best position, d the inverse expert's distance to the nearest poke, and q', d' their
//! medians over the left-out examples. The powers are those that predict the left-out examples best. A frame that fits
//! worse than 95 % of them is widened at least by its novelty: the skin has changed, or several touches share the
//! frame.

use crate::locator::posterior::{ONE_SIGMA, SELECTION_MARGIN, Trial, log_student, weighted_quantile};
use crate::statistics::median;

/// Powers tried of the misfit and of the distance, the defaults first.
const MISFIT_POWERS: [f64; 4] = [0.0, 0.5, 1.0, 1.5];
const DISTANCE_POWERS: [f64; 4] = [0.0, 0.25, 0.5, 1.0];
/// Gain in total log score that each power above zero must bring: Akaike's penalty for one parameter, plus the
/// logarithm of the number of powers tried. Fifty pokes otherwise choose one by chance.
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

/// The law of the widening.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Excess {
    /// Medians over left-out examples.
    pub usual_novelty: f64,
    pub usual_distance: f64,
    /// a and b.
    pub misfit_power: f64,
    pub distance_power: f64,
}

impl Default for Excess {
    fn default() -> Self {
        Self { usual_novelty: 1.0, usual_distance: 1.0, misfit_power: 0.0, distance_power: 0.0 }
    }
}

impl Excess {
    /// Factor on the posterior's variance.
    pub(super) fn of(&self, frame: Unlike) -> f64 {
        let ratio = |value: f64, usual: f64| (value / usual).clamp(LIMITS.0, LIMITS.1);
        let law = ratio(frame.novelty, self.usual_novelty).powf(self.misfit_power)
            * ratio(frame.distance, self.usual_distance).powf(self.distance_power);
        if frame.novelty > 1.0 { law.max(frame.novelty) } else { law }
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
        let mut best = plain;
        let mut reached = plain.score(trials, frames);
        for misfit_power in MISFIT_POWERS {
            for distance_power in DISTANCE_POWERS {
                let candidate = Self { misfit_power, distance_power, ..plain };
                let powers = u8::from(misfit_power > 0.0) + u8::from(distance_power > 0.0);
                let score = candidate.score(trials, frames) - MARGIN * f64::from(powers);
                if score > reached {
                    (best, reached) = (candidate, score);
                }
            }
        }
        best
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

    /// Trials whose error variance grows with the misfit to a power.
    fn trials(power: f64) -> (Vec<Trial>, Vec<Unlike>) {
        let numbers = normals(600);
        let frames: Vec<Unlike> =
            (0..200).map(|i| Unlike { novelty: 0.3 + 0.7 * (i % 20) as f64 / 20.0, distance: 1.0 }).collect();
        let trial = |i: usize| {
            let sigma_m = 1e-3 * frames[i].novelty.powf(0.5 * power);
            let error_m = [sigma_m * numbers[2 * i], sigma_m * numbers[2 * i + 1]];
            Trial { error_m, variance_m2: [1e-6; 2], unexplained: 0.0, weight: 1.0 }
        };
        ((0..200).map(trial).collect(), frames)
    }

    #[test]
    fn the_widening_by_misfit_follows_left_out_errors() {
        let (with, frames) = trials(1.5);
        let excess = Excess::choose(&with, &frames);
        assert!(excess.misfit_power >= 1.0 && excess.distance_power == 0.0, "{excess:?}");
        // A frame of a changed skin: three times the usual misfit.
        let changed = Unlike { novelty: 3.0 * excess.usual_novelty, distance: 1.0 };
        assert!(excess.of(changed) >= 3.0, "{excess:?}");
        let (without, frames) = trials(0.0);
        assert_eq!(Excess::choose(&without, &frames).misfit_power, 0.0);
    }

    #[test]
    fn a_frame_unlike_all_pokes_is_widened_by_its_novelty() {
        let plain = Excess::default();
        assert_eq!(plain.of(Unlike { novelty: 4.0, distance: 1.0 }), 4.0);
        assert_eq!(plain.of(Unlike { novelty: 0.5, distance: 1.0 }), 1.0);
    }
}
