//! Locates one frame with both experts, without allocating.

use super::excess::{Unlike, misfit_ratio};
use super::features::Features;
use super::inverse::{Guess, Memory};
use super::inverse_fit::plain_share;
use super::model::FusedLocator;
use crate::locator::data::{LoadEstimate, Located};
use crate::locator::error::{LocatorError, check_length};
use crate::locator::live::LocatorScratch;
use crate::locator::posterior::Spread;
use crate::plane::squared_distance;

/// Number of nearest pokes that stand in for a missing channel.
const STAND_INS: usize = 8;

/// Working memory of [`FusedLocator::predict_into`], kept by the caller between frames.
#[derive(Debug, Clone, Default)]
pub struct FusedScratch {
    unit: Vec<f64>,
    forward_frame: Vec<f64>,
    inverse_frame: Vec<f64>,
    features: Vec<f32>,
    pub(super) forward: LocatorScratch,
    memory: Memory,
    stand_ins: Vec<(usize, f64)>,
}

impl FusedScratch {
    /// Probability of each map position for the last frame located; sums to 1. Empty before the first frame.
    pub fn posterior(&self) -> &[f64] {
        &self.forward.posterior
    }
}

impl FusedLocator {
    /// Memory for [`FusedLocator::predict_into`].
    pub fn scratch(&self) -> FusedScratch {
        FusedScratch { forward: self.state.forward.scratch(), ..FusedScratch::default() }
    }

    /// Locates the touch in `frame`, difference data in the unit of the examples. NaN or infinite channels count as
    /// missing.
    ///
    /// # Errors
    /// A different number of channels than in the examples, too few usable ones, or a frame that is all zero.
    pub fn predict_into(&self, frame: &[f64], scratch: &mut FusedScratch) -> Result<Located, LocatorError> {
        let state = &self.state;
        check_length("frame", self.channels(), frame.len())?;
        scratch.unit.resize(frame.len(), 0.0);
        scratch.forward_frame.resize(frame.len(), 0.0);
        let (amplitude, seen) = state.features.unit(frame, &mut scratch.unit)?;
        state.features.forward(frame, &scratch.unit, amplitude, &mut scratch.forward_frame);
        let (weighed, misfit) = state.forward.compare(&scratch.forward_frame, &mut scratch.forward)?;
        let novelty = misfit / state.forward.state.usual_misfit;
        let guess = state.fusion.doublings.is_some().then(|| self.guess(scratch, seen, novelty));
        let forward = &state.forward.state;
        let positions = &forward.positions_m;
        let LocatorScratch { log_likelihood, posterior, along, .. } = &mut scratch.forward;
        let found = state.fusion.join(positions, &self.cells, log_likelihood, guess, along, posterior);
        let unexplained: f64 = forward.variance.iter().zip(posterior.iter()).map(|(v, w)| v * w).sum();
        let spread = |axis: usize| Spread { factor: state.sigma_factors[axis], extrapolation_m: state.extrapolation_m };
        let distance = guess.map_or(1.0, |guess| guess.distance);
        let excess = state.excess.of(Unlike { novelty, distance });
        let sigma = |axis: usize| spread(axis).variance_m2(excess * found.covariance_m2[axis], unexplained).sqrt();
        let load = forward.load.as_ref().map(|law| {
            let log_factor: f64 = law.log_factor.iter().zip(posterior.iter()).map(|(f, w)| f * w).sum();
            let value = ((weighed.amplitude.ln() - log_factor) / law.exponent).exp();
            LoadEstimate { value, sigma: value * law.relative_error }
        });
        Ok(Located {
            x_m: found.mean_m[0],
            y_m: found.mean_m[1],
            sigma_x_m: sigma(0),
            sigma_y_m: sigma(1),
            covariance_xy_m2: excess * found.covariance_m2[2] * state.sigma_factors[0] * state.sigma_factors[1],
            peak_x_m: positions[found.peak][0],
            peak_y_m: positions[found.peak][1],
            amplitude: weighed.amplitude,
            load,
            log_evidence: found.log_evidence,
            unexplained,
            novelty,
        })
    }

    /// Like [`FusedLocator::predict_into`], with its own memory.
    ///
    /// # Errors
    /// As [`FusedLocator::predict_into`].
    pub fn predict(&self, frame: &[f64]) -> Result<Located, LocatorError> {
        self.predict_into(frame, &mut self.scratch())
    }

    /// The inverse expert's position in a frame with this misfit. Missing channels increase its variance.
    fn guess(&self, scratch: &mut FusedScratch, seen: f64, novelty: f64) -> Guess {
        let state = &self.state;
        let share = plain_share(state.plain_share, misfit_ratio(novelty, state.excess.usual_novelty));
        let plain = (share > 0.0).then(|| {
            if !scratch.forward.missing_now.is_empty() {
                self.stand_in(scratch);
            }
            scratch.inverse_frame.resize(state.features.inverse_len(), 0.0);
            Features::inverse(&scratch.unit, &mut scratch.inverse_frame);
            scratch.features.clear();
            scratch.features.extend(scratch.inverse_frame.iter().map(|v| *v as f32));
            state.plain.guess(&scratch.features, &mut scratch.memory, None)
        });
        let whitened = state.whitened.as_ref().filter(|_| share < 1.0).map(|whitened| {
            scratch.features.clear();
            scratch.features.extend_from_slice(&scratch.forward.whitened);
            unit_length(&mut scratch.features);
            whitened.guess(&scratch.features, &mut scratch.memory, None)
        });
        let guess = match (plain, whitened) {
            (Some(plain), Some(whitened)) => plain.mixed(share, whitened),
            (one, other) => one.or(other).unwrap_or_default(),
        };
        Guess { variance_m2: guess.variance_m2 / (seen * seen), ..guess }
    }

    /// Fills missing channels with values of the pokes nearest to the forward expert's best position.
    fn stand_in(&self, scratch: &mut FusedScratch) {
        let state = &self.state;
        let log_likelihood = &scratch.forward.log_likelihood;
        let best = (0..log_likelihood.len()).fold(0, |b, p| if log_likelihood[p] > log_likelihood[b] { p } else { b });
        let place = state.forward.state.positions_m[best];
        let nearest = &mut scratch.stand_ins;
        nearest.clear();
        nearest.reserve(STAND_INS + 1);
        for (i, poked) in state.places_m.iter().enumerate() {
            let d2 = squared_distance(*poked, place);
            if nearest.len() < STAND_INS || d2 < nearest[STAND_INS - 1].1 {
                let slot = nearest.partition_point(|n| n.1 <= d2);
                nearest.insert(slot, (i, d2));
                nearest.truncate(STAND_INS);
            }
        }
        let share = 1.0 / nearest.len() as f64;
        nearest.iter_mut().for_each(|n| n.1 = share);
        for &k in &scratch.forward.missing_now {
            scratch.unit[k] = state.plain.expected(k, nearest);
        }
    }
}

/// Scales a vector to unit length.
pub(super) fn unit_length(values: &mut [f32]) {
    let square: f32 = values.iter().map(|v| v * v).sum();
    if square > 0.0 {
        let scale = square.sqrt().recip();
        values.iter_mut().for_each(|v| *v *= scale);
    }
}
