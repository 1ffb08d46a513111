//! Presses on a sheet under separate plates, by the physics of contact.
//!
//! Under a disc of radius R, pressure P reaches the sheet through a cover that spreads it over s: at distance d from
//! the centre it is `p = P Phi((R - d) / s)`, with the normal distribution Phi. Pressures of several presses add.
//! Where they close the gap, a contact of conductance `g(p)` connects sheet and plate, and the plates' potentials
//! follow ([`PlatedSheet`]).

use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use std::sync::Arc;

use dermis_tomo::eit::EitError;
use dermis_tomo::eit::contacts::{PlateContact, PlatedSheet};
use dermis_tomo::least_squares::{
    Acceptance, Control, Damping, NormalEquations, Params, Problem, Progress, Scratch, Tolerances, Trial, minimise,
};
use dermis_tomo::mesh::PixelGrid;

use crate::press::{Cost, Effort, Press, PressFit};
use crate::whitening::Whitening;

/// Parameters of a press: x, y, logarithm of the pressure, logarithm of the radius.
const OF_PRESS: usize = 4;
const LOG_PRESSURE: usize = 2;
const LOG_RADIUS: usize = 3;
/// Largest number of steps of a fit, and of one that only compares explanations.
const STEPS: usize = 15;
const QUICK_STEPS: usize = 8;
/// A fit has converged when no press moves by more than this share of its radius, and no logarithm changes by more
/// than ten times this.
const CONVERGED: f64 = 2e-3;
/// Largest move in one step, in radii, and largest change of a logarithm.
const LONGEST: f64 = 0.5;
const LONGEST_LOG: f64 = 0.7;
/// Prior standard deviations of the logarithms of pressure and radius.
const LOG_DEVIATIONS: [f64; 2] = [1.5, 0.7];
/// Pressures beyond this many deviations from the usual one are not tried: contact is saturated, or open.
const MOST_DEVIATIONS: f64 = 4.0;
/// Excess of the residual's mean square over 1 that noise may have: the uncertainty of noise estimated from 32 frames.
const NOISE_UNKNOWN: f64 = 0.3;
/// Contact below this share of the saturated one is left out, and the rest lowered by as much. The faint edge of a
/// press covers many cells and carries little current.
const FAINT: f64 = 0.02;
/// Number of rings over which a contact is integrated, and steps from a reported press to the parameters of the fit.
const RINGS: usize = 48;
const INVERSE_STEPS: usize = 30;
/// Number of proposals for one more press, and their distance from each other in typical radii.
const PROPOSALS: usize = 3;
const APART: f64 = 2.0;

/// Conductance of the contact between sheet and plates: `g_max x / (1 + x)` with `x = ((p - p_t) / p_ref)^n` above the
/// threshold `p_t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateLaw {
    /// p_t: pressure that closes the gap, pascal.
    pub threshold_pa: f64,
    /// p_ref: pressure above the threshold at half the saturated conductance, pascal.
    pub reference_pa: f64,
    /// n.
    pub exponent: f64,
    /// g_max, S/m^2.
    pub saturation_s_per_m2: f64,
    /// s: standard deviation of the Gaussian by which pressure spreads on its way to the gap, metres.
    pub spread_m: f64,
}

impl PlateLaw {
    /// Conductance per area (S/m^2) and its derivative with respect to the pressure.
    fn conductance(&self, pressure_pa: f64) -> [f64; 2] {
        let above = pressure_pa - self.threshold_pa;
        if above <= 0.0 {
            return [0.0; 2];
        }
        let x = (above / self.reference_pa).powf(self.exponent);
        let g = self.saturation_s_per_m2 / (1.0 + 1.0 / x);
        let faint = FAINT * self.saturation_s_per_m2;
        if g <= faint { [0.0; 2] } else { [g - faint, g * self.exponent / (above * (1.0 + x))] }
    }

    /// Pressure at this share of the saturated conductance, pascal.
    pub fn pressure_at_pa(&self, share: f64) -> f64 {
        self.threshold_pa + self.reference_pa * (share / (1.0 - share)).powf(self.exponent.recip())
    }
}

