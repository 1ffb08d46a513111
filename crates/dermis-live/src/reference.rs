//! The reference of difference data: a baseline, the factors that convert measured voltages to the model's, and the
//! noise of the channels.

use dermis_tomo::eit::OrderReport;

use dermis_skin::{GainMatch, Modality, Reads, WeightChoice};

pub use crate::channel_noise::MeasuredNoise;

use crate::Error;
use crate::frame_noise::noise_of_frames;
use crate::prepare::Prepared;

/// Minimum number of baseline frames for estimating noise.
const FEWEST_FOR_NOISE: usize = 8;
/// Assumed noise of differences if there are too few frames to estimate it, relative to their RMS.
const ASSUMED_OF_DIFFERENCES: f64 = 0.01;
/// Lower bound on estimated noise, as a share of the assumed noise.
const LEAST_OF_ASSUMED: f64 = 0.02;
/// A channel whose model voltage is below this share of the largest gets no gain of its own.
const SMALLEST_SHARE: f64 = 1e-6;
/// Standard deviation of the channels' gains about the common one. Current that spreads in depth changes them by
/// factors from 0.5 to 1.3.
const GAIN_SPREAD: f64 = 0.3;
/// Error of the model at rest, as a share of its largest voltage, on twins of 32 narrow electrodes.
const MODEL_ERROR: f64 = 0.002;

/// Source of the channel noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseSource {
    /// The scatter of the baseline's frames.
    Baseline,
    /// The scatter of the baselines, where each frame has its own.
    Pairs,
    /// The frames themselves, see [`noise_of_frames`].
    Frames,
    /// The skin file's `touch.assumed_noise_share`.
    Assumed,
}

impl NoiseSource {
    /// Description for users.
    pub fn describe(self) -> &'static str {
        match self {
            Self::Baseline => "measured from the baseline",
            Self::Pairs => "measured from the baselines",
            Self::Frames => "estimated from the frames themselves",
            Self::Assumed => "assumed",
        }
    }
}

/// A baseline that can be compared with the model.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Baseline, as measured, one value per channel (`NaN`: missing).
    pub baseline: Vec<f64>,
    /// Difference data in model volts are `scale * (frame - baseline)`.
    pub scale: Vec<f64>,
    /// Noise standard deviation of difference data, model volts.
    pub noise: Vec<f64>,
    /// Source of `noise`.
    pub noise_source: NoiseSource,
    /// Full noise covariance in model volts (row-major), if the skin file requests it and there were enough frames.
    pub covariance: Option<Vec<f64>>,
    /// Differences of successive baseline frames, as measured: examples of drift and noise.
    pub successive: Vec<Vec<f64>>,
    /// Comparison of the baseline with the model.
    pub order: OrderReport,
    /// Root mean square of the baseline's difference from the model, relative; NaN where there is no baseline to
    /// compare.
    pub misfit: f64,
}

impl Reference {
    /// Makes a reference from baseline frames (channels in the protocol's order). Several frames are averaged. From 8
    /// frames on, their scatter from frame to frame is used as the noise.
    ///
    /// # Errors
    /// No frames, frames of the wrong length, or a baseline that is zero everywhere.
    pub fn of(prepared: &Prepared, frames: &[Vec<f64>]) -> Result<Self, Error> {
        Self::averaged(prepared, frames, frames.len(), NoiseSource::Baseline)
    }

    /// As [`Reference::of`], for frames with one of these baselines each: differences contain the noise of two
    /// frames.
    ///
    /// # Errors
    /// As [`Reference::of`].
    pub fn of_pairs(prepared: &Prepared, baselines: &[Vec<f64>]) -> Result<Self, Error> {
        Self::averaged(prepared, baselines, 1, NoiseSource::Pairs)
    }

