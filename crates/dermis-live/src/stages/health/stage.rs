//! The health monitor of a skin, fed with the operator's view of its frames. It returns decisions for the other
//! stages.

use dermis_tomo::inverse::{LeaveOneOutResidual, Operator};
use dermis_touch::Baseline;
use dermis_touch::health::{HEALTH_WINDOW, Health, HealthMonitor, HealthReference, JudgedFrame};

use super::wiring::{health_params, wiring};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{MeasuredNoise, Reference};

/// Standard deviations estimated from start-up frames are uncertain; they are increased by this factor.
const UNCERTAINTY: f64 = 1.2;
/// Minimum share of the channels needed for an image.
const FEWEST_SHARE: f64 = 0.25;
/// A restored channel is back where it was within this many standard deviations of the noise.
const BACK: f64 = 5.0;
/// Weight of a new frame in the reading at which a channel would agree with the others.
const AGREEING: f64 = 0.1;

/// The health monitor of a skin, with the inputs it needs from the operator.
#[derive(Debug)]
pub(crate) struct HealthStage {
    monitor: HealthMonitor,
    residual_of: Option<LeaveOneOutResidual>,
    /// Difference data without the channels already excluded.
    masked: Vec<f64>,
    residuals: Vec<f64>,
    /// Their standard deviations at rest; 0 if there is nothing to compare with.
    unexplained: Vec<f64>,
    /// Readings at which excluded channels would agree with the others.
    agreeing: Vec<f64>,
    /// Channels excluded permanently, for the operator.
    left_out: Vec<u32>,
    /// The operator does not know them yet.
    is_left_out_new: bool,
    moved: Vec<(usize, f64)>,
    /// Consecutive doubtful frames.
    doubtful_frames: usize,
}

/// One frame for a health check.
pub(crate) struct HealthFrame<'a> {
    /// Time on the host's clock, and sequence number.
    pub at: (u64, u64),
    /// Readings as received.
    pub raw: &'a [f64],
    /// Factors from readings to model volts.
    pub scale: &'a [f64],
    /// Difference data, model volts.
    pub difference: &'a [f64],
    /// All channels as expected from the remaining ones: [`HealthStage::mask`], filled in. `None` if too few remain.
    pub expected: Option<&'a [f64]>,
    /// The skin was touched in the last frame.
    pub is_touched: bool,
}

/// Visibility of the skin in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sight {
    /// An image can be made, and is reliable.
    Clear,
    /// An unidentified fault makes the frame unreliable.
    Doubtful,
    /// Nothing can be seen: the frames are wrong as a whole, or too few channels are left for an image.
    Blind,
}

/// Decisions from one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HealthDecision<'a> {
    /// Channels excluded from this frame.
    pub excluded: &'a [bool],
    /// Channels excluded permanently, if the set has changed.
    pub left_out: Option<&'a [u32]>,
    /// Channels restored, each with the reading to which its baseline must move so that it agrees with the others.
    pub moved: &'a [(usize, f64)],
    /// Visibility of the skin.
    pub sight: Sight,
}

