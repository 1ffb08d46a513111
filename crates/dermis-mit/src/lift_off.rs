//! Lift-off of known bodies, i.e. their heights above the coils, from readings of the coils. A touch moves bodies at
//! known places, so their travel towards the coils is solved for directly instead of an image. Minimises
//! `sum ((d - f(t))/s)^2 + sum (t/p)^2 + 2 sum t/e` over travels `0 <= t <= limit` by Gauss-Newton steps
//! ([`dermis_tomo::least_squares`]), each a least-squares problem in that box (`in_box`). f are changes of the
//! magnitudes of mutual inductances, s their standard deviations, and p and e the scales of a Gaussian and an
//! exponential prior; the latter favours solutions in which few bodies move.

use dermis_tomo::least_squares::{
    Acceptance, Control, NormalEquations, Outcome, Params, Problem, Scratch, Tolerances, Trial, minimise,
};

use crate::error::{MitError, positive};
use crate::in_box::{deviations, in_box};
use crate::multipole_array::MultipoleArray;
use crate::vector::Complex;

/// Options of the lift-off fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LiftOffOptions {
    /// p: prior standard deviation of travels, metres.
    pub prior_m: f64,
    /// e: mean travel of the exponential prior, metres; infinite for none.
    pub mean_m: f64,
    /// Model error as a share of each channel's change, which adds to the noise.
    pub model_share: f64,
    /// Model error as a share of the RMS change over all channels, which also adds to the noise.
    pub model_floor: f64,
    /// Maximum number of Gauss-Newton steps.
    pub most_steps: usize,
    /// The fit ends if no travel changes by more than this, metres.
    pub tolerance_m: f64,
}

impl Default for LiftOffOptions {
    /// For travels of millimetres and a model accurate to a few per cent.
    fn default() -> Self {
        Self { prior_m: 10e-3, mean_m: 1e-3, model_share: 0.02, model_floor: 0.003, most_steps: 30, tolerance_m: 1e-6 }
    }
}

/// Travels fitted to readings.
#[derive(Clone, Debug, PartialEq)]
pub struct LiftOffFit {
    /// Travel of each body towards the coils, metres.
    pub travel_m: Vec<f64>,
    /// Posterior standard deviation of each travel, metres, linearised; for bodies at rest (on the bound), as if they
    /// were free.
    pub deviation_m: Vec<f64>,
    /// Mean squared residual in units of noise and model error; about 1 if these are correct.
    pub misfit: f64,
    /// Number of Gauss-Newton steps made.
    pub steps: usize,
    /// True if the tolerance was met.
    pub converged: bool,
}

/// Bodies over coils, whose lift-off is solved for as travel from rest.
#[derive(Clone, Debug)]
pub struct LiftOff {
    bodies: MultipoleArray,
    mutuals_h: Vec<f64>,
    rest_m: Vec<f64>,
    limit_m: f64,
    rest_h: Vec<f64>,
    /// Heights to which `changes_h` belong.
    heights_m: Vec<f64>,
    changes_h: Vec<Complex>,
    slopes_h_per_m: Vec<Complex>,
}

impl LiftOff {
    /// Bodies at their rest heights that move down by at most `limit_m`; `mutuals_h` are the pairs' inductances
    /// without bodies.
    ///
    /// # Errors
    /// Counts that disagree, or a limit that is not positive or reaches outside the bodies' tables.
    pub fn new(
        mut bodies: MultipoleArray,
        mutuals_h: Vec<f64>,
        rest_m: Vec<f64>,
        limit_m: f64,
    ) -> Result<Self, MitError> {
        positive("limit_m", limit_m)?;
        let (pairs, count) = (bodies.pairs().len(), bodies.count());
        if mutuals_h.len() != pairs {
            return Err(MitError::Count { what: "mutual inductances", expected: pairs, got: mutuals_h.len() });
        }
        let zero = Complex::new(0.0, 0.0);
        let mut changes_h = vec![zero; pairs];
        let lowest: Vec<f64> = rest_m.iter().map(|h| h - limit_m).collect();
        bodies.changes(&lowest, &mut changes_h)?;
        bodies.changes(&rest_m, &mut changes_h)?;
        let rest_h = magnitudes(&mutuals_h, &changes_h).collect();
        let slopes_h_per_m = vec![zero; pairs * count];
        let heights_m = rest_m.clone();
        Ok(Self { bodies, mutuals_h, rest_m, limit_m, rest_h, heights_m, changes_h, slopes_h_per_m })
    }

    /// Number of bodies.
    pub fn count(&self) -> usize {
        self.rest_m.len()
    }

    /// Magnitudes of the mutual inductances at rest, henries.
    pub fn rest_h(&self) -> &[f64] {
        &self.rest_h
    }

    /// Changes of the magnitudes from rest for these travels, henries.
    ///
    /// # Errors
    /// As [`MultipoleArray::changes`].
    pub fn differences_h(&mut self, travel_m: &[f64]) -> Result<Vec<f64>, MitError> {
        self.stand_at(travel_m)?;
        Ok(magnitudes(&self.mutuals_h, &self.changes_h).zip(&self.rest_h).map(|(now, rest)| now - rest).collect())
    }

