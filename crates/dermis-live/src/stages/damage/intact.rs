//! The intact skin, and the difference of each frame from it. The reference stays unchanged until no damage is left.

use dermis_touch::Baseline;

use super::frame::DamageFrame;
use super::readings::mean_difference;

/// A frame matches the intact skin if it is off by at most this many standard deviations, RMS over the channels.
/// Noise alone gives 1.0, to within 0.05 for 208 channels. With the noise of a reference made from few frames, and
/// with drift, values of 1.1 to 1.5 were observed.
const AS_INTACT_SIGMA: f64 = 2.0;

/// The reference for judging damage, and the current frame against it.
#[derive(Debug)]
pub(super) struct IntactReference {
    /// Readings of the intact skin, and the drift factor at the time they were taken.
    readings: Vec<f64>,
    drift: f64,
    record: usize,
    /// Drift factor from then to the current frame.
    drift_since: f64,
    difference: Vec<f64>,
    image: Vec<f32>,
    stands: bool,
}

impl IntactReference {
    pub fn new(channels: usize, pixels: usize) -> Self {
        Self {
            readings: vec![f64::NAN; channels],
            drift: 1.0,
            record: 0,
            drift_since: 1.0,
            difference: vec![0.0; channels],
            image: vec![f32::NAN; pixels],
            stands: false,
        }
    }

    /// True once there is a reference.
    pub fn stands(&self) -> bool {
        self.stands
    }

    /// Index of the reference among the baselines used.
    pub fn record(&self) -> Option<usize> {
        self.stands.then_some(self.record)
    }

    /// Readings of the intact skin.
    pub fn readings(&self) -> &[f64] {
        &self.readings
    }

    /// Makes the latest baseline the intact reference.
    pub fn set(&mut self, baseline: &Baseline) {
        self.set_readings(baseline.baseline(), baseline.drift_factor());
        self.record = baseline.records().len().saturating_sub(1);
        self.stands = true;
    }

    /// Makes these readings, with the drift factor at that time, the intact reference.
    pub fn set_readings(&mut self, readings: &[f64], drift: f64) {
        self.readings.copy_from_slice(readings);
        self.drift = drift;
    }

    /// Computes a frame's difference from the intact skin. Returns the data to image, and the image to write.
    pub fn compare(&mut self, baseline: &Baseline, difference: &[f64], scale: &[f64]) -> (&[f64], &mut [f32]) {
        self.drift_since = baseline.drift_factor() / self.drift;
        for (channel, value) in self.difference.iter_mut().enumerate() {
            let left_out = difference[channel].is_nan();
            let change = scale[channel] * (baseline.raw()[channel] - self.drift_since * self.readings[channel]);
            *value = if left_out { f64::NAN } else { change };
        }
        (&self.difference, &mut self.image)
    }

    /// As `compare` for mean readings, without some channels.
    pub fn compare_mean(
        &mut self,
        mean: &[f64],
        baseline: &Baseline,
        scale: &[f64],
        left_out: &[u32],
    ) -> (&[f64], &mut [f32]) {
        self.drift_since = baseline.drift_factor() / self.drift;
        for (channel, value) in self.difference.iter_mut().enumerate() {
            *value = scale[channel] * (mean[channel] - self.drift_since * self.readings[channel]);
        }
        left_out.iter().for_each(|&channel| self.difference[channel as usize] = f64::NAN);
        (&self.difference, &mut self.image)
    }

    /// Difference of the current frame, model volts, NaN in excluded channels.
    pub fn difference(&self) -> &[f64] {
        &self.difference
    }

    /// True if the current frame matches the intact skin to within noise (model volts, one value per channel).
    pub fn is_read(&self, noise: &[f64]) -> bool {
        let ratios = self.difference.iter().zip(noise).map(|(difference, sigma)| (difference / sigma).powi(2));
        let (mut sum, mut channels) = (0.0, 0.0_f64);
        for ratio in ratios.filter(|ratio| ratio.is_finite()) {
            sum += ratio;
            channels += 1.0;
        }
        self.stands && channels > 0.0 && sum <= AS_INTACT_SIGMA * AS_INTACT_SIGMA * channels
    }

    /// Image of that difference.
    pub fn image(&self) -> &[f32] {
        &self.image
    }

    /// Difference of mean readings, of the free or of a warm skin, model volts, NaN in excluded channels.
    pub fn change_of(&self, mean: &[f64], frame: &DamageFrame<'_>) -> Vec<f64> {
        let intact: Vec<f64> = self.readings.iter().map(|value| self.drift_since * value).collect();
        mean_difference(mean, &intact, frame)
    }
}
