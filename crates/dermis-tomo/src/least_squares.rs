//! Damped nonlinear least squares: one loop for all parameter fits. It minimises a cost `F(x)`, a full or half sum of
//! squares with priors, by steps that solve `(N + damping diag N) step = g` with `N = J'WJ` and `g = J'Wr`
//! (Levenberg, Quart. Appl. Math. 2, 1944, 164; Marquardt, J. SIAM 11, 1963, 431), or by full steps that are
//! shortened while the cost rises. A problem provides its points, costs and equations; it may solve these itself, for
//! example within bounds. The loop decides which steps to take and when to stop.

mod params;
#[cfg(test)]
mod tests;

pub use params::{Acceptance, Control, Damping, Error, Params, Progress, Tolerances};

/// The normal equations at one point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NormalEquations {
    /// `J'WJ` with the priors, unknowns x unknowns, row-major, both triangles.
    pub normal: Vec<f64>,
    /// `J'Wr` with the priors, a descent direction of the cost; or other input of the problem's own
    /// [`Problem::solve`].
    pub right: Vec<f64>,
}

impl NormalEquations {
    /// Equations for `unknowns` unknowns, all zero.
    pub fn new(unknowns: usize) -> Self {
        Self { normal: vec![0.0; unknowns * unknowns], right: vec![0.0; unknowns] }
    }

    /// Resizes for `unknowns` unknowns.
    pub fn resize(&mut self, unknowns: usize) {
        self.normal.resize(unknowns * unknowns, 0.0);
        self.right.resize(unknowns, 0.0);
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.right.len()
    }

    /// Fixes an unknown: its step will be 0.
    pub fn fix(&mut self, unknown: usize) {
        let n = self.unknowns();
        for other in 0..n {
            (self.normal[unknown * n + other], self.normal[other * n + unknown]) = (0.0, 0.0);
        }
        (self.normal[unknown * n + unknown], self.right[unknown]) = (1.0, 0.0);
    }

    /// Solves with the diagonal increased by the damping's share of itself and by 1e-12 of its largest entry.
    /// `factor` must have room for the matrix. Returns false if the matrix is not positive definite; `step` is then
    /// meaningless.
    pub fn solve_damped(&self, damping: f64, factor: &mut [f64], step: &mut [f64]) -> bool {
        let n = self.unknowns();
        let floor = 1e-12 * (0..n).map(|k| self.normal[k * n + k]).fold(0.0, f64::max);
        factor[..n * n].copy_from_slice(&self.normal);
        for k in 0..n {
            factor[k * n + k] += damping * factor[k * n + k] + floor;
        }
        if !factorise(factor, n) {
            return false;
        }
        step[..n].copy_from_slice(&self.right);
        solve_factored(factor, step, n);
        true
    }
}

/// Working memory of the loop; it grows to the size of the problem and is kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scratch {
    /// The equations of the last linearisation.
    pub equations: NormalEquations,
    /// Space for a factor of the matrix.
    pub factor: Vec<f64>,
    /// The last step.
    pub step: Vec<f64>,
}

impl Scratch {
    /// Allocates memory for problems with `unknowns` unknowns.
    pub fn new(unknowns: usize) -> Self {
        let mut scratch = Self::default();
        scratch.resize(unknowns);
        scratch
    }

    /// Resizes for `unknowns` unknowns.
    pub fn resize(&mut self, unknowns: usize) {
        self.equations.resize(unknowns);
        self.factor.resize(unknowns * unknowns, 0.0);
        self.step.resize(unknowns, 0.0);
    }
}

/// Result of trying a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Cost at the end of the step.
    pub cost: f64,
    /// Length of the step in the problem's own measure; 0 if no tolerance uses it.
    pub moved: f64,
}

/// A problem to fit. It has a current point and remembers another one that is being tried.
pub trait Problem {
    /// Errors of the problem.
    type Error: From<Error>;

    /// Number of unknowns, constant during the fit.
    fn unknowns(&self) -> usize;

    /// Cost at the current point.
    ///
    /// # Errors
    /// The problem's own.
    fn cost(&mut self) -> Result<f64, Self::Error>;

