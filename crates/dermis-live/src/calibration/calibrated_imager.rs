//! The imager of a skin with or without calibration, and the finder that locates its touches.

use dermis_tomo::inverse::{Hyperparameter, LinearProblem};

use super::placement_finder::{LearntFinder, PlacementFinder};
use super::poke_calibration::Calibration;
use super::self_calibrated::SelfCalibrated;
use crate::Error;
use crate::imager::{Imager, weighting};
use crate::prepare::Prepared;
use crate::reference::Reference;

/// Imager, reference and placement finder, with or without calibration.
#[derive(Debug)]
pub struct CalibratedImager {
    /// Difference data to images.
    pub imager: Imager,
    /// The reference for making difference data.
    pub reference: Reference,
    /// Locates single touches, if the skin is calibrated.
    pub placement: Option<PlacementFinder>,
}

impl CalibratedImager {
    /// The imager for a reference: on the measured Jacobian if a calibration locates touches, otherwise on the
    /// model's.
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
            check_wiring(prepared)?;
            if let Some(SelfCalibrated { imager, reference, finder }) = SelfCalibrated::fit(prepared, &reference, data)?
            {
                let placement = Some(PlacementFinder::Matched(Box::new(finder)));
                return Ok(Self { imager, reference, placement });
            }
            let imager = Imager::new(prepared, &reference, data)?;
            return Ok(Self { imager, reference, placement: None });
        };
        calibration.check(prepared)?;
        if calibration.correction().is_some() {
            let imager = Imager::new(prepared, &reference, data)?;
            let placement = Some(learnt_finder(prepared, calibration, &reference)?);
            return Ok(Self { imager, reference, placement });
        }
        let measured = calibration.measured_jacobian(prepared)?;
        let weighting = weighting(prepared, &reference)?;
        let prior = prepared.prior().matrix(measured.jacobian.as_mat(), &weighting, &prepared.basis)?;
        let problem = LinearProblem::new(measured.jacobian.as_mat(), weighting, prior)?;
        let lambda = problem.choose(&Hyperparameter::Relative(0.1), data)?;
        let imager = Imager::from_problem(prepared, problem, lambda, &reference.noise, 1.0)?;
        let placement = Some(learnt_finder(prepared, calibration, &reference)?);
        Ok(Self { imager, reference, placement })
    }
}

/// The finder that locates touches by a calibration, at the noise of this reference.
pub(crate) fn learnt_finder(
    prepared: &Prepared,
    calibration: &Calibration,
    reference: &Reference,
) -> Result<PlacementFinder, Error> {
    let smallest_amplitude = calibration.smallest_amplitude(prepared, reference)?;
    let finder = LearntFinder::new(calibration, smallest_amplitude, prepared.half_width_m())?;
    Ok(PlacementFinder::Learnt(Box::new(finder)))
}

/// Rejects a skin with unknown wiring, which needs a calibration.
pub(crate) fn check_wiring(prepared: &Prepared) -> Result<(), Error> {
    if prepared.skin.backend.wiring.is_known() {
        return Ok(());
    }
    Err(Error::Frames {
        what: format!("skin {}, backend.wiring = \"unknown\"", prepared.skin.name),
        expected: "a calibration (--calibration), made by dermis calibrate".into(),
        got: "none".into(),
    })
}