/// Sizes of presses on plates. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateOptions {
    /// Typical radius and pressure.
    pub typical_radius_m: f64,
    /// See `typical_radius_m`.
    pub typical_pa: f64,
    /// Smallest and largest radius.
    pub radii_m: [f64; 2],
    /// Distance between the positions at which presses are proposed.
    pub spacing_m: f64,
    /// Largest number of presses fitted to one frame.
    pub most_presses: usize,
    /// Share of a frame's energy that the model leaves unexplained of usual presses.
    pub error_share: f64,
}

/// The model of presses on one skin, shared by its fits.
#[derive(Debug)]
pub struct PlateModel {
    /// For comparing explanations, and for the final fit.
    sheets: [PlatedSheet; 2],
    law: PlateLaw,
    options: PlateOptions,
    grid: PixelGrid,
    inside: Vec<bool>,
    /// Positions at which presses are proposed, with the change of the channels (volts) by a typical press there.
    proposals: Vec<([f64; 2], Vec<f64>)>,
}

/// Fits presses to frames with these weights.
#[derive(Debug)]
pub struct PlateFit {
    model: Arc<PlateModel>,
    whitening: Whitening,
    /// Whitened changes by the proposed presses, of unit length, and their lengths.
    units: Vec<f32>,
    lengths: Vec<f64>,
    error_share: f64,
    frame: Vec<f64>,
    at: State,
    covariances: Vec<[[f64; OF_PRESS]; OF_PRESS]>,
}

/// Presses with what they explain.
#[derive(Clone, Debug)]
struct State {
    effort: Effort,
    presses: Vec<Pressed>,
    /// Contacts of the presses, and of those that are part of the baseline and have ended.
    contacts: [Option<PlateContact>; 2],
    /// Whitened frame less whitened change.
    residual: Vec<f64>,
}

/// A press in the parameters of the fit.
#[derive(Clone, Copy, Debug)]
struct Pressed {
    position_m: [f64; 2],
    log_pressure: f64,
    log_radius: f64,
    has_ended: bool,
}

impl State {
    fn nothing(residual: Vec<f64>) -> Self {
        Self { effort: Effort::Quick, presses: Vec::new(), contacts: [None, None], residual }
    }
}

impl PlateModel {
    /// A model on the pixels of a grid (row by row) that are on the skin. Explanations are compared on the first,
    /// coarser sheet and fitted on the second.
    ///
    /// # Errors
    /// Contacts that cannot be solved.
    pub fn new(
        sheets: [PlatedSheet; 2],
        law: PlateLaw,
        options: PlateOptions,
        grid: PixelGrid,
        inside: Vec<bool>,
    ) -> Result<Self, EitError> {
        let mut model = Self { sheets, law, options, grid, inside, proposals: Vec::new() };
        let (width_m, height_m) = (grid.pixel_m * grid.columns as f64, grid.pixel_m * grid.rows as f64);
        let count = |length_m: f64| (length_m / options.spacing_m).ceil().max(1.0) as usize;
        let (columns, rows) = (count(width_m), count(height_m));
        let at = |origin: f64, length: f64, k: usize, of: usize| origin + length * (k as f64 + 0.5) / of as f64;
        for place in (0..rows * columns).map(|k| {
            let (row, column) = (k / columns, k % columns);
            [at(grid.left_m, width_m, column, columns), at(grid.top_m, -height_m, row, rows)]
        }) {
            if model.is_inside(place) {
                let contact = model.contact(&[model.typical(place)], false, Effort::Quick)?;
                model.proposals.extend(contact.map(|contact| (place, contact.change_v)));
            }
        }
        Ok(model)
    }

    fn sheet(&self, effort: Effort) -> &PlatedSheet {
        &self.sheets[usize::from(effort == Effort::Full)]
    }

    fn channels(&self) -> usize {
        self.sheets[1].channels()
    }

    fn typical(&self, position_m: [f64; 2]) -> Pressed {
        let PlateOptions { typical_radius_m, typical_pa, .. } = self.options;
        Pressed { position_m, log_pressure: typical_pa.ln(), log_radius: typical_radius_m.ln(), has_ended: false }
    }

    fn is_inside(&self, position_m: [f64; 2]) -> bool {
        self.grid.pixel_at(position_m).is_some_and(|pixel| self.inside[pixel])
    }

