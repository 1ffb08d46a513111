//! What the pipeline is made of before and after its first baseline.

use dermis_touch::DriftCompensation;
use dermis_touch::force::ForceCalibration;

use crate::Error;
use crate::calibration::{CalibratedImager, Calibration, learnt_finder};
use crate::imager::{Imager, operator_needs_no_baseline};
use crate::prepare::Prepared;
use crate::reconstructor::Reconstructor;
use crate::reference::Reference;
use crate::stages::damage::LevelStage;
use crate::stages::refinement::Refinement;

/// Where the pipeline is in its life.
#[derive(Debug)]
pub(super) enum State {
    /// Frames make the first baseline.
    Starting(Box<Starting>),
    /// Frames are compared with a baseline.
    Running(Box<Running>),
}

/// What is made before any frame has to wait for it.
#[derive(Debug)]
pub(super) struct Starting {
    /// The operator, where it does not depend on the baseline.
    imager: Option<Imager>,
    refinement: Refinement,
}

/// What frames are compared with and made into touches by.
#[derive(Debug)]
pub(super) struct Running {
    pub reference: Reference,
    pub reconstructor: Reconstructor,
}

/// What the user has chosen beside the skin file.
#[derive(Debug, Default)]
pub(super) struct Choices {
    pub calibration: Option<Calibration>,
    pub hyperparameter: Option<f64>,
    pub forces: Option<ForceCalibration>,
}

impl Starting {
    pub fn new(prepared: &Prepared, calibration: Option<&Calibration>) -> Result<Self, Error> {
        let by_model = calibration.is_none_or(|calibration| calibration.correction().is_some());
        // Neither needs the other.
        let imager = || -> Result<_, Error> {
            if !by_model || !operator_needs_no_baseline(prepared) {
                return Ok(None);
            }
            let reference = Reference::from_baseline(prepared, &prepared.voltages, None)?;
            Ok(Some(Imager::new(prepared, &reference, &[])?))
        };
        let refinement = || {
            if Refinement::is_wanted(prepared, calibration) {
                Refinement::without_noise(prepared)
            } else {
                Ok(Refinement::none())
            }
        };
        let (imager, refinement) = rayon::join(imager, refinement);
        let (imager, refinement) = (imager?, refinement?);
        Ok(Self { imager, refinement })
    }

    /// What follows the first baseline. A hyperparameter that this baseline's system cannot be solved at is dropped
    /// from the choices with a warning: the stream goes on at the skin file's.
    pub fn run(&mut self, prepared: &Prepared, choices: &mut Choices, reference: Reference) -> Result<Running, Error> {
        let CalibratedImager { mut imager, reference, placement } = match self.imager.take() {
            Some(mut imager) => {
                imager.set_noise(&reference.noise)?;
                let finder = |calibration: &Calibration| learnt_finder(prepared, calibration, &reference);
                let placement = choices.calibration.as_ref().map(finder).transpose()?;
                CalibratedImager { imager, reference, placement }
            }
            None => CalibratedImager::new(prepared, choices.calibration.as_ref(), reference, &[])?,
        };
        if let Some(lambda) = choices.hyperparameter
            && let Err(error) = imager.set_hyperparameter(lambda, &reference.noise)
        {
            tracing::warn!(
                "the hyperparameter {lambda} cannot be used ({error}); going on with {:.3e}",
                imager.hyperparameter()
            );
            choices.hyperparameter = None;
        }
        let refinement = std::mem::replace(&mut self.refinement, Refinement::none());
        let mut reconstructor = Reconstructor::new(prepared, imager, placement, refinement)?;
        reconstructor.touches.set_forces(choices.forces.clone());
        reconstructor.refinement.set_noise(&reference.noise);
        reconstructor.refinement.leave_out(prepared, &[], &reference.noise)?;
        reconstructor.take_reference(prepared, &reference);
        Ok(Running { reference, reconstructor })
    }
}

/// As the skin file has it; where damage is watched, drift is one factor for all channels, which no damage looks like.
/// Where it is told by levels, these are the baseline.
pub(super) fn drift_compensation(prepared: &Prepared) -> DriftCompensation {
    if LevelStage::is_wanted(prepared) {
        return DriftCompensation::Off;
    }
    match prepared.skin.touch.drift_time_constant_s {
        time_constant_s if time_constant_s > 0.0 && prepared.skin.damage.watch => {
            DriftCompensation::Uniform { time_constant_s, settle_s: 2.0 }
        }
        time_constant_s if time_constant_s > 0.0 => DriftCompensation::Exponential { time_constant_s, settle_s: 2.0 },
        _ => DriftCompensation::Off,
    }
}
