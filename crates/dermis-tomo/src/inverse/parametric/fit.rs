//! The fit of spots to a frame, in reusable memory.

use super::SpotModel;
use super::beyond::Beyond;
use super::large_changes::{LargeChanges, LargeScratch};
use super::products::products;
use super::scratch::FitScratch;
use super::spot::{OF_SPOT, Spot, State};
use crate::inner_product;
use crate::inverse::InverseError;
use crate::least_squares::{
    NormalEquations, Params, Problem, Progress, Scratch, Tolerances, Trial, factorise, minimise, solve_factored,
};
use crate::mesh::Point;

/// Summary of a fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FitOutcome {
    /// Whitened energy of the frame, per combination of channels.
    pub energy: f64,
    /// Whitened energy of the residual, per degree of freedom (combinations minus parameters): 1 for pure noise.
    pub residual: f64,
    /// The same for the linear fit, before any correction for large changes.
    pub in_proportion: f64,
    /// Uniform change of the whole skin, fitted together with the spots.
    pub uniform: f64,
    /// Steps taken.
    pub steps: usize,
}

/// Maximum number of steps of a linear fit.
const MOST_STEPS: usize = 12;
/// Maximum number of steps of a fit with large changes. It uses the derivatives of the linear model and so converges
/// slowly: of 180 presses on a liquid, 7 needed more than 12 steps, none more than 40.
const MOST_STEPS_BEYOND: usize = 40;
/// A fit has converged when no spot moves by more than this share of its radius, and the logarithm of no radius
/// changes by more than ten times this.
const CONVERGED: f64 = 2e-3;
/// A fit has also converged when a step lowers the residual by less than this share of it: with large changes, whose
/// steps take a solve each, by some tenths of a squared standard deviation.
const NO_BETTER: f64 = 1e-6;
const NO_BETTER_BEYOND: f64 = 1e-3;
/// Prior standard deviation of the logarithm of the radius.
const LOG_RADIUS_DEVIATION: f64 = 0.7;
/// Uncertainty of the noise's own energy, which is nominally 1: noise is estimated from 32 frames at rest, and is
/// only roughly the same in all of them. An excess over 1 smaller than this isn't counted as model error.
const NOISE_UNKNOWN: f64 = 0.3;
/// Prior standard deviation of the uniform change. Without a prior it would be confounded with wide spots.
pub(super) const UNIFORM_DEVIATION: f64 = 0.2;
/// Rules of the linear fit. Convergence is decided by `CONVERGED`.
const PARAMS: Params = Params::until_settled(1e-4, MOST_STEPS);
/// Rules of a fit with large changes.
const PARAMS_BEYOND: Params = Params::until_settled(1e-4, MOST_STEPS_BEYOND);

impl SpotModel {
    /// Fits one spot from each start (metres) to difference data (volts). The spots are then in `scratch`. Allocates
    /// nothing, unless the changes are large and the model corrects for that.
    ///
    /// # Errors
    /// A frame of the wrong length or with values that are not finite; no starts, more starts than the model was made
    /// for, or a start outside the skin.
    pub fn fit(
        &self,
        difference: &[f64],
        starts_m: &[Point],
        scratch: &mut FitScratch,
    ) -> Result<FitOutcome, InverseError> {
        let outcome = self.fit_in_proportion(difference, starts_m, scratch)?;
        self.go_beyond_proportion(outcome, scratch)
    }

    /// Continues from the linear fit that has just ended to the result of [`SpotModel::fit`]. Changes nothing if the
    /// changes are small or the model has no correction for large ones. The derivatives stay those of the linear
    /// model.
    ///
    /// # Errors
    /// As [`SpotModel::fit`].
    pub fn go_beyond_proportion(
        &self,
        mut outcome: FitOutcome,
        scratch: &mut FitScratch,
    ) -> Result<FitOutcome, InverseError> {
        if self.look_beyond(outcome.uniform, scratch).is_some() {
            outcome.steps += self.improve(&mut outcome.uniform, scratch)?;
            outcome.residual = self.mean_square(scratch);
            self.finish(outcome.residual, outcome.uniform, scratch);
        }
        Ok(outcome)
    }

