//! Locates one frame without allocating: whitening, one product with the signatures of all positions, moments.
//!
//! For a missing channel k, the value y_k is known only by its prior N(0, e_k), where e_k is its mean square in the
//! examples. Marginalising over it changes the metric from I to (I + D E D')^-1, where D holds the columns of the
//! transform that belong to missing channels. Woodbury's formula reduces that to a small factor, kept in the scratch
//! until the set of missing channels changes.

use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side};

use super::data::{LoadEstimate, Located, MIN_CHANNELS};
use super::error::{LocatorError, check_length};
use super::model::Locator;
use super::posterior::moments;
use super::regression::{Products, noise_variance};
use super::rows::{dot, logarithms, products};

/// Working memory of [`Locator::predict_into`], kept by the caller between frames.
///
/// It grows at first use and when the set of missing channels changes. Otherwise locating allocates nothing.
#[derive(Debug, Clone, Default)]
pub struct LocatorScratch {
    fingerprint: Option<u64>,
    frame: Vec<f32>,
    pub(super) whitened: Vec<f32>,
    missing: Vec<usize>,
    pub(super) missing_now: Vec<usize>,
    /// E = L^-1 D', a row of `rank` values for each missing channel.
    removed: Vec<f32>,
    /// E y, one value per missing channel.
    shares: Vec<f32>,
    /// Inner product of each signature with the whitened frame.
    pub(super) along: Vec<f32>,
    /// Logarithms of the variances.
    logarithms: Vec<f32>,
    /// Squared lengths of the signatures in the current metric.
    squares: Vec<f64>,
    pub(super) log_likelihood: Vec<f64>,
    pub(super) posterior: Vec<f64>,
}

impl LocatorScratch {
    /// Probability of each map position for the last frame located; sums to 1. Empty before the first frame.
    ///
    /// This is the tempered posterior whose calibrated covariance is reported.
    pub fn posterior(&self) -> &[f64] {
        &self.posterior
    }
}

/// Amplitude of a frame and the share of a typical frame's energy in its channels.
pub(super) struct Weighed {
    pub amplitude: f64,
    usable: usize,
}

impl Locator {
    /// Memory for [`Locator::predict_into`], sized for this locator.
    pub fn scratch(&self) -> LocatorScratch {
        let mut scratch = LocatorScratch::default();
        self.adopt(&mut scratch);
        scratch
    }

    /// Locates the touch in `frame`, difference data in the unit of the examples. NaN or infinite channels count as
    /// missing.
    ///
    /// # Errors
    /// A different number of channels than in the examples, too few usable ones, or a frame that is all zero.
    pub fn predict_into(&self, frame: &[f64], scratch: &mut LocatorScratch) -> Result<Located, LocatorError> {
        check_length("frame", self.channels(), frame.len())?;
        let (weighed, misfit_at_peak) = self.compare(frame, scratch)?;
        Ok(self.read_out(&weighed, misfit_at_peak, scratch))
    }

    /// Computes log-likelihoods over the map, in the scratch. Returns the misfit per channel at the most likely
    /// position.
    pub(super) fn compare(&self, frame: &[f64], scratch: &mut LocatorScratch) -> Result<(Weighed, f64), LocatorError> {
        if scratch.fingerprint != Some(self.fingerprint) {
            self.adopt(scratch);
        }
        let weighed = self.weigh(frame, scratch)?;
        self.whiten(scratch);
        let misfit_at_peak = self.fill_log_likelihood(&weighed, scratch);
        Ok((weighed, misfit_at_peak))
    }

    /// Like [`Locator::predict_into`], with its own memory.
    ///
    /// # Errors
    /// As [`Locator::predict_into`].
    pub fn predict(&self, frame: &[f64]) -> Result<Located, LocatorError> {
        self.predict_into(frame, &mut self.scratch())
    }

    fn adopt(&self, scratch: &mut LocatorScratch) {
        let (channels, positions) = (self.channels(), self.state.positions_m.len());
        scratch.fingerprint = Some(self.fingerprint);
        scratch.frame.resize(channels, 0.0);
        scratch.whitened.resize(self.state.rank, 0.0);
        scratch.missing.clear();
        scratch.missing.reserve(channels);
        scratch.missing_now.clear();
        scratch.missing_now.reserve(channels);
        scratch.removed.clear();
        scratch.shares.clear();
        scratch.squares.clear();
        scratch.squares.extend_from_slice(&self.squares);
        scratch.along.resize(positions, 0.0);
        scratch.logarithms.resize(positions, 0.0);
        scratch.log_likelihood.resize(positions, 0.0);
        scratch.posterior.resize(positions, 0.0);
    }

    /// Weights the frame, scales it to the length it would have if complete, and updates the metric if the set of
    /// missing channels has changed.
    fn weigh(&self, frame: &[f64], scratch: &mut LocatorScratch) -> Result<Weighed, LocatorError> {
        let state = &self.state;
        scratch.missing_now.clear();
        let (mut sum, mut usable, mut lost) = (0.0, 0, 0.0);
        for (k, (value, weight)) in frame.iter().zip(&state.weights).enumerate() {
            if *weight > 0.0 && value.is_finite() {
                sum += (value * weight).powi(2);
                usable += 1;
            } else if *weight > 0.0 {
                lost += state.energy[k];
                scratch.missing_now.push(k);
            }
        }
        if usable < MIN_CHANNELS {
            return Err(LocatorError::TooFewChannels { frame: 0, got: usable, expected: MIN_CHANNELS });
        }
        if !(sum > 0.0 && sum.is_finite()) {
            return Err(LocatorError::EmptyFrame { frame: 0 });
        }
        if scratch.missing_now != scratch.missing {
            self.renew_metric(scratch)?;
        }
        let total: f64 = state.energy.iter().sum();
        let seen = ((total - lost) / total).clamp(0.01, 1.0);
        let scale = (seen / sum).sqrt();
        for k in 0..frame.len() {
            let value = frame[k] * state.weights[k] * scale;
            scratch.frame[k] = if value.is_finite() { value as f32 } else { 0.0 };
        }
        Ok(Weighed { amplitude: (sum / seen / frame.len() as f64).sqrt(), usable })
    }

