//! Converts a raw frame into the inputs of the two experts.
//!
//! u = w f / |w f|: weighted by the channels' noise and scaled to unit length, so that a light touch looks like a
//! hard one. The forward expert sees u, or u companded: t_k = asinh(u_k / m_k), again scaled to unit length, where
//! m_k is the median of the channel's |u_k|. Companding stops a few strong channels from dominating. The inverse
//! expert sees u and its signed square root.

use crate::locator::data::{Examples, MIN_CHANNELS};
use crate::locator::design::channel_weights;
use crate::locator::error::{LocatorError, check_first, check_length};
use crate::statistics::median;

/// Lower bound on a channel's median, as a share of the median channel's.
const SMALLEST_MEDIAN: f64 = 0.2;

/// Scales frames to unit length and compands them.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Features {
    /// Weight of each channel; 0 if it is never used.
    pub weights: Vec<f64>,
    /// Mean square of each channel of u: the part of the squared length lost if the channel is missing.
    pub energy: Vec<f64>,
    /// Median |u_k| of each channel, with a lower bound.
    pub medians: Vec<f64>,
    /// True if the forward expert sees companded frames.
    pub companded: bool,
}

impl Features {
    /// Learns weights, energies and medians from the examples.
    pub(super) fn new(examples: &Examples) -> Result<Self, LocatorError> {
        let c = examples.channels;
        let weights = channel_weights(examples);
        let mut features = Self { weights, energy: vec![1.0; c], medians: vec![1.0; c], companded: false };
        let mut u = vec![0.0; c];
        let mut seen: Vec<Vec<f64>> = vec![Vec::with_capacity(examples.len()); c];
        for (i, frame) in examples.frames.chunks_exact(c).enumerate() {
            features.unit(frame, &mut u).map_err(|error| in_frame(error, i))?;
            for k in 0..c {
                if features.usable(frame, k) {
                    seen[k].push(u[k].abs());
                }
            }
        }
        for k in 0..c {
            let count = seen[k].len().max(1) as f64;
            features.energy[k] = seen[k].iter().map(|v| v * v).sum::<f64>() / count;
            features.medians[k] = if seen[k].is_empty() { 0.0 } else { median(&seen[k]) };
        }
        let alive: Vec<f64> = features.medians.iter().copied().filter(|m| *m > 0.0).collect();
        let typical = if alive.is_empty() { 1.0 } else { median(&alive) };
        features.medians.iter_mut().for_each(|m| *m = m.max(SMALLEST_MEDIAN * typical));
        Ok(features)
    }

    fn usable(&self, frame: &[f64], k: usize) -> bool {
        self.weights[k] > 0.0 && frame[k].is_finite()
    }

    /// Writes u, zero where a channel is missing, at the length it would have if complete. Returns the RMS of the
    /// weighted frame and the share of a typical frame's energy that was measured.
    pub(super) fn unit(&self, frame: &[f64], u: &mut [f64]) -> Result<(f64, f64), LocatorError> {
        let (mut sum, mut count, mut lost, mut total) = (0.0, 0, 0.0, 0.0);
        for k in 0..frame.len() {
            u[k] = 0.0;
            total += self.energy[k];
            if self.usable(frame, k) {
                u[k] = frame[k] * self.weights[k];
                sum += u[k] * u[k];
                count += 1;
            } else if self.weights[k] > 0.0 {
                lost += self.energy[k];
            }
        }
        if count < MIN_CHANNELS {
            return Err(LocatorError::TooFewChannels { frame: 0, got: count, expected: MIN_CHANNELS });
        }
        if !(sum > 0.0 && sum.is_finite()) {
            return Err(LocatorError::EmptyFrame { frame: 0 });
        }
        let seen = if total > 0.0 { ((total - lost) / total).clamp(0.01, 1.0) } else { 1.0 };
        let scale = (seen / sum).sqrt();
        u.iter_mut().for_each(|v| *v *= scale);
        Ok(((sum / seen / frame.len() as f64).sqrt(), seen))
    }

