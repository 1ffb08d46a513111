//! Fits patches of contact to a frame: all positions, radii and conductances together, by damped least squares
//! ([`crate::least_squares`]) on the full model, with a broad prior on radius and conductance.

use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};

use super::sheet::{ContactPatch, ContactSheet, Touched};
use crate::eit::EitError;
use crate::least_squares::{
    Acceptance, Control, Damping, NormalEquations, Outcome, Params, Problem, Scratch, Tolerances, Trial, minimise,
};

/// Parameters of a patch: x, y, logarithm of the radius, logarithm of the conductance per area.
pub(super) const OF_PATCH: usize = 4;
/// Initial and maximum damping, relative to the diagonal.
const DAMPING: [f64; 2] = [1e-3, 1e6];
/// Minimum drop in cost (half squared standard deviations) to take another step. Below it, all parameters are within
/// a tenth of their standard deviations of the optimum.
const SETTLED: f64 = 5e-3;
/// Maximum change of a position in one step, in radii, and of a logarithm ([`LONGEST_LOG`]).
const LONGEST: f64 = 0.7;
const LONGEST_LOG: f64 = 0.7;

/// Prior on patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitOptions {
    /// Typical radius, metres.
    pub radius_m: f64,
    /// Standard deviation of its natural logarithm.
    pub radius_log_deviation: f64,
    /// Maximum radius that a step may reach, metres; infinite for no bound. The cost of a step grows with its fourth
    /// power.
    pub most_radius_m: f64,
    /// Typical conductance per area, S/m^2.
    pub conductance_s_per_m2: f64,
    /// Standard deviation of its natural logarithm.
    pub conductance_log_deviation: f64,
    /// Standard deviation of a common relative change of all voltages, fitted together with the patches (for example
    /// as a sheet warms up). 0 to leave it out.
    pub gain_deviation: f64,
    /// Maximum number of steps.
    pub most_steps: usize,
}

/// A patch with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactFit {
    /// The patch.
    pub patch: ContactPatch,
    /// Covariance of x, y (metres), and the natural logarithms of radius and conductance.
    pub covariance: [[f64; 4]; 4],
}

/// Summary of a fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FitSummary {
    /// Mean over the channels of squared residual over variance: 1 if only noise is left.
    pub misfit: f64,
    /// The same before the fit.
    pub energy: f64,
    /// The quantity that a fit minimises: the sum over the channels of squared residual over variance, plus the sum
    /// over the patches of the squared deviations of radius and conductance from the prior, in standard deviations.
    pub cost: f64,
    /// Number of steps taken.
    pub steps: usize,
    /// True if further steps would change nothing or cannot be taken.
    pub settled: bool,
}

/// Patches with their effect on the sheet: the state from which a fit continues, on the same frame or the next.
#[derive(Clone, Debug)]
pub struct PatchFit {
    patches: Vec<ContactPatch>,
    touched: Touched,
    /// Change of the channels due to the patches, volts.
    change_v: Vec<f64>,
    /// Common change of all voltages, as a share of the bare sheet's voltages.
    gain: f64,
    /// Derivatives of the change with respect to the patch parameters, channels x parameters; computed on demand.
    jacobian: Option<Vec<f64>>,
    damping: f64,
}

impl PatchFit {
    /// The current patches.
    pub fn patches(&self) -> &[ContactPatch] {
        &self.patches
    }

    /// Fitted common change of all voltages, as a share of the bare sheet's voltages.
    pub fn gain(&self) -> f64 {
        self.gain
    }
}

impl ContactSheet {
    /// Starts a fit from these patches.
    ///
    /// # Errors
    /// As [`ContactSheet::change_v`].
    pub fn begin_fit(&self, start: &[ContactPatch]) -> Result<PatchFit, EitError> {
        let touched = self.touch(start)?;
        let change_v = self.change_of(&touched);
        Ok(PatchFit { patches: start.to_vec(), touched, change_v, gain: 0.0, jacobian: None, damping: DAMPING[0] })
    }

    /// Fits patches, starting from their current positions, to changes of the channels (volts; non-finite ones are
    /// ignored) with these standard deviations. `left_v` receives the residuals, `NaN` where the change was.
    ///
    /// # Errors
    /// Fails if a length is not the number of channels; otherwise as [`ContactSheet::change_v`].
    pub fn fit(
        &self,
        change_v: &[f64],
        deviation_v: &[f64],
        start: &[ContactPatch],
        options: &FitOptions,
        left_v: &mut Vec<f64>,
    ) -> Result<(Vec<ContactFit>, FitSummary), EitError> {
        self.go_on(change_v, deviation_v, &mut self.begin_fit(start)?, options, left_v)
    }

