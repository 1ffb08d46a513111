//! Prepares raw examples for the regression: noise-weighted unit-length frames z = w f / |w f|, the physical
//! signatures in the same form at the examples and over the map, and, for very many channels, a projection on
//! principal directions.

use faer::{Mat, Side};

use super::data::{Examples, MIN_CHANNELS, SignatureMap};
use super::error::{LocatorError, check_length};
use super::pair_correlations::{APART, Copies, Sessions, matern52};
use crate::plane::squared_distance;
use crate::statistics::median;

/// Channel noise is raised to at least this share of the median, so that a stuck channel does not dominate.
const NOISE_FLOOR: f64 = 0.05;
/// Prior weight of the gain common to all channels, in pseudo-examples, against each channel's own gain.
const GAIN_PRIOR_EXAMPLES: f64 = 25.0;

/// Weighted unit frames of the examples, and what is needed to bring a new frame into the same form.
#[derive(Debug, Clone)]
pub(super) struct Design {
    /// Examples by channels; missing channels are filled.
    pub z: Mat<f64>,
    /// RMS over channels of each weighted frame.
    pub amplitude: Vec<f64>,
    /// Position of each example, metres.
    pub positions_m: Vec<[f64; 2]>,
    /// Which rows are rotated copies of others, if any.
    pub copies: Option<Copies>,
    /// Which rows are of an earlier session, if any.
    pub sessions: Option<Sessions>,
    /// Weight of each channel; 0 if it is never used.
    pub weights: Vec<f64>,
    /// Mean square of each channel of z.
    pub energy: Vec<f64>,
    /// Missing entries as (example, channel).
    pub missing: Vec<(usize, usize)>,
    /// Variance of measurement noise in every direction of z, for an example of median amplitude; 0 if the channel
    /// noise is unknown.
    pub noise_variance: f64,
}

impl Design {
    /// Weights and normalises the examples. Missing channels are left at zero until [`Design::fill`].
    pub(super) fn new(examples: &Examples) -> Result<Self, LocatorError> {
        let (n, c) = (examples.len(), examples.channels);
        let weights = channel_weights(examples);
        let mut z = Mat::<f64>::zeros(n, c);
        let mut missing = Vec::new();
        let mut amplitude = vec![0.0; n];
        for i in 0..n {
            let frame = &examples.frames[i * c..(i + 1) * c];
            let usable = (0..c).filter(|&k| weights[k] > 0.0 && frame[k].is_finite()).count();
            if usable < MIN_CHANNELS {
                return Err(LocatorError::TooFewChannels { frame: i, got: usable, expected: MIN_CHANNELS });
            }
            let mut sum = 0.0;
            for k in 0..c {
                if frame[k].is_finite() {
                    z[(i, k)] = frame[k] * weights[k];
                    sum += z[(i, k)] * z[(i, k)];
                } else if weights[k] > 0.0 {
                    missing.push((i, k));
                }
            }
            if sum == 0.0 {
                return Err(LocatorError::EmptyFrame { frame: i });
            }
            amplitude[i] = sum.sqrt();
            scale_row(&mut z, i, 1.0 / amplitude[i]);
        }
        let energy = vec![0.0; c];
        let mut design = Self {
            z,
            amplitude,
            positions_m: examples.positions_m.clone(),
            copies: None,
            sessions: None,
            weights,
            energy,
            missing,
            noise_variance: 0.0,
        };
        design.measure_energy();
        let root = (c as f64).sqrt();
        let seen = design.seen_energy();
        for i in 0..n {
            let shrink = seen[i].sqrt();
            scale_row(&mut design.z, i, shrink);
            design.amplitude[i] /= root * shrink;
        }
        design.measure_energy();
        if examples.channel_noise.is_some() {
            // Weighted channels have noise 1, and a frame has the energy c a^2.
            design.noise_variance = 1.0 / (c as f64 * median(&design.amplitude).powi(2));
        }
        Ok(design)
    }

    /// Fills missing channels with `fitted` values and restores unit length.
    pub(super) fn fill(&mut self, fitted: &Mat<f64>) {
        for &(i, k) in &self.missing {
            self.z[(i, k)] = fitted[(i, k)];
        }
        for i in 0..self.z.nrows() {
            let norm = (0..self.z.ncols()).map(|k| self.z[(i, k)] * self.z[(i, k)]).sum::<f64>().sqrt();
            scale_row(&mut self.z, i, 1.0 / norm);
            self.amplitude[i] *= norm;
        }
        self.measure_energy();
    }

    /// Extra variance of a frame about the map: rotated copies are never exactly alike.
    pub(super) fn apart(&self) -> f64 {
        self.copies.as_ref().map_or(0.0, |_| APART)
    }

