//! The steps of a fit of presses on plates.

use dermis_tomo::inner_product;
use dermis_tomo::least_squares::{
    Error, NormalEquations, Outcome, Params, Problem, Progress, Scratch, Tolerances, Trial, minimise,
};

use super::{LOG_PRESSURE, LOG_RADIUS, PlateFit, State};
use crate::evidence::Evidence;
use crate::plates::force::PressDoubt;
use crate::plates::model::LONGEST_LOG;
use crate::plates::pressure::{OF_PRESS, Pressed};
use crate::press::{Cost, Effort};

/// Initial damping. Frames determine pressure and radius together a thousand times better than either alone, so this
/// stops fits early along that direction. [`PressDoubt::to_go`] remembers what is left of the way.
const DAMPING: f64 = 1e-3;
/// A fit has converged when no press moves by more than this share of its radius, and no logarithm changes by more
/// than ten times this.
const CONVERGED: f64 = 2e-3;
/// A fit has also converged when a step lowers the residual by less than this share of it, or of [`OF_ENERGY`].
/// If the residual is noise, in some 200 readings, that is 0.2 of a squared standard deviation. Errors of the model
/// come in few shapes, so that they weigh more.
const NO_BETTER: f64 = 1e-3;
/// The same for a fit that only compares explanations. A full fit follows where it matters.
const QUICK_NO_BETTER: f64 = 0.02;
/// Share of a frame's energy that counts like its residual there: more precise fits take long and move no press. Forces
/// are found from the step that is left.
const OF_ENERGY: f64 = 5e-4;
/// Largest move in one step, in radii.
const LONGEST: f64 = 0.5;

impl PlateFit {
    /// Fits presses from the current ones by this number of steps at most. `None` if they cannot be fitted.
    pub(super) fn improve(&mut self, steps: usize) -> Option<Cost> {
        let mut solver = Scratch::new(OF_PRESS * self.at.presses.len());
        let params = Params::until_settled(DAMPING, steps);
        let mut way = FitUnderWay { fit: &mut *self, tried: None, columns: Vec::new() };
        let info = minimise(&mut way, &params, &mut solver).ok()?;
        // The last step of a fit that has settled is too short to change its covariances.
        let has_fixed = !std::mem::take(&mut way.fit.fixed).is_empty();
        if info.outcome == Outcome::Settled && !has_fixed {
            way.slopes(&way.fit.at, &mut solver.equations.right);
        } else {
            way.linearise(&mut solver.equations).ok()?;
        }
        let columns = way.columns;
        let cost = self.cost();
        let Scratch { equations, factor, step } = &mut solver;
        if !equations.solve_damped(0.0, factor, step) {
            step.fill(0.0);
        }
        self.gain_of_step = inner_product(&equations.right, step);
        let explained: Vec<f64> = self.frame.iter().zip(&self.at.residual).map(|(frame, left)| frame - left).collect();
        let doubt = |(step, columns): (&[f64], &[Vec<f64>])| PressDoubt {
            to_go: [LOG_PRESSURE, LOG_RADIUS].map(|parameter| step[parameter]),
            by_gain: [LOG_PRESSURE, LOG_RADIUS].map(|parameter| inner_product(&columns[parameter], &explained)),
        };
        let parts = step.chunks_exact(OF_PRESS).zip(columns.chunks_exact(OF_PRESS));
        self.doubt.of_presses = parts.map(doubt).collect();
        self.find_covariances(&mut solver, &cost);
        Some(cost)
    }
}

/// A fit in progress.
struct FitUnderWay<'a> {
    fit: &'a mut PlateFit,
    tried: Option<State>,
    /// Whitened derivatives of the channels at the last linearisation.
    columns: Vec<Vec<f64>>,
}

