//! The fit of presses on plates to a frame.

mod steps;

use std::sync::Arc;

use dermis_tomo::eit::contacts::PatchSets;
use dermis_tomo::inner_product;
use dermis_tomo::least_squares::{NormalEquations, Scratch};
use dermis_tomo::mesh::{Point, distance};

use super::force::{Alike, PressDoubt};
use super::model::{Made, PlateModel, PlateOptions, SizePrior};
use super::pressure::{OF_PRESS, Pressed, turned};
use super::weighing::Weighing;
use crate::evidence::Evidence;
use crate::press::{BuiltVariance, Cost, Effort, Footprint, Press, PressFit};

/// Places of the logarithms of pressure and radius among the parameters of a press.
const LOG_PRESSURE: usize = 2;
const LOG_RADIUS: usize = 3;
/// Largest number of steps of a fit.
const STEPS: usize = 15;
/// Largest number of steps of a fit that only compares explanations.
const QUICK_STEPS: usize = 8;
/// Radii from which joint sets may be fitted, relative to the usual one. Wider presses would explain much of a cut.
const STARTING_RADII: [f64; 2] = [0.75, 1.05];
/// Work per operation of a search for joint sets: it takes longer than those of factorisations.
const WORK_OF_SETS: f64 = 1.5;
/// Number of proposals for one more press.
const PROPOSALS: usize = 3;
/// Distance of these proposals from each other, in typical radii.
const APART: f64 = 2.0;

/// Fits presses to frames with these weights.
#[derive(Debug)]
pub struct PlateFit {
    model: Arc<PlateModel>,
    weighing: Arc<Weighing>,
    error_share: f64,
    prior: SizePrior,
    /// Radius of the indenter whose forces are reported, if it is known, metres.
    indenter_m: Option<f64>,
    /// The last frame, volts and whitened.
    volts: Vec<f64>,
    frame: Vec<f64>,
    at: State,
    /// Presses evaluated for [`PressFit::left_by`]: a fit may start from them.
    evaluated: Option<State>,
    /// Full fits to the last frame.
    fitted: Vec<Fitted>,
    covariances: Vec<[[f64; OF_PRESS]; OF_PRESS]>,
    /// Presses whose positions and radii are fixed.
    fixed: Vec<bool>,
    /// Amount by which a further step of all parameters would lower the residual.
    gain_of_step: f64,
    doubt: Doubt,
    /// Operations spent on this frame, and the most that may be.
    work: f64,
    most_work: f64,
    /// The search for presses that act together.
    joint: Option<PatchSets>,
}

/// Uncertainties of a fit besides its covariances.
#[derive(Clone, Debug)]
struct Doubt {
    /// Factor on all variances by what the fit has left.
    left_scale: f64,
    /// Factor on the variances of forces by errors of the model. Radius and pressure of an indenter have nearly the
    /// same effect on the channels, so these errors weigh more on a force than on a position.
    inflation: f64,
    of_presses: Vec<PressDoubt>,
}

impl Default for Doubt {
    fn default() -> Self {
        Self { left_scale: 1.0, inflation: 1.0, of_presses: Vec::new() }
    }
}

/// A full fit to the last frame.
#[derive(Clone, Debug)]
struct Fitted {
    /// As reported.
    reported: Vec<Press>,
    presses: Vec<Pressed>,
    /// Change of the channels, volts.
    change: Vec<f64>,
    doubt: Doubt,
}

/// Presses with what they explain.
#[derive(Clone, Debug)]
struct State {
    effort: Effort,
    presses: Vec<Pressed>,
    contacts: Vec<Made>,
    /// Change of the channels, volts.
    change: Vec<f64>,
    /// Whitened frame less whitened change.
    residual: Vec<f64>,
}

impl State {
    fn nothing(residual: Vec<f64>) -> Self {
        Self { effort: Effort::Quick, presses: Vec::new(), contacts: Vec::new(), change: Vec::new(), residual }
    }
}

