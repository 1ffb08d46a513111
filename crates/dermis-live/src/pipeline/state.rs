//! Contents of the pipeline before and after its first baseline.

use crate::beside::Beside;
use crate::imager::NewOperator;
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

/// Phase of the pipeline.
#[derive(Debug)]
pub(super) enum State {
    /// Collecting frames for the first baseline.
    Starting(Box<Starting>),
    /// Comparing frames with a baseline.
    Running(Box<Running>),
}

/// Parts built before any frame has to wait for them.
#[derive(Debug)]
pub(super) struct Starting {
    /// The operator, if it does not depend on the baseline.
    imager: Option<Imager>,
    pub refinement: Refinement,
}

/// The reference that frames are compared with, and the reconstructor that turns them into touches.
#[derive(Debug)]
pub(super) struct Running {
    pub reference: Reference,
    pub reconstructor: Reconstructor,
}

/// The user's choices in addition to the skin file.
#[derive(Debug, Default)]
pub(super) struct Choices {
    pub calibration: Option<Calibration>,
    pub hyperparameter: Option<f64>,
    pub forces: Option<ForceCalibration>,
    /// Frames come from an instrument.
    pub is_live: bool,
}

impl Starting {
    pub fn new(prepared: &Prepared, calibration: Option<&Calibration>) -> Result<Self, Error> {
        let by_model = calibration.is_none_or(|calibration| calibration.correction().is_some());
        // The two are independent.
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

    /// Makes the state after the first baseline. If the system cannot be solved at the requested hyperparameter, that
    /// is dropped with a warning, and the stream continues with the skin file's value.
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
                "the hyperparameter {lambda} cannot be used ({error}); continuing with {:.3e}",
                imager.hyperparameter()
            );
            choices.hyperparameter = None;
        }
        let refinement = std::mem::replace(&mut self.refinement, Refinement::none());
        let mut reconstructor = Reconstructor::new(prepared, imager, placement, refinement)?;
        reconstructor.set_forces(choices.forces.clone())?;
        reconstructor.refinement.leave_out(prepared, &[], &reference.noise)?;
        reconstructor.take_reference(prepared, &reference);
        Ok(Running { reference, reconstructor })
    }
}

/// Drift compensation according to the skin file. If damage is monitored, drift is one factor for all channels, which
/// damage does not resemble. If damage is detected by levels, these are the baseline.
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

/// Operators for other hyperparameters, built in the background.
#[derive(Debug)]
pub(super) struct Operators {
    /// The lambda of the operator being built.
    pub making: Option<f64>,
    pub coming: Beside<Result<NewOperator, Error>>,
    /// The last lambda requested while another operator is being built.
    pub next: Option<f64>,
    /// Frames that waited for operators of an earlier model.
    waited: u64,
}

impl Operators {
    /// No operator in progress, and this many frames that waited before.
    pub fn after(waited: u64) -> Self {
        Self { making: None, coming: Beside::new(), next: None, waited }
    }

    pub fn waits(&self) -> u64 {
        self.waited + self.coming.waits()
    }
}
