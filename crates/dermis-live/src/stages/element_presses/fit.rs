//! The fit of round presses to the readings of coils: position, radius and pressure of each by Levenberg-Marquardt.
//! Wide priors on radius and pressure keep quantities that the readings do not determine at their usual values.

use dermis_mit::MitError;
use dermis_tomo::least_squares::{
    Acceptance, Control, Damping, NormalEquations, Params, Problem, Scratch, Tolerances, Trial, minimise,
};
use dermis_tomo::mesh::Point;
use faer::linalg::solvers::{DenseSolveCore, Llt};
use faer::{MatRef, Side};

use super::mechanics::{Mechanics, OF_PRESS, Press, Travels};
use crate::imager::ElementFrame;

/// Prior standard deviations of the logarithms of radius and pressure.
const LOG_RADIUS_DEVIATION: f64 = 0.35;
const LOG_PRESSURE_DEVIATION: f64 = 1.2;
/// Range of possible radii, in cells.
const RADII_CELLS: [f64; 2] = [0.1, 3.0];
/// Number of steps to scan on either side of a press along a direction, and their length in cells.
const SCANNED_STEPS: i32 = 12;
pub(super) const SCANNED_CELLS: f64 = 0.1;
/// At each step, the lowest cost across the direction is found by parabolas of these half widths in cells.
const ACROSS_CELLS: [f64; 2] = [0.05, 0.02];
/// A position that costs this much more than the best one, and any beyond it, is impossible.
const NOT_POSSIBLE: f64 = 50.0;
/// Longest step, in cells and in logarithms.
const LONGEST_STEP: f64 = 0.5;
/// A fit has converged if no position moves by more than this share of a cell, and no logarithm by more than this.
const CONVERGED: f64 = 3e-3;
/// Maximum number of trials of a fit.
pub(super) const MOST_TRIALS: usize = 25;
const PARAMS: Params = Params {
    control: Control::Damping(Damping {
        start: 1e-3,
        least: 1e-6,
        most: 1e6,
        decrease: 0.1,
        increase: 8.0,
        least_after_rejection: 1e-3,
        refused: Some(10.0),
    }),
    acceptance: Acceptance::Lower,
    tolerances: Tolerances { moved: Some(CONVERGED), gain: Some(1e-4), predicted: None, agreement: None },
    most_trials: MOST_TRIALS,
    most_linearisations: usize::MAX,
    most_rejections: 6,
};

/// Prior knowledge about presses.
#[derive(Clone, Copy, Debug)]
pub(super) struct Usual {
    pub log_radius: f64,
    pub log_pressure: f64,
    /// Range of positions, metres.
    pub low_m: Point,
    pub high_m: Point,
}

/// Covariance of x and y, square metres.
pub(super) type Covariance = [[f64; 2]; 2];

/// Presses that explain a frame.
#[derive(Clone, Debug)]
pub(super) struct FittedPresses {
    pub presses: Vec<Press>,
    /// Cost: sum of squared residuals in units of noise and model error, plus the squared deviations of the presses
    /// from usual ones.
    pub cost: f64,
    /// The residuals' part of the cost.
    pub left: f64,
    /// Total force of each press on all elements, newtons.
    pub forces_n: Vec<f64>,
    /// Readings minus unknowns.
    pub degrees_of_freedom: usize,
}

/// Fits presses from these starting points, in at most `most_trials` trials.
pub(super) fn fit(
    mechanics: &Mechanics,
    usual: &Usual,
    frame: &mut ElementFrame<'_>,
    starts: &[Press],
    most_trials: usize,
) -> Result<FittedPresses, MitError> {
    let mut way = Way::new(mechanics, usual, frame, starts);
    let mut scratch = Scratch::default();
    let info = minimise(&mut way, &Params { most_trials, ..PARAMS }, &mut scratch)?;
    let left = way.left_of(&way.residual);
    let unknowns = way.unknowns();
    way.mechanics.travels(&way.presses, false, &mut way.travels);
    let forces_n = way.travels.forces_n.clone();
    let degrees_of_freedom = way.residual.len().saturating_sub(unknowns);
    Ok(FittedPresses { forces_n, presses: way.presses, cost: info.cost, left, degrees_of_freedom })
}