impl PlateFit {
    /// A fit with these deviations of the channels (volts, infinite for channels to leave out). `nuisances` are
    /// changes of the channels by one standard deviation of each cause besides presses, volts.
    pub fn new(model: Arc<PlateModel>, deviations: &[f64], nuisances: &[Vec<f64>]) -> Self {
        let weighing = Arc::new(Weighing::new(&model, deviations, nuisances));
        let (error_share, prior) = (model.options.error_share, model.prior(None));
        Self {
            model,
            weighing,
            error_share,
            prior,
            indenter_m: None,
            volts: Vec::new(),
            frame: Vec::new(),
            at: State::nothing(Vec::new()),
            evaluated: None,
            fitted: Vec::new(),
            covariances: Vec::new(),
            fixed: Vec::new(),
            gain_of_step: 0.0,
            doubt: Doubt::default(),
            work: 0.0,
            most_work: f64::INFINITY,
            joint: None,
        }
    }

    /// The same fit, which reports forces for an indenter of this radius (metres), if it is known.
    #[must_use]
    pub fn with_indenter(mut self, radius_m: Option<f64>) -> Self {
        self.indenter_m = radius_m;
        self
    }

    /// The state of these presses, with their residual; `None` if their contacts cannot be solved, or beyond the bound
    /// of operations.
    fn state(&mut self, presses: Vec<Pressed>, effort: Effort) -> Option<State> {
        if self.work > self.most_work { None } else { self.evaluate(presses, effort) }
    }

    /// As [`PlateFit::state`], also beyond the bound.
    fn evaluate(&mut self, presses: Vec<Pressed>, effort: Effort) -> Option<State> {
        let contacts = self.model.contacts(&presses, effort).ok()?;
        self.work += PlateModel::work(&contacts);
        let (mut change, mut residual) = (Vec::new(), Vec::new());
        self.model.change(&contacts, &mut change);
        self.weighing.whitening.apply(&change, &mut residual);
        residual.iter_mut().zip(&self.frame).for_each(|(value, frame)| *value = frame - *value);
        Some(State { effort, presses, contacts, change, residual })
    }

    /// Force of a press and its standard deviation, newtons, with this prior. `doubt` is that of its fit, `of_press` its
    /// own part. `None` for a press that has ended.
    fn force_n(
        &self,
        press: &Press,
        pressed: Pressed,
        prior: &SizePrior,
        (doubt, of_press): (&Doubt, PressDoubt),
        built: BuiltVariance,
    ) -> Option<[f64; 2]> {
        // Covariance of the logarithms of load and radius, without what the fit has left.
        let by = [press.load.recip(), 1.0];
        let covariance =
            [0, 1].map(|j| [0, 1].map(|k| by[j] * by[k] * press.covariance[2 + j][2 + k] / doubt.left_scale));
        let conductance = self.model.conductance();
        let alike = Alike::new(conductance, prior, pressed, &covariance, doubt.inflation, of_press, built)?;
        // The law's pressures and its conductances are unknown independently.
        let widened = |[force_n, sigma_n]: [f64; 2]| [force_n, sigma_n.hypot(force_n * built.law.sqrt())];
        if pressed.has_ended { None } else { alike.force_n().map(widened) }
    }

    /// The last full fit to this frame that found this press, with its place in it.
    fn fit_of(&self, press: &Press) -> Option<(&Fitted, usize)> {
        self.fitted.iter().rev().find_map(|fitted| Some((fitted, fitted.place(press)?)))
    }

    fn cost(&self) -> Cost {
        self.cost_of(&self.at)
    }

    fn cost_of(&self, state: &State) -> Cost {
        let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
        let presses = state.presses.len();
        let freedom = (self.weighing.whitening.present() as f64 - (OF_PRESS * presses + 1) as f64).max(1.0);
        let energy = square(&self.frame);
        let model_error = if presses == 0 { 0.0 } else { self.error_share * energy };
        Cost { residual: square(&state.residual), energy, freedom, model_error }
    }