    /// The change of the channels by presses that act, or by those that have ended; `None` without contact.
    fn contact(&self, presses: &[Pressed], has_ended: bool, effort: Effort) -> Result<Option<PlateContact>, EitError> {
        if presses.iter().all(|press| press.has_ended != has_ended) {
            return Ok(None);
        }
        let sheet = self.sheet(effort);
        let cells = sheet.cells();
        let mut pressure_pa = vec![0.0; cells.len()];
        for press in presses.iter().filter(|press| press.has_ended == has_ended) {
            let field = Field::new(press, self.law.spread_m);
            for (sum, cell) in pressure_pa.iter_mut().zip(cells) {
                *sum += field.at(cell.position_m).map_or(0.0, |(pressure, _)| pressure);
            }
        }
        let of_cell = |(pressure, area): (&f64, f64)| self.law.conductance(*pressure)[0] * area;
        let conductance_s: Vec<f64> =
            pressure_pa.iter().zip(cells.iter().map(|cell| cell.area_m2)).map(of_cell).collect();
        let contact = sheet.contact(&conductance_s)?;
        Ok((!contact.cells.is_empty()).then_some(contact))
    }

    /// Change of the channels, volts.
    fn change(&self, contacts: &[Option<PlateContact>; 2], volts: &mut Vec<f64>) {
        volts.clear();
        volts.resize(self.channels(), 0.0);
        for (contact, sign) in contacts.iter().zip([1.0, -1.0]) {
            for contact in contact.iter() {
                volts.iter_mut().zip(&contact.change_v).for_each(|(sum, value)| *sum += sign * value);
            }
        }
    }

    /// Derivatives of the channels with respect to the parameters of each press, volts: one column after the other.
    fn derivatives(&self, state: &State) -> Vec<Vec<f64>> {
        let sheet = self.sheet(state.effort);
        let mut columns = vec![Vec::new(); OF_PRESS * state.presses.len()];
        for (contact, has_ended) in state.contacts.iter().zip([false, true]) {
            let Some(contact) = contact else { continue };
            let cells: Vec<_> = contact.cells.iter().map(|&cell| sheet.cells()[cell]).collect();
            let fields: Vec<(usize, Field)> = state
                .presses
                .iter()
                .enumerate()
                .filter(|(_, press)| press.has_ended == has_ended)
                .map(|(k, press)| (k, Field::new(press, self.law.spread_m)))
                .collect();
            let slopes: Vec<f64> = cells
                .iter()
                .map(|cell| {
                    let pressures = fields.iter().filter_map(|(_, field)| field.at(cell.position_m));
                    self.law.conductance(pressures.map(|(pressure, _)| pressure).sum())[1] * cell.area_m2
                })
                .collect();
            let sign = if has_ended { -1.0 } else { 1.0 };
            for (k, field) in &fields {
                let moves: Vec<[f64; OF_PRESS]> = cells
                    .iter()
                    .zip(&slopes)
                    .map(|(cell, slope)| {
                        let by = field.at(cell.position_m).map_or([0.0; OF_PRESS], |(_, by)| by);
                        by.map(|value| sign * slope * value)
                    })
                    .collect();
                let jacobian = sheet.derivatives(contact, &moves);
                for parameter in 0..OF_PRESS {
                    columns[OF_PRESS * k + parameter] =
                        jacobian.iter().skip(parameter).step_by(OF_PRESS).copied().collect();
                }
            }
        }
        columns.iter_mut().filter(|column| column.is_empty()).for_each(|column| {
            column.resize(self.channels(), 0.0);
        });
        columns
    }

    /// Logarithms of the load and the radius of a press as reported: those of a Gaussian spot of the same conductance
    /// and second moment. Frames determine the conductance far better than pressure and size of the indenter.
    fn reported(&self, log_pressure: f64, log_radius: f64) -> [f64; 2] {
        let (disc_m, spread_m) = (log_radius.exp(), self.law.spread_m);
        let reach_m = disc_m + Field::REACH * spread_m;
        let (mut total, mut second) = (f64::MIN_POSITIVE, 0.0);
        for k in 0..RINGS {
            let at_m = reach_m * (k as f64 + 0.5) / RINGS as f64;
            let share = 0.5 * libm::erfc((at_m - disc_m) / spread_m * FRAC_1_SQRT_2);
            let ring = at_m * self.law.conductance(log_pressure.exp() * share)[0];
            total += ring;
            second += ring * at_m * at_m;
        }
        // A spot exp(-d^2 / (2 r^2)) has the second moment 2 r^2 and the integral 2 pi r^2.
        let square = (0.5 * second / total).max(f64::MIN_POSITIVE);
        let load = total * reach_m / RINGS as f64 / (square * self.law.saturation_s_per_m2);
        [load.ln(), 0.5 * square.ln()]
    }

