//! Mean readings over frames, and their difference from other readings.

use super::frame::DamageFrame;

/// Time constant of the mean readings, seconds.
const MEAN_S: f64 = 0.4;
/// Minimum effective number of frames in the mean.
const FEWEST_IN_MEAN: f64 = 12.0;

/// Mean of the readings over related frames.
#[derive(Debug, Default)]
pub(super) struct Readings {
    pub mean: Vec<f64>,
    pub frames: usize,
    last_ns: u64,
}

impl Readings {
    pub fn with_capacity(channels: usize) -> Self {
        Self { mean: Vec::with_capacity(channels), ..Self::default() }
    }

    /// Restarts the mean.
    pub fn restart(&mut self) {
        self.frames = 0;
    }

    /// Adds the readings of a frame.
    pub fn add(&mut self, time_ns: u64, raw: &[f64]) {
        let elapsed_s = time_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        self.last_ns = time_ns;
        self.frames += 1;
        // Even at low frame rates, average several frames.
        let follow = (-(-elapsed_s / MEAN_S).exp_m1()).min(1.0 / FEWEST_IN_MEAN);
        let gain = if self.frames == 1 { 1.0 } else { (1.0 / self.frames as f64).max(follow) };
        if self.frames == 1 {
            self.mean.clear();
            self.mean.extend_from_slice(raw);
        }
        for (mean, &value) in self.mean.iter_mut().zip(raw) {
            *mean = if mean.is_finite() && value.is_finite() { *mean + gain * (value - *mean) } else { value };
        }
    }
}

/// Difference of mean readings from others, model volts, NaN in excluded channels.
pub(super) fn mean_difference(mean: &[f64], from: &[f64], frame: &DamageFrame<'_>) -> Vec<f64> {
    let change = |(channel, scale): (usize, &f64)| {
        let left_out = frame.difference[channel].is_nan();
        if left_out { f64::NAN } else { scale * (mean[channel] - from[channel]) }
    };
    frame.scale.iter().enumerate().map(change).collect()
}
