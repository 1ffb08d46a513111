//! What differences are taken against: a baseline, the factors that bring measured voltages to the model's, and the
//! noise of the channels.

use dermis_tomo::eit::OrderReport;

use dermis_skin::{GainMatch, Reads};

use crate::Error;
use crate::prepare::Prepared;

/// Fewest baseline frames from which noise is estimated.
const FEWEST_FOR_NOISE: usize = 8;
/// A channel whose model voltage is below this share of the largest is not matched by itself.
const SMALLEST_SHARE: f64 = 1e-6;

/// A baseline made comparable to the model.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Baseline, as measured, one value a channel (`NaN`: missing).
    pub baseline: Vec<f64>,
    /// Difference data in model volts are `scale * (frame - baseline)`.
    pub scale: Vec<f64>,
    /// Noise standard deviation of difference data, model volts.
    pub noise: Vec<f64>,
    /// True where the noise was measured, false where it was assumed.
    pub noise_measured: bool,
    /// Full noise covariance in model volts (row-major), where enough frames were given.
    pub covariance: Option<Vec<f64>>,
    /// Differences of successive baseline frames, as measured: what drift and noise look like.
    pub successive: Vec<Vec<f64>>,
    /// Does the baseline look like the model?
    pub order: OrderReport,
}

impl Reference {
    /// Makes a reference from baseline frames (channels in the protocol's order). Several frames are averaged; from 8 on,
    /// their scatter from frame to frame is taken as the noise.
    ///
    /// # Errors
    /// No frames, frames of the wrong length, or a baseline that is zero everywhere.
    pub fn of(prepared: &Prepared, frames: &[Vec<f64>]) -> Result<Self, Error> {
        let channels = prepared.channels();
        check_frames("baseline", frames, channels)?;
        let baseline: Vec<f64> = (0..channels).map(|channel| finite_mean(frames.iter().map(|f| f[channel]))).collect();
        let scale = match_gain(prepared, &baseline)?;
        let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let assumed = prepared.skin.touch.assumed_noise_share * largest;
        let noise_measured = frames.len() >= FEWEST_FOR_NOISE;
        let noise = (0..channels)
            .map(|channel| {
                let measured = if noise_measured { successive_deviation(frames, channel) } else { f64::NAN };
                let in_volts = measured * scale[channel].abs();
                if in_volts.is_finite() && in_volts > 0.0 { in_volts } else { assumed }
            })
            .collect();
        let covariance = if frames.len() >= 2 * FEWEST_FOR_NOISE { covariance(frames, &scale)? } else { None };
        let order = prepared.diagnose(&baseline);
        let difference =
            |pair: &[Vec<f64>]| pair[1].iter().zip(&pair[0]).map(|(after, before)| after - before).collect();
        let successive = frames.windows(2).map(difference).collect();
        Ok(Self { baseline, scale, noise, noise_measured, covariance, successive, order })
    }

    /// Makes a reference from a baseline and the standard deviation of its noise, both as measured (`None` or NaN where
    /// unknown): what the live pipeline has after a tare.
    ///
    /// # Errors
    /// As [`Reference::of`].
    pub fn from_baseline(prepared: &Prepared, baseline: &[f64], deviation: Option<&[f64]>) -> Result<Self, Error> {
        let mut reference = Self::of(prepared, std::slice::from_ref(&baseline.to_vec()))?;
        if let Some(deviation) = deviation {
            for ((noise, sigma), scale) in reference.noise.iter_mut().zip(deviation).zip(&reference.scale) {
                let volts = sigma * scale.abs();
                if volts.is_finite() && volts > 0.0 {
                    *noise = volts;
                }
            }
            reference.noise_measured = true;
        }
        Ok(reference)
    }

    /// Difference data of one frame in model volts, against this baseline or the frame's own.
    pub fn difference(&self, frame: &[f64], own_baseline: Option<&[f64]>) -> Vec<f64> {
        let baseline = own_baseline.unwrap_or(&self.baseline);
        frame.iter().zip(baseline).zip(&self.scale).map(|((f, b), scale)| scale * (f - b)).collect()
    }
}

/// Factors from measured differences to model volts.
fn match_gain(prepared: &Prepared, baseline: &[f64]) -> Result<Vec<f64>, Error> {
    let magnitudes = prepared.skin.backend.reads == Reads::Magnitude;
    let model = &prepared.voltages;
    // A rectified reading has lost its sign; the model's is put back, channel by channel.
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
                if usable { factor } else { global * sign(channel) }
            })
            .collect(),
    })
}

/// Refuses a table of frames that has none, or one of another length than `channels`; `what` names them in the error.
///
/// # Errors
/// As said.
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

/// 1/g of the regression `measured = g model + b` over the channels that are present.
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

/// Standard deviation from successive differences, which slow drift does not enter: `sqrt(mean d^2 / 2)`.
fn successive_deviation(frames: &[Vec<f64>], channel: usize) -> f64 {
    let squares = frames.windows(2).map(|pair| (pair[1][channel] - pair[0][channel]).powi(2));
    (finite_mean(squares) / 2.0).sqrt()
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
