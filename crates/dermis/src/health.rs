//! Channel health in the live pipeline: what `dermis_touch::health` finds broken is left out of image and touches, and
//! taken back when it is good again. Everything here follows from the frames alone, in their order, so that a replay gives
//! the same result as the live run.

mod changes;

pub use changes::{HealthChange, HealthWatch};

use dermis_tomo::eit::{Pattern, Protocol};
use dermis_tomo::inverse::Unexplained;
use dermis_touch::Baseline;
use dermis_touch::health::{HEALTH_WINDOW, Health, HealthMonitor, HealthParams, HealthReference, Wiring};

use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// An electrode belongs to a pattern where its weight is at least this share of the largest: mean references hold all.
const LEAST_WEIGHT: f64 = 0.5;
/// Deviations estimated from a start-up's frames are uncertain by this share; they are taken to be larger by it.
const UNCERTAINTY: f64 = 1.2;
/// Below this share of the channels there is no image.
const FEWEST_SHARE: f64 = 0.25;
/// Weight of a new frame in the value at which a channel would agree with the others.
const AGREEING: f64 = 0.1;

/// The monitor of a skin with what it needs of the operator.
#[derive(Debug)]
pub(crate) struct HealthStage {
    monitor: HealthMonitor,
    unexplained: Option<Unexplained>,
    /// Difference data without the channels left out so far.
    masked: Vec<f64>,
    residuals: Vec<f64>,
    /// Readings at which channels left out would agree with the others.
    agreeing: Vec<f64>,
    /// Channels left out for good, for the operator.
    left_out: Vec<u32>,
    /// Doubtful frames in a row.
    held: usize,
}

/// What one frame has shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Judgement {
    /// What is left out for good is no longer the same.
    pub changed: bool,
    /// Too few channels are left for an image.
    pub blind: bool,
    /// Something is wrong that is not known yet: what is made of the frame is not to be believed.
    pub doubtful: bool,
}

impl Prepared {
    /// How the protocol's channels use the electrodes, for a [`HealthMonitor`].
    ///
    /// # Errors
    /// None for a protocol that could be made.
    pub fn wiring(&self) -> Result<Wiring, Error> {
        let protocol: &Protocol = &self.protocol;
        let electrodes = |patterns: &[Pattern]| patterns.iter().map(main_electrodes).collect::<Vec<_>>();
        let channels = protocol.measurements().iter().map(|m| [m.stimulation, m.pattern]).collect();
        // A readout circuit mixes lines, and coils are read one way only.
        let reciprocal = self.skin.backend.circuit.is_none() && self.skin.modality == crate::skin::Modality::Eit;
        let partners = if reciprocal { protocol.reciprocal_channels() } else { vec![None; protocol.channel_count()] };
        let (drives, patterns) = (electrodes(protocol.stimulations()), electrodes(protocol.patterns()));
        Ok(Wiring::new(protocol.electrode_count(), drives, patterns, channels, partners)?)
    }

    /// The limits of health as the skin file has them.
    pub fn health_params(&self) -> HealthParams {
        let settings = &self.skin.health;
        HealthParams {
            clean_frames: settings.recover_frames,
            full_scale: settings.full_scale_mv.map(|mv| 1e-3 * mv),
            ..HealthParams::default()
        }
    }
}

fn main_electrodes(pattern: &Pattern) -> Vec<u32> {
    let largest = pattern.entries().iter().map(|(_, w)| w.abs()).fold(0.0, f64::max);
    pattern.entries().iter().filter(|(_, w)| w.abs() >= LEAST_WEIGHT * largest).map(|(e, _)| *e).collect()
}

