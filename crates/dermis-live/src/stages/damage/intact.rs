//! The intact skin, and how far each frame is from it. The reference stays as it is until nothing is damaged any more.

use dermis_touch::Baseline;

use super::frame::DamageFrame;
use super::readings::mean_difference;

/// A frame reads as the intact skin does if it is off by no more than this many standard deviations, root mean square
/// over the channels. Noise alone makes 1.0, within 0.05 for 208 channels; with the noise of a reference of few frames
/// and with drift it was seen at 1.1 to 1.5.
const AS_INTACT_SIGMA: f64 = 2.0;

/// The reference that damage is judged by, and the frame at hand against it.
#[derive(Debug)]
pub(super) struct IntactReference {
    /// Readings of the intact skin, and the drift that was followed when they were taken.
    readings: Vec<f64>,
    drift: f64,
    record: usize,
    /// Drift since then, up to the frame at hand.
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

    /// Whether there is a reference yet.
    pub fn stands(&self) -> bool {
        self.stands
    }

    /// Place of the reference among the baselines that were in use.
    pub fn record(&self) -> Option<usize> {
        self.stands.then_some(self.record)
    }

    /// Readings of the intact skin.
    pub fn readings(&self) -> &[f64] {
        &self.readings
    }

    /// The baseline just taken is one of the intact skin.
    pub fn set(&mut self, baseline: &Baseline) {
        self.set_readings(baseline.baseline(), baseline.drift_factor());
        self.record = baseline.records().len().saturating_sub(1);
        self.stands = true;
    }

    /// Takes these readings, followed by drift so far, for those of the intact skin.
    pub fn set_readings(&mut self, readings: &[f64], drift: f64) {
        self.readings.copy_from_slice(readings);
        self.drift = drift;
    }

    /// Takes the difference of a frame from the intact skin: what is to be imaged, and where to.
    pub fn compare(&mut self, baseline: &Baseline, difference: &[f64], scale: &[f64]) -> (&[f64], &mut [f32]) {
        self.drift_since = baseline.drift_factor() / self.drift;
        for (channel, value) in self.difference.iter_mut().enumerate() {
            let left_out = difference[channel].is_nan();
            let change = scale[channel] * (baseline.raw()[channel] - self.drift_since * self.readings[channel]);
            *value = if left_out { f64::NAN } else { change };
        }
        (&self.difference, &mut self.image)
    }

    /// Takes the difference of mean readings from the intact skin, without some channels, in place of a frame's.
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

    /// Difference of the frame at hand, model volts, NaN where channels are left out.
    pub fn difference(&self) -> &[f64] {
        &self.difference
    }

    /// Whether the frame at hand reads as the intact skin does, within noise (model volts, one a channel).
    pub fn is_read(&self, noise: &[f64]) -> bool {
        let ratios = self.difference.iter().zip(noise).map(|(difference, sigma)| (difference / sigma).powi(2));
        let (mut sum, mut channels) = (0.0, 0.0_f64);
        for ratio in ratios.filter(|ratio| ratio.is_finite()) {
            sum += ratio;
            channels += 1.0;
        }
        self.stands && channels > 0.0 && sum <= AS_INTACT_SIGMA * AS_INTACT_SIGMA * channels
    }

    /// Its image.
    pub fn image(&self) -> &[f32] {
        &self.image
    }

    /// Difference of mean readings, of the free skin or of a warm one, model volts, NaN where channels are left out.
    pub fn change_of(&self, mean: &[f64], frame: &DamageFrame<'_>) -> Vec<f64> {
        let intact: Vec<f64> = self.readings.iter().map(|value| self.drift_since * value).collect();
        mean_difference(mean, &intact, frame)
    }
}