    /// As [`ContactSheet::fit`], continuing from the state of a fit and leaving it at the patches found. A fit that
    /// used up its steps can be continued.
    ///
    /// # Errors
    /// As [`ContactSheet::fit`].
    pub fn go_on(
        &self,
        change_v: &[f64],
        deviation_v: &[f64],
        from: &mut PatchFit,
        options: &FitOptions,
        left_v: &mut Vec<f64>,
    ) -> Result<(Vec<ContactFit>, FitSummary), EitError> {
        self.check_frame(change_v, deviation_v)?;
        let gain_precision =
            (options.gain_deviation != 0.0).then(|| self.gain_precision(change_v, deviation_v, options));
        let fit = Fit { sheet: self, change_v, deviation_v, options, gain_precision };
        let is_empty = from.patches.is_empty();
        let control = Control::Damping(Damping {
            start: from.damping,
            least: 1e-9,
            most: DAMPING[1],
            decrease: 0.2,
            increase: 8.0,
            least_after_rejection: 0.0,
            refused: None,
        });
        let params = Params {
            control,
            acceptance: Acceptance::Lower,
            tolerances: Tolerances { predicted: Some(SETTLED), agreement: Some(SETTLED), ..Tolerances::default() },
            most_trials: options.most_steps,
            ..Params::default()
        };
        let (mut way, mut scratch) =
            (FitUnderWay { fit: &fit, at: from, tried: None, misfit: 0.0 }, Scratch::default());
        let info = minimise(&mut way, &params, &mut scratch)?;
        let equations = &mut scratch.equations;
        if info.linearisations == 0 && !is_empty {
            fit.normal(way.at, equations);
        }
        let FitUnderWay { misfit, at: from, .. } = way;
        let (steps, cost) = (info.trials, info.cost);
        let settled = steps < options.most_steps || (info.outcome == Outcome::Settled && !is_empty);
        from.damping = info.damping;
        // Restart with little damping when the fit continues on another frame.
        if settled {
            from.damping = DAMPING[0];
        }
        left_v.clear();
        let model = from.change_v.iter().zip(&self.bare_v).map(|(change, bare)| change + from.gain * bare);
        left_v.extend(change_v.iter().zip(model).map(|(change, model)| change - model));
        let energy = fit.misfit(&vec![0.0; change_v.len()], 0.0);
        let summary = FitSummary { misfit, cost: 2.0 * cost, energy, steps, settled };
        let covariance = inverse(equations);
        let block = |k: usize| {
            let mut values = [[f64::NAN; OF_PATCH]; OF_PATCH];
            if let Some(matrix) = &covariance {
                for (row, column) in (0..OF_PATCH).flat_map(|r| (0..OF_PATCH).map(move |c| (r, c))) {
                    values[row][column] = matrix[(OF_PATCH * k + row, OF_PATCH * k + column)];
                }
            }
            values
        };
        let patches = from.patches.iter().enumerate();
        let fits = patches.map(|(k, &patch)| ContactFit { patch, covariance: block(k) }).collect();
        Ok((fits, summary))
    }

    /// Channels x parameters, row-major: `dV/dg_p = -w_m w_s` times the derivative of the node's conductance with
    /// respect to each parameter.
    pub(super) fn derivatives(&self, patches: &[ContactPatch], touched: &Touched) -> Vec<f64> {
        let size = OF_PATCH * patches.len();
        let mut jacobian = vec![0.0; self.channels() * size];
        for (k, patch) in patches.iter().enumerate() {
            // The rows of the touched nodes that this patch covers, and the derivatives of their conductances.
            let (mut rows, mut moves) = (Vec::new(), Vec::new());
            for (row, &node) in touched.nodes.iter().enumerate() {
                let (at, area) = (self.positions_m[node as usize], self.areas_m2[node as usize]);
                let [dx, dy] = [at[0] - patch.position_m[0], at[1] - patch.position_m[1]];
                let distance = (dx * dx + dy * dy).sqrt();
                let (share, slope) = self.coverage(patch.radius_m, distance);
                if share > 0.0 {
                    let g = patch.conductance_s_per_m2 * area;
                    let far = distance.max(1e-12);
                    rows.push(row);
                    // Divided by the node's conductance, which turns a current into the potential across the contact.
                    let by = g / touched.conductance_s[row];
                    moves.push([
                        -slope * dx / far * by,
                        -slope * dy / far * by,
                        -slope * patch.radius_m * by,
                        share * by,
                    ]);
                }
            }
            self.exchange(touched, &rows, &moves, |channel, parameter, value| {
                jacobian[channel * size + OF_PATCH * k + parameter] = value;
            });
        }
        jacobian
    }