    /// As [`Reference::of`], where the baseline of a difference is the mean of `averaged` frames, and the noise, if
    /// there are enough, is `measured`.
    fn averaged(
        prepared: &Prepared,
        frames: &[Vec<f64>],
        averaged: usize,
        measured: NoiseSource,
    ) -> Result<Self, Error> {
        let channels = prepared.channels();
        check_frames("baseline", frames, channels)?;
        let baseline: Vec<f64> = (0..channels).map(|channel| finite_mean(frames.iter().map(|f| f[channel]))).collect();
        let scale = scale_to_model(prepared, &baseline)?;
        let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let assumed = prepared.skin.touch.assumed_noise_share * largest;
        let noise_measured = frames.len() >= FEWEST_FOR_NOISE;
        let mut noise = vec![assumed; channels];
        if noise_measured {
            let deviation: Vec<f64> = (0..channels).map(|channel| successive_deviation(frames, channel)).collect();
            let measured = MeasuredNoise { deviation: &deviation, freedom: freedom_of_successive(frames.len()) };
            // Every difference contains the baseline's own noise.
            let with_baseline = (1.0 + 1.0 / averaged as f64).sqrt();
            take_known(&mut noise, measured.moderated(&baseline).iter().map(|sigma| with_baseline * sigma), &scale);
        }
        let is_wanted = matches!(prepared.skin.imaging.weights, WeightChoice::MeasuredFull);
        let enough = frames.len() >= 2 * FEWEST_FOR_NOISE;
        let covariance = if is_wanted && enough { covariance(frames, &scale)? } else { None };
        let order = prepared.diagnose(&baseline);
        let difference =
            |pair: &[Vec<f64>]| pair[1].iter().zip(&pair[0]).map(|(after, before)| after - before).collect();
        let successive = frames.windows(2).map(difference).collect();
        let noise_source = if noise_measured { measured } else { NoiseSource::Assumed };
        let misfit = if baseline_is_known(prepared) { misfit(&prepared.voltages, &baseline) } else { f64::NAN };
        Ok(Self { baseline, scale, noise, noise_source, covariance, successive, order, misfit })
    }

    /// The reference of frames that are already differences: the baseline is zero, and scaling only restores the
    /// signs lost by rectified readings. The noise comes from [`noise_of_frames`] if there are enough frames.
    ///
    /// # Errors
    /// No frames, frames of the wrong length, or frames that are zero everywhere.
    pub fn of_differences(prepared: &Prepared, frames: &[Vec<f64>]) -> Result<Self, Error> {
        let channels = prepared.channels();
        check_frames("difference", frames, channels)?;
        let scale = signs(prepared);
        let squares = frames.iter().flatten().map(|v| v * v);
        let level = finite_mean(squares).sqrt();
        if level.is_nan() || level <= 0.0 {
            return Err(Error::Frames {
                what: "differences".into(),
                expected: "values that are not all zero".into(),
                got: "zeros, or nothing but missing values".into(),
            });
        }
        let mut reference = Self {
            baseline: vec![0.0; channels],
            scale,
            noise: vec![ASSUMED_OF_DIFFERENCES * level; channels],
            noise_source: NoiseSource::Assumed,
            covariance: None,
            successive: Vec::new(),
            order: prepared.diagnose(&prepared.voltages),
            misfit: f64::NAN,
        };
        reference.estimate_noise(frames);
        Ok(reference)
    }

    /// If the noise is only assumed, estimates it by [`noise_of_frames`] from these difference data, if there are
    /// enough. It never drops below a small share of the assumed noise, so that noise-free frames do not imply
    /// certainty.
    pub fn estimate_noise(&mut self, differences: &[Vec<f64>]) {
        if self.noise_source != NoiseSource::Assumed {
            return;
        }
        let Some(estimate) = noise_of_frames(differences) else { return };
        for (noise, sigma) in self.noise.iter_mut().zip(estimate) {
            let least = LEAST_OF_ASSUMED * *noise;
            *noise = if sigma.is_finite() { sigma.max(least) } else { *noise };
        }
        self.noise_source = NoiseSource::Frames;
    }

    /// Makes a reference from a baseline and its noise, both as measured (`None`: unknown), as the live pipeline has
    /// after a tare.
    ///
    /// # Errors
    /// As [`Reference::of`].
    pub fn from_baseline(
        prepared: &Prepared,
        baseline: &[f64],
        noise: Option<MeasuredNoise<'_>>,
    ) -> Result<Self, Error> {
        let mut reference = Self::of(prepared, std::slice::from_ref(&baseline.to_vec()))?;
        if let Some(measured) = noise {
            take_known(&mut reference.noise, measured.moderated(baseline).into_iter(), &reference.scale);
            reference.noise_source = NoiseSource::Baseline;
        }
        Ok(reference)
    }