    /// Derivatives of [`PlateModel::reported`]: rows are the reported logarithms.
    fn reported_by(&self, log_pressure: f64, log_radius: f64) -> [[f64; 2]; 2] {
        let h = 1e-4;
        let slope = |up: [f64; 2], down: [f64; 2]| [0, 1].map(|k| (up[k] - down[k]) / (2.0 * h));
        let by_pressure =
            slope(self.reported(log_pressure + h, log_radius), self.reported(log_pressure - h, log_radius));
        let by_radius = slope(self.reported(log_pressure, log_radius + h), self.reported(log_pressure, log_radius - h));
        [[by_pressure[0], by_radius[0]], [by_pressure[1], by_radius[1]]]
    }

    /// The press in the parameters of the fit, within their limits, by Newton's method on both logarithms.
    fn pressed(&self, press: &Press) -> Pressed {
        let wanted = [press.load.abs().max(1e-6).ln(), press.radius_m.ln()];
        let has_ended = press.load < 0.0;
        let mut at = Pressed { has_ended, ..self.typical(press.position_m) };
        for _ in 0..INVERSE_STEPS {
            let reported = self.reported(at.log_pressure, at.log_radius);
            let off = [wanted[0] - reported[0], wanted[1] - reported[1]];
            let [[a, b], [c, d]] = self.reported_by(at.log_pressure, at.log_radius);
            let determinant = a * d - b * c;
            if off.iter().all(|off| off.abs() < 1e-9) || determinant.abs() < 1e-9 {
                break;
            }
            let step = [(d * off[0] - b * off[1]) / determinant, (a * off[1] - c * off[0]) / determinant];
            let [by_pressure, by_radius] = step.map(|value| value.clamp(-LONGEST_LOG, LONGEST_LOG));
            at = self.limited(Pressed {
                log_pressure: at.log_pressure + by_pressure,
                log_radius: at.log_radius + by_radius,
                ..at
            });
        }
        at
    }

    fn limited(&self, press: Pressed) -> Pressed {
        let PlateOptions { typical_pa, radii_m: [least, most], .. } = self.options;
        let reach = MOST_DEVIATIONS * LOG_DEVIATIONS[0];
        Pressed {
            log_pressure: press.log_pressure.clamp(typical_pa.ln() - reach, typical_pa.ln() + reach),
            log_radius: press.log_radius.clamp(least.ln(), most.ln()),
            ..press
        }
    }

    /// Deviations of pressure and radius from their priors, in standard deviations.
    fn off(&self, press: &Pressed) -> [f64; 2] {
        [
            (press.log_pressure - self.options.typical_pa.ln()) / LOG_DEVIATIONS[0],
            (press.log_radius - self.options.typical_radius_m.ln()) / LOG_DEVIATIONS[1],
        ]
    }

    /// Penalty of pressures and radii: a hard press on a small disc may look like a soft one on a large disc.
    fn prior(&self, presses: &[Pressed]) -> f64 {
        presses.iter().flat_map(|press| self.off(press)).map(|off| off * off).sum()
    }
}

/// The pressure under one press.
#[derive(Clone, Copy, Debug)]
struct Field {
    centre_m: [f64; 2],
    pressure_pa: f64,
    radius_m: f64,
    spread_m: f64,
}

impl Field {
    /// Pressures further outside the disc than this many spreads are left out.
    const REACH: f64 = 5.0;

    fn new(press: &Pressed, spread_m: f64) -> Self {
        let (pressure_pa, radius_m) = (press.log_pressure.exp(), press.log_radius.exp());
        Self { centre_m: press.position_m, pressure_pa, radius_m, spread_m }
    }