    /// Derivatives of the channels with respect to the parameters of one patch. `rows` are the touched nodes that it
    /// covers, and `moves` the derivatives of their conductances, divided by the conductances.
    pub(super) fn exchange(
        &self,
        touched: &Touched,
        rows: &[usize],
        moves: &[[f64; OF_PATCH]],
        mut set: impl FnMut(usize, usize, f64),
    ) {
        let (measuring, stimulations) = (self.measuring(), self.stimulations);
        let mut measured = Mat::<f64>::zeros(rows.len(), measuring.len());
        for (field, column) in measured.col_iter_mut().enumerate() {
            let currents = touched.currents.col(measuring.start + field);
            column.iter_mut().zip(rows).for_each(|(v, &row)| *v = currents[row] / touched.conductance_s[row]);
        }
        let mut driven = Mat::<f64>::zeros(rows.len(), OF_PATCH * stimulations);
        for (column, values) in driven.col_iter_mut().enumerate() {
            let (j, stimulation) = (column / stimulations, column % stimulations);
            let currents = touched.currents.col(stimulation);
            for ((value, &row), by) in values.iter_mut().zip(rows).zip(moves) {
                *value = by[j] * currents[row];
            }
        }
        let exchange = measured.transpose() * &driven;
        for (number, channel) in self.measurements.iter().enumerate() {
            for j in 0..OF_PATCH {
                let column = j * stimulations + channel.stimulation as usize;
                set(number, j, -self.measured(channel, |field| exchange[(field - measuring.start, column)]));
            }
        }
    }

    fn gain_precision(&self, change_v: &[f64], deviation_v: &[f64], options: &FitOptions) -> f64 {
        let channels = change_v.iter().zip(deviation_v).zip(&self.bare_v).filter(|((change, _), _)| change.is_finite());
        let of_prior = 1.0 / (options.gain_deviation * options.gain_deviation);
        channels.fold(of_prior, |precision, ((_, sigma), bare)| precision + (bare / sigma) * (bare / sigma))
    }

    pub(super) fn check_frame(&self, change_v: &[f64], deviation_v: &[f64]) -> Result<(), EitError> {
        let expected = self.channels();
        match [change_v.len(), deviation_v.len()].into_iter().find(|length| *length != expected) {
            Some(got) => Err(EitError::ChannelCount { expected, got }),
            None => Ok(()),
        }
    }
}

struct Fit<'a> {
    sheet: &'a ContactSheet,
    change_v: &'a [f64],
    deviation_v: &'a [f64],
    options: &'a FitOptions,
    /// Precision of the gain (inverse variance) from data and prior, if it is fitted.
    gain_precision: Option<f64>,
}

impl Fit<'_> {
    fn misfit(&self, model: &[f64], gain: f64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (channel, (change, sigma)) in self.change_v.iter().zip(self.deviation_v).enumerate() {
            if change.is_finite() {
                sum += ((change - model[channel] - gain * self.sheet.bare_v[channel]) / sigma).powi(2);
                count += 1.0;
            }
        }
        sum / f64::max(count, 1.0)
    }

    /// The best-fitting gain for patches with this effect; 0 if it is not fitted.
    fn gain(&self, model: &[f64]) -> f64 {
        let Some(precision) = self.gain_precision else { return 0.0 };
        let mut cross = 0.0;
        for (channel, (change, sigma)) in self.change_v.iter().zip(self.deviation_v).enumerate() {
            if change.is_finite() {
                cross += self.sheet.bare_v[channel] / sigma * (change - model[channel]) / sigma;
            }
        }
        cross / precision
    }

    /// Misfit and cost at the current state, with the best-fitting gain.
    fn judge(&self, at: &mut PatchFit) -> (f64, f64) {
        at.gain = self.gain(&at.change_v);
        let misfit = self.misfit(&at.change_v, at.gain);
        let count = self.change_v.iter().filter(|change| change.is_finite()).count() as f64;
        let mut prior: f64 = at.patches.iter().map(|patch| self.off(patch).iter().map(|v| v * v).sum::<f64>()).sum();
        if at.gain != 0.0 {
            prior += (at.gain / self.options.gain_deviation).powi(2);
        }
        (misfit, 0.5 * (count * misfit + prior))
    }

    /// Deviations of radius and conductance from the prior, in standard deviations.
    fn off(&self, patch: &ContactPatch) -> [f64; 2] {
        let options = self.options;
        [
            (patch.radius_m / options.radius_m).ln() / options.radius_log_deviation,
            (patch.conductance_s_per_m2 / options.conductance_s_per_m2).ln() / options.conductance_log_deviation,
        ]
    }

    /// The normal equations at the current state, with the gain eliminated.
    fn normal(&self, at: &mut PatchFit, equations: &mut NormalEquations) {
        let size = OF_PATCH * at.patches.len();
        let gain = at.gain;
        let mut by_gain = vec![0.0; size];
        let PatchFit { patches, touched, jacobian, .. } = at;
        let jacobian = &*jacobian.get_or_insert_with(|| self.sheet.derivatives(patches, touched));
        let NormalEquations { normal, right } = equations;
        normal.fill(0.0);
        right.fill(0.0);
        for (channel, (change, sigma)) in self.change_v.iter().zip(self.deviation_v).enumerate() {
            if !change.is_finite() {
                continue;
            }
            let row = &jacobian[channel * size..(channel + 1) * size];
            let weight = 1.0 / (sigma * sigma);
            let bare = self.sheet.bare_v[channel];
            let residual = change - at.change_v[channel] - gain * bare;
            for a in 0..size {
                by_gain[a] += weight * bare * row[a];
                right[a] += weight * residual * row[a];
                for b in 0..=a {
                    normal[a * size + b] += weight * row[a] * row[b];
                }
            }
        }
        for a in 0..size {
            for b in 0..=a {
                if let Some(precision) = self.gain_precision {
                    normal[a * size + b] -= by_gain[a] * by_gain[b] / precision;
                }
                normal[b * size + a] = normal[a * size + b];
            }
        }
        let deviations = [self.options.radius_log_deviation, self.options.conductance_log_deviation];
        for (k, patch) in at.patches.iter().enumerate() {
            for (j, (off, deviation)) in self.off(patch).into_iter().zip(deviations).enumerate() {
                let at = OF_PATCH * k + 2 + j;
                normal[at * size + at] += 1.0 / (deviation * deviation);
                right[at] -= off / deviation;
            }
        }
    }
}