    /// Writes the equations at the current point into `equations`, which has the right size and arbitrary values.
    /// Returns false if the equations do not exist, which ends the fit.
    ///
    /// # Errors
    /// The problem's own.
    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, Self::Error>;

    /// Solves the equations into `step`, with space for a factor of the matrix. The damping is 0 if steps are
    /// shortened instead. Returns false on failure.
    fn solve(&mut self, equations: &NormalEquations, damping: f64, factor: &mut [f64], step: &mut [f64]) -> bool {
        equations.solve_damped(damping, factor, step)
    }

    /// Tries the point at the end of a step, shortened if the problem bounds its steps. `None` if that point is not
    /// allowed.
    ///
    /// # Errors
    /// The problem's own.
    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, Self::Error>;

    /// Moves to the last point tried.
    fn accept(&mut self);

    /// True if the equations at a point also depend on the steps tried from there.
    fn learns_from_steps(&self) -> bool {
        false
    }

    /// True if no further steps are needed after this accepted step.
    fn is_settled(&self, progress: &Progress, tolerances: &Tolerances) -> bool {
        tolerances.are_met(progress)
    }
}

/// Reason why a fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// A tolerance is met.
    Settled,
    /// All permitted trials or linearisations are used up.
    Limit,
    /// No step lowers the cost: the damping has reached its maximum, or too many consecutive steps were rejected.
    Stalled,
    /// The equations are unavailable or cannot be solved.
    Unsolvable,
}

/// Summary of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Info {
    /// Reason for ending.
    pub outcome: Outcome,
    /// Number of accepted steps.
    pub steps: usize,
    /// Number of steps tried, including accepted ones.
    pub trials: usize,
    /// Number of linearisations.
    pub linearisations: usize,
    /// Final cost.
    pub cost: f64,
    /// Predicted drop in cost of the last step tried; NaN before the first.
    pub predicted: f64,
    /// Actual drop in cost of the last accepted step; NaN before the first.
    pub actual: f64,
    /// Final damping, from which a later fit may continue; 0 if steps are shortened.
    pub damping: f64,
}

/// Minimises a problem's cost from its current point and leaves it at the best point found. Allocates nothing once
/// the scratch has grown to size, unless the problem does.
///
/// # Errors
/// Parameters out of range, and the problem's own.
pub fn minimise<P: Problem>(problem: &mut P, params: &Params, scratch: &mut Scratch) -> Result<Info, P::Error> {
    params.check()?;
    scratch.resize(problem.unknowns());
    let cost = problem.cost()?;
    let (damping, nan) = (params.control.start(), f64::NAN);
    let info = Info {
        outcome: Outcome::Settled,
        steps: 0,
        trials: 0,
        linearisations: 0,
        cost,
        predicted: nan,
        actual: nan,
        damping,
    };
    if problem.unknowns() == 0 {
        return Ok(info);
    }
    let mut search = Search { problem, params, scratch, info, is_stale: true, is_solved: false, rejected: 0 };
    loop {
        if let Some(outcome) = search.step()? {
            search.info.outcome = outcome;
            return Ok(search.info);
        }
    }
}

/// A fit in progress.
struct Search<'a, P> {
    problem: &'a mut P,
    params: &'a Params,
    scratch: &'a mut Scratch,
    info: Info,
    /// The equations do not belong to the current point.
    is_stale: bool,
    /// The step solves the current equations, or is a shortened version of that step.
    is_solved: bool,
    /// Number of consecutive steps rejected at this point.
    rejected: usize,
}

