//! Skins whose readout circuit is known only in kind: the sign and the weight of every channel are found from frames
//! without labels, best from the drift between successive baselines, where nothing was pressed at all.

use dermis_tomo::inverse::{
    CalibrationOptions, Hyperparameter, LinearProblem, SelfCalibration, TouchEffect, TouchTemplates,
};

use super::{CalibratedImager, PlacementFinder};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::skin::{HyperparameterChoice, Polarity};
use crate::touches::Placement;

/// From so many differences of successive baselines, no pressed frame is looked at.
const ENOUGH_BASELINES: usize = 60;
/// Fewest frames to calibrate on.
const FEWEST: usize = 20;
/// Below this correlation with the best place's signature, a frame is doubted to be a single touch.
const LEAST_SCORE: f64 = 0.5;
/// Touches are looked for at least this far from the rim, in sizes of a touch: nearer, model and skin part.
const RIM_SIZES: f64 = 1.2;

/// The matched filter and what it needs to read difference data.
#[derive(Clone, Debug)]
pub struct MatchedFinder {
    calibration: SelfCalibration,
    relative: Vec<f64>,
    noise: Vec<f64>,
    smallest_amplitude: f64,
    variance_m2: f64,
}

impl MatchedFinder {
    pub(super) fn place(&mut self, difference: &[f64]) -> Result<Option<Placement>, Error> {
        // Root mean square of the frame in units of its noise: is there a touch at all?
        let in_noise = difference.iter().zip(&self.noise).filter(|(d, noise)| d.is_finite() && **noise > 0.0);
        let (count, sum) = in_noise.fold((0, 0.0), |(n, sum), (d, noise)| (n + 1, sum + (d / noise).powi(2)));
        if count == 0 || (sum / f64::from(count)).sqrt() < self.smallest_amplitude {
            return Ok(None);
        }
        self.relative.clear();
        self.relative.extend(difference.iter().zip(self.calibration.data_scale()).map(|(d, scale)| d * scale));
        let touch = self.calibration.locate(&self.relative)?;
        let covariance_m2 = [[self.variance_m2, 0.0], [0.0, self.variance_m2]];
        Ok(touch.map(|touch| Placement {
            position_m: touch.position_m,
            covariance_m2,
            doubtful: touch.score < LEAST_SCORE,
        }))
    }
}

impl Prepared {
    /// The imager of a skin with a readout circuit, calibrated without labels; `None` for other skins, and where there are
    /// too few frames to calibrate on. `data` are difference data made with `reference`.
    pub(super) fn self_calibrated(
        &self,
        reference: &Reference,
        data: &[Vec<f64>],
    ) -> Result<Option<CalibratedImager>, Error> {
        let relative = |frame: &Vec<f64>, unscale: bool| -> Vec<f64> {
            let factor = |c: usize| if unscale { reference.scale[c] } else { 1.0 } * reference.baseline[c];
            frame.iter().enumerate().map(|(c, value)| value / factor(c)).collect()
        };
        let frames: Vec<Vec<f64>> = if reference.successive.len() >= ENOUGH_BASELINES {
            reference.successive.iter().map(|frame| relative(frame, false)).collect()
        } else {
            data.iter().map(|frame| relative(frame, true)).collect()
        };
        if self.skin.backend.circuit.is_none() || frames.len() < FEWEST {
            return Ok(None);
        }
        let pixels = self.map.inside_centres_m();
        let size = self.skin.touch.relative_size * self.half_width_m();
        let places = self.places_off_the_rim(RIM_SIZES * size);
        let templates = TouchTemplates::blurred(self.jacobian.as_mat(), &pixels, &places, size)?;
        let effect = match self.skin.imaging.polarity {
            Polarity::LowersConductivity => TouchEffect::LowersConductivity,
            Polarity::RaisesConductivity => TouchEffect::RaisesConductivity,
        };
        let options = CalibrationOptions { effect, ..CalibrationOptions::default() };
        let calibration = SelfCalibration::fit(&templates, &self.voltages, &frames, options)?;
        let mut reference = reference.clone();
        for channel in 0..self.channels() {
            let scale = 1.0 / (reference.baseline[channel] * calibration.data_scale()[channel]);
            let old = reference.scale[channel].abs();
            let scale = if scale.is_finite() { scale } else { 0.0 };
            reference.noise[channel] *= if old > 0.0 { scale.abs() / old } else { 0.0 };
            reference.scale[channel] = scale;
        }
        let rows = calibration.calibrated_rows(self.jacobian.as_mat())?;
        let prior = self.prior().matrix(rows.as_ref(), &calibration.weighting(), &self.basis)?;
        let problem = LinearProblem::new(rows.as_ref(), calibration.weighting(), prior)?;
        let rule = match &self.skin.imaging.hyperparameter {
            HyperparameterChoice::Number(value) => Hyperparameter::Number(*value),
            HyperparameterChoice::Relative(factor) => Hyperparameter::Relative(*factor),
            _ => Hyperparameter::Relative(10.0),
        };
        let lambda = problem.choose(&rule, &[])?;
        let imager = self.imager_from(problem, lambda, &reference.noise, self.skin.imaging.polarity.sign())?;
        let variance_m2 = (self.skin.touch.position_floor_mm * 1e-3).powi(2);
        let finder = MatchedFinder {
            calibration,
            relative: Vec::new(),
            noise: reference.noise.clone(),
            smallest_amplitude: self.skin.touch.hold_sigma,
            variance_m2,
        };
        Ok(Some(CalibratedImager { imager, reference, placement: Some(PlacementFinder::Matched(Box::new(finder))) }))
    }

    /// Inside pixels with no outside pixel, and no edge of the grid, within `margin_m`.
    fn places_off_the_rim(&self, margin_m: f64) -> Vec<[f64; 2]> {
        let grid = self.map.grid();
        let mask = self.map.inside_mask();
        let outside: Vec<[f64; 2]> = (0..grid.len()).filter(|&p| !mask[p]).map(|p| grid.centre_m(p)).collect();
        let right = grid.left_m + grid.columns as f64 * grid.pixel_m;
        let bottom = grid.top_m - grid.rows as f64 * grid.pixel_m;
        let far = |p: &[f64; 2]| {
            let edge = (p[0] - grid.left_m).min(right - p[0]).min(grid.top_m - p[1]).min(p[1] - bottom);
            edge >= margin_m && outside.iter().all(|q| (p[0] - q[0]).hypot(p[1] - q[1]) >= margin_m)
        };
        self.map.inside_centres_m().into_iter().filter(far).collect()
    }
}