    /// Pressure at a position (pascal), and its derivatives by the parameters of the press; `None` beyond its reach.
    fn at(&self, place_m: [f64; 2]) -> Option<(f64, [f64; OF_PRESS])> {
        let off = [place_m[0] - self.centre_m[0], place_m[1] - self.centre_m[1]];
        let reach_m = self.radius_m + Self::REACH * self.spread_m;
        let square = off[0] * off[0] + off[1] * off[1];
        if square > reach_m * reach_m {
            return None;
        }
        let distance_m = square.sqrt();
        let u = (self.radius_m - distance_m) / self.spread_m;
        let pressure = self.pressure_pa * 0.5 * libm::erfc(-u * FRAC_1_SQRT_2);
        let density = self.pressure_pa * (-0.5 * u * u).exp() / (TAU.sqrt() * self.spread_m);
        let along = density / distance_m.max(1e-9);
        Some((pressure, [along * off[0], along * off[1], pressure, density * self.radius_m]))
    }
}

impl PlateFit {
    /// A fit with these deviations of the channels (volts, infinite for channels to leave out). `nuisances` are
    /// changes of the channels by one standard deviation of each cause besides presses, volts.
    pub fn new(model: Arc<PlateModel>, deviations: &[f64], nuisances: &[Vec<f64>]) -> Self {
        let whitening = Whitening::new(deviations, nuisances);
        let (mut units, mut lengths, mut whitened) = (Vec::new(), Vec::new(), Vec::new());
        for (_, change) in &model.proposals {
            whitening.apply(change, &mut whitened);
            let length = whitened.iter().map(|v| v * v).sum::<f64>().sqrt();
            units.extend(whitened.iter().map(|v| (v / length.max(f64::MIN_POSITIVE)) as f32));
            lengths.push(length);
        }
        let (at, error_share) = (State::nothing(Vec::new()), model.options.error_share);
        Self { model, whitening, units, lengths, error_share, frame: Vec::new(), at, covariances: Vec::new() }
    }

    /// The state of these presses, with their residual.
    fn state(&self, presses: Vec<Pressed>, effort: Effort) -> Result<State, EitError> {
        let contact = |has_ended| self.model.contact(&presses, has_ended, effort);
        let contacts = [contact(false)?, contact(true)?];
        let (mut change, mut residual) = (Vec::new(), Vec::new());
        self.model.change(&contacts, &mut change);
        self.whitening.apply(&change, &mut residual);
        residual.iter_mut().zip(&self.frame).for_each(|(value, frame)| *value = frame - *value);
        Ok(State { effort, presses, contacts, residual })
    }

    fn cost(&self) -> Cost {
        let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
        let presses = self.at.presses.len();
        let freedom = (self.whitening.present() as f64 - (OF_PRESS * presses + 1) as f64).max(1.0);
        let energy = square(&self.frame);
        let model_error = if presses == 0 { 0.0 } else { self.error_share * energy };
        Cost { residual: square(&self.at.residual), energy, freedom, model_error }
    }

    fn fit_with(&mut self, starts: &[Press], effort: Effort) -> Option<Cost> {
        if starts.is_empty() || starts.len() > self.model.options.most_presses {
            return None;
        }
        let presses: Vec<Pressed> = starts.iter().map(|start| self.model.pressed(start)).collect();
        self.at = self.state(presses, effort).ok()?;
        let steps = if effort == Effort::Full { STEPS } else { QUICK_STEPS };
        let mut solver = Scratch::new(OF_PRESS * starts.len());
        let params = Params { most_trials: steps, ..PARAMS };
        let mut way = FitUnderWay { fit: &mut *self, tried: None };
        minimise(&mut way, &params, &mut solver).ok()?;
        way.linearise(&mut solver.equations).ok()?;
        let cost = self.cost();
        self.find_covariances(&mut solver, &cost);
        Some(cost)
    }

