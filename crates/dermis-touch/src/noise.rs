//! Statistics of noise: running means and variances per channel, the full covariance with shrinkage, and the
//! signal-to-noise ratios of the published skins, each under its own name because they differ.

use crate::error::{TouchError, require_length};
use faer::prelude::*;
use serde::{Deserialize, Serialize};

/// Count, mean and variance of every channel of a stream, by Welford's recurrence (Technometrics 4 (1962) 419).
///
/// Values that are not finite are ignored, so channels may have different counts.
#[derive(Debug, Clone, PartialEq)]
pub struct RunningStats {
    count: Vec<u64>,
    mean: Vec<f64>,
    /// Sum of squared deviations from the mean.
    squares: Vec<f64>,
}

impl RunningStats {
    /// Statistics for frames of `channels` values.
    #[must_use]
    pub fn new(channels: usize) -> Self {
        Self { count: vec![0; channels], mean: vec![0.0; channels], squares: vec![0.0; channels] }
    }

    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.count.len()
    }

    /// Adds one frame.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn push(&mut self, frame: &[f64]) -> Result<(), TouchError> {
        require_length("frame", self.channels(), frame.len())?;
        for (channel, &value) in frame.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            self.count[channel] += 1;
            let before = value - self.mean[channel];
            self.mean[channel] += before / self.count[channel] as f64;
            self.squares[channel] += before * (value - self.mean[channel]);
        }
        Ok(())
    }

    /// Resets all statistics.
    pub fn reset(&mut self) {
        self.count.fill(0);
        self.mean.fill(0.0);
        self.squares.fill(0.0);
    }

    /// Number of finite values in a channel.
    #[must_use]
    pub fn count(&self, channel: usize) -> u64 {
        self.count[channel]
    }

    /// Mean of a channel, in its units; NaN without values.
    #[must_use]
    pub fn mean(&self, channel: usize) -> f64 {
        if self.count[channel] == 0 { f64::NAN } else { self.mean[channel] }
    }

    /// Unbiased variance of a channel (divided by count - 1), in its units squared; NaN with fewer than two values.
    #[must_use]
    pub fn variance(&self, channel: usize) -> f64 {
        if self.count[channel] < 2 { f64::NAN } else { self.squares[channel] / (self.count[channel] - 1) as f64 }
    }

    /// Square root of [`RunningStats::variance`].
    #[must_use]
    pub fn std(&self, channel: usize) -> f64 {
        self.variance(channel).sqrt()
    }
}

/// Definition of a signal-to-noise ratio.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SnrDefinition {
    /// 10 log10(mean V / std V), as printed in the paper on the ionic-liquid skin: ten times the logarithm of an
    /// amplitude ratio, half of [`SnrDefinition::Amplitude`].
    IonicAsPrinted,
    /// 10 log10(sum V^2 / sum (V - mean V)^2), equation 5 of the paper on the self-healing skin: a ratio of energies.
    HealingEnergy,
    /// 20 log10(mean V / std V): the amplitude ratio in decibels.
    Amplitude,
}

impl SnrDefinition {
    /// The formula, for tables.
    #[must_use]
    pub fn formula(self) -> &'static str {
        match self {
            Self::IonicAsPrinted => "10 log10(mean V / std V)",
            Self::HealingEnergy => "10 log10(sum V^2 / sum (V - mean V)^2)",
            Self::Amplitude => "20 log10(mean V / std V)",
        }
    }
}

/// The signal-to-noise ratio of one channel, dB.
///
/// It uses the absolute value of the mean, since a channel's sign depends on wiring; std is [`RunningStats::std`]
/// (divided by count - 1). Infinite without noise, minus infinity for a zero mean in the two amplitude ratios, NaN
/// with fewer than two values or if signal and noise are both zero.
#[must_use]
pub fn snr_db(definition: SnrDefinition, stats: &RunningStats, channel: usize) -> f64 {
    if stats.count(channel) < 2 {
        return f64::NAN;
    }
    let ratio = stats.mean(channel).abs() / stats.std(channel);
    match definition {
        SnrDefinition::IonicAsPrinted => 10.0 * ratio.log10(),
        SnrDefinition::Amplitude => 20.0 * ratio.log10(),
        SnrDefinition::HealingEnergy => {
            let noise = stats.squares[channel];
            let signal = stats.count(channel) as f64 * stats.mean(channel).powi(2) + noise;
            10.0 * (signal / noise).log10()
        }
    }
}