    /// The inverse of the normal matrix, inflated by what the fit has left.
    fn find_covariances(&mut self, solver: &mut Scratch, cost: &Cost) {
        let n = OF_PRESS * self.at.presses.len();
        let Scratch { equations, factor, step } = solver;
        let scale = Evidence::left_scale(cost);
        (self.doubt.left_scale, self.doubt.inflation) = (scale, Evidence::model_scale(cost));
        self.covariances.clear();
        self.covariances.resize(self.at.presses.len(), [[f64::INFINITY; OF_PRESS]; OF_PRESS]);
        for column in 0..n {
            equations.right.fill(0.0);
            equations.right[column] = scale;
            if !equations.solve_damped(0.0, factor, step) {
                return;
            }
            let (k, column) = (column / OF_PRESS, column % OF_PRESS);
            (0..OF_PRESS).for_each(|row| self.covariances[k][row][column] = step[OF_PRESS * k + row]);
        }
    }
}

impl PressFit for PlateFit {
    fn take_frame(&mut self, frame: &[f64]) -> Option<Cost> {
        if frame.len() != self.model.channels() || frame.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let mut whitened = std::mem::take(&mut self.frame);
        self.weighing.whitening.apply(frame, &mut whitened);
        self.frame = whitened;
        self.volts.clear();
        self.volts.extend_from_slice(frame);
        self.work = 0.0;
        self.evaluated = None;
        self.fitted.clear();
        self.fit_nothing()
    }

    fn fit(&mut self, starts: &[Press], effort: Effort) -> Option<Cost> {
        if starts.is_empty() || starts.len() > self.model.options.most_presses {
            return None;
        }
        let presses: Vec<Pressed> = starts.iter().map(|start| self.model.pressed(start)).collect();
        let is_start = |state: &State| state.presses == presses && state.effort == effort;
        self.at = match self.evaluated.take().filter(is_start) {
            Some(start) => start,
            None => self.state(presses, effort)?,
        };
        let steps = if effort == Effort::Full { STEPS } else { QUICK_STEPS };
        let cost = self.improve(steps)?;
        if effort == Effort::Full {
            self.fitted.push(Fitted {
                reported: self.presses(),
                presses: self.at.presses.clone(),
                change: self.at.change.clone(),
                doubt: self.doubt.clone(),
            });
        }
        Some(cost)
    }

    fn left_by(&mut self, presses: &[Press]) -> Option<Cost> {
        let presses: Vec<Pressed> = presses.iter().map(|press| self.model.pressed(press)).collect();
        let state = self.evaluate(presses, Effort::Full)?;
        let cost = self.cost_of(&state);
        self.evaluated = Some(state);
        Some(cost)
    }

    fn fit_loads(&mut self, starts: &[Press]) -> Option<Cost> {
        if starts.is_empty() || starts.len() > self.model.options.most_presses {
            return None;
        }
        // Each press alone, scaled: contacts saturate, but a search needs no more than this.
        let presses: Vec<Pressed> = starts.iter().map(|start| self.model.pressed(start)).collect();
        let (n, mut columns, mut volts) = (starts.len(), Vec::new(), Vec::new());
        for press in &presses {
            let mut whitened = Vec::new();
            self.model.change(&self.model.contacts(&[*press], Effort::Quick).ok()?, &mut volts);
            self.weighing.whitening.apply(&volts, &mut whitened);
            columns.push(whitened);
        }
        let mut equations = NormalEquations::new(n);
        for a in 0..n {
            equations.right[a] = inner_product(&columns[a], &self.frame);
            (0..n).for_each(|b| equations.normal[a * n + b] = inner_product(&columns[a], &columns[b]));
        }
        let (mut factor, mut shares) = (vec![0.0; n * n], vec![0.0; n]);
        if !equations.solve_damped(1e-9, &mut factor, &mut shares) {
            return None;
        }
        self.at = State::nothing(self.frame.clone());
        self.covariances.clear();
        for (k, (start, share)) in starts.iter().zip(&shares).enumerate() {
            self.at.residual.iter_mut().zip(&columns[k]).for_each(|(left, value)| *left -= share * value);
            self.at.presses.push(self.model.pressed(&Press { load: share * start.load, ..*start }));
            let mut covariance = [[0.0; OF_PRESS]; OF_PRESS];
            covariance[LOG_PRESSURE][LOG_PRESSURE] = 1.0 / (share * share * equations.normal[k * n + k]);
            self.covariances.push(covariance);
        }
        Some(self.cost())
    }