    /// Like [`SpotModel::fit`], but treats the channels as linear in all changes; the nonlinear part of large ones
    /// stays in the residual. Allocates nothing.
    ///
    /// # Errors
    /// As [`SpotModel::fit`].
    pub fn fit_in_proportion(
        &self,
        difference: &[f64],
        starts_m: &[Point],
        scratch: &mut FitScratch,
    ) -> Result<FitOutcome, InverseError> {
        self.check_fit(difference, starts_m)?;
        let FitScratch { data, linear, .. } = scratch;
        self.project(difference, data);
        linear.copy_from_slice(data);
        let energy: f64 = data.iter().map(|v| f64::from(*v).powi(2)).sum();
        scratch.looks_beyond = false;
        let mut uniform = self.begin(starts_m, scratch)?;
        let steps = self.improve(&mut uniform, scratch)?;
        let residual = self.mean_square(scratch);
        self.finish(residual, uniform, scratch);
        let energy = energy / self.combinations() as f64;
        Ok(FitOutcome { energy, residual, in_proportion: residual, uniform, steps })
    }

    /// Whitened energy of the residual, per degree of freedom.
    pub(super) fn mean_square(&self, scratch: &FitScratch) -> f64 {
        let left: f64 = scratch.residual.iter().map(|v| f64::from(*v).powi(2)).sum();
        let parameters = OF_SPOT * scratch.state.len() + 1;
        left / self.combinations().saturating_sub(parameters).max(1) as f64
    }

    /// Continues from the current state, whose residual is known. Returns the number of steps taken.
    pub(super) fn improve(&self, uniform: &mut f64, scratch: &mut FitScratch) -> Result<usize, InverseError> {
        let params = if scratch.looks_beyond { &PARAMS_BEYOND } else { &PARAMS };
        let mut solver = std::mem::take(&mut scratch.solver);
        let mut way = FitUnderWay { model: self, scratch: &mut *scratch, uniform: *uniform, tried_uniform: *uniform };
        let info = minimise(&mut way, params, &mut solver);
        *uniform = way.uniform;
        scratch.solver = solver;
        Ok(info?.trials)
    }

    /// Starts to account for large changes. `None` if the model has no correction for them, the changes are small, or
    /// the forward model fails; the spots then stay as they are.
    pub(super) fn look_beyond(&self, uniform: f64, scratch: &mut FitScratch) -> Option<()> {
        let model = self.large.as_ref()?;
        let FitScratch { state, rows, data, residual, large, beyond, looks_beyond, .. } = scratch;
        if !model.are_large(state.iter().map(State::spot), large) {
            return None;
        }
        let part = self.beyond(state, rows, model, beyond, large)?;
        self.residual(state, rows, data, uniform, residual);
        take_off(part, residual);
        *looks_beyond = true;
        Some(())
    }