    /// The inverse of the normal matrix, times the residual if it exceeds the noise by more than the noise's own
    /// uncertainty.
    fn find_covariances(&mut self, solver: &mut Scratch, cost: &Cost) {
        let n = OF_PRESS * self.at.presses.len();
        let Scratch { equations, factor, step } = solver;
        let scale = (cost.residual / cost.freedom - NOISE_UNKNOWN).max(1.0);
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

    /// Products of the residual with the proposals.
    fn products(&self) -> Vec<f64> {
        let residual: Vec<f32> = self.at.residual.iter().map(|value| *value as f32).collect();
        let product = |unit: &[f32]| f64::from(unit.iter().zip(&residual).map(|(a, b)| a * b).sum::<f32>());
        self.units.chunks_exact(residual.len().max(1)).map(product).collect()
    }
}

/// Rules of the fit. Convergence is decided by [`CONVERGED`].
const PARAMS: Params = Params {
    control: Control::Damping(Damping {
        start: 1e-3,
        least: 0.0,
        most: 1e4,
        decrease: 0.2,
        increase: 8.0,
        least_after_rejection: 1e-3,
        refused: Some(10.0),
    }),
    acceptance: Acceptance::NotHigher,
    tolerances: Tolerances { moved: None, gain: None, predicted: None, agreement: None },
    most_trials: STEPS,
    most_linearisations: usize::MAX,
    most_rejections: usize::MAX,
};

impl PressFit for PlateFit {
    fn take_frame(&mut self, frame: &[f64]) -> Option<Cost> {
        if frame.len() != self.model.channels() || frame.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let mut whitened = std::mem::take(&mut self.frame);
        self.whitening.apply(frame, &mut whitened);
        self.frame = whitened;
        self.fit_nothing()
    }

    fn fit(&mut self, starts: &[Press], effort: Effort) -> Option<Cost> {
        self.fit_with(starts, effort)
    }

    fn fit_loads(&mut self, starts: &[Press]) -> Option<Cost> {
        if starts.is_empty() || starts.len() > self.model.options.most_presses {
            return None;
        }
        // Each press alone, scaled: contacts saturate, but a search needs no more than this.
        let presses: Vec<Pressed> = starts.iter().map(|start| self.model.pressed(start)).collect();
        let (n, mut columns, mut volts) = (starts.len(), Vec::new(), Vec::new());
        for press in &presses {
            let contact = |has_ended| self.model.contact(&[*press], has_ended, Effort::Quick);
            let mut whitened = Vec::new();
            self.model.change(&[contact(false).ok()?, contact(true).ok()?], &mut volts);
            self.whitening.apply(&volts, &mut whitened);
            columns.push(whitened);
        }
        let mut equations = NormalEquations::new(n);
        for a in 0..n {
            equations.right[a] = dot(&columns[a], &self.frame);
            (0..n).for_each(|b| equations.normal[a * n + b] = dot(&columns[a], &columns[b]));
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

    fn has_quick_fit(&self) -> bool {
        true
    }

    fn presses(&self) -> Vec<Press> {
        let press = |(pressed, covariance): (&Pressed, &[[f64; OF_PRESS]; OF_PRESS])| {
            let [log_load, log_radius] = self.model.reported(pressed.log_pressure, pressed.log_radius);
            let load = if pressed.has_ended { -log_load.exp() } else { log_load.exp() };
            let by = self.model.reported_by(pressed.log_pressure, pressed.log_radius);
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
        let products = self.products();
        let apart_m = APART * self.model.options.typical_radius_m;
        let mut found: Vec<Press> = Vec::with_capacity(PROPOSALS);
        while found.len() < PROPOSALS {
            let mut best: Option<(usize, f64)> = None;
            for (k, product) in products.iter().enumerate() {
                let value = if negative { product.abs() } else { *product };
                let [x, y] = self.model.proposals[k].0;
                let is_apart = |other: &Press| (x - other.position_m[0]).hypot(y - other.position_m[1]) >= apart_m;
                if value > best.map_or(0.0, |(_, most)| most) && found.iter().all(is_apart) {
                    best = Some((k, value));
                }
            }
            let Some((k, _)) = best else { break };
            let share = products[k] / self.lengths[k].max(f64::MIN_POSITIVE);
            let PlateOptions { typical_pa, typical_radius_m, .. } = self.model.options;
            let [log_load, log_radius] = self.model.reported(typical_pa.ln(), typical_radius_m.ln());
            found.push(Press {
                position_m: self.model.proposals[k].0,
                radius_m: log_radius.exp(),
                load: share * log_load.exp(),
                ..Press::default()
            });
        }
        found
    }

    fn most_gain(&self, negative: bool) -> f64 {
        let signed = |product: f64| if negative { product.abs() } else { product };
        self.products().into_iter().map(signed).fold(0.0, f64::max).powi(2)
    }

    fn is_inside(&self, position_m: [f64; 2]) -> bool {
        self.model.is_inside(position_m)
    }

    fn most_sigma_m(&self) -> f64 {
        self.model.options.typical_radius_m
    }

    fn most_presses(&self) -> usize {
        self.model.options.most_presses
    }

    fn set_error_beyond(&mut self, share: f64) {
        self.error_share = self.model.options.error_share + share;
    }

    fn channels_of(&mut self, presses: &[Press], volts: &mut Vec<f64>) {
        let presses: Vec<Pressed> = presses.iter().map(|press| self.model.pressed(press)).collect();
        let contact = |has_ended| self.model.contact(&presses, has_ended, Effort::Full).ok().flatten();
        self.model.change(&[contact(false), contact(true)], volts);
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `T C T'`.
fn turned(turn: &[[f64; OF_PRESS]; OF_PRESS], covariance: &[[f64; OF_PRESS]; OF_PRESS]) -> [[f64; OF_PRESS]; OF_PRESS] {
    let product = |a: usize, b: usize| {
        let pairs = (0..OF_PRESS).flat_map(|j| (0..OF_PRESS).map(move |k| (j, k)));
        pairs
            .filter(|&(j, k)| turn[a][j] != 0.0 && turn[b][k] != 0.0)
            .map(|(j, k)| turn[a][j] * covariance[j][k] * turn[b][k])
            .sum()
    };
    std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)))
}

/// A fit in progress.
struct FitUnderWay<'a> {
    fit: &'a mut PlateFit,
    tried: Option<State>,
}

impl FitUnderWay<'_> {
    fn cost_of(&self, state: &State) -> f64 {
        state.residual.iter().map(|v| v * v).sum::<f64>() + self.fit.model.prior(&state.presses)
    }
}

/// Errors of a fit in progress: contacts that cannot be solved, or rules out of range.
#[derive(Debug)]
struct Failed;

impl From<dermis_tomo::least_squares::Error> for Failed {
    fn from(_: dermis_tomo::least_squares::Error) -> Self {
        Self
    }
}

impl Problem for FitUnderWay<'_> {
    type Error = Failed;

