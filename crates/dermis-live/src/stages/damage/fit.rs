//! A cut's position, direction and length from difference data. The response of [`CrackModel`] is fitted by damped
//! least squares ([`dermis_tomo::least_squares`]), from several starting points, together with a change of the whole
//! sheet.

use dermis_tomo::inner_product;
use dermis_tomo::least_squares::{
    Acceptance, Control, Damping, Error as StepError, NormalEquations, Params, Problem, Scratch, Tolerances, Trial,
    minimise,
};
use dermis_tomo::mesh::Point;

use dermis_touch::damage::DamageShape;

use super::crack::{Crack, CrackModel, CrackScratch};
use crate::Error;
use crate::prepare::Prepared;

/// Centre x, centre y, direction, logarithm of the length.
const UNKNOWNS: usize = 4;
/// Model error in addition to the noise, as a share of the data's RMS: meshes, contact, the rim's response.
const MODEL_ERROR: f64 = 0.03;
/// Parameters of the fit.
const PARAMS: Params = Params {
    control: Control::Damping(Damping {
        start: 1e-2,
        least: 1e-9,
        most: f64::INFINITY,
        decrease: 0.3,
        increase: 5.0,
        least_after_rejection: 0.0,
        refused: Some(5.0),
    }),
    acceptance: Acceptance::Lower,
    tolerances: Tolerances { moved: None, gain: Some(1e-4), predicted: None, agreement: None },
    most_trials: usize::MAX,
    most_linearisations: 15,
    most_rejections: 6,
};
/// Number of starting points that are followed to the end.
const BEST: usize = 4;
/// Range of lengths in a fit, and at its start, metres.
const LENGTHS_M: [f64; 2] = [1e-3, 0.12];
const START_LENGTHS_M: [f64; 2] = [4e-3, 30e-3];

/// A fitted cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutEstimate {
    /// The cut.
    pub crack: Crack,
    /// Covariance of centre x and y (m), direction (rad) and length (m).
    pub covariance: [[f64; UNKNOWNS]; UNKNOWNS],
    /// Share of the data's energy explained together with the change of the whole sheet; 1 is all.
    pub explained: f64,
    /// Additional change of all voltages, as a share of the resting ones.
    pub uniform: f64,
}

impl CutEstimate {
    /// Standard deviations of centre x and y, length (m) and direction (rad).
    pub fn deviations(&self) -> [f64; 4] {
        let deviation = |k: usize| self.covariance[k][k].max(0.0).sqrt();
        [deviation(0), deviation(1), deviation(3), deviation(2)]
    }

    /// Shape of the cut.
    pub fn shape(&self) -> DamageShape {
        let Crack { centre_m, length_m, direction_rad, .. } = self.crack;
        DamageShape { centre_m, length_m, width_m: 0.0, direction_rad, deviations: Some(self.deviations()) }
    }
}

/// Fits a cut to difference data against the intact skin (model volts, NaN where missing, with standard deviations
/// `noise`): its centre, direction and length with their covariance. `start` is its shape in the image. `None` if no
/// cut fits.
///
/// # Errors
/// Data or noise whose length is not the skin's number of channels.
pub fn estimate_cut(
    prepared: &Prepared,
    model: &CrackModel,
    difference: &[f64],
    noise: &[f64],
    start: &DamageShape,
) -> Result<Option<CutEstimate>, Error> {
    let channels = prepared.channels();
    for (what, values) in [("difference data", difference), ("noise", noise)] {
        if values.len() != channels {
            let (expected, got) = (format!("{channels} values"), values.len().to_string());
            return Err(Error::Frames { what: what.into(), expected, got });
        }
    }
    let data = CutData { model, difference, noise, rest: &prepared.voltages };
    // The centre in the image is off by up to half a cut's length, and some margin.
    Ok(fit(&data, start.centre_m, 0.4 * prepared.half_width_m(), 0.0))
}