/// Covariance of x and y of each press at its current position, square metres: the inverse of the normal matrix.
///
/// # Errors
/// Travels that the model of the coils rejects.
pub(super) fn covariances(
    mechanics: &Mechanics,
    usual: &Usual,
    frame: &mut ElementFrame<'_>,
    presses: &[Press],
) -> Result<Vec<Covariance>, MitError> {
    let mut way = Way::new(mechanics, usual, frame, presses);
    way.cost()?;
    let mut equations = NormalEquations::new(way.unknowns());
    way.linearise(&mut equations)?;
    Ok(inverse_of_places(&equations, mechanics.cell_m))
}

/// Distribution of a press of a fit along a direction: mean offset and variance (metres, square metres) allowed by
/// these readings and the priors, at constant force on the elements. Beyond the outermost elements, and for small
/// presses within a cell, the cost is not a parabola.
pub(super) fn moments_along(
    mechanics: &Mechanics,
    usual: &Usual,
    frame: &mut ElementFrame<'_>,
    found: &FittedPresses,
    number: usize,
    direction: [f64; 2],
) -> Result<(f64, f64), MitError> {
    let presses = found.presses.clone();
    let mut way = Way::new(mechanics, usual, frame, &presses);
    let cell = mechanics.cell_m[0].min(mechanics.cell_m[1]);
    let across = [-direction[1], direction[0]];
    let (mut tried, mut residual) = (presses.clone(), Vec::new());
    // Cost of a press at these offsets along and across, at constant force; `None` outside the possible positions.
    let mut cost_at = |along_m: f64, across_m: f64| -> Result<Option<f64>, MitError> {
        let press = &mut tried[number];
        *press = presses[number];
        let moved = |axis: usize| along_m * direction[axis] + across_m * across[axis];
        press.centre_m = [0, 1].map(|axis| presses[number].centre_m[axis] + moved(axis));
        if (0..2).any(|axis| press.centre_m[axis] < usual.low_m[axis] || press.centre_m[axis] > usual.high_m[axis]) {
            return Ok(None);
        }
        mechanics.travels(&tried, false, &mut way.travels);
        let force_n = way.travels.forces_n[number];
        if force_n <= 0.0 {
            return Ok(None);
        }
        tried[number].log_pressure += (found.forces_n[number] / force_n).ln();
        way.residual_of(&tried, &mut residual)?;
        Ok(Some(way.cost_of(&tried, &residual)))
    };
    let (mut sums, mut least) = ([0.0; 3], found.cost);
    for sign in [-1.0, 1.0] {
        // Carry the best offset across the direction over from step to step.
        let mut across_m = 0.0;
        for step in i32::from(sign > 0.0)..=SCANNED_STEPS {
            let offset_m = sign * f64::from(step) * SCANNED_CELLS * cell;
            let Some(mut cost) = cost_at(offset_m, across_m)? else { continue };
            for beside_m in ACROSS_CELLS.map(|cells| cells * cell) {
                let [left, right] = [cost_at(offset_m, across_m - beside_m)?, cost_at(offset_m, across_m + beside_m)?];
                let (Some(left), Some(right)) = (left, right) else { continue };
                let bent = left + right - 2.0 * cost;
                let to_m = beside_m * if bent > 0.0 { (0.5 * (left - right) / bent).clamp(-2.0, 2.0) } else { 0.0 };
                match cost_at(offset_m, across_m + to_m)? {
                    Some(there) if there < cost => {
                        cost = there;
                        across_m += to_m;
                    }
                    _ => {}
                }
            }
            if cost > least + NOT_POSSIBLE {
                break;
            }
            // Sums are relative to the lowest cost found.
            let (scale, weight) = (((cost - least).min(0.0) * 0.5).exp(), (-0.5 * (cost - least).max(0.0)).exp());
            least = least.min(cost);
            sums = sums.map(|sum| sum * scale);
            sums[0] += weight;
            sums[1] += weight * offset_m;
            sums[2] += weight * offset_m * offset_m;
        }
    }
    if sums[0] <= 0.0 {
        return Ok((0.0, 0.0));
    }
    let mean = sums[1] / sums[0];
    Ok((mean, (sums[2] / sums[0] - mean * mean).max(0.0)))
}

