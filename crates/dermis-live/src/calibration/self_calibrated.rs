//! Skins whose readout circuit is known only in kind. The sign and weight of every channel are found from frames
//! without labels, preferably from the drift between successive baselines, where nothing was pressed at all.

use dermis_skin::{HyperparameterChoice, Polarity};
use dermis_tomo::inverse::{
    CalibrationOptions, Hyperparameter, LinearProblem, SelfCalibration, TouchEffect, TouchTemplates,
};
use dermis_tomo::mesh::{Point, distance};

use super::matched::{MatchedFinder, PlaceError, TOUCHES_APART, are_two};
use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::Reference;

/// With this many differences of successive baselines, pressed frames are not used.
const ENOUGH_BASELINES: usize = 60;
/// Minimum number of frames for a calibration.
const FEWEST: usize = 20;
/// Minimum distance of touches from the rim, in touch sizes: closer to it, model and skin disagree.
pub(super) const RIM_SIZES: f64 = 1.2;

/// RMS of a frame, in units of the noise, above which it shows a touch. For noise alone it is 1 to within 0.1 over a
/// hundred channels.
const TOUCHED: f64 = 2.0;

/// Result of a self-calibration.
#[derive(Debug)]
pub(crate) struct SelfCalibrated {
    pub imager: Imager,
    /// The reference with the signs and weights that were found.
    pub reference: Reference,
    pub finder: MatchedFinder,
}

impl SelfCalibrated {
    /// The imager of a skin with a readout circuit, calibrated without labels. `None` for other skins, and if there
    /// are too few frames. `data` are difference data made with `reference`.
    pub fn fit(prepared: &Prepared, reference: &Reference, data: &[Vec<f64>]) -> Result<Option<Self>, Error> {
        let relative = |frame: &Vec<f64>, unscale: bool| -> Vec<f64> {
            let factor = |c: usize| if unscale { reference.scale[c] } else { 1.0 } * reference.baseline[c];
            frame.iter().enumerate().map(|(c, value)| value / factor(c)).collect()
        };
        let frames: Vec<Vec<f64>> = if reference.successive.len() >= ENOUGH_BASELINES {
            reference.successive.iter().map(|frame| relative(frame, false)).collect()
        } else {
            data.iter().map(|frame| relative(frame, true)).collect()
        };
        if prepared.skin.backend.differences || prepared.skin.backend.circuit.is_none() || frames.len() < FEWEST {
            return Ok(None);
        }
        Self::of_changes(prepared, reference.clone(), &frames, TOUCHED).map(Some)
    }

    /// Calibrates on frames of relative changes from their baselines. Frames with an RMS below `smallest_amplitude`,
    /// in units of the noise, show no touch.
    pub fn of_changes(
        prepared: &Prepared,
        reference: Reference,
        frames: &[Vec<f64>],
        smallest_amplitude: f64,
    ) -> Result<Self, Error> {
        let pixels = prepared.map.inside_centres_m();
        let size = prepared.skin.touch.relative_size * prepared.half_width_m();
        let places = places_off_the_rim(prepared, RIM_SIZES * size);
        let templates = TouchTemplates::blurred(prepared.jacobian.as_mat(), &pixels, &places, size)?;
        let effect = match prepared.skin.imaging.polarity {
            Polarity::LowersConductivity => TouchEffect::LowersConductivity,
            Polarity::RaisesConductivity => TouchEffect::RaisesConductivity,
        };
        let options = CalibrationOptions { effect, ..CalibrationOptions::default() };
        let mut calibration = SelfCalibration::fit(&templates, &prepared.voltages, frames, options)?;
        calibration.weigh_with_pairs(&templates, frames, TOUCHES_APART * prepared.places_apart_m(), are_two);
        let rows = calibration.calibrated_rows(prepared.jacobian.as_mat())?;
        let prior = prepared.prior().matrix(rows.as_ref(), &calibration.weighting(), &prepared.basis)?;
        let problem = LinearProblem::new(rows.as_ref(), calibration.weighting(), prior)?;
        let rule = match &prepared.skin.imaging.hyperparameter {
            HyperparameterChoice::Number(value) => Hyperparameter::Number(*value),
            HyperparameterChoice::Relative(factor) => Hyperparameter::Relative(*factor),
            _ => Hyperparameter::Relative(10.0),
        };
        let lambda = problem.choose(&rule, &[])?;
        let error = PlaceError { cell_m: prepared.map.grid().pixel_m, size_m: size };
        let mut finder = MatchedFinder::new(calibration, smallest_amplitude, error, prepared.places_apart_m());
        let reference = finder.adapt(reference);
        let imager =
            Imager::from_problem(prepared, problem, lambda, &reference.noise, prepared.skin.imaging.polarity.sign())?;
        Ok(Self { imager, reference, finder })
    }
}

/// Inside pixels with no outside pixel, and no edge of the grid, within `margin_m`.
pub(super) fn places_off_the_rim(prepared: &Prepared, margin_m: f64) -> Vec<Point> {
    let grid = prepared.map.grid();
    let mask = prepared.map.inside_mask();
    let outside: Vec<Point> = (0..grid.len()).filter(|&p| !mask[p]).map(|p| grid.centre_m(p)).collect();
    let right = grid.left_m + grid.columns as f64 * grid.pixel_m;
    let bottom = grid.top_m - grid.rows as f64 * grid.pixel_m;
    let far = |p: &Point| {
        let edge = (p[0] - grid.left_m).min(right - p[0]).min(grid.top_m - p[1]).min(p[1] - bottom);
        edge >= margin_m && outside.iter().all(|q| distance(*p, *q) >= margin_m)
    };
    prepared.map.inside_centres_m().into_iter().filter(far).collect()
}