/// Difference data with everything needed to judge a fit.
struct CutData<'a> {
    pub model: &'a CrackModel,
    /// Model volts; NaN where missing.
    pub difference: &'a [f64],
    /// Standard deviations of the data, model volts.
    pub noise: &'a [f64],
    /// Resting voltages of the model.
    pub rest: &'a [f64],
}

/// One evaluation.
#[derive(Clone, Copy)]
struct Misfit {
    cost: f64,
    uniform: f64,
}

struct Fitter<'a> {
    data: &'a CutData<'a>,
    weights: Vec<f64>,
    scratch: CrackScratch,
    energy: f64,
}

impl Fitter<'_> {
    /// Starting points within `reach_m` of a place, the most promising first: for centres and directions on a grid,
    /// the short cut that explains most, which fits linearly.
    fn starts(&mut self, near_m: Point, reach_m: f64, joined_per_m: f64) -> Vec<Crack> {
        let mut data = self.data.difference.to_vec();
        self.whiten(&mut data);
        let mut starts = Vec::new();
        let mut responses: [Vec<f64>; 3] = Default::default();
        for (row, column) in (-3..=3).flat_map(|row| (-3..=3).map(move |column| (row, column))) {
            let place = |middle_m: f64, step: i32| middle_m + reach_m * f64::from(step) / 3.0;
            let centre_m = [place(near_m[0], column), place(near_m[1], row)];
            if !self.data.model.respond_short(centre_m, &mut self.scratch, &mut responses) {
                continue;
            }
            for response in &mut responses {
                self.whiten(response);
            }
            let along = responses.each_ref().map(|response| inner_product(response, &data));
            let products = responses.each_ref().map(|a| responses.each_ref().map(|b| inner_product(a, b)));
            for turn in 0..6 {
                let direction_rad = std::f64::consts::PI * f64::from(turn) / 6.0;
                let (sin, cos) = direction_rad.sin_cos();
                let factors = [sin * sin, -sin * cos, cos * cos];
                let explains = inner_product(&factors, &along);
                let square = inner_product(&factors, &products.map(|row| inner_product(&row, &factors)));
                if explains > 0.0 && square > 0.0 {
                    let length_m = (2.0 * (explains / square).sqrt()).clamp(START_LENGTHS_M[0], START_LENGTHS_M[1]);
                    starts.push((
                        explains * explains / square,
                        Crack { centre_m, length_m, direction_rad, joined_per_m },
                    ));
                }
            }
        }
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        starts.into_iter().map(|(_, crack)| crack).collect()
    }

    /// Whitens changes of the channels and removes the best uniform change, whose share of the resting voltages it
    /// returns.
    fn whiten(&self, values: &mut [f64]) -> f64 {
        let (mut cross, mut square) = (0.0, 0.0);
        for ((value, weight), rest) in values.iter_mut().zip(&self.weights).zip(self.data.rest) {
            *value = if *weight > 0.0 { weight * *value } else { 0.0 };
            let rest = weight * rest;
            cross += *value * rest;
            square += rest * rest;
        }
        let uniform = if square > 0.0 { cross / square } else { 0.0 };
        for ((value, weight), rest) in values.iter_mut().zip(&self.weights).zip(self.data.rest) {
            *value -= uniform * weight * rest;
        }
        uniform
    }

    /// Whitened residual of a cut after removing the best uniform change, into `residual`.
    fn residual(&mut self, crack: &Crack, residual: &mut Vec<f64>) -> Option<Misfit> {
        residual.resize(self.data.difference.len(), 0.0);
        if !self.data.model.respond(crack, &mut self.scratch, residual) {
            return None;
        }
        residual.iter_mut().zip(self.data.difference).for_each(|(value, difference)| *value = difference - *value);
        let uniform = self.whiten(residual);
        let cost = residual.iter().map(|value| value * value).sum();
        Some(Misfit { cost, uniform })
    }

    /// Derivatives of the residual by central differences.
    fn jacobian(&mut self, crack: &Crack) -> Option<[Vec<f64>; UNKNOWNS]> {
        let steps = [1e-4, 1e-4, 1e-2, 1e-2];
        let mut columns: [Vec<f64>; UNKNOWNS] = Default::default();
        let mut behind = Vec::new();
        for (unknown, column) in columns.iter_mut().enumerate() {
            let mut step = [0.0; UNKNOWNS];
            step[unknown] = steps[unknown];
            self.residual(&moved(crack, step), column)?;
            step[unknown] = -steps[unknown];
            self.residual(&moved(crack, step), &mut behind)?;
            column.iter_mut().zip(&behind).for_each(|(a, b)| *a = (*a - b) / (2.0 * steps[unknown]));
        }
        Some(columns)
    }

    fn follow(&mut self, start: Crack) -> Option<(Crack, Misfit)> {
        let mut residual = Vec::new();
        let at = (start, self.residual(&start, &mut residual)?);
        let mut way = FitUnderWay { fitter: self, at, tried: at, residual };
        minimise(&mut way, &PARAMS, &mut Scratch::default()).ok()?;
        Some(way.at)
    }

    fn estimate(&mut self, crack: Crack, misfit: Misfit) -> Option<CutEstimate> {
        let mut residual = Vec::new();
        self.residual(&crack, &mut residual)?;
        let columns = self.jacobian(&crack)?;
        let (normal, _) = normal_equations(&columns, &residual);
        let freedom = (self.weights.iter().filter(|w| **w > 0.0).count() as f64 - UNKNOWNS as f64 - 1.0).max(1.0);
        let scale = (misfit.cost / freedom).max(1.0);
        let mut covariance = inverse(normal)?;
        covariance.iter_mut().flatten().for_each(|value| *value *= scale);
        // Convert from the logarithm of the length to the length.
        for k in 0..UNKNOWNS {
            covariance[k][3] *= crack.length_m;
            covariance[3][k] *= crack.length_m;
        }
        let explained = 1.0 - misfit.cost / self.energy;
        Some(CutEstimate { crack, covariance, explained, uniform: misfit.uniform })
    }
}