impl FitUnderWay<'_> {
    fn cost_of(&self, state: &State) -> f64 {
        state.residual.iter().map(|v| v * v).sum::<f64>() + self.fit.prior.penalty(&state.presses)
    }

    /// Writes the slopes of half the cost, downwards, with the derivatives of the last linearisation.
    fn slopes(&self, state: &State, right: &mut [f64]) {
        for (value, column) in right.iter_mut().zip(&self.columns) {
            *value = inner_product(column, &state.residual);
        }
        for (press, right) in state.presses.iter().zip(right.chunks_exact_mut(OF_PRESS)) {
            let [of_pressure, of_radius] = self.fit.prior.slopes(press);
            right[LOG_PRESSURE] -= of_pressure;
            right[LOG_RADIUS] -= of_radius;
        }
    }
}

impl Problem for FitUnderWay<'_> {
    type Error = Error;

    fn unknowns(&self) -> usize {
        OF_PRESS * self.fit.at.presses.len()
    }

    fn cost(&mut self) -> Result<f64, Error> {
        Ok(self.cost_of(&self.fit.at))
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, Error> {
        let PlateFit { model, weighing, prior, at, .. } = &*self.fit;
        let whitened = |column: &Vec<f64>| {
            let mut whitened = Vec::new();
            weighing.whitening.apply(column, &mut whitened);
            whitened
        };
        self.columns = model.derivatives(&at.presses, &at.contacts).iter().map(whitened).collect();
        let n = self.columns.len();
        for a in 0..n {
            for b in 0..=a {
                let value = inner_product(&self.columns[a], &self.columns[b]);
                (equations.normal[a * n + b], equations.normal[b * n + a]) = (value, value);
            }
        }
        for k in 0..at.presses.len() {
            for (parameter, precision) in [LOG_PRESSURE, LOG_RADIUS].into_iter().zip(prior.precisions()) {
                let at = OF_PRESS * k + parameter;
                equations.normal[at * n + at] += precision;
            }
        }
        self.slopes(at, &mut equations.right);
        for (press, _) in self.fit.fixed.iter().enumerate().filter(|(_, is_fixed)| **is_fixed) {
            [0, 1, LOG_RADIUS].into_iter().for_each(|parameter| equations.fix(OF_PRESS * press + parameter));
        }
        Ok(true)
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, Error> {
        let mut moved: f64 = 0.0;
        let model = &self.fit.model;
        let presses = self.fit.at.presses.iter().zip(step.chunks_exact(OF_PRESS)).map(|(press, step)| {
            let radius_m = press.log_radius.exp();
            let distance_m = step[0].hypot(step[1]);
            let longest_m = LONGEST * radius_m.max(model.law().spread_m);
            let share = (longest_m / distance_m).min(1.0);
            // A step shortened in only one of the logarithms would leave the direction that frames hardly determine.
            let log_share = (LONGEST_LOG / step[LOG_PRESSURE].abs().max(step[LOG_RADIUS].abs())).min(1.0);
            let next = model.limited(Pressed {
                position_m: [press.position_m[0] + share * step[0], press.position_m[1] + share * step[1]],
                log_pressure: press.log_pressure + log_share * step[LOG_PRESSURE],
                log_radius: press.log_radius + log_share * step[LOG_RADIUS],
                has_ended: press.has_ended,
            });
            let logs = (next.log_pressure - press.log_pressure).abs().max((next.log_radius - press.log_radius).abs());
            moved = moved.max(share * distance_m / radius_m).max(0.1 * logs);
            next
        });
        let presses: Vec<Pressed> = presses.collect();
        let Some(next) = self.fit.state(presses, self.fit.at.effort) else { return Ok(None) };
        let cost = self.cost_of(&next);
        self.tried = Some(next);
        Ok(cost.is_finite().then_some(Trial { cost, moved }))
    }

    fn accept(&mut self) {
        if let Some(next) = self.tried.take() {
            self.fit.at = next;
        }
    }

    fn is_settled(&self, progress: &Progress, _tolerances: &Tolerances) -> bool {
        let PlateFit { frame, at, .. } = &*self.fit;
        let (no_better, left) = match at.effort {
            Effort::Quick => (QUICK_NO_BETTER, progress.after),
            Effort::Full => (NO_BETTER, Evidence::left_in_shapes(&self.fit.cost_of(at))),
        };
        let least_gain = no_better * left.max(OF_ENERGY * inner_product(frame, frame));
        progress.moved < CONVERGED || progress.before - progress.after < least_gain
    }
}
