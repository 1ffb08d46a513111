//! Examples of an earlier session of the same skin. The new map is correlated with the earlier one by the resemblance r
//! ([`Sessions`]): r = 1 pools the examples, r = 0 ignores the earlier ones. The r that makes all frames most probable
//! is used. Choices by left-out examples count the new ones fully and the earlier ones with a small weight.

use crate::locator::data::{Examples, Hyperparameters, MIN_EXAMPLES};
use crate::locator::design::{Design, Prior};
use crate::locator::error::LocatorError;
use crate::locator::pair_correlations::Sessions;
use crate::locator::turn::log_density;
use crate::statistics::evenly;

/// Resemblances tried.
const RESEMBLANCES: [f64; 10] = [1.0, 0.99, 0.97, 0.94, 0.9, 0.8, 0.65, 0.5, 0.25, 0.0];
/// Weight of all earlier examples together, in new ones: the smallest number that can be fitted. With 10, too few
/// errors of a damaged skin are within one sigma after 5 pokes, 54 instead of 59 %.
const EARLIER_WORTH: f64 = MIN_EXAMPLES as f64;
/// The same where they choose how the experts are combined: a dozen examples would choose one of forty combinations by
/// chance.
const JOINING_WORTH: f64 = 50.0;
/// Lower bound on a weight: quantiles need weights above zero.
const LEAST_WEIGHT: f64 = 1e-9;

/// The resemblance under which the frames are most probable.
pub(super) fn choose(
    design: &Design,
    prior: &Prior,
    is_earlier: &[bool],
    hyper: &Hyperparameters,
) -> Result<Sessions, LocatorError> {
    let mut rest = Design { z: &design.z - &prior.at_examples, ..design.clone() };
    let sessions = |resemblance: f64| Sessions { is_earlier: is_earlier.to_vec(), resemblance };
    let mut best = (f64::NEG_INFINITY, RESEMBLANCES[0]);
    for resemblance in RESEMBLANCES {
        rest.sessions = Some(sessions(resemblance));
        let density = log_density(&rest, hyper)?;
        if density > best.0 {
            best = (density, resemblance);
        }
    }
    Ok(sessions(best.1))
}

/// Weights of the forward expert's rows.
pub(super) struct Weights {
    /// Which rows are of an earlier session; `None` if none is.
    pub is_earlier: Option<Vec<bool>>,
    count: usize,
    of_earlier: f64,
    /// Variance of an example about its map, relative to the variance about the new map.
    told: f64,
}

impl Weights {
    /// Weights of the given rows of the examples.
    pub(super) fn new(examples: &Examples, rows: &[usize]) -> Self {
        let first = examples.len() - examples.earlier;
        let is_earlier: Vec<bool> = rows.iter().map(|&row| row >= first).collect();
        let earlier = is_earlier.iter().filter(|is| **is).count();
        Self {
            is_earlier: (earlier > 0).then_some(is_earlier),
            count: rows.len(),
            of_earlier: (EARLIER_WORTH / earlier.max(1) as f64).min(1.0),
            told: 1.0,
        }
    }

    /// Weighs earlier examples less if the skin has changed: about the new map they have an additional variance of 1 -
    /// r^2, which `noise` is relative to.
    pub(super) fn discount(&mut self, sessions: &Sessions, noise: f64) {
        self.told = noise / (noise + 1.0 - sessions.resemblance.powi(2));
    }

    /// Weight of a row.
    pub(super) fn of(&self, row: usize) -> f64 {
        if self.is_earlier.as_ref().is_some_and(|is_earlier| is_earlier[row]) {
            (self.of_earlier * self.told).max(LEAST_WEIGHT)
        } else {
            1.0
        }
    }

    /// At most `most` rows that choose how the experts are combined, with their weights: new ones first.
    pub(super) fn joining(&self, most: usize) -> Vec<(usize, f64)> {
        let Some(is_earlier) = &self.is_earlier else {
            return evenly(self.count, most).into_iter().map(|row| (row, 1.0)).collect();
        };
        let (earlier, new): (Vec<usize>, Vec<usize>) = (0..self.count).partition(|&row| is_earlier[row]);
        let new: Vec<usize> = evenly(new.len(), most).into_iter().map(|i| new[i]).collect();
        let kept = evenly(earlier.len(), most - new.len());
        let weight = (self.told * JOINING_WORTH / kept.len().max(1) as f64).clamp(LEAST_WEIGHT, 1.0);
        new.into_iter().map(|row| (row, 1.0)).chain(kept.into_iter().map(|i| (earlier[i], weight))).collect()
    }
}