/// A fit in progress.
struct FitUnderWay<'a, 'b> {
    fitter: &'a mut Fitter<'b>,
    at: (Crack, Misfit),
    tried: (Crack, Misfit),
    residual: Vec<f64>,
}

impl Problem for FitUnderWay<'_, '_> {
    type Error = StepError;

    fn unknowns(&self) -> usize {
        UNKNOWNS
    }

    fn cost(&mut self) -> Result<f64, StepError> {
        Ok(self.at.1.cost)
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, StepError> {
        let crack = self.at.0;
        if self.fitter.residual(&crack, &mut self.residual).is_none() {
            return Ok(false);
        }
        let Some(columns) = self.fitter.jacobian(&crack) else { return Ok(false) };
        let (normal, slope) = normal_equations(&columns, &self.residual);
        equations.normal.copy_from_slice(normal.as_flattened());
        equations.right.iter_mut().zip(slope).for_each(|(right, slope)| *right = -slope);
        Ok(true)
    }

    fn solve(&mut self, equations: &NormalEquations, damping: f64, _factor: &mut [f64], step: &mut [f64]) -> bool {
        let mut damped: [[f64; UNKNOWNS]; UNKNOWNS] =
            std::array::from_fn(|row| std::array::from_fn(|column| equations.normal[row * UNKNOWNS + column]));
        (0..UNKNOWNS).for_each(|k| damped[k][k] *= 1.0 + damping);
        let Some(inverse) = inverse(damped) else { return false };
        step.iter_mut().zip(&inverse).for_each(|(step, row)| *step = inner_product(row, &equations.right));
        true
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, StepError> {
        let next = moved(&self.at.0, limited(std::array::from_fn(|k| step[k])));
        let Some(misfit) = self.fitter.residual(&next, &mut self.residual) else { return Ok(None) };
        self.tried = (next, misfit);
        Ok(Some(Trial { cost: misfit.cost, moved: 0.0 }))
    }

    fn accept(&mut self) {
        self.at = self.tried;
    }
}

/// Fits a cut with the given joining (0: open) to the data, near a position given by the image, metres, and initially
/// within `reach_m` of it. `None` if no cut fits at all.
fn fit(data: &CutData<'_>, near_m: Point, reach_m: f64, joined_per_m: f64) -> Option<CutEstimate> {
    let present = |v: &&f64| v.is_finite();
    let energy: f64 = data.difference.iter().filter(present).map(|v| v * v).sum();
    let count = data.difference.iter().filter(present).count();
    let floor = MODEL_ERROR * (energy / count.max(1) as f64).sqrt();
    let weight = |(d, sigma): (&f64, &f64)| if d.is_finite() { 1.0 / sigma.hypot(floor).max(1e-300) } else { 0.0 };
    let weights: Vec<f64> = data.difference.iter().zip(data.noise).map(weight).collect();
    let energy =
        data.difference.iter().zip(&weights).filter(|(d, _)| d.is_finite()).map(|(d, w)| (d * w).powi(2)).sum();
    let mut fitter = Fitter { data, weights, scratch: CrackScratch::default(), energy };
    let starts = fitter.starts(near_m, reach_m, joined_per_m);
    let ends = starts.into_iter().filter_map(|crack| fitter.follow(crack)).take(BEST).collect::<Vec<_>>();
    let (crack, misfit) = ends.into_iter().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))?;
    fitter.estimate(crack, misfit)
}

