//! Whether a frame shows all of several touches: a ratio of likelihoods, with their strengths integrated out.

use super::{MOST_TOUCHES, Superposition, SuperpositionScratch};

/// Minimum error of the map, relative to the typical strength at a place.
const MAP_ERROR: f64 = 0.1;
/// Minimum variance of errors, relative to the squared median poke: single precision hides smaller ones.
const LEAST_VARIANCE: f64 = 1e-9;

impl Superposition {
    /// Evidence that a part of the trial is a touch, in standard deviations: (2 ln b)^1/2, with b how many times as
    /// probable the frame is with it as without, 0 if it isn't. The strengths of all parts are integrated out. That of
    /// a touch is about the strength t that is typical at its place, a ~ N(t, t^2). Without a touch, the map's error
    /// looks like one, a ~ N(0, (`MAP_ERROR` t)^2).
    pub(super) fn evidence(&self, scratch: &SuperpositionScratch, part: usize) -> f64 {
        let ratio = self.log_likelihood(scratch, None) - self.log_likelihood(scratch, Some(part));
        (2.0 * ratio).max(0.0).sqrt()
    }

    /// Logarithm of a frame's likelihood if all parts of the trial are touches but `absent`, up to a constant. With
    /// y = S'a + e, e ~ N(0, v I) and a ~ N(m, D), it is (r' Q^-1 r - m' D^-1 m - ln |Q D|) / 2, where
    /// Q = S S'/v + D^-1 and r = S y/v + D^-1 m. As far as errors aren't noise, they grow and fall with the frame's
    /// strength. A single touch that stands for two is up to twice as strong, so a gain from 1 to 2 says nothing.
    fn log_likelihood(&self, scratch: &SuperpositionScratch, absent: Option<usize>) -> f64 {
        let SuperpositionScratch { along, columns, trial, gain, .. } = scratch;
        let noise = self.map.noise_share;
        let gain = if *gain > 1.0 { (0.5 * gain).max(1.0) } else { *gain };
        let growth = noise + (1.0 - noise) * gain * gain;
        let variance = (growth * self.map.error_variance).max(LEAST_VARIANCE);
        let map_error = growth.sqrt() * MAP_ERROR;
        let mut factor = [[0.0; MOST_TOUCHES]; MOST_TOUCHES];
        let mut solved = [0.0; MOST_TOUCHES];
        let mut twice = 0.0;
        for (row, part) in trial.iter().enumerate() {
            let (typical, column) = (self.typical[part.index], columns.of(part.index));
            let (mean, deviation) = if absent == Some(row) { (0.0, map_error * typical) } else { (typical, typical) };
            for j in 0..=row {
                let own = if j == row { deviation.powi(-2) } else { 0.0 };
                let sum: f64 = (0..j).map(|k| factor[row][k] * factor[j][k]).sum();
                let left = f64::from(column[trial[j].index]) / variance + own - sum;
                factor[row][j] = if j == row { left.max(f64::MIN_POSITIVE).sqrt() } else { left / factor[j][j] };
            }
            let sum: f64 = (0..row).map(|k| factor[row][k] * solved[k]).sum();
            let toward = f64::from(along[part.index]) / variance + mean / deviation.powi(2);
            solved[row] = (toward - sum) / factor[row][row];
            twice += solved[row].powi(2) - (mean / deviation).powi(2) - 2.0 * (factor[row][row] * deviation).ln();
        }
        0.5 * twice
    }
}