    /// Correlations of the rows at one length.
    pub(super) fn correlations_among(&self, length_m: f64) -> Mat<f64> {
        let (n, places) = (self.positions_m.len(), &self.positions_m);
        let copied = |i: usize, j: usize| self.copies.as_ref().map_or(1.0, |copies| copies.between(i, j));
        let session = |i: usize, j: usize| self.sessions.as_ref().map_or(1.0, |sessions| sessions.between(i, j));
        Mat::from_fn(n, n, |i, j| copied(i, j) * session(i, j) * matern52(places[i], places[j], length_m))
    }

    /// Correlations of the map at `positions` (rows) with the design's rows (columns).
    pub(super) fn correlations_to(&self, positions: &[[f64; 2]], length_m: f64) -> Mat<f64> {
        let (n, places) = (self.positions_m.len(), &self.positions_m);
        let copied = |i: usize| self.copies.as_ref().map_or(1.0, |copies| copies.with_map(i));
        let session = |i: usize| self.sessions.as_ref().map_or(1.0, |sessions| sessions.with_map(i));
        let factors: Vec<f64> = (0..n).map(|i| copied(i) * session(i)).collect();
        Mat::from_fn(positions.len(), n, |p, i| factors[i] * matern52(positions[p], places[i], length_m))
    }

    /// The given rows of a design without copies, as a design.
    pub(super) fn subset(&self, rows: &[usize]) -> Self {
        Self {
            z: Mat::from_fn(rows.len(), self.z.ncols(), |i, k| self.z[(rows[i], k)]),
            amplitude: rows.iter().map(|&i| self.amplitude[i]).collect(),
            positions_m: rows.iter().map(|&i| self.positions_m[i]).collect(),
            copies: None,
            sessions: self.sessions.as_ref().map(|sessions| sessions.subset(rows)),
            weights: self.weights.clone(),
            energy: self.energy.clone(),
            missing: Vec::new(),
            noise_variance: self.noise_variance,
        }
    }

    /// Share of a typical frame's energy in the measured channels, for each example.
    fn seen_energy(&self) -> Vec<f64> {
        let total: f64 = self.energy.iter().sum();
        let mut lost = vec![0.0; self.z.nrows()];
        for &(i, k) in &self.missing {
            lost[i] += self.energy[k];
        }
        lost.iter().map(|l| ((total - l) / total).clamp(0.01, 1.0)).collect()
    }

    /// Mean square of each channel over the examples that measured it.
    fn measure_energy(&mut self) {
        let n = self.z.nrows();
        let mut absent = vec![0usize; self.energy.len()];
        for m in &self.missing {
            absent[m.1] += usize::from(self.z[*m] == 0.0);
        }
        for k in 0..self.energy.len() {
            let sum: f64 = (0..n).map(|i| self.z[(i, k)] * self.z[(i, k)]).sum();
            self.energy[k] = sum / (n - absent[k]).max(1) as f64;
        }
    }
}

/// 1 / noise, limited; 0 for a channel without finite noise or measured in fewer than half of the examples.
pub(super) fn channel_weights(examples: &Examples) -> Vec<f64> {
    let (n, c) = (examples.len(), examples.channels);
    let mut weights = match &examples.channel_noise {
        None => vec![1.0; c],
        Some(noise) => {
            let mut sorted: Vec<f64> = noise.iter().copied().filter(|v| v.is_finite() && *v > 0.0).collect();
            sorted.sort_by(f64::total_cmp);
            let floor = NOISE_FLOOR * sorted[sorted.len() / 2];
            noise.iter().map(|&v| if v.is_finite() { 1.0 / v.max(floor) } else { 0.0 }).collect()
        }
    };
    for k in 0..c {
        let seen = (0..n).filter(|&i| examples.frames[i * c + k].is_finite()).count();
        if 2 * seen < n {
            weights[k] = 0.0;
        }
    }
    weights
}

fn scale_row(matrix: &mut Mat<f64>, row: usize, factor: f64) {
    for k in 0..matrix.ncols() {
        matrix[(row, k)] *= factor;
    }
}

/// The physical signatures in the form of [`Design::z`], with each channel's gain: the prior mean of the map.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    /// Examples by channels.
    pub at_examples: Mat<f64>,
    /// Map positions by channels.
    pub over_map: Mat<f64>,
    /// Mean cosine between the signatures before gains and the examples.
    pub cosine: f64,
}