/// A fit in progress.
struct FitUnderWay<'a> {
    fit: &'a Fit<'a>,
    at: &'a mut PatchFit,
    /// The last patches tried, with their misfit.
    tried: Option<(PatchFit, f64)>,
    /// Misfit at the current state.
    misfit: f64,
}

impl Problem for FitUnderWay<'_> {
    type Error = EitError;

    fn unknowns(&self) -> usize {
        OF_PATCH * self.at.patches.len()
    }

    fn cost(&mut self) -> Result<f64, EitError> {
        let (misfit, cost) = self.fit.judge(self.at);
        self.misfit = misfit;
        Ok(cost)
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, EitError> {
        self.fit.normal(self.at, equations);
        Ok(true)
    }

    fn solve(&mut self, equations: &NormalEquations, damping: f64, _factor: &mut [f64], step: &mut [f64]) -> bool {
        let damped = matrix(equations, 1.0 + damping);
        let Ok(factor) = Llt::new(damped.as_ref(), Side::Lower) else { return false };
        let solution = factor.solve(Mat::from_fn(step.len(), 1, |row, _| equations.right[row]));
        step.iter_mut().zip(solution.col(0).iter()).for_each(|(step, value)| *step = *value);
        true
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, EitError> {
        let mut next = self.fit.sheet.begin_fit(&stepped(&self.at.patches, step, self.fit.options.most_radius_m))?;
        let (misfit, cost) = self.fit.judge(&mut next);
        self.tried = Some((next, misfit));
        Ok(Some(Trial { cost, moved: 0.0 }))
    }

    fn accept(&mut self) {
        if let Some((next, misfit)) = self.tried.take() {
            (*self.at, self.misfit) = (next, misfit);
        }
    }
}

/// The matrix of the normal equations with its diagonal scaled.
fn matrix(equations: &NormalEquations, diagonal: f64) -> Mat<f64> {
    let size = equations.unknowns();
    Mat::from_fn(size, size, |a, b| equations.normal[a * size + b] * if a == b { diagonal } else { 1.0 })
}

fn inverse(equations: &NormalEquations) -> Option<Mat<f64>> {
    let size = equations.unknowns();
    if size == 0 {
        return None;
    }
    let factor = Llt::new(matrix(equations, 1.0).as_ref(), Side::Lower).ok()?;
    Some(factor.solve(Mat::<f64>::identity(size, size)))
}

fn stepped(patches: &[ContactPatch], step: &[f64], most_radius_m: f64) -> Vec<ContactPatch> {
    let moved = |(patch, step): (&ContactPatch, &[f64])| {
        let longest = LONGEST * patch.radius_m;
        let share = (longest / step[0].hypot(step[1])).min(1.0);
        let log = |value: f64| value.clamp(-LONGEST_LOG, LONGEST_LOG).exp();
        ContactPatch {
            position_m: [patch.position_m[0] + share * step[0], patch.position_m[1] + share * step[1]],
            radius_m: (patch.radius_m * log(step[2])).min(most_radius_m.max(patch.radius_m)),
            conductance_s_per_m2: patch.conductance_s_per_m2 * log(step[3]),
        }
    };
    patches.iter().zip(step.chunks_exact(OF_PATCH)).map(moved).collect()
}
