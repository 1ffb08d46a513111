//! The imager of a skin with or without calibration, and what places its touches.

use dermis_tomo::inverse::{Hyperparameter, LinearProblem};

use super::placement_finder::{LearntFinder, PlacementFinder};
use super::poke_calibration::Calibration;
use super::self_calibrated::SelfCalibrated;
use crate::Error;
use crate::imager::{Imager, weighting};
use crate::prepare::Prepared;
use crate::reference::Reference;

/// What an operator for a reference consists of, with or without calibration.
#[derive(Debug)]
pub struct CalibratedImager {
    /// Difference data to images.
    pub imager: Imager,
    /// The reference that the difference data are to be made with.
    pub reference: Reference,
    /// Places single touches, if the skin is calibrated.
    pub placement: Option<PlacementFinder>,
}

impl CalibratedImager {
    /// The imager for a reference: on the measured Jacobian where there is a calibration, else on the model's.
    ///
    /// # Errors
    /// As [`Imager::new`]; a calibration of another skin.
    pub fn new(
        prepared: &Prepared,
        calibration: Option<&Calibration>,
        reference: Reference,
        data: &[Vec<f64>],
    ) -> Result<Self, Error> {
        let Some(calibration) = calibration else {
            if let Some(SelfCalibrated { imager, reference, finder }) = SelfCalibrated::fit(prepared, &reference, data)?
            {
                let placement = Some(PlacementFinder::Matched(Box::new(finder)));
                return Ok(Self { imager, reference, placement });
            }
            let imager = Imager::new(prepared, &reference, data)?;
            return Ok(Self { imager, reference, placement: None });
        };
        calibration.check(prepared)?;
        let measured = calibration.measured_jacobian(prepared)?;
        let weighting = weighting(prepared, &reference)?;
        let prior = prepared.prior().matrix(measured.jacobian.as_mat(), &weighting, &prepared.basis)?;
        let problem = LinearProblem::new(measured.jacobian.as_mat(), weighting, prior)?;
        let lambda = problem.choose(&Hyperparameter::Relative(0.1), data)?;
        let imager = Imager::from_problem(prepared, problem, lambda, &reference.noise, 1.0)?;
        let smallest_amplitude = prepared.skin.touch.hold_sigma.min(0.5 * calibration.weakest_amplitude()?);
        let finder = LearntFinder::new(calibration.locator(), smallest_amplitude);
        let placement = Some(PlacementFinder::Learnt(Box::new(finder)));
        Ok(Self { imager, reference, placement })
    }
}
