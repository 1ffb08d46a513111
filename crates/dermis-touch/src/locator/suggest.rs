//! Suggests where more pokes would help: the position uncertainty expected across the map, and the positions where a
//! poke reduces it most. A poke at q lowers the map's variance by c(p)^2 / (c(q) + s), where c(p) is the signatures'
//! covariance between p and q given the examples.

use faer::Mat;
use rayon::prelude::*;

use super::data::SuggestedPoke;
use super::error::LocatorError;
use super::model::Locator;
use super::posterior::moments;
use super::regression::{Products, correlations, inverse_covariance, noise_variance};
use super::rows::dot;
use crate::statistics::evenly;

/// Maximum number of map positions considered.
const CANDIDATES: usize = 600;

impl Locator {
    /// Expected position uncertainty of a touch of median amplitude at each map position: RMS of sigma x and sigma y,
    /// metres. It includes what the examples leave unknown of the map, and the ambiguity of the skin itself.
    pub fn expected_sigma_m(&self) -> Vec<f64> {
        let mut weights = vec![0.0; self.state.positions_m.len()];
        let mut log_likelihood = weights.clone();
        (0..weights.len()).map(|p| self.expected_sigma_at(p, &mut log_likelihood, &mut weights)).collect()
    }

    /// Up to `count` positions where one more poke would help most, best first. Each assumes that the earlier ones
    /// have been poked.
    ///
    /// # Errors
    /// The covariance of the examples is singular, which does not happen for a fitted locator.
    pub fn suggest_pokes(&self, count: usize) -> Result<Vec<SuggestedPoke>, LocatorError> {
        let state = &self.state;
        let chosen = evenly(state.positions_m.len(), CANDIDATES);
        let places: Vec<[f64; 2]> = chosen.iter().map(|&p| state.positions_m[p]).collect();
        let examples: Vec<[f64; 2]> = state.report.examples.iter().map(|e| e.position_m).collect();
        let length_m = state.hyperparameters.length_m;
        let mut covariance = conditional_covariance(&places, &examples, &state.example_noise, length_m)?;
        let noise = noise_variance(state.hyperparameters.noise, 1.0, 1.0);
        let zeros = || vec![0.0; state.positions_m.len()];
        let sigma_at =
            |(scratch, weights): &mut (Vec<f64>, Vec<f64>), p: &usize| self.expected_sigma_at(*p, scratch, weights);
        let sigma: Vec<f64> = chosen.par_iter().map_init(|| (zeros(), zeros()), sigma_at).collect();
        let mut suggestions = Vec::with_capacity(count.min(places.len()));
        for _ in 0..count.min(places.len()) {
            let gain = |q: usize| {
                let taken = |p: usize| sigma[p].powi(2) * covariance[(p, q)].powi(2);
                (0..places.len()).map(taken).sum::<f64>() / (covariance[(q, q)] + noise)
            };
            let gains: Vec<f64> = (0..places.len()).map(gain).collect();
            let best = (0..places.len()).fold(0, |b, q| if gains[q] > gains[b] { q } else { b });
            let unexplained = covariance[(best, best)].clamp(0.0, 1.0);
            suggestions.push(SuggestedPoke { position_m: places[best], sigma_m: sigma[best], unexplained });
            condition_on(&mut covariance, best, noise);
        }
        Ok(suggestions)
    }

    /// Sigma of the posterior for the mean signature at `p`, with the misfit that its noise adds.
    fn expected_sigma_at(&self, p: usize, log_likelihood: &mut [f64], weights: &mut [f64]) -> f64 {
        let state = &self.state;
        let rank = state.rank;
        let noise = noise_variance(state.hyperparameters.noise, 1.0, 1.0);
        let here = &state.signatures[p * rank..(p + 1) * rank];
        let scatter = rank as f64 * (state.variance[p] + noise);
        for (q, there) in state.signatures.chunks_exact(rank).enumerate() {
            let frame_map = f64::from(dot(here, there));
            let products = Products { frame_frame: self.squares[p], frame_map, map_map: self.squares[q] };
            let variance = state.variance[q] + noise;
            log_likelihood[q] = -0.5 * ((products.misfit() + scatter) / variance + rank as f64 * variance.ln());
        }
        let found = moments(&state.positions_m, log_likelihood, state.temperature, state.spacing_m, weights);
        let mean_m2 = 0.5 * (found.covariance_m2[0] + found.covariance_m2[1]);
        state.spread().variance_m2(mean_m2, state.variance[p]).sqrt()
    }
}

/// Covariance of the map at `places` given the examples.
fn conditional_covariance(
    places: &[[f64; 2]],
    examples: &[[f64; 2]],
    noise: &[f64],
    length_m: f64,
) -> Result<Mat<f64>, LocatorError> {
    let inverse = inverse_covariance(examples, noise, length_m)?;
    let across = correlations(places, examples, length_m);
    Ok(correlations(places, places, length_m) - &across * &inverse * across.transpose())
}

/// Conditions on a poke of noise variance `noise` at position index `q`.
fn condition_on(covariance: &mut Mat<f64>, q: usize, noise: f64) {
    let column: Vec<f64> = covariance.col_as_slice(q).to_vec();
    let scale = 1.0 / (column[q] + noise);
    for j in 0..column.len() {
        for i in 0..column.len() {
            covariance[(i, j)] -= column[i] * column[j] * scale;
        }
    }
}