    /// The nonlinear part of the response to these spots, whose responses are in `rows`. `None` as in
    /// [`LargeChanges::compute`].
    pub(super) fn beyond<'a>(
        &self,
        spots: &[State],
        rows: &[f32],
        model: &LargeChanges,
        beyond: &'a mut Beyond,
        large: &'a mut LargeScratch,
    ) -> Option<&'a [f32]> {
        if beyond.extrapolated(spots, rows).is_some() {
            return Some(beyond.last());
        }
        let part = model.compute(spots.iter().map(State::spot), &self.responses, large)?;
        beyond.learn(spots, part);
        Some(part)
    }

    /// The Cramer-Rao bound on the covariance of a spot (x and y in metres, amplitude, log radius): the inverse of
    /// the Fisher matrix of the spot and the uniform change, with the priors of [`SpotModel::fit`].
    ///
    /// # Errors
    /// A position or radius outside the table; channels that cannot distinguish the parameters.
    pub fn bound(&self, position_m: Point, amplitude: f64, radius_m: f64) -> Result<[[f64; 4]; 4], InverseError> {
        let (mut scratch, log_radius) = (self.scratch(), radius_m.ln());
        let rows = &mut scratch.rows[..OF_SPOT * self.combinations()];
        self.responses.evaluate(position_m, log_radius, &mut scratch.tabulated, rows).ok_or(InverseError::Value {
            what: "radius of a spot (m), or its place",
            index: None,
            value: radius_m,
            expected: "within the table",
        })?;
        scratch.state.push(State { position_m, amplitude, log_radius });
        self.finish(1.0, 0.0, &mut scratch);
        let covariance = scratch.spots[0].covariance;
        if covariance[0][0].is_finite() {
            Ok(covariance)
        } else {
            Err(InverseError::Singular {
                what: "the Fisher matrix of a spot",
                hint: "give it an amplitude that is not 0",
            })
        }
    }

    fn check_fit(&self, difference: &[f64], starts_m: &[Point]) -> Result<(), InverseError> {
        if difference.len() != self.channels() {
            let (expected, got) = (self.channels(), difference.len());
            return Err(InverseError::Size { what: "channels of the frame", expected, got });
        }
        crate::inverse::check_finite("channel", difference)?;
        let most = self.options().most_spots;
        if starts_m.is_empty() || starts_m.len() > most {
            return Err(InverseError::Size { what: "spots to fit", expected: most, got: starts_m.len() });
        }
        match starts_m.iter().position(|start| !self.responses.holds(*start)) {
            Some(index) => Err(InverseError::Value {
                what: "place of a spot (m), x",
                index: Some(index),
                value: starts_m[index][0],
                expected: "on the skin",
            }),
            None => Ok(()),
        }
    }

    /// Starts all spots at one radius: the one at which amplitudes alone explain most of the frame.
    fn begin(&self, starts_m: &[Point], scratch: &mut FitScratch) -> Result<f64, InverseError> {
        let [least, most] = self.responses.log_radii();
        let typical = self.options().typical_radius_m.ln().clamp(least, most);
        let mut best = (f64::INFINITY, typical);
        for candidate in [typical, 0.5 * (least + typical), 0.5 * (most + typical)] {
            let cost = self.linear(starts_m, candidate, scratch);
            if cost.0 < best.0 {
                best = (cost.0, candidate);
            }
        }
        Ok(self.linear(starts_m, best.1, scratch).1)
    }

    /// Fits amplitudes at fixed positions and one radius. Returns the cost and the uniform change.
    fn linear(&self, starts_m: &[Point], log_radius: f64, scratch: &mut FitScratch) -> (f64, f64) {
        let length = self.combinations();
        scratch.state.clear();
        for (k, start) in starts_m.iter().enumerate() {
            scratch.state.push(State { position_m: *start, amplitude: 0.0, log_radius });
            let rows = &mut scratch.rows[OF_SPOT * length * k..OF_SPOT * length * (k + 1)];
            if self.responses.evaluate(*start, log_radius, &mut scratch.tabulated, rows).is_none() {
                return (f64::INFINITY, 0.0);
            }
        }
        let count = starts_m.len() + 1;
        for k in 0..starts_m.len() {
            let from = OF_SPOT * length * k;
            scratch.columns[k * length..(k + 1) * length].copy_from_slice(&scratch.rows[from..from + length]);
        }
        match self.solve_amplitudes(count, scratch) {
            Some(uniform) => (self.cost(scratch, uniform), uniform),
            None => (f64::INFINITY, 0.0),
        }
    }

    /// Solves for the amplitudes of the spots whose responses are in the first columns, and for the uniform change,
    /// which it returns.
    pub(super) fn solve_amplitudes(&self, count: usize, scratch: &mut FitScratch) -> Option<f64> {
        let length = self.combinations();
        scratch.columns[(count - 1) * length..count * length].copy_from_slice(&self.uniform);
        let FitScratch { columns, linear, solver, .. } = scratch;
        solver.resize(count);
        let Scratch { equations: NormalEquations { normal, right }, factor, .. } = solver;
        products(columns, linear, length, count, normal, right);
        for k in 0..count {
            normal[k * count + k] *= 1.0 + 1e-9;
        }
        normal[count * count - 1] += UNIFORM_DEVIATION.powi(-2);
        factor.copy_from_slice(normal);
        if !factorise(factor, count) {
            return None;
        }
        solve_factored(factor, right, count);
        scratch.state.iter_mut().zip(right.iter()).for_each(|(state, a)| state.amplitude = *a);
        let uniform = right[count - 1];
        self.residual(&scratch.state, &scratch.rows, &scratch.linear, uniform, &mut scratch.residual);
        Some(uniform)
    }

    /// Data minus the linear model.
    pub(super) fn residual(&self, state: &[State], rows: &[f32], data: &[f32], uniform: f64, residual: &mut [f32]) {
        let length = data.len();
        residual.copy_from_slice(data);
        for (k, state) in state.iter().enumerate() {
            let (amplitude, from) = (state.amplitude as f32, OF_SPOT * length * k);
            residual.iter_mut().zip(&rows[from..from + length]).for_each(|(r, v)| *r -= amplitude * v);
        }
        residual.iter_mut().zip(&self.uniform).for_each(|(r, v)| *r -= uniform as f32 * v);
    }

    fn cost(&self, scratch: &FitScratch, uniform: f64) -> f64 {
        self.cost_of(&scratch.residual, &scratch.state, uniform)
    }

    fn cost_of(&self, residual: &[f32], state: &[State], uniform: f64) -> f64 {
        let typical = self.options().typical_radius_m.ln();
        let energy: f64 = residual.iter().map(|v| f64::from(*v).powi(2)).sum();
        let radii: f64 = state.iter().map(|s| ((s.log_radius - typical) / LOG_RADIUS_DEVIATION).powi(2)).sum();
        energy + radii + (uniform / UNIFORM_DEVIATION).powi(2)
    }

    /// `G'G` with the priors, and `G'r`, at the current state. The columns are x, y, amplitude and log r of each
    /// spot, then the uniform change. The radius is varied at constant `a r^2`: wide and weak looks like narrow and
    /// strong, and steps along that valley would otherwise be cut short.
    fn normal_equations(&self, uniform: f64, scratch: &mut FitScratch, equations: &mut NormalEquations) {
        let length = self.combinations();
        let FitScratch { rows, columns, residual, state, looks_beyond, beyond, .. } = scratch;
        let NormalEquations { normal, right } = equations;
        let parameters = OF_SPOT * state.len() + 1;
        for (k, state) in state.iter().enumerate() {
            let amplitude = state.amplitude as f32;
            // Responses are stored as value, then the derivatives by x, y and log r.
            let column = |of: usize| (OF_SPOT * k + of) * length..(OF_SPOT * k + of + 1) * length;
            for (place, source, factor) in [(0, 1, amplitude), (1, 2, amplitude), (2, 0, 1.0)] {
                columns[column(place)].iter_mut().zip(&rows[column(source)]).for_each(|(c, v)| *c = factor * v);
            }
            let both = rows[column(3)].iter().zip(&rows[column(0)]);
            columns[column(3)].iter_mut().zip(both).for_each(|(c, (by_r, v))| *c = amplitude * (by_r - 2.0 * v));
            for at in (OF_SPOT * k..OF_SPOT * (k + 1)).filter(|_| *looks_beyond) {
                let column = &mut columns[at * length..(at + 1) * length];
                beyond.weigh(at, column);
                column.iter_mut().zip(beyond.slope(at)).for_each(|(c, v)| *c += v);
            }
        }
        columns[(parameters - 1) * length..parameters * length].copy_from_slice(&self.uniform);
        products(columns, residual, length, parameters, normal, right);
        add_priors(normal, parameters, 1.0);
        let (of_radius, typical) = (LOG_RADIUS_DEVIATION.powi(-2), self.options().typical_radius_m.ln());
        for (k, state) in state.iter().enumerate() {
            let at = OF_SPOT * k + 3;
            right[at] -= of_radius * (state.log_radius - typical);
        }
        right[parameters - 1] -= UNIFORM_DEVIATION.powi(-2) * uniform;
    }

    /// The trial state at the end of a step. Returns the largest move (see [`CONVERGED`]), the uniform change and the
    /// cost there. `None` if the step leaves the table.
    fn try_step(&self, step: &[f64], uniform: f64, scratch: &mut FitScratch) -> Option<(f64, f64, f64)> {
        let length = self.combinations();
        let FitScratch { state, trial, trial_rows, trial_residual, tabulated, large, beyond, looks_beyond, .. } =
            scratch;
        let frame = if *looks_beyond { &scratch.data } else { &scratch.linear };
        let [least, most] = self.responses.log_radii();
        let mut moved: f64 = 0.0;
        trial.clear();
        for (k, state) in state.iter().enumerate() {
            let change = &step[OF_SPOT * k..OF_SPOT * (k + 1)];
            let radius = state.log_radius.exp();
            // Limit steps to half a radius: beyond that the model is not linear in the position.
            let distance = change[0].hypot(change[1]);
            let share = if distance > 0.5 * radius { 0.5 * radius / distance } else { 1.0 };
            let position_m = [state.position_m[0] + share * change[0], state.position_m[1] + share * change[1]];
            let log_radius = (state.log_radius + change[3].clamp(-0.5, 0.5)).clamp(least, most);
            let wider = log_radius - state.log_radius;
            moved = moved.max(share * distance / radius).max(0.1 * wider.abs());
            let rows = &mut trial_rows[OF_SPOT * length * k..OF_SPOT * length * (k + 1)];
            self.responses.evaluate(position_m, log_radius, tabulated, rows)?;
            let amplitude = (state.amplitude + change[2]) * (-2.0 * wider).exp();
            trial.push(State { position_m, amplitude, log_radius });
        }
        let uniform = uniform + step[OF_SPOT * state.len()];
        self.residual(trial, trial_rows, frame, uniform, trial_residual);
        if let Some(model) = self.large.as_ref().filter(|_| *looks_beyond) {
            take_off(self.beyond(trial, trial_rows, model, beyond, large)?, trial_residual);
        }
        let cost = self.cost_of(trial_residual, trial, uniform);
        cost.is_finite().then_some((moved, uniform, cost))
    }

    /// The equations at the current state, with the derivatives of the linear model, in the memory of the solver.
    fn equations_in_proportion(&self, uniform: f64, scratch: &mut FitScratch) -> Scratch {
        let mut solver = std::mem::take(&mut scratch.solver);
        solver.resize(OF_SPOT * scratch.state.len() + 1);
        let looks_beyond = std::mem::replace(&mut scratch.looks_beyond, false);
        self.normal_equations(uniform, scratch, &mut solver.equations);
        scratch.looks_beyond = looks_beyond;
        solver
    }

    /// Amount by which a step of all parameters from the current state would lower the cost, if the model were linear.
    pub(super) fn gain_of_step(&self, uniform: f64, scratch: &mut FitScratch) -> f64 {
        let mut solver = self.equations_in_proportion(uniform, scratch);
        let Scratch { equations, factor, step } = &mut solver;
        let gain = match equations.solve_damped(0.0, factor, step) {
            true => inner_product(&equations.right, step),
            false => f64::INFINITY,
        };
        scratch.solver = solver;
        gain
    }

    /// Fills in the spots with their covariances: the inverse of the normal matrix, in which the frame counts less if
    /// the residual exceeds the noise by more than the noise's own uncertainty.
    pub(super) fn finish(&self, residual: f64, uniform: f64, scratch: &mut FitScratch) {
        let parameters = OF_SPOT * scratch.state.len() + 1;
        let mut solver = self.equations_in_proportion(uniform, scratch);
        let FitScratch { state, spots, .. } = &mut *scratch;
        let Scratch { equations: NormalEquations { normal, right }, factor, .. } = &mut solver;
        // Errors of the model weaken the frame's information, not the priors.
        let scale = (residual - NOISE_UNKNOWN).max(1.0);
        factor.iter_mut().zip(normal.iter()).for_each(|(factor, normal)| *factor = normal / scale);
        add_priors(factor, parameters, 1.0 - 1.0 / scale);
        let known = factorise(factor, parameters);
        spots.clear();
        for (k, state) in state.iter().enumerate() {
            let mut covariance = [[f64::INFINITY; OF_SPOT]; OF_SPOT];
            if known {
                for (column, of_column) in (0..OF_SPOT).map(|column| (column, OF_SPOT * k + column)) {
                    right[..parameters].fill(0.0);
                    right[of_column] = 1.0;
                    solve_factored(factor, right, parameters);
                    (0..OF_SPOT).for_each(|row| covariance[row][column] = right[OF_SPOT * k + row]);
                }
            }
            // Convert from a r^2 back to a.
            let slope = -2.0 * state.amplitude;
            (0..OF_SPOT).for_each(|k| covariance[2][k] += slope * covariance[3][k]);
            (0..OF_SPOT).for_each(|k| covariance[k][2] += slope * covariance[k][3]);
            let radius_m = state.log_radius.exp();
            spots.push(Spot { position_m: state.position_m, amplitude: state.amplitude, radius_m, covariance });
        }
        scratch.solver = solver;
    }
}