impl HealthStage {
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let count = prepared.channels();
        Ok(Self {
            monitor: HealthMonitor::new(wiring(prepared)?, health_params(prepared)),
            residual_of: None,
            masked: Vec::with_capacity(count),
            residuals: vec![0.0; count],
            unexplained: vec![0.0; count],
            agreeing: vec![f64::NAN; count],
            left_out: Vec::with_capacity(count),
            is_left_out_new: false,
            moved: Vec::with_capacity(count),
            doubtful_frames: 0,
        })
    }

    /// All known faults.
    pub fn health(&self) -> Health<'_> {
        self.monitor.health()
    }

    /// Channels excluded permanently.
    pub fn left_out(&self) -> &[u32] {
        &self.left_out
    }

    /// True if the current frame is not wrong as a whole, so that other stages may learn from it.
    pub fn is_frame_sound(&self) -> bool {
        !self.monitor.is_frame_suspect()
    }

    /// Takes the readings of every frame. Call it before any other processing.
    pub fn read(&mut self, raw: &[f64]) -> Result<(), Error> {
        Ok(self.monitor.read(raw)?)
    }

    /// Looks for faults that existed while the first baseline was made.
    pub fn check_start(&mut self, at: (u64, u64), prepared: &Prepared, baseline: &Baseline) -> Result<(), Error> {
        self.monitor.check_start(at, baseline.baseline(), baseline.noise_std(), &prepared.voltages)?;
        self.note_left_out();
        Ok(())
    }

    /// The reference of a new baseline. Excluded channels do not contribute to it; they get the model's own resting
    /// values, to which their baselines must be moved.
    pub fn reference(&self, prepared: &Prepared, baseline: &Baseline) -> Result<Reference, Error> {
        let (mut rest, mut noise) = (baseline.baseline().to_vec(), baseline.noise_std().to_vec());
        for &channel in &self.left_out {
            (rest[channel as usize], noise[channel as usize]) = (f64::NAN, f64::NAN);
        }
        let mut reference = Reference::from_baseline(prepared, &rest, Some(MeasuredNoise::of_start(&noise)))?;
        for channel in self.left_out.iter().map(|&c| c as usize) {
            reference.baseline[channel] = prepared.voltages[channel] / reference.scale[channel];
        }
        Ok(reference)
    }

    /// Switches to a new reference or operator.
    pub fn compare_with(&mut self, reference: &Reference, operator: &Operator) -> Result<(), Error> {
        let deviation: Vec<f64> = reference.noise.iter().map(|sigma| UNCERTAINTY * sigma).collect();
        let rest: Vec<f64> = reference.baseline.iter().zip(&reference.scale).map(|(b, s)| b * s).collect();
        self.residual_of = LeaveOneOutResidual::new(operator);
        let of_reading = |(sigma, scale): (&f64, &f64)| sigma / scale.abs();
        let readings_deviation: Vec<f64> = reference.noise.iter().zip(&reference.scale).map(of_reading).collect();
        let unexplained = self.residual_of.as_ref().map(|residual_of| residual_of.deviations(&deviation));
        self.unexplained = unexplained.clone().unwrap_or_else(|| vec![0.0; deviation.len()]);
        let reference = HealthReference {
            rest: &rest,
            deviation: &deviation,
            readings: &reference.baseline,
            readings_deviation: &readings_deviation,
            unexplained: unexplained.as_deref(),
        };
        Ok(self.monitor.begin(&reference)?)
    }

    /// Difference data without the channels excluded from the last frame (NaN); `None` if too few remain to fill
    /// these in.
    pub fn mask(&mut self, difference: &[f64]) -> Option<&[f64]> {
        self.masked.clear();
        let kept = |(d, excluded): (&f64, &bool)| if *excluded { f64::NAN } else { *d };
        self.masked.extend(difference.iter().zip(self.monitor.excluded()).map(kept));
        is_enough(&self.masked).then_some(&self.masked)
    }

    /// Checks a frame, after [`HealthStage::mask`] of its difference data. `is_explained` tells whether presses explain
    /// it.
    pub fn examine(
        &mut self,
        frame: &HealthFrame<'_>,
        is_explained: impl FnMut() -> bool,
    ) -> Result<HealthDecision<'_>, Error> {
        let difference = frame.difference;
        let residuals = match (&mut self.residual_of, frame.expected) {
            (Some(residual_of), Some(filled)) => {
                residual_of.of(filled, &mut self.residuals);
                for (channel, residual) in self.residuals.iter_mut().enumerate() {
                    if self.masked[channel].is_nan() {
                        *residual = difference[channel] - filled[channel];
                    }
                }
                Some(&self.residuals[..])
            }
            _ => None,
        };
        if let Some(filled) = frame.expected {
            for (channel, _) in self.monitor.declared().iter().enumerate().filter(|(_, declared)| **declared) {
                let value = frame.raw[channel] - filled[channel] / frame.scale[channel];
                let agreeing = &mut self.agreeing[channel];
                // Average only fault-free frames; there are many of these before a channel is restored. Under presses,
                // the expected values are rough.
                *agreeing = if agreeing.is_finite() && frame.is_touched {
                    *agreeing
                } else if agreeing.is_finite() && self.monitor.is_clean(channel) {
                    *agreeing + AGREEING * (value - *agreeing)
                } else {
                    value
                };
            }
        }
        let is_compared = residuals.is_some();
        let judged = JudgedFrame { at: frame.at, difference, unexplained: residuals, is_touched: frame.is_touched };
        let changed = self.monitor.judge(&judged, is_explained)?;
        self.moved.clear();
        if changed {
            // The kind of a fault may change while the channels stay the same.
            self.is_left_out_new |= self.note_left_out();
            for channel in self.monitor.recovered().iter().map(|&c| c as usize) {
                let agreeing = std::mem::replace(&mut self.agreeing[channel], f64::NAN);
                // A channel that reads what it should by its old baseline keeps it. Under a touch, it is restored only
                // if it does.
                let is_back = is_compared && self.residuals[channel].abs() <= BACK * self.unexplained[channel];
                if !is_back && !frame.is_touched {
                    self.moved.push((channel, agreeing));
                }
            }
        }
        let excluded = self.monitor.excluded();
        let is_suspect = self.monitor.is_frame_suspect();
        let doubtful = is_suspect || self.monitor.is_doubtful();
        self.doubtful_frames = if doubtful { self.doubtful_frames.saturating_add(1) } else { 0 };
        let left = difference.iter().zip(excluded).filter(|(value, excluded)| value.is_finite() && !**excluded).count();
        let sight = if self.monitor.health().frame.is_some() || !is_enough_of(left, difference.len()) {
            Sight::Blind
        } else if is_suspect || (doubtful && self.doubtful_frames <= HEALTH_WINDOW) {
            // Stop doubting after the window, so that the skin does not freeze.
            Sight::Doubtful
        } else {
            Sight::Clear
        };
        // Channels of an electrode are found faulty one after another. Until they all are, no image needs the operator.
        let is_due = sight == Sight::Clear && std::mem::take(&mut self.is_left_out_new);
        let left_out = is_due.then_some(&self.left_out[..]);
        Ok(HealthDecision { excluded, left_out, moved: &self.moved, sight })
    }

    /// Takes the channels to exclude from the monitor. True if they have changed.
    fn note_left_out(&mut self) -> bool {
        let declared = || (0..).zip(self.monitor.declared()).filter(|(_, declared)| **declared).map(|(c, _)| c);
        let has_changed = !declared().eq(self.left_out.iter().copied());
        if has_changed {
            self.left_out.clear();
            self.left_out.extend(declared());
        }
        has_changed
    }
}

fn is_enough(difference: &[f64]) -> bool {
    is_enough_of(difference.iter().filter(|v| v.is_finite()).count(), difference.len())
}

fn is_enough_of(present: usize, channels: usize) -> bool {
    present > 0 && present as f64 >= FEWEST_SHARE * channels as f64
}