impl HealthStage {
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let count = prepared.channels();
        Ok(Self {
            monitor: HealthMonitor::new(prepared.wiring()?, prepared.health_params()),
            unexplained: None,
            masked: Vec::with_capacity(count),
            residuals: vec![0.0; count],
            agreeing: vec![f64::NAN; count],
            left_out: Vec::with_capacity(count),
            held: 0,
        })
    }

    /// What is known to be broken.
    pub fn health(&self) -> Health<'_> {
        self.monitor.health()
    }

    /// Channels left out for good.
    pub fn left_out(&self) -> &[u32] {
        &self.left_out
    }

    /// To be called with the readings of every frame.
    pub fn read(&mut self, raw: &[f64]) -> Result<(), Error> {
        Ok(self.monitor.read(raw)?)
    }

    /// Looks for what was broken while the first baseline was made.
    pub fn check_start(&mut self, at: (u64, u64), prepared: &Prepared, baseline: &Baseline) -> Result<(), Error> {
        self.monitor.check_start(at, baseline.baseline(), baseline.noise_std(), &prepared.voltages)?;
        self.note_left_out();
        Ok(())
    }

    /// The reference of a new baseline. Channels left out have no say in it, and get the model's own resting values.
    pub fn reference(&self, prepared: &Prepared, baseline: &mut Baseline) -> Result<Reference, Error> {
        let (mut rest, mut noise) = (baseline.baseline().to_vec(), baseline.noise_std().to_vec());
        for &channel in &self.left_out {
            (rest[channel as usize], noise[channel as usize]) = (f64::NAN, f64::NAN);
        }
        let mut reference = prepared.reference_from(&rest, Some(&noise))?;
        for channel in self.left_out.iter().map(|&c| c as usize) {
            let value = prepared.voltages[channel] / reference.scale[channel];
            baseline.move_channel(channel, value);
            reference.baseline[channel] = value;
        }
        Ok(reference)
    }

    /// Compares with a new reference, or through a new operator, from now on.
    pub fn begin(&mut self, reference: &Reference, imager: &Imager) -> Result<(), Error> {
        let deviation: Vec<f64> = reference.noise.iter().map(|sigma| UNCERTAINTY * sigma).collect();
        let rest: Vec<f64> = reference.baseline.iter().zip(&reference.scale).map(|(b, s)| b * s).collect();
        self.unexplained = Unexplained::new(imager.operator());
        let unexplained = self.unexplained.as_ref().map(|unexplained| unexplained.deviations(&deviation));
        let reference = HealthReference { rest: &rest, deviation: &deviation, unexplained: unexplained.as_deref() };
        Ok(self.monitor.begin(&reference)?)
    }

    /// Judges a frame and takes what is left out of it from its difference data (NaN).
    pub fn judge(
        &mut self,
        at: (u64, u64),
        raw: &[f64],
        scale: &[f64],
        difference: &mut [f64],
        imager: &mut Imager,
    ) -> Result<Judgement, Error> {
        self.masked.clear();
        let kept = |(d, excluded): (&f64, &bool)| if *excluded { f64::NAN } else { *d };
        self.masked.extend(difference.iter().zip(self.monitor.excluded()).map(kept));
        let expected = if is_enough(&self.masked) { Some(imager.fill_in(&self.masked)?) } else { None };
        let residuals = match (&mut self.unexplained, expected) {
            (Some(unexplained), Some(filled)) => {
                unexplained.of(filled, &mut self.residuals);
                for (channel, residual) in self.residuals.iter_mut().enumerate() {
                    if self.masked[channel].is_nan() {
                        *residual = difference[channel] - filled[channel];
                    }
                }
                Some(&self.residuals[..])
            }
            _ => None,
        };
        if let Some(filled) = expected {
            for (channel, _) in self.monitor.declared().iter().enumerate().filter(|(_, declared)| **declared) {
                let value = raw[channel] - filled[channel] / scale[channel];
                let agreeing = &mut self.agreeing[channel];
                // Of frames without fault only, of which there are many before a channel is taken back.
                *agreeing = if agreeing.is_finite() && self.monitor.is_clean(channel) {
                    *agreeing + AGREEING * (value - *agreeing)
                } else {
                    value
                };
            }
        }
        let changed = self.monitor.judge(at, difference, residuals)?;
        for (value, _) in difference.iter_mut().zip(self.monitor.excluded()).filter(|(_, excluded)| **excluded) {
            *value = f64::NAN;
        }
        if changed {
            self.note_left_out();
        }
        let doubtful = self.monitor.is_doubtful();
        self.held = if doubtful { self.held.saturating_add(1) } else { 0 };
        // A doubt that is not settled within the window ends: the skin must not stand still.
        Ok(Judgement { changed, blind: !is_enough(difference), doubtful: doubtful && self.held <= HEALTH_WINDOW })
    }

    /// Moves the baseline of channels that the last frame took back to where they agree with the others.
    pub fn adopt(&mut self, baseline: &mut Baseline) {
        for channel in self.monitor.recovered().iter().map(|&c| c as usize) {
            baseline.move_channel(channel, self.agreeing[channel]);
            self.agreeing[channel] = f64::NAN;
        }
    }

    fn note_left_out(&mut self) {
        self.left_out.clear();
        self.left_out.extend((0..).zip(self.monitor.declared()).filter(|(_, declared)| **declared).map(|(c, _)| c));
    }
}

fn is_enough(difference: &[f64]) -> bool {
    let present = difference.iter().filter(|v| v.is_finite()).count();
    present > 0 && present as f64 >= FEWEST_SHARE * difference.len() as f64
}