/// Cost of these presses as they are: see [`FittedPresses::cost`].
pub(super) fn cost_of(
    mechanics: &Mechanics,
    usual: &Usual,
    frame: &mut ElementFrame<'_>,
    presses: &[Press],
) -> Result<f64, MitError> {
    Way::new(mechanics, usual, frame, presses).cost()
}

/// The position blocks of the inverse of a normal matrix.
fn inverse_of_places(equations: &NormalEquations, cell_m: [f64; 2]) -> Vec<Covariance> {
    let n = equations.unknowns();
    let normal = MatRef::from_row_major_slice(&equations.normal, n, n);
    let Ok(factor) = Llt::new(normal, Side::Lower) else {
        return vec![[[f64::INFINITY, 0.0], [0.0, f64::INFINITY]]; n / OF_PRESS];
    };
    let inverse = factor.inverse();
    let of = |press: usize| {
        let entry = |a: usize, b: usize| inverse[(OF_PRESS * press + a, OF_PRESS * press + b)] * cell_m[a] * cell_m[b];
        [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]]
    };
    (0..n / OF_PRESS).map(of).collect()
}

/// A fit's equations at its presses, and what they were made of.
pub(super) struct Linearised<'a> {
    /// The equations, with the priors.
    pub equations: NormalEquations,
    /// Derivatives of the readings by the travels, reading by reading, henries per metre.
    pub jacobian: &'a [f64],
    /// Derivatives of the readings by the unknowns, unknown by unknown.
    pub columns: &'a [f64],
    /// Derivative of each element's travel by a linear spring's travel.
    pub stiffening: &'a [f64],
    /// Readings minus those under the presses, henries.
    pub residual: &'a [f64],
    /// Inverse variances of the readings.
    pub weights: &'a [f64],
}

/// Presses during a fit.
pub(super) struct Way<'a, 'f> {
    mechanics: &'a Mechanics,
    usual: &'a Usual,
    frame: &'a mut ElementFrame<'f>,
    presses: Vec<Press>,
    tried: Vec<Press>,
    travels: Travels,
    residual: Vec<f64>,
    tried_residual: Vec<f64>,
    /// Derivatives of the readings by the travels, reading by reading, at the last equations.
    jacobian: Vec<f64>,
    /// Derivative of each reading by each unknown, unknown by unknown.
    columns: Vec<f64>,
}

impl<'a, 'f> Way<'a, 'f> {
    pub(super) fn new(
        mechanics: &'a Mechanics,
        usual: &'a Usual,
        frame: &'a mut ElementFrame<'f>,
        starts: &[Press],
    ) -> Self {
        Self {
            mechanics,
            usual,
            presses: starts.to_vec(),
            tried: starts.to_vec(),
            travels: Travels::default(),
            residual: Vec::new(),
            tried_residual: Vec::new(),
            jacobian: Vec::new(),
            columns: Vec::new(),
            frame,
        }
    }

    /// The equations at the current presses.
    pub(super) fn linearised(&mut self) -> Result<Linearised<'_>, MitError> {
        self.cost()?;
        let mut equations = NormalEquations::new(self.unknowns());
        self.linearise(&mut equations)?;
        Ok(Linearised {
            equations,
            jacobian: &self.jacobian,
            columns: &self.columns,
            stiffening: &self.travels.stiffening,
            residual: &self.residual,
            weights: &self.frame.weights,
        })
    }

    fn residual_of(&mut self, presses: &[Press], out: &mut Vec<f64>) -> Result<(), MitError> {
        self.mechanics.travels(presses, false, &mut self.travels);
        let predicted = self.frame.coils.differences_h(&self.travels.travel_m)?;
        out.clear();
        out.extend(self.frame.differences_h.iter().zip(&predicted).map(|(d, p)| d - p));
        Ok(())
    }

    fn left_of(&self, residual: &[f64]) -> f64 {
        residual.iter().zip(&self.frame.weights).map(|(r, w)| w * r * r).sum()
    }

    /// Deviation of the logarithms of radius and pressure from the usual ones, in standard deviations.
    fn unusual(&self, press: &Press) -> [f64; 2] {
        [
            (press.log_radius - self.usual.log_radius) / LOG_RADIUS_DEVIATION,
            (press.log_pressure - self.usual.log_pressure) / LOG_PRESSURE_DEVIATION,
        ]
    }

    fn cost_of(&self, presses: &[Press], residual: &[f64]) -> f64 {
        let unusual = |press: &Press| self.unusual(press).iter().map(|v| v * v).sum::<f64>();
        self.left_of(residual) + presses.iter().map(unusual).sum::<f64>()
    }

    fn stepped(&self, press: &Press, step: &[f64]) -> Press {
        let cell_m = self.mechanics.cell_m;
        let radius = RADII_CELLS.map(|cells| (cells * cell_m[0].min(cell_m[1])).ln());
        Press {
            centre_m: [0, 1].map(|axis| {
                let to = press.centre_m[axis] + step[axis] * cell_m[axis];
                to.clamp(self.usual.low_m[axis], self.usual.high_m[axis])
            }),
            log_radius: (press.log_radius + step[2]).clamp(radius[0], radius[1]),
            log_pressure: press.log_pressure + step[3],
        }
    }
}

