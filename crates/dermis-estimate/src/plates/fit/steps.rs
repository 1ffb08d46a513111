//! The steps of a fit of presses on plates.

use dermis_tomo::inner_product;
use dermis_tomo::least_squares::{
    Error, NormalEquations, Outcome, Params, Problem, Progress, Scratch, Tolerances, Trial, minimise,
};

use super::{LOG_PRESSURE, LOG_RADIUS, PlateFit, State};
use crate::evidence::Evidence;
use crate::plates::model::LONGEST_LOG;
use crate::plates::pressure::{OF_PRESS, Pressed};
use crate::press::{Cost, Effort};

/// Initial damping.
const DAMPING: f64 = 1e-3;
/// A fit has converged when no press moves by more than this share of its radius, and no logarithm changes by more
/// than ten times this.
const CONVERGED: f64 = 2e-3;
/// A fit has also converged when a step lowers the residual by less than this share of it, or of the model's own error.
/// If the residual is noise, in some 200 readings, that is 0.2 of a squared standard deviation. Errors of the model
/// come in few shapes, so that they weigh more.
const NO_BETTER: f64 = 1e-3;
/// The same for a fit that only compares explanations. A full fit follows where it matters.
const QUICK_NO_BETTER: f64 = 0.02;
/// Largest move in one step, in radii.
const LONGEST: f64 = 0.5;

impl PlateFit {
    /// Fits presses from the current ones by this number of steps at most. `None` if they cannot be fitted.
    pub(super) fn improve(&mut self, steps: usize) -> Option<Cost> {
        let mut solver = Scratch::new(OF_PRESS * self.at.presses.len());
        let params = Params::until_settled(DAMPING, steps);
        let mut way = FitUnderWay { fit: &mut *self, tried: None };
        let info = minimise(&mut way, &params, &mut solver).ok()?;
        // The last step of a fit that has settled is too short to change its covariances.
        if info.outcome != Outcome::Settled {
            way.linearise(&mut solver.equations).ok()?;
        }
        let cost = self.cost();
        self.find_covariances(&mut solver, &cost);
        Some(cost)
    }
}

/// A fit in progress.
struct FitUnderWay<'a> {
    fit: &'a mut PlateFit,
    tried: Option<State>,
}

impl FitUnderWay<'_> {
    fn cost_of(&self, state: &State) -> f64 {
        state.residual.iter().map(|v| v * v).sum::<f64>() + self.fit.prior.penalty(&state.presses)
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
        let columns: Vec<Vec<f64>> = model
            .derivatives(&at.presses, &at.contacts)
            .iter()
            .map(|column| {
                let mut whitened = Vec::new();
                weighing.whitening.apply(column, &mut whitened);
                whitened
            })
            .collect();
        let n = columns.len();
        let NormalEquations { normal, right } = equations;
        for a in 0..n {
            right[a] = inner_product(&columns[a], &at.residual);
            for b in 0..=a {
                let value = inner_product(&columns[a], &columns[b]);
                (normal[a * n + b], normal[b * n + a]) = (value, value);
            }
        }
        for (k, press) in at.presses.iter().enumerate() {
            let priors = [LOG_PRESSURE, LOG_RADIUS].into_iter().zip(prior.off(press)).zip(prior.deviations);
            for ((parameter, off), deviation) in priors {
                let at = OF_PRESS * k + parameter;
                normal[at * n + at] += deviation.powi(-2);
                right[at] -= off / deviation;
            }
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
            let share = if distance_m > longest_m { longest_m / distance_m } else { 1.0 };
            let log = |change: f64| change.clamp(-LONGEST_LOG, LONGEST_LOG);
            let next = model.limited(Pressed {
                position_m: [press.position_m[0] + share * step[0], press.position_m[1] + share * step[1]],
                log_pressure: press.log_pressure + log(step[LOG_PRESSURE]),
                log_radius: press.log_radius + log(step[LOG_RADIUS]),
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
        let PlateFit { error_share, frame, at, .. } = &*self.fit;
        let (no_better, left) = match at.effort {
            Effort::Quick => (QUICK_NO_BETTER, progress.after),
            Effort::Full => (NO_BETTER, Evidence::left_in_shapes(&self.fit.cost_of(at))),
        };
        let least_gain = no_better * left.max(error_share * inner_product(frame, frame));
        progress.moved < CONVERGED || progress.before - progress.after < least_gain
    }
}