fn moved(crack: &Crack, [x, y, turn, longer]: [f64; UNKNOWNS]) -> Crack {
    let turned = crack.direction_rad + turn;
    // Within half a turn, above -pi/2.
    let direction_rad = turned - std::f64::consts::PI * ((turned / std::f64::consts::PI) - 0.5).ceil();
    Crack {
        centre_m: [crack.centre_m[0] + x, crack.centre_m[1] + y],
        direction_rad,
        length_m: (crack.length_m * longer.exp()).clamp(LENGTHS_M[0], LENGTHS_M[1]),
        ..*crack
    }
}

/// Limits a step to 10 mm, half a radian and a factor of 1.6.
fn limited(step: [f64; UNKNOWNS]) -> [f64; UNKNOWNS] {
    let most = [10e-3, 10e-3, 0.5, 0.5];
    let excess = step.iter().zip(most).map(|(step, most)| step.abs() / most).fold(1.0, f64::max);
    step.map(|value| value / excess)
}

fn normal_equations(
    columns: &[Vec<f64>; UNKNOWNS],
    residual: &[f64],
) -> ([[f64; UNKNOWNS]; UNKNOWNS], [f64; UNKNOWNS]) {
    let normal = std::array::from_fn(|a| std::array::from_fn(|b| inner_product(&columns[a], &columns[b])));
    (normal, std::array::from_fn(|k| inner_product(&columns[k], residual)))
}

/// The inverse of a small positive matrix, by Gauss-Jordan elimination; `None` if it is singular.
fn inverse(mut matrix: [[f64; UNKNOWNS]; UNKNOWNS]) -> Option<[[f64; UNKNOWNS]; UNKNOWNS]> {
    let mut inverse = [[0.0; UNKNOWNS]; UNKNOWNS];
    (0..UNKNOWNS).for_each(|k| inverse[k][k] = 1.0);
    for pivot in 0..UNKNOWNS {
        let value = matrix[pivot][pivot];
        if !(value > 0.0 && value.is_finite()) {
            return None;
        }
        for column in 0..UNKNOWNS {
            matrix[pivot][column] /= value;
            inverse[pivot][column] /= value;
        }
        for row in (0..UNKNOWNS).filter(|row| *row != pivot) {
            let factor = matrix[row][pivot];
            for column in 0..UNKNOWNS {
                matrix[row][column] -= factor * matrix[pivot][column];
                inverse[row][column] -= factor * inverse[pivot][column];
            }
        }
    }
    Some(inverse)
}