    fn fit_fixed(&mut self, starts: &[Press], fixed: &[bool]) -> Option<(Cost, f64)> {
        self.fixed.extend_from_slice(fixed);
        let cost = self.fit(starts, Effort::Full);
        self.fixed.clear();
        Some((cost?, self.gain_of_step))
    }

    fn has_quick_fit(&self) -> bool {
        true
    }

    fn presses(&self) -> Vec<Press> {
        let press = |(pressed, covariance): (&Pressed, &[[f64; OF_PRESS]; OF_PRESS])| {
            let ([log_load, log_radius], by) =
                self.model.conductance().reported(pressed.log_pressure, pressed.log_radius);
            let load = if pressed.has_ended { -log_load.exp() } else { log_load.exp() };
            // x and y stay; load and radius follow from pressure and radius of the disc.
            let mut turn = [[0.0; OF_PRESS]; OF_PRESS];
            (turn[0][0], turn[1][1]) = (1.0, 1.0);
            (turn[2][LOG_PRESSURE], turn[2][LOG_RADIUS]) = (load * by[0][0], load * by[0][1]);
            (turn[3][LOG_PRESSURE], turn[3][LOG_RADIUS]) = (by[1][0], by[1][1]);
            let covariance = turned(&turn, covariance);
            Press { position_m: pressed.position_m, radius_m: log_radius.exp(), load, covariance }
        };
        self.at.presses.iter().zip(&self.covariances).map(press).collect()
    }

    fn fit_nothing(&mut self) -> Option<Cost> {
        self.at = State::nothing(self.frame.clone());
        self.covariances.clear();
        Some(self.cost())
    }

    fn seek(&self, negative: bool) -> Vec<Press> {
        let products = self.weighing.products(&self.at.residual);
        let apart_m = APART * self.model.options.typical_radius_m;
        let [load, radius_m] = self.model.reported_typical();
        let mut found: Vec<Press> = Vec::with_capacity(PROPOSALS);
        while found.len() < PROPOSALS {
            let mut best: Option<(usize, f64)> = None;
            for (k, product) in products.iter().enumerate() {
                let value = if negative { product.abs() } else { *product };
                let at_m = self.model.proposals[k].0;
                let is_apart = |other: &Press| distance(at_m, other.position_m) >= apart_m;
                if value > best.map_or(0.0, |(_, most)| most) && found.iter().all(is_apart) {
                    best = Some((k, value));
                }
            }
            let Some((k, _)) = best else { break };
            let share = products[k] / self.weighing.length(k);
            found.push(Press {
                position_m: self.model.proposals[k].0,
                radius_m,
                load: share * load,
                ..Press::default()
            });
        }
        found
    }

    fn set_most_work(&mut self, operations: f64) {
        (self.work, self.most_work) = (0.0, operations);
    }

    fn work(&self) -> f64 {
        self.work
    }

    fn copy(&self) -> Option<Box<dyn PressFit>> {
        Some(Box::new(Self {
            model: self.model.clone(),
            weighing: self.weighing.clone(),
            volts: Vec::new(),
            frame: Vec::new(),
            at: State::nothing(Vec::new()),
            evaluated: None,
            fitted: Vec::new(),
            covariances: Vec::new(),
            doubt: Doubt::default(),
            joint: None,
            fixed: Vec::new(),
            ..*self
        }))
    }

    fn is_joint(&self) -> bool {
        self.model.is_joint()
    }

    fn next_joint_set(&mut self, is_first: bool, have_ended: bool) -> Option<Vec<Press>> {
        let sign = if have_ended { -1.0 } else { 1.0 };
        if is_first {
            let volts: Vec<f64> = self.volts.iter().map(|value| sign * value).collect();
            self.joint = self.model.begin_joint(&volts, &self.weighing.deviations);
        }
        let [load, radius_m] = self.model.reported_typical();
        let sets = self.joint.as_mut()?;
        self.work += WORK_OF_SETS * self.model.joint_operations(sets);
        if self.work > self.most_work {
            return None;
        }
        let places = self.model.next_joint(sets);
        let press = |position_m: Point| Press { position_m, radius_m, load: sign * load, ..Press::default() };
        Some(places?.into_iter().map(press).collect())
    }