impl Problem for Way<'_, '_> {
    type Error = MitError;

    fn unknowns(&self) -> usize {
        OF_PRESS * self.presses.len()
    }

    fn cost(&mut self) -> Result<f64, MitError> {
        let presses = self.presses.clone();
        let mut residual = std::mem::take(&mut self.residual);
        self.residual_of(&presses, &mut residual)?;
        self.residual = residual;
        Ok(self.cost_of(&self.presses, &self.residual))
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, MitError> {
        let (unknowns, count, channels) = (self.unknowns(), self.mechanics.count(), self.residual.len());
        self.mechanics.travels(&self.presses, true, &mut self.travels);
        self.jacobian = self.frame.coils.jacobian(&self.travels.travel_m)?;
        self.columns.clear();
        for slopes in self.travels.slopes.chunks_exact(count) {
            let moved: Vec<usize> = (0..count).filter(|&k| slopes[k] != 0.0).collect();
            let of_row = |row: &[f64]| moved.iter().map(|&k| row[k] * slopes[k]).sum::<f64>();
            self.columns.extend(self.jacobian.chunks_exact(count).map(of_row));
        }
        let weights = &self.frame.weights;
        let column = |k: usize| &self.columns[k * channels..(k + 1) * channels];
        for a in 0..unknowns {
            let weighted: Vec<f64> = column(a).iter().zip(weights).map(|(v, w)| v * w).collect();
            equations.right[a] = weighted.iter().zip(&self.residual).map(|(v, r)| v * r).sum();
            for b in 0..=a {
                let sum = weighted.iter().zip(column(b)).map(|(v, c)| v * c).sum();
                equations.normal[a * unknowns + b] = sum;
                equations.normal[b * unknowns + a] = sum;
            }
        }
        for (number, press) in self.presses.iter().enumerate() {
            // Presses may be anywhere: positions have the variance of a uniform prior, and no gradient.
            for axis in 0..2 {
                let side_cells = (self.usual.high_m[axis] - self.usual.low_m[axis]) / self.mechanics.cell_m[axis];
                let at = OF_PRESS * number + axis;
                equations.normal[at * unknowns + at] += 12.0 / (side_cells * side_cells);
            }
            let deviations = [LOG_RADIUS_DEVIATION, LOG_PRESSURE_DEVIATION];
            for ((k, unusual), deviation) in (2..OF_PRESS).zip(self.unusual(press)).zip(deviations) {
                let at = OF_PRESS * number + k;
                equations.normal[at * unknowns + at] += deviation.powi(-2);
                equations.right[at] -= unusual / deviation;
            }
        }
        Ok(true)
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, MitError> {
        let longest = step.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        if !longest.is_finite() {
            return Ok(None);
        }
        let shortened = (LONGEST_STEP / longest).min(1.0);
        let step: Vec<f64> = step.iter().map(|v| shortened * v).collect();
        self.tried =
            self.presses.iter().zip(step.chunks_exact(OF_PRESS)).map(|(press, by)| self.stepped(press, by)).collect();
        let (tried, mut residual) = (self.tried.clone(), std::mem::take(&mut self.tried_residual));
        self.residual_of(&tried, &mut residual)?;
        self.tried_residual = residual;
        Ok(Some(Trial { cost: self.cost_of(&self.tried, &self.tried_residual), moved: shortened * longest }))
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.presses, &mut self.tried);
        std::mem::swap(&mut self.residual, &mut self.tried_residual);
    }
}