    /// Difference data of one frame in model volts, against this baseline or the frame's own.
    pub fn difference(&self, frame: &[f64], own_baseline: Option<&[f64]>) -> Vec<f64> {
        let baseline = own_baseline.unwrap_or(&self.baseline);
        frame.iter().zip(baseline).zip(&self.scale).map(|((f, b), scale)| scale * (f - b)).collect()
    }
}

/// True if each frame has its own baseline: there are equally many, and more than one.
pub fn are_pairs(baselines: &[Vec<f64>], frames: &[Vec<f64>]) -> bool {
    baselines.len() == frames.len() && frames.len() > 1
}

/// Replaces `noise` (model volts) by measured standard deviations where these are known. `scale` converts them to
/// model volts.
fn take_known(noise: &mut [f64], measured: impl Iterator<Item = f64>, scale: &[f64]) {
    for ((noise, sigma), scale) in noise.iter_mut().zip(measured).zip(scale) {
        let volts = sigma * scale.abs();
        if volts.is_finite() && volts > 0.0 {
            *noise = volts;
        }
    }
}

/// The signs that rectified readings have lost; 1 if nothing is rectified or the wiring is unknown.
fn signs(prepared: &Prepared) -> Vec<f64> {
    let backend = &prepared.skin.backend;
    let rectified = backend.reads == Reads::Magnitude && backend.wiring.is_known();
    prepared.voltages.iter().map(|v| if rectified { v.signum() } else { 1.0 }).collect()
}

/// True if a baseline can be compared with the model.
pub(crate) fn baseline_is_known(prepared: &Prepared) -> bool {
    !prepared.skin.backend.differences && prepared.skin.backend.wiring.is_known()
}

/// Relative root mean square difference between a baseline and the model, without signs and after the best common
/// gain.
pub(crate) fn misfit(model: &[f64], baseline: &[f64]) -> f64 {
    let pairs = || model.iter().zip(baseline).filter(|(_, b)| b.is_finite()).map(|(m, b)| (m.abs(), b.abs()));
    let (cross, square) = pairs().fold((0.0, 0.0), |(cross, square), (m, b)| (cross + m * b, square + b * b));
    let gain = cross / square;
    let (off, all) = pairs().fold((0.0, 0.0), |(off, all), (m, b)| (off + (gain * b - m).powi(2), all + m * m));
    (off / all).sqrt()
}

/// Factors from measured differences to model volts.
pub(crate) fn scale_to_model(prepared: &Prepared, baseline: &[f64]) -> Result<Vec<f64>, Error> {
    if !baseline_is_known(prepared) {
        // There is nothing to compare with the model.
        return Ok(signs(prepared));
    }
    let magnitudes = prepared.skin.backend.reads == Reads::Magnitude;
    let model = &prepared.voltages;
    // A rectified reading has lost its sign; restore the model's sign for each channel.
    let sign = |channel: usize| if magnitudes { model[channel].signum() } else { 1.0 };
    let largest = model.iter().map(|v| v.abs()).fold(0.0, f64::max);
    let fit = |members: &mut dyn Iterator<Item = usize>| {
        let (mut cross, mut square) = (0.0, 0.0);
        for channel in members.filter(|&channel| baseline[channel].is_finite()) {
            cross += model[channel] * sign(channel) * baseline[channel];
            square += model[channel] * model[channel];
        }
        if cross != 0.0 { square / cross } else { f64::NAN }
    };
    let channels = 0..model.len();
    let global = fit(&mut channels.clone());
    if !global.is_finite() {
        return Err(Error::Frames {
            what: "baseline".into(),
            expected: "voltages that vary with the channel".into(),
            got: "zeros, or nothing but missing values".into(),
        });
    }
    // Voltages between electrodes cross zero, where the model's error exceeds them. For coils they decay instead, and
    // behind a readout's circuit they cross zero elsewhere.
    let crosses_zero = prepared.skin.modality == Modality::Eit && prepared.skin.backend.circuit.is_none();
    Ok(match prepared.skin.imaging.gain {
        GainMatch::Global => channels.map(|channel| global * sign(channel)).collect(),
        GainMatch::GlobalWithOffset => {
            let signed = |channel: usize| sign(channel) * baseline[channel];
            let factor = slope(model, &channels.clone().map(signed).collect::<Vec<_>>()).unwrap_or(global);
            channels.map(|channel| factor * sign(channel)).collect()
        }
        GainMatch::Drive => {
            let measurements = prepared.protocol.measurements();
            let per_drive: Vec<f64> = (0..prepared.protocol.stimulations().len() as u32)
                .map(|drive| fit(&mut channels.clone().filter(|&c| measurements[c].stimulation == drive)))
                .map(|factor| if factor.is_finite() { factor } else { global })
                .collect();
            channels.map(|c| per_drive[measurements[c].stimulation as usize] * sign(c)).collect()
        }
        GainMatch::Channel => channels
            .map(|channel| {
                let factor = model[channel] / baseline[channel];
                let usable = factor.is_finite() && model[channel].abs() > SMALLEST_SHARE * largest;
                let common = global * sign(channel);
                let own = if crosses_zero { believed(model[channel].abs() / largest) } else { 1.0 };
                if usable { common + own * (factor - common) } else { common }
            })
            .collect(),
    })
}