impl Prior {
    /// Weights, normalises and interpolates the signatures, then fits one gain per channel by ridge regression
    /// towards the common gain: `g_k = (sum_i u_ik z_ik + a g) / (sum_i u_ik^2 + a)`.
    pub(super) fn new(map: &SignatureMap, design: &Design) -> Result<Self, LocatorError> {
        let (c, n) = (map.channels, design.positions_m.len());
        check_length("signature map channels", design.weights.len(), c)?;
        let mut over_map = Mat::from_fn(map.len(), c, |p, k| map.signatures[p * c + k] * design.weights[k]);
        for p in 0..map.len() {
            let norm = (0..c).map(|k| over_map[(p, k)] * over_map[(p, k)]).sum::<f64>().sqrt();
            if norm > 0.0 {
                scale_row(&mut over_map, p, 1.0 / norm);
            }
        }
        let mut at_examples = Mat::<f64>::zeros(n, c);
        for i in 0..n {
            for (p, share) in nearest(&map.positions_m, design.positions_m[i]) {
                for k in 0..c {
                    at_examples[(i, k)] += share * over_map[(p, k)];
                }
            }
        }
        let mut prior = Self { at_examples, over_map, cosine: 0.0 };
        prior.apply_gains(design);
        Ok(prior)
    }

    fn apply_gains(&mut self, design: &Design) {
        let (n, c) = (self.at_examples.nrows(), self.at_examples.ncols());
        let product = |k: usize| (0..n).map(|i| self.at_examples[(i, k)] * design.z[(i, k)]).sum::<f64>();
        let square = |k: usize| (0..n).map(|i| self.at_examples[(i, k)].powi(2)).sum::<f64>();
        let products: Vec<f64> = (0..c).map(product).collect();
        let squares: Vec<f64> = (0..c).map(square).collect();
        let total: f64 = squares.iter().sum();
        if total == 0.0 {
            return;
        }
        let common = products.iter().sum::<f64>() / total;
        let ridge = GAIN_PRIOR_EXAMPLES * total / (n * c) as f64;
        self.cosine = products.iter().sum::<f64>() / (total * n as f64).sqrt();
        for k in 0..c {
            let gain = (products[k] + ridge * common) / (squares[k] + ridge);
            for i in 0..n {
                self.at_examples[(i, k)] *= gain;
            }
            for p in 0..self.over_map.nrows() {
                self.over_map[(p, k)] *= gain;
            }
        }
    }

    /// The given rows of the part at the examples, with the whole map.
    pub(super) fn subset(&self, rows: &[usize]) -> Self {
        let at_examples = Mat::from_fn(rows.len(), self.at_examples.ncols(), |i, k| self.at_examples[(rows[i], k)]);
        Self { at_examples, over_map: self.over_map.clone(), cosine: self.cosine }
    }
}

/// The four nearest map positions and their weights by inverse square distance.
pub(super) fn nearest(positions: &[[f64; 2]], at: [f64; 2]) -> Vec<(usize, f64)> {
    let mut best: Vec<(usize, f64)> = Vec::with_capacity(5);
    for (p, position) in positions.iter().enumerate() {
        let d2 = squared_distance(*position, at);
        if best.len() < 4 || d2 < best[3].1 {
            let slot = best.partition_point(|b| b.1 <= d2);
            best.insert(slot, (p, d2));
            best.truncate(4);
        }
    }
    let soft = 1e-4 * best[best.len() - 1].1 + f64::MIN_POSITIVE;
    let total: f64 = best.iter().map(|b| 1.0 / (b.1 + soft)).sum();
    best.iter().map(|b| (b.0, 1.0 / ((b.1 + soft) * total))).collect()
}

/// Orthonormal directions (channels by rank) that span examples and prior. `None` if there are at most `max_rank`
/// channels, since no projection is needed.
pub(super) fn basis(design: &Design, prior: &Prior, max_rank: usize) -> Result<Option<Mat<f64>>, LocatorError> {
    let (n, c, g) = (design.z.nrows(), design.z.ncols(), prior.over_map.nrows());
    if c <= max_rank {
        return Ok(None);
    }
    let from_map = g.min(256);
    let n_used = n.min(768);
    let rows = Mat::from_fn(n_used + from_map, c, |i, k| {
        if i < n_used { design.z[(i * n / n_used, k)] } else { prior.over_map[((i - n_used) * g / from_map, k)] }
    });
    let gram = &rows * rows.transpose();
    let eigen =
        gram.self_adjoint_eigen(Side::Lower).map_err(|_| LocatorError::Singular { what: "Gram matrix of frames" })?;
    let values = eigen.S().column_vector();
    let largest = values[values.nrows() - 1];
    let kept: Vec<usize> = (0..values.nrows()).rev().take(max_rank).filter(|&j| values[j] > 1e-10 * largest).collect();
    let combine = Mat::from_fn(rows.nrows(), kept.len(), |i, j| eigen.U()[(i, kept[j])] / values[kept[j]].sqrt());
    Ok(Some(rows.transpose() * &combine))
}