/// A signal-to-noise ratio over all channels, dB. NaN if no channel has a finite one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SnrSummary {
    /// Definition of the ratio.
    pub definition: SnrDefinition,
    /// Mean of the channels' decibels, as in the papers.
    pub mean_db: f64,
    /// Smallest ratio.
    pub min_db: f64,
    /// Largest ratio.
    pub max_db: f64,
    /// Number of channels averaged.
    pub channels: usize,
    /// Number of channels ignored because their ratio is not finite.
    pub left_out: usize,
}

/// [`snr_db`] averaged over the channels in which it is finite.
#[must_use]
pub fn average_snr_db(definition: SnrDefinition, stats: &RunningStats) -> SnrSummary {
    let (mut sum, mut min, mut max, mut channels) = (0.0, f64::INFINITY, f64::NEG_INFINITY, 0usize);
    for db in (0..stats.channels()).map(|channel| snr_db(definition, stats, channel)).filter(|db| db.is_finite()) {
        (sum, min, max, channels) = (sum + db, db.min(min), db.max(max), channels + 1);
    }
    let left_out = stats.channels() - channels;
    if channels == 0 {
        (min, max) = (f64::NAN, f64::NAN);
    }
    SnrSummary { definition, mean_db: sum / channels as f64, min_db: min, max_db: max, channels, left_out }
}

/// Target towards which a sample covariance is shrunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShrinkageTarget {
    /// The identity times the mean variance, as in Ledoit and Wolf: for channels of similar noise.
    ScaledIdentity,
    /// The diagonal of the channels' own variances: the same method on channels scaled to unit variance, then scaled
    /// back. For instruments whose channels differ by orders of magnitude.
    #[default]
    Diagonal,
}

/// A covariance of channels, well conditioned by shrinkage: S* = (1 - shrinkage) S + shrinkage T.
///
/// The shrinkage minimises the expected squared error, estimated as in O. Ledoit and M. Wolf, *A well-conditioned
/// estimator for large-dimensional covariance matrices*, J. Multivariate Analysis 88 (2004) 365, lemmas 3.2 to 3.5.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariance {
    /// Number of channels n.
    pub channels: usize,
    /// Number of frames it is estimated from.
    pub frames: usize,
    /// Mean of every channel.
    pub mean: Vec<f64>,
    /// n x n, row-major, symmetric, channel units squared. The sample part is divided by the number of frames, as in
    /// the paper.
    pub matrix: Vec<f64>,
    /// Weight of the target, from 0 (the sample covariance, with enough frames) to 1 (the target).
    pub shrinkage: f64,
}