/// Weight of a channel's own gain against the common one, given its model voltage as a share of the largest. Gains
/// scatter about the common one, and the model is off by a share of its largest voltage. The weight gives the
/// posterior mean if both are normal.
fn believed(share_of_largest: f64) -> f64 {
    let off = MODEL_ERROR / share_of_largest;
    GAIN_SPREAD * GAIN_SPREAD / (GAIN_SPREAD * GAIN_SPREAD + off * off)
}

/// Rejects an empty table of frames, or one with frames of the wrong length. `what` names them in the error.
///
/// # Errors
/// No frames, or a frame that does not have `channels` values.
pub fn check_frames(what: &str, frames: &[Vec<f64>], channels: usize) -> Result<(), Error> {
    if frames.is_empty() {
        let (expected, got) = ("at least one frame".to_string(), "none".to_string());
        return Err(Error::Frames { what: what.to_string(), expected, got });
    }
    match frames.iter().position(|frame| frame.len() != channels) {
        Some(index) => Err(Error::Frames {
            what: format!("{what} frame {index}"),
            expected: format!("{channels} values"),
            got: format!("{} values", frames[index].len()),
        }),
        None => Ok(()),
    }
}

/// 1/g of the regression `measured = g model + b` over the available channels.
fn slope(model: &[f64], measured: &[f64]) -> Option<f64> {
    let present = || model.iter().zip(measured).filter(|(_, v)| v.is_finite());
    let (mean_model, mean) = (finite_mean(present().map(|(f, _)| *f)), finite_mean(present().map(|(_, v)| *v)));
    let square: f64 = present().map(|(f, _)| (f - mean_model).powi(2)).sum();
    let cross: f64 = present().map(|(f, v)| (f - mean_model) * (v - mean)).sum();
    (cross != 0.0).then_some(square / cross).filter(|factor| factor.is_finite())
}

fn finite_mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for value in values.filter(|value| value.is_finite()) {
        sum += value;
        count += 1;
    }
    if count > 0 { sum / count as f64 } else { f64::NAN }
}

/// Standard deviation from successive differences, which slow drift does not affect: `sqrt(mean d^2 / 2)`.
fn successive_deviation(frames: &[Vec<f64>], channel: usize) -> f64 {
    let squares = frames.windows(2).map(|pair| (pair[1][channel] - pair[0][channel]).powi(2));
    (finite_mean(squares) / 2.0).sqrt()
}

/// Degrees of freedom of [`successive_deviation`], from its variance sigma^4 (3n - 4) / (n - 1)^2 for white noise.
fn freedom_of_successive(frames: usize) -> f64 {
    let n = frames as f64;
    2.0 * (n - 1.0).powi(2) / (3.0 * n - 4.0)
}

fn covariance(frames: &[Vec<f64>], scale: &[f64]) -> Result<Option<Vec<f64>>, Error> {
    let channels = scale.len();
    let mut flat = Vec::with_capacity(frames.len() * channels);
    for frame in frames {
        flat.extend(frame.iter().zip(scale).map(|(value, scale)| value * scale));
    }
    if flat.iter().any(|value| !value.is_finite()) {
        return Ok(None);
    }
    let estimate = dermis_touch::Covariance::ledoit_wolf(&flat, channels, dermis_touch::ShrinkageTarget::Diagonal)?;
    Ok(Some(estimate.matrix))
}