impl<P: Problem> Search<'_, P> {
    /// Tries one step; returns the outcome if the fit ends.
    fn step(&mut self) -> Result<Option<Outcome>, P::Error> {
        let params = self.params;
        if self.info.trials >= params.most_trials {
            return Ok(Some(Outcome::Limit));
        }
        if self.info.damping >= params.control.most() || self.rejected >= params.most_rejections {
            return Ok(Some(Outcome::Stalled));
        }
        if self.is_stale {
            if self.info.linearisations >= params.most_linearisations {
                return Ok(Some(Outcome::Limit));
            }
            self.info.linearisations += 1;
            if !self.problem.linearise(&mut self.scratch.equations)? {
                return Ok(Some(Outcome::Unsolvable));
            }
            (self.is_stale, self.is_solved, self.rejected) = (false, false, 0);
        }
        if !self.is_solved {
            let Scratch { equations, factor, step } = &mut *self.scratch;
            if !self.problem.solve(equations, self.info.damping, factor, step) {
                if !params.control.survives_refusal() {
                    return Ok(Some(Outcome::Unsolvable));
                }
                self.info.trials += 1;
                return Ok(self.refuse());
            }
            let product: f64 = step.iter().zip(&equations.right).map(|(step, slope)| step * slope).sum();
            self.info.predicted = 0.5 * product;
            if params.tolerances.predicted.is_some_and(|least| self.info.predicted < least) {
                return Ok(Some(Outcome::Settled));
            }
        }
        self.info.trials += 1;
        let Some(trial) = self.problem.try_step(&self.scratch.step)? else { return Ok(self.refuse()) };
        if params.acceptance.allows(self.info.cost, trial.cost) { Ok(self.take(trial)) } else { Ok(self.reject(trial)) }
    }

    fn take(&mut self, trial: Trial) -> Option<Outcome> {
        self.problem.accept();
        let progress =
            Progress { before: self.info.cost, after: trial.cost, predicted: self.info.predicted, moved: trial.moved };
        self.info.steps += 1;
        self.info.actual = progress.before - progress.after;
        self.info.cost = trial.cost;
        self.info.damping = self.params.control.after_success(self.info.damping);
        self.is_stale = true;
        self.problem.is_settled(&progress, &self.params.tolerances).then_some(Outcome::Settled)
    }

    fn reject(&mut self, trial: Trial) -> Option<Outcome> {
        self.rejected += 1;
        self.info.damping = self.params.control.after_rejection(self.info.damping);
        (self.is_solved, self.is_stale) = (false, self.problem.learns_from_steps());
        if let Control::Shortening { factor } = self.params.control {
            if self.params.tolerances.moved.is_some_and(|least| trial.moved <= least) {
                return Some(Outcome::Settled);
            }
            self.shorten(factor);
        }
        None
    }

    /// Handles equations that cannot be solved, or a step to a point that is not allowed.
    fn refuse(&mut self) -> Option<Outcome> {
        self.rejected += 1;
        self.is_solved = false;
        match self.params.control {
            Control::Damping(Damping { refused: Some(factor), .. }) => self.info.damping *= factor,
            Control::Damping(_) => return Some(Outcome::Unsolvable),
            Control::Shortening { factor } => self.shorten(factor),
        }
        None
    }

    fn shorten(&mut self, factor: f64) {
        self.scratch.step.iter_mut().for_each(|value| *value *= factor);
        self.is_solved = true;
    }
}

/// Replaces the lower triangle of a symmetric matrix (row-major) with its Cholesky factor; false if it is not
/// positive definite.
pub(crate) fn factorise(matrix: &mut [f64], n: usize) -> bool {
    for row in 0..n {
        for column in 0..=row {
            let mut sum = matrix[row * n + column];
            for k in 0..column {
                sum -= matrix[row * n + k] * matrix[column * n + k];
            }
            if row == column {
                if !(sum > 0.0 && sum.is_finite()) {
                    return false;
                }
                matrix[row * n + row] = sum.sqrt();
            } else {
                matrix[row * n + column] = sum / matrix[column * n + column];
            }
        }
    }
    true
}

/// Solves with this factor, in place.
pub(crate) fn solve_factored(factor: &[f64], x: &mut [f64], n: usize) {
    for row in 0..n {
        let sum: f64 = (0..row).map(|k| factor[row * n + k] * x[k]).sum();
        x[row] = (x[row] - sum) / factor[row * n + row];
    }
    for row in (0..n).rev() {
        let sum: f64 = (row + 1..n).map(|k| factor[k * n + row] * x[k]).sum();
        x[row] = (x[row] - sum) / factor[row * n + row];
    }
}