    fn resized(&mut self, presses: Vec<Press>) -> Vec<Press> {
        let mut best: Option<(f64, Vec<Press>, State)> = None;
        let PlateOptions { typical_radius_m, usual_radius_m, .. } = self.model.options;
        for share in STARTING_RADII.map(|share| share * usual_radius_m / typical_radius_m) {
            let scaled: Vec<Press> =
                presses.iter().map(|press| Press { radius_m: share * press.radius_m, ..*press }).collect();
            let pressed = scaled.iter().map(|press| self.model.pressed(press)).collect();
            let Some(state) = self.state(pressed, Effort::Quick) else { break };
            let left = inner_product(&state.residual, &state.residual);
            if best.as_ref().is_none_or(|(least, ..)| left < *least) {
                best = Some((left, scaled, state));
            }
        }
        let Some((_, scaled, state)) = best else { return presses };
        self.evaluated = Some(state);
        scaled
    }

    fn most_gain(&self, negative: bool) -> f64 {
        let signed = |product: f64| if negative { product.abs() } else { product };
        self.weighing.products(&self.at.residual).into_iter().map(signed).fold(0.0, f64::max).powi(2)
    }

    fn is_inside(&self, position_m: Point) -> bool {
        self.model.is_inside(position_m)
    }

    fn typical_radius_m(&self) -> f64 {
        self.model.options.typical_radius_m
    }

    fn most_presses(&self) -> usize {
        self.model.options.most_presses
    }

    fn set_error_beyond(&mut self, share: f64) {
        self.error_share = self.model.options.error_share + share;
    }

    fn place_scale(&self, cost: &Cost) -> f64 {
        Evidence::place_scale(cost)
    }

    fn footprints(&mut self, presses: &[Press], built: &[BuiltVariance]) -> Vec<Footprint> {
        // A frame tells pressure and radius of an indenter apart only roughly. The fit with its radius given serves its
        // force alone: other objects touch the skin, too.
        let given = self.model.prior(self.indenter_m);
        let prior = std::mem::replace(&mut self.prior, given);
        let is_refitted = self.indenter_m.is_some() && self.fit(presses, Effort::Full).is_some();
        self.prior = prior;
        let refitted = if is_refitted { self.presses() } else { presses.to_vec() };
        let prior = if is_refitted { &given } else { &prior };
        let conductance = self.model.conductance();
        let footprint = |((press, refitted), built): ((&Press, &Press), &BuiltVariance)| {
            let radius_m = match self.fit_of(press) {
                Some((fitted, place)) => conductance.contact_radius_m(&fitted.presses[place]),
                None => conductance.contact_radius_m(&self.model.pressed(press)),
            };
            let (pressed, doubt) = match self.fit_of(refitted) {
                Some((Fitted { presses, doubt, .. }, place)) => (presses[place], (doubt, doubt.of_presses[place])),
                None => (self.model.pressed(refitted), (&self.doubt, PressDoubt::default())),
            };
            Footprint { radius_m, force_n: self.force_n(refitted, pressed, prior, doubt, *built) }
        };
        presses.iter().zip(&refitted).zip(built).map(footprint).collect()
    }

    fn channels_of(&mut self, presses: &[Press], volts: &mut Vec<f64>) {
        let found = |fitted: &&Fitted| {
            fitted.presses.len() == presses.len() && presses.iter().all(|press| fitted.place(press).is_some())
        };
        if let Some(fitted) = self.fitted.iter().find(found) {
            volts.clone_from(&fitted.change);
            return;
        }
        let presses: Vec<Pressed> = presses.iter().map(|press| self.model.pressed(press)).collect();
        let contacts = self.model.contacts(&presses, Effort::Full).unwrap_or_default();
        self.model.change(&contacts, volts);
    }
}

impl Fitted {
    /// Place of a press among those fitted.
    fn place(&self, press: &Press) -> Option<usize> {
        self.reported.iter().position(|fitted| {
            fitted.position_m == press.position_m && fitted.load == press.load && fitted.radius_m == press.radius_m
        })
    }
}