/// Takes the nonlinear part of a response off a residual.
pub(super) fn take_off(part: &[f32], residual: &mut [f32]) {
    residual.iter_mut().zip(part).for_each(|(left, part)| *left -= part);
}

/// Adds a share of the priors of radii and uniform change to a normal matrix.
fn add_priors(normal: &mut [f64], parameters: usize, share: f64) {
    for at in (OF_SPOT - 1..parameters - 1).step_by(OF_SPOT) {
        normal[at * parameters + at] += share * LOG_RADIUS_DEVIATION.powi(-2);
    }
    normal[parameters * parameters - 1] += share * UNIFORM_DEVIATION.powi(-2);
}

/// A fit in progress.
struct FitUnderWay<'a> {
    model: &'a SpotModel,
    scratch: &'a mut FitScratch,
    uniform: f64,
    tried_uniform: f64,
}

impl Problem for FitUnderWay<'_> {
    type Error = InverseError;

    fn unknowns(&self) -> usize {
        OF_SPOT * self.scratch.state.len() + 1
    }

    fn cost(&mut self) -> Result<f64, InverseError> {
        Ok(self.model.cost(self.scratch, self.uniform))
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, InverseError> {
        self.model.normal_equations(self.uniform, self.scratch, equations);
        for (spot, _) in self.scratch.fixed.iter().enumerate().filter(|(_, is_fixed)| **is_fixed) {
            [0, 1, 3].into_iter().for_each(|parameter| equations.fix(OF_SPOT * spot + parameter));
        }
        Ok(true)
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, InverseError> {
        let Some((moved, uniform, cost)) = self.model.try_step(step, self.uniform, self.scratch) else {
            return Ok(None);
        };
        self.tried_uniform = uniform;
        Ok(Some(Trial { cost, moved }))
    }

    fn accept(&mut self) {
        let FitScratch { state, trial, rows, trial_rows, residual, trial_residual, .. } = &mut *self.scratch;
        std::mem::swap(state, trial);
        std::mem::swap(rows, trial_rows);
        std::mem::swap(residual, trial_residual);
        self.uniform = self.tried_uniform;
    }

    fn learns_from_steps(&self) -> bool {
        self.scratch.looks_beyond
    }

    fn is_settled(&self, progress: &Progress, _tolerances: &Tolerances) -> bool {
        let no_better = if self.scratch.looks_beyond { NO_BETTER_BEYOND } else { NO_BETTER };
        progress.moved < CONVERGED || progress.before - progress.after < no_better * progress.after
    }
}