    /// Computes the changes for these travels, unless they are already available.
    fn stand_at(&mut self, travel_m: &[f64]) -> Result<(), MitError> {
        let heights = self.rest_m.iter().zip(travel_m).map(|(rest, t)| rest - t);
        if self.heights_m.len() == travel_m.len() && heights.clone().eq(self.heights_m.iter().copied()) {
            return Ok(());
        }
        let heights: Vec<f64> = heights.collect();
        self.heights_m.clear();
        self.bodies.changes(&heights, &mut self.changes_h)?;
        self.heights_m = heights;
        Ok(())
    }

    /// Derivatives of the magnitudes with respect to the travels, by pair and then body, henries per metre.
    ///
    /// # Errors
    /// As [`MultipoleArray::changes`].
    pub fn jacobian(&mut self, travel_m: &[f64]) -> Result<Vec<f64>, MitError> {
        self.stand_at(travel_m)?;
        self.bodies.slopes(&self.heights_m, &mut self.slopes_h_per_m)?;
        let mut jacobian = Vec::with_capacity(self.slopes_h_per_m.len());
        let rows = self.slopes_h_per_m.chunks_exact(self.rest_m.len());
        for ((row, change), mutual) in rows.zip(&self.changes_h).zip(&self.mutuals_h) {
            let whole = *change + *mutual;
            let direction = whole.conj() * (1.0 / whole.norm().max(f64::MIN_POSITIVE));
            jacobian.extend(row.iter().map(|slope| -(direction * *slope).re));
        }
        Ok(jacobian)
    }

    /// Fits travels to these changes of magnitudes (henries: volts over `2 pi f I`) with noise of these standard
    /// deviations.
    ///
    /// # Errors
    /// Counts that disagree, or deviations or options that are not positive.
    pub fn solve(
        &mut self,
        differences_h: &[f64],
        deviations_h: &[f64],
        options: &LiftOffOptions,
    ) -> Result<LiftOffFit, MitError> {
        self.solve_from(&vec![0.0; self.count()], differences_h, deviations_h, options)
    }

    /// The same with a warm start, for instance from the previous frame; takes fewer steps.
    ///
    /// # Errors
    /// As [`LiftOff::solve`].
    pub fn solve_from(
        &mut self,
        start_m: &[f64],
        differences_h: &[f64],
        deviations_h: &[f64],
        options: &LiftOffOptions,
    ) -> Result<LiftOffFit, MitError> {
        let weights = self.weights(differences_h, deviations_h, options)?;
        let (prior, pull) = (options.prior_m.powi(-2), 1.0 / options.mean_m);
        let count = self.count();
        if start_m.len() != count {
            return Err(MitError::Count { what: "travels", expected: count, got: start_m.len() });
        }
        let travel: Vec<f64> = start_m.iter().map(|t| t.clamp(0.0, self.limit_m)).collect();
        let tried = (travel.clone(), Vec::new());
        let mut way =
            SolutionUnderWay { coils: self, differences_h, weights, prior, pull, travel, residual: Vec::new(), tried };
        let params = Params {
            control: Control::Shortening { factor: 0.5 },
            acceptance: Acceptance::NotHigher,
            tolerances: Tolerances { moved: Some(options.tolerance_m), ..Tolerances::default() },
            most_trials: usize::MAX,
            most_linearisations: options.most_steps,
            most_rejections: usize::MAX,
        };
        let info = minimise(&mut way, &params, &mut Scratch::default())?;
        let SolutionUnderWay { weights, travel, residual, .. } = way;
        let jacobian = self.jacobian(&travel)?;
        let mut normal = vec![0.0; count * count];
        write_normal_matrix(&jacobian, &weights, count, prior, &mut normal);
        let squares: f64 = residual.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
        let deviation_m = deviations(&normal, &travel);
        let (misfit, steps) = (squares / residual.len() as f64, info.linearisations);
        let converged = info.outcome == Outcome::Settled && steps > 0;
        Ok(LiftOffFit { travel_m: travel, deviation_m, misfit, steps, converged })
    }

    /// Inverse variances of changes of magnitudes (henries) from noise of these standard deviations and from model
    /// error.
    ///
    /// # Errors
    /// Counts that disagree, or deviations or options that are not positive.
    pub fn weights(&self, d: &[f64], deviations_h: &[f64], options: &LiftOffOptions) -> Result<Vec<f64>, MitError> {
        positive("prior_m", options.prior_m)?;
        positive("tolerance_m", options.tolerance_m)?;
        if options.mean_m.is_nan() || options.mean_m <= 0.0 {
            return Err(MitError::Value { field: "mean_m", value: options.mean_m, expected: "above zero" });
        }
        for (what, got) in [("differences", d.len()), ("deviations", deviations_h.len())] {
            if got != self.mutuals_h.len() {
                return Err(MitError::Count { what, expected: self.mutuals_h.len(), got });
            }
        }
        let mean_square = d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64;
        let mut weights = Vec::with_capacity(d.len());
        for (d, s) in d.iter().zip(deviations_h) {
            positive("deviation_h", *s)?;
            let model = (options.model_share * d).powi(2) + options.model_floor.powi(2) * mean_square;
            let weight = 1.0 / (s * s + model);
            if !d.is_finite() {
                return Err(MitError::Value { field: "difference_h", value: *d, expected: "finite" });
            }
            weights.push(weight);
        }
        Ok(weights)
    }
}