impl Covariance {
    /// Estimates the covariance from `frames`, one after another, each of `channels` values, of an untouched skin.
    ///
    /// Memory and time are proportional to `channels` squared.
    ///
    /// # Errors
    /// [`TouchError::Length`] if the values do not fill whole frames, [`TouchError::TooFewFrames`] below 2 frames,
    /// [`TouchError::NonFinite`] with the index of the value: exclude such channels beforehand.
    pub fn ledoit_wolf(frames: &[f64], channels: usize, target: ShrinkageTarget) -> Result<Self, TouchError> {
        let count = frames.len().checked_div(channels).unwrap_or(0);
        require_length("frames", count * channels, frames.len())?;
        if count < 2 {
            return Err(TouchError::TooFewFrames { what: "covariance", expected: 2, got: count });
        }
        if let Some((index, &value)) = frames.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            return Err(TouchError::NonFinite { what: "frames", index, value });
        }
        let sample = Mat::from_fn(channels, count, |channel, frame| frames[frame * channels + channel]);
        let mean: Vec<f64> =
            (0..channels).map(|channel| sample.row(channel).iter().sum::<f64>() / count as f64).collect();
        let mut deviations = sample;
        let scale = centre_and_scale(&mut deviations, &mean, target);
        let (matrix, shrinkage) = shrink(&deviations);
        let matrix = (0..channels * channels)
            .map(|index| (index / channels, index % channels))
            .map(|(row, column)| matrix[(row, column)] * scale[row] * scale[column])
            .collect();
        Ok(Self { channels, frames: count, mean, matrix, shrinkage })
    }

    /// Variance of one channel.
    #[must_use]
    pub fn variance(&self, channel: usize) -> f64 {
        self.matrix[channel * self.channels + channel]
    }

    /// The weights W = covariance^-1, n x n, row-major, by Cholesky factorisation of the correlation matrix.
    ///
    /// # Errors
    /// [`TouchError::SingularCovariance`], for example if a channel never changes.
    pub fn inverse(&self) -> Result<Vec<f64>, TouchError> {
        let n = self.channels;
        let smallest = (0..n).map(|channel| self.variance(channel)).fold(f64::INFINITY, f64::min);
        let singular = TouchError::SingularCovariance { channels: n, smallest_variance: smallest };
        if smallest.is_nan() || smallest <= 0.0 {
            return Err(singular);
        }
        let deviation: Vec<f64> = (0..n).map(|channel| self.variance(channel).sqrt()).collect();
        let correlation =
            Mat::from_fn(n, n, |row, column| self.matrix[row * n + column] / (deviation[row] * deviation[column]));
        let factor = correlation.llt(faer::Side::Lower).map_err(|_| singular)?;
        let inverse = factor.solve(Mat::<f64>::identity(n, n));
        let entry = |row: usize, column: usize| 0.5 * (inverse[(row, column)] + inverse[(column, row)]);
        Ok((0..n * n)
            .map(|index| (index / n, index % n))
            .map(|(row, column)| entry(row, column) / (deviation[row] * deviation[column]))
            .collect())
    }
}

/// Turns values (channels x frames) into deviations from the mean, scaled to unit variance if the target requires it.
/// Returns the factors that undo the scaling.
fn centre_and_scale(values: &mut Mat<f64>, mean: &[f64], target: ShrinkageTarget) -> Vec<f64> {
    let frames = values.ncols() as f64;
    let mut scale = vec![1.0; mean.len()];
    for (channel, mean) in mean.iter().enumerate() {
        let mut squares = 0.0;
        for frame in 0..values.ncols() {
            values[(channel, frame)] -= mean;
            squares += values[(channel, frame)].powi(2);
        }
        if target == ShrinkageTarget::Diagonal {
            // Constant channels stay constant: their target is a variance of 0.
            scale[channel] = (squares / frames).sqrt();
        }
        if target == ShrinkageTarget::Diagonal && squares > 0.0 {
            for frame in 0..values.ncols() {
                values[(channel, frame)] /= scale[channel];
            }
        }
    }
    scale
}

/// The shrunk covariance of deviations (channels x frames), and the shrinkage.
///
/// With <A, B> = tr(A B') / n: m = <S, I>, d^2 = |S - m I|^2, b^2 = min(d^2, (1/k^2) sum_f |x_f x_f' - S|^2),
/// shrinkage b^2 / d^2. The sum is (sum_f |x_f|^4) / n - k |S|^2, since the x_f x_f' average to S.
fn shrink(deviations: &Mat<f64>) -> (Mat<f64>, f64) {
    let (channels, frames) = (deviations.nrows() as f64, deviations.ncols() as f64);
    let mut sample = deviations * deviations.transpose() * faer::Scale(1.0 / frames);
    let n = sample.nrows();
    let mean_variance = (0..n).map(|i| sample[(i, i)]).sum::<f64>() / channels;
    let norm_squared = sample.squared_norm_l2() / channels;
    let dispersion = norm_squared - mean_variance * mean_variance;
    let fourth: f64 = (0..deviations.ncols()).map(|frame| deviations.col(frame).squared_norm_l2().powi(2)).sum();
    let error = ((fourth / channels - frames * norm_squared) / (frames * frames)).max(0.0);
    // If the sample equals its target, no dispersion is left to divide by.
    let shrinkage = if dispersion > f64::EPSILON * norm_squared { (error / dispersion).min(1.0) } else { 1.0 };
    for column in 0..n {
        for row in 0..n {
            sample[(row, column)] *= 1.0 - shrinkage;
        }
        sample[(column, column)] += shrinkage * mean_variance;
    }
    (sample, shrinkage)
}