    fn unknowns(&self) -> usize {
        OF_PRESS * self.fit.at.presses.len()
    }

    fn cost(&mut self) -> Result<f64, Failed> {
        Ok(self.cost_of(&self.fit.at))
    }

    fn linearise(&mut self, equations: &mut NormalEquations) -> Result<bool, Failed> {
        let PlateFit { model, whitening, at, .. } = &*self.fit;
        let columns: Vec<Vec<f64>> = model
            .derivatives(at)
            .iter()
            .map(|column| {
                let mut whitened = Vec::new();
                whitening.apply(column, &mut whitened);
                whitened
            })
            .collect();
        let n = columns.len();
        let NormalEquations { normal, right } = equations;
        for a in 0..n {
            right[a] = dot(&columns[a], &at.residual);
            for b in 0..=a {
                let value = dot(&columns[a], &columns[b]);
                (normal[a * n + b], normal[b * n + a]) = (value, value);
            }
        }
        for (k, press) in at.presses.iter().enumerate() {
            let priors = [LOG_PRESSURE, LOG_RADIUS].into_iter().zip(model.off(press)).zip(LOG_DEVIATIONS);
            for ((parameter, off), deviation) in priors {
                let at = OF_PRESS * k + parameter;
                normal[at * n + at] += deviation.powi(-2);
                right[at] -= off / deviation;
            }
        }
        Ok(true)
    }

    fn try_step(&mut self, step: &[f64]) -> Result<Option<Trial>, Failed> {
        let mut moved: f64 = 0.0;
        let model = &self.fit.model;
        let presses = self.fit.at.presses.iter().zip(step.chunks_exact(OF_PRESS)).map(|(press, step)| {
            let radius_m = press.log_radius.exp();
            let distance_m = step[0].hypot(step[1]);
            let longest_m = LONGEST * radius_m.max(model.law.spread_m);
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
        let Ok(next) = self.fit.state(presses.collect(), self.fit.at.effort) else { return Ok(None) };
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
        progress.moved < CONVERGED || progress.before - progress.after < 1e-6 * progress.after
    }
}