    /// Rebuilds the factor that marginalises over the channels in `missing_now`.
    fn renew_metric(&self, scratch: &mut LocatorScratch) -> Result<(), LocatorError> {
        let (rank, channels) = (self.state.rank, self.channels());
        let known = |k: &&usize| self.state.energy[**k] > 0.0;
        let lost: Vec<usize> = scratch.missing_now.iter().filter(known).copied().collect();
        let columns = Mat::from_fn(rank, lost.len(), |r, j| f64::from(self.state.transform[r * channels + lost[j]]));
        let mut inner = columns.transpose() * &columns;
        for (j, k) in lost.iter().enumerate() {
            inner[(j, j)] += 1.0 / self.state.energy[*k];
        }
        let what = "covariance of the missing channels";
        let factor = inner.llt(Side::Lower).map_err(|_| LocatorError::Singular { what })?;
        let mut rows = columns.transpose().to_owned();
        solve_lower_triangular_in_place(factor.L(), rows.as_mut(), Par::Seq);
        scratch.removed.clear();
        for j in 0..lost.len() {
            scratch.removed.extend((0..rank).map(|r| rows[(j, r)] as f32));
        }
        scratch.shares.resize(lost.len(), 0.0);
        for (p, signature) in self.state.signatures.chunks_exact(rank).enumerate() {
            let taken: f32 = scratch.removed.chunks_exact(rank).map(|row| dot(row, signature).powi(2)).sum();
            scratch.squares[p] = (self.squares[p] - f64::from(taken)).max(0.0);
        }
        scratch.missing.clear();
        scratch.missing.extend_from_slice(&scratch.missing_now);
        Ok(())
    }

    /// y = T z, minus its part along missing channels.
    fn whiten(&self, scratch: &mut LocatorScratch) {
        products(&self.state.transform, self.channels(), &scratch.frame, &mut scratch.whitened);
    }

    /// L(p) for every position. Returns the misfit per channel at the most likely one.
    fn fill_log_likelihood(&self, weighed: &Weighed, scratch: &mut LocatorScratch) -> f64 {
        let state = &self.state;
        let mut square: f64 = scratch.whitened.iter().map(|v| f64::from(*v).powi(2)).sum();
        // Take all shares from the original vector before removing any, since the rows are not orthogonal.
        for (share, row) in scratch.shares.iter_mut().zip(scratch.removed.chunks_exact(state.rank)) {
            *share = dot(row, &scratch.whitened);
            square -= f64::from(*share).powi(2);
        }
        for (share, row) in scratch.shares.iter().zip(scratch.removed.chunks_exact(state.rank)) {
            for (y, e) in scratch.whitened.iter_mut().zip(row) {
                *y -= share * e;
            }
        }
        let noise = noise_variance(state.hyperparameters.noise, weighed.amplitude, state.median_amplitude);
        let used = state.weights.iter().filter(|w| **w > 0.0).count();
        let rank = state.rank as f64 * weighed.usable as f64 / used as f64;
        let mut best = (f64::NEG_INFINITY, 0.0);
        products(&state.signatures, state.rank, &scratch.whitened, &mut scratch.along);
        scratch.logarithms.iter_mut().zip(&state.variance).for_each(|(l, v)| *l = (v + noise) as f32);
        logarithms(&mut scratch.logarithms);
        for (p, along) in scratch.along.iter().enumerate() {
            let frame_map = f64::from(*along);
            let products = Products { frame_frame: square.max(0.0), frame_map, map_map: scratch.squares[p] };
            let variance = state.variance[p] + noise;
            let misfit = products.misfit() / variance;
            let value = -0.5 * (misfit + rank * f64::from(scratch.logarithms[p]));
            scratch.log_likelihood[p] = value;
            if value > best.0 {
                best = (value, misfit);
            }
        }
        best.1 / rank
    }

    fn read_out(&self, weighed: &Weighed, misfit: f64, scratch: &mut LocatorScratch) -> Located {
        let state = &self.state;
        let positions = &state.positions_m;
        let posterior = &mut scratch.posterior;
        let found = moments(positions, &scratch.log_likelihood, state.temperature, state.spacing_m, posterior);
        let spread = state.spread();
        let unexplained: f64 = state.variance.iter().zip(posterior.iter()).map(|(v, w)| v * w).sum();
        let load = state.load.as_ref().map(|law| {
            let log_factor: f64 = law.log_factor.iter().zip(posterior.iter()).map(|(f, w)| f * w).sum();
            let value = ((weighed.amplitude.ln() - log_factor) / law.exponent).exp();
            LoadEstimate { value, sigma: value * law.relative_error }
        });
        Located {
            x_m: found.mean_m[0],
            y_m: found.mean_m[1],
            sigma_x_m: spread.variance_m2(found.covariance_m2[0], unexplained).sqrt(),
            sigma_y_m: spread.variance_m2(found.covariance_m2[1], unexplained).sqrt(),
            covariance_xy_m2: found.covariance_m2[2] * spread.factor * spread.factor,
            peak_x_m: positions[found.peak][0],
            peak_y_m: positions[found.peak][1],
            amplitude: weighed.amplitude,
            load,
            log_evidence: found.log_evidence,
            unexplained,
            novelty: misfit / state.usual_misfit,
        }
    }
}