    /// The forward expert's input: u or t, times the amplitude; NaN where `frame` is missing.
    pub(super) fn forward(&self, frame: &[f64], u: &[f64], amplitude: f64, out: &mut [f64]) {
        let mut sum = 0.0;
        for k in 0..u.len() {
            out[k] = self.compand(k, u[k]);
            sum += out[k] * out[k];
        }
        let length = (u.iter().map(|v| v * v).sum::<f64>() / sum).sqrt();
        let scale = amplitude * (u.len() as f64).sqrt() * length;
        for k in 0..u.len() {
            out[k] = if self.usable(frame, k) { out[k] * scale } else { f64::NAN };
        }
    }

    /// t_k before scaling to unit length, or u_k without companding.
    pub(super) fn compand(&self, k: usize, u: f64) -> f64 {
        if self.companded { (u / self.medians[k]).asinh() } else { u }
    }

    /// Number of values in the inverse expert's input.
    pub(super) fn inverse_len(&self) -> usize {
        2 * self.weights.len()
    }

    /// The inverse expert's input: u and sign(u) sqrt(|u|), each scaled to unit length.
    pub(super) fn inverse(u: &[f64], out: &mut [f64]) {
        let (plain, roots) = out.split_at_mut(u.len());
        let (mut square, mut sum) = (0.0, 0.0);
        for k in 0..u.len() {
            square += u[k] * u[k];
            sum += u[k].abs();
        }
        let (a, b) = (square.sqrt().recip(), sum.sqrt().recip());
        for k in 0..u.len() {
            plain[k] = u[k] * a;
            roots[k] = u[k].abs().sqrt().copysign(u[k]) * b;
        }
    }

    /// Rejects arrays that do not match.
    pub(super) fn check(&self) -> Result<(), LocatorError> {
        let c = self.weights.len();
        check_length("features energy", c, self.energy.len())?;
        check_length("features medians", c, self.medians.len())?;
        let sound = |v: f64| v.is_finite() && v >= 0.0;
        check_first("features weights", self.weights.iter().copied(), sound, "a finite number, zero or above")?;
        check_first("features energy", self.energy.iter().copied(), sound, "a finite number, zero or above")?;
        let above = |v: f64| v.is_finite() && v > 0.0;
        check_first("features medians", self.medians.iter().copied(), above, "a finite number above zero")
    }
}

/// Adds the frame's index to an error.
pub(super) fn in_frame(error: LocatorError, index: usize) -> LocatorError {
    match error {
        LocatorError::TooFewChannels { got, expected, .. } => {
            LocatorError::TooFewChannels { frame: index, got, expected }
        }
        LocatorError::EmptyFrame { .. } => LocatorError::EmptyFrame { frame: index },
        other => other,
    }
}

/// Fills an example's missing channels with the mean of its nearest neighbours that have them.
pub(super) fn fill_from_neighbours(units: &mut [Vec<f64>], present: &[Vec<bool>], positions: &[[f64; 2]]) {
    const NEIGHBOURS: usize = 8;
    let original: Vec<Vec<f64>> = units.to_vec();
    for i in 0..units.len() {
        if present[i].iter().all(|p| *p) {
            continue;
        }
        let mut order: Vec<usize> = (0..units.len()).filter(|j| *j != i).collect();
        let distance = |j: usize| crate::plane::squared_distance(positions[i], positions[j]);
        order.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        for k in 0..present[i].len() {
            if present[i][k] {
                continue;
            }
            let found: Vec<f64> =
                order.iter().filter(|j| present[**j][k]).take(NEIGHBOURS).map(|j| original[*j][k]).collect();
            units[i][k] = if found.is_empty() { 0.0 } else { found.iter().sum::<f64>() / found.len() as f64 };
        }
    }
}
