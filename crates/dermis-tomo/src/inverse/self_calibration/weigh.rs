//! Reweights channels with frames of two touches.

use super::batch::{Batch, Peak};
use super::pair::Explained;
use super::{PairSearch, SelfCalibration, TouchTemplates};

/// Maximum number of frames used, evenly spaced.
const MOST_FRAMES: usize = 240;
/// Number of rounds of explaining and reweighting.
const ROUNDS: usize = 4;

/// Explanation of a calibration frame.
enum By {
    One(Peak),
    Two(Explained),
}

impl SelfCalibration {
    /// Reweights the channels with the frames of the fit, assuming that some of them contain two touches, at least
    /// `apart_m` apart. In those frames, channels are not penalised for what a single touch cannot explain. `are_two`
    /// decides whether a frame has two touches, given the share of its energy left by the best single place, the share
    /// left by the best two, and the strength of the weaker touch relative to the stronger. Nothing changes if no frame
    /// has two.
    pub fn weigh_with_pairs(
        &mut self,
        templates: &TouchTemplates,
        frames: &[Vec<f64>],
        apart_m: f64,
        are_two: impl Fn(f64, f64, f64) -> bool,
    ) {
        let matched = self.matched_rows(templates);
        let step = frames.len().div_ceil(MOST_FRAMES).max(1);
        let batches: Vec<Batch> =
            frames.iter().step_by(step).map(|frame| Batch::new(&[frame], &self.data_scale)).collect();
        for _ in 0..ROUNDS {
            let search = self.pair_search(apart_m);
            let explained: Vec<(By, f64)> =
                batches.iter().map(|batch| self.explain(batch, &search, &are_two)).collect();
            if explained.iter().all(|(by, _)| matches!(by, By::One(_))) {
                break;
            }
            for channel in 0..self.weights.len() {
                let (mut sum, mut count) = (0.0, 0.0);
                for (batch, (by, _)) in batches.iter().zip(&explained) {
                    if batch.present[(channel, 0)] > 0.0 {
                        let of_model = match by {
                            By::One(peak) => peak.amplitude * matched[(peak.place, channel)],
                            By::Two(two) => (0..2).map(|k| two.amplitudes[k] * matched[(two.places[k], channel)]).sum(),
                        };
                        sum += (batch.values[(channel, 0)] - of_model).powi(2);
                        count += 1.0;
                    }
                }
                if self.weights[channel] > 0.0 && count > 0.0 {
                    self.weights[channel] = 1.0 / (sum / count + self.options.noise_floor).sqrt();
                }
            }
            self.set_filter(&matched);
            let mut left: Vec<f64> = explained.iter().map(|(_, left)| *left).collect();
            left.sort_by(f64::total_cmp);
            self.score = (1.0 - left[left.len() / 2]).max(0.0).sqrt();
        }
    }

    /// Explains the only frame in a batch, and returns the share of its energy left unexplained.
    fn explain(&self, batch: &Batch, search: &PairSearch, are_two: &impl Fn(f64, f64, f64) -> bool) -> (By, f64) {
        let peak = self.peaks(batch).remove(0);
        let one = 1.0 - peak.score.max(0.0).powi(2);
        if let Some((projected, two)) = self.best_pair(batch, search) {
            let left = projected.left_by(&two);
            let [a, b] = two.amplitudes;
            if are_two(one, left, a.min(b) / a.max(b)) {
                return (By::Two(two), left);
            }
        }
        (By::One(peak), one)
    }
}