fn magnitudes<'a>(mutuals_h: &'a [f64], changes_h: &'a [Complex]) -> impl Iterator<Item = f64> + 'a {
    mutuals_h.iter().zip(changes_h).map(|(mutual, change)| (*change + *mutual).norm())
}

/// A fit of travels in progress.
struct SolutionUnderWay<'a> {
    coils: &'a mut LiftOff,
    differences_h: &'a [f64],
    weights: Vec<f64>,
    prior: f64,
    pull: f64,
    travel: Vec<f64>,
    residual: Vec<f64>,
    /// The last travels tried, and their residuals.
    tried: (Vec<f64>, Vec<f64>),
}

impl SolutionUnderWay<'_> {
    fn left(&mut self, travel: &[f64]) -> Result<Vec<f64>, MitError> {
        let predicted = self.coils.differences_h(travel)?;
        Ok(self.differences_h.iter().zip(&predicted).map(|(d, p)| d - p).collect())
    }

    fn cost_of(&self, residual: &[f64], travel: &[f64]) -> f64 {
        residual.iter().zip(&self.weights).map(|(r, w)| w * r * r).sum::<f64>()
            + travel.iter().map(|t| self.prior * t * t + 2.0 * self.pull * t).sum::<f64>()
    }
}

impl Problem for SolutionUnderWay<'_> {
    type Error = MitError;

    fn unknowns(&self) -> usize {
        self.travel.len()
    }

    fn cost(&mut self) -> Result<f64, MitError> {
        let travel = self.travel.clone();
        self.residual = self.left(&travel)?;
        Ok(self.cost_of(&self.residual, &self.travel))
    }

    /// The right-hand side is b of the quadratic `t'Nt/2 - b't` in the travels, not in the step.
    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, MitError> {
        let jacobian = self.coils.jacobian(&self.travel)?;
        let NormalEquations { normal, right } = equations;
        write_normal_matrix(&jacobian, &self.weights, self.travel.len(), self.prior, normal);
        *right = gradient(&jacobian, &self.weights, &self.residual, &self.travel, normal, self.prior);
        right.iter_mut().for_each(|b| *b -= self.pull);
        Ok(true)
    }

    fn solve(&mut self, equations: &NormalEquations, _damping: f64, _factor: &mut [f64], step: &mut [f64]) -> bool {
        let wanted = in_box(&equations.normal, &equations.right, &self.travel, self.coils.limit_m);
        step.iter_mut().zip(wanted.iter().zip(&self.travel)).for_each(|(step, (wanted, now))| *step = wanted - now);
        true
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, MitError> {
        let travel: Vec<f64> = self.travel.iter().zip(step).map(|(t, step)| t + step).collect();
        let left = self.left(&travel)?;
        let cost = self.cost_of(&left, &travel);
        let moved = self.travel.iter().zip(&travel).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        self.tried = (travel, left);
        Ok(Some(Trial { cost, moved }))
    }

    fn accept(&mut self) {
        std::mem::swap(&mut self.travel, &mut self.tried.0);
        std::mem::swap(&mut self.residual, &mut self.tried.1);
    }
}

/// `J'WJ + prior I`, row by row.
fn write_normal_matrix(jacobian: &[f64], weights: &[f64], count: usize, prior: f64, normal: &mut [f64]) {
    normal.fill(0.0);
    for (row, w) in jacobian.chunks_exact(count).zip(weights) {
        for (i, a) in row.iter().enumerate() {
            let scaled = w * a;
            normal[i * count..(i + 1) * count].iter_mut().zip(row).for_each(|(n, b)| *n += scaled * b);
        }
    }
    (0..count).for_each(|i| normal[i * count + i] += prior);
}

/// b of the quadratic `t'Ht/2 - b't` at the current travels: `J'W r - prior t + H t`.
fn gradient(
    jacobian: &[f64],
    weights: &[f64],
    residual: &[f64],
    travel: &[f64],
    normal: &[f64],
    prior: f64,
) -> Vec<f64> {
    let count = travel.len();
    let mut b: Vec<f64> = normal
        .chunks_exact(count)
        .zip(travel)
        .map(|(row, t)| row.iter().zip(travel).map(|(h, t)| h * t).sum::<f64>() - prior * t)
        .collect();
    for ((row, w), r) in jacobian.chunks_exact(count).zip(weights).zip(residual) {
        b.iter_mut().zip(row).for_each(|(b, j)| *b += w * r * j);
    }
    b
}
