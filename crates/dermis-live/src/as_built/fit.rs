//! Conditions the prior of a skin's errors on pokes at known positions, by Gauss-Newton steps.
//!
//! A poke's frame is the response of the skin as built to a spot of unknown load and radius at the known position; both
//! are marginalised. The baseline counts too, with the tolerance of the channels' gains. Differences are scaled to the
//! model by the baseline, so gains drop out of the frames.

use dermis_skin::Reads;
use dermis_tomo::inverse::ChangeResponse;
use dermis_tomo::mesh::Point;
use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use rayon::prelude::*;

use super::build::{Build, BuildPrior};
use super::errors::{error_table, places};
use super::spots::{LOAD, PARAMETERS, RADIUS, Spots};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{Reference, baseline_is_known, scale_to_model};
use crate::stages::spot_model::{TYPICAL_RADIUS, change_response};
use crate::stages::workshop_error::WorkshopError;

/// Gauss-Newton steps.
const STEPS: usize = 3;
/// Steps of the fit of a poke's load and radius.
const SPOT_STEPS: usize = 6;
/// Share of a poke's response that the model of a spot is first assumed to leave. Later the share is measured.
const LEFT_AT_FIRST: f64 = 0.02;
/// Error of the model at rest, as a share of its largest voltage, on meshes unlike the instrument's.
const REST_ERROR: f64 = 0.001;
/// Largest relative loss of conductance under a press.
const MOST_LOST: f64 = 0.95;
/// Smallest load.
const LEAST_LOAD: f64 = 1e-6;
/// Largest change of a radius's logarithm in a step.
const MOST_RADIUS_STEP: f64 = 0.4;
/// Added to the normal equations of nuisances, which may be nearly alike, relative to their norms.
const NEARLY_ALIKE: f64 = 1e-9;

/// A poke as fitted: its load and radius, and what the fit leaves.
struct Fitted {
    load: f64,
    radius_m: f64,
    left: Vec<f64>,
    /// Response to the spot and to its radius.
    nuisance: Mat<f64>,
}

/// Changes by one deviation of each parameter.
struct Modes {
    /// Voltages at rest: channels x parameters.
    rest: Mat<f64>,
    /// Response to the spot of each poke, then of each tabulated place: for every parameter, channels x spots.
    /// Single precision, since this is the largest object here. `None` for an error that cannot be built.
    spots: Vec<Option<Mat<f32>>>,
    pokes: usize,
}

impl Modes {
    /// Response to a poke's spot: channels x parameters.
    fn of_poke(&self, poke: usize) -> Mat<f64> {
        let change = |c: usize, k: usize| self.spots[k].as_ref().map_or(0.0, |spots| f64::from(spots[(c, poke)]));
        Mat::from_fn(self.rest.nrows(), self.rest.ncols(), change)
    }

    /// Response to a spot at a tabulated place.
    fn of_place(&self, place: usize) -> Mat<f64> {
        self.of_poke(self.pokes + place)
    }
}

/// Learns how a skin was built from pokes.
pub(crate) struct BuildFit<'a> {
    prepared: &'a Prepared,
    reference: &'a Reference,
    prior: BuildPrior,
    pokes: Vec<Poke<'a>>,
    grid: (Vec<[f64; 2]>, f64),
    modes: Modes,
}

/// A skin as built.
pub(crate) struct Built {
    pub(crate) build: Build,
    /// Errors of touches that remain.
    pub(crate) errors: WorkshopError,
    /// Root mean square difference of the baseline from this skin, in standard deviations.
    pub(crate) rest_misfit: f64,
}

/// A poke with its fit on the skin as drawn.
struct Poke<'a> {
    difference: &'a [f64],
    place_m: Point,
    drawn: Fitted,
}

impl<'a> BuildFit<'a> {
    /// Prepares the fit to pokes at known positions, metres. `differences` are model volts of the skin as drawn, NaN
    /// where missing.
    ///
    /// # Errors
    /// A skin that cannot be solved.
    pub(crate) fn new(
        prepared: &'a Prepared,
        reference: &'a Reference,
        differences: &'a [Vec<f64>],
        places_m: &[Point],
    ) -> Result<Self, Error> {
        let prior = BuildPrior::of(&prepared.body, &prepared.skin.tolerances);
        let grid = places(&prepared.body.outline);
        let typical_m = TYPICAL_RADIUS * prepared.half_width_m();
        let seen: Vec<Seen<'_>> = differences
            .iter()
            .zip(places_m)
            .map(|(difference, place_m)| Seen { difference, place_m: *place_m, radius_m: typical_m })
            .collect();
        let drawn = fit_spots(prepared, &seen)?;
        let known: Vec<([f64; 2], f64)> =
            seen.iter().zip(&drawn).map(|(seen, fitted)| (seen.place_m, fitted.radius_m)).collect();
        let modes = modes(prepared, &prior, &known, &grid.0)?;
        let pokes = differences.iter().zip(places_m).zip(drawn);
        let pokes = pokes.map(|((difference, place_m), drawn)| Poke { difference, place_m: *place_m, drawn }).collect();
        Ok(Self { prepared, reference, prior, pokes, grid, modes })
    }

    /// The skin that explains these pokes best, with the errors of touches that remain.
    ///
    /// # Errors
    /// A skin that cannot be solved.
    pub(crate) fn fit(&self, rows: &[usize]) -> Result<Built, Error> {
        let count = self.prior.len();
        let mut parameters = vec![0.0; count];
        let mut covariance = Mat::identity(count, count);
        let mut left = LEFT_AT_FIRST;
        let is_poked = !rows.is_empty();
        let mut built: Option<(Prepared, Vec<Vec<f64>>, Vec<Fitted>)> = None;
        for _ in 0..STEPS {
            let mut system = System::new(count);
            for (number, &row) in rows.iter().enumerate() {
                let (frame, fitted) = match &built {
                    Some((_, frames, fitted)) => (&frames[number][..], &fitted[number]),
                    None => (self.pokes[row].difference, &self.pokes[row].drawn),
                };
                system.add_poke(frame, fitted, &self.modes.of_poke(row), &self.reference.noise, left);
            }
            if baseline_is_known(self.prepared) {
                let now = built.as_ref().map_or(self.prepared, |(skin, ..)| skin);
                system.add_rest(now, &self.reference.baseline, &self.modes.rest);
            }
            (parameters, covariance) = system.solve(&parameters)?;
            let skin = self.prepared.as_built(self.prior.build(&parameters))?;
            let scale = scale_to_model(&skin, &self.reference.baseline)?;
            let scales = || scale.iter().zip(&self.reference.scale);
            let rescaled = |row: &usize| -> Vec<f64> {
                self.pokes[*row].difference.iter().zip(scales()).map(|(value, (new, old))| value * new / old).collect()
            };
            let frames: Vec<Vec<f64>> = rows.iter().map(rescaled).collect();
            let seen: Vec<Seen<'_>> = rows
                .iter()
                .zip(&frames)
                .map(|(&row, difference)| {
                    let Poke { place_m, drawn, .. } = &self.pokes[row];
                    Seen { difference, place_m: *place_m, radius_m: drawn.radius_m }
                })
                .collect();
            let fitted = fit_spots(&skin, &seen)?;
            let shares: Vec<f64> = fitted
                .iter()
                .zip(&frames)
                .map(|(fitted, frame)| share_left(&fitted.left, frame, &self.reference.noise))
                .collect();
            left = if is_poked { dermis_touch::median(&shares) } else { 0.0 };
            tracing::debug!("pokes leave {left:.4} of their response");
            built = Some((skin, frames, fitted));
        }
        let skin = built.as_ref().map_or(self.prepared, |(skin, ..)| skin);
        let errors = self.remaining(skin, &covariance)?.leaving(left * left);
        let mut rest = System::new(count);
        let rest_misfit = rest.add_rest(skin, &self.reference.baseline, &self.modes.rest);
        Ok(Built { build: self.prior.build(&parameters), errors, rest_misfit })
    }

    /// Relative misfit of the baseline of a usual skin within the tolerances.
    pub(crate) fn usual_misfit(&self) -> f64 {
        let of_model: f64 = self.prepared.voltages.iter().map(|v| v * v).sum();
        let gain = 0.01 * self.prepared.skin.tolerances.gain_percent;
        (self.modes.rest.squared_norm_l2() / of_model.max(f64::MIN_POSITIVE)).sqrt().hypot(gain)
    }

    /// Errors of touches on the skin as built, for this covariance of the parameters.
    fn remaining(&self, skin: &Prepared, covariance: &Mat<f64>) -> Result<WorkshopError, Error> {
        let root = match covariance.llt(Side::Lower) {
            Ok(factor) => factor.L().to_owned(),
            Err(_) => Mat::zeros(covariance.nrows(), covariance.nrows()),
        };
        let typical_m = TYPICAL_RADIUS * skin.half_width_m();
        let at: Vec<(Point, f64)> = self.grid.0.iter().map(|place| (*place, typical_m)).collect();
        let jacobian = skin.jacobian.as_mat();
        let responses = jacobian * Spots::new(skin)?.columns(&at);
        let uniform: Vec<f64> = jacobian.row_iter().map(|row| row.iter().sum()).collect();
        let law = (0.01 * skin.skin.tolerances.contact_law_percent).powi(2);
        let changes = |place: usize| self.modes.of_place(place) * &root;
        Ok(error_table(self.grid.clone(), responses.as_ref(), &uniform, law, changes))
    }
}

/// Share of a frame that a fit leaves beyond the noise, root mean square.
fn share_left(left: &[f64], frame: &[f64], noise: &[f64]) -> f64 {
    let present = || left.iter().zip(frame).zip(noise).filter(|((left, _), _)| left.is_finite());
    let beyond: f64 = present().map(|((left, _), noise)| left * left - noise * noise).sum();
    let all: f64 = present().map(|((_, frame), _)| frame * frame).sum();
    (beyond.max(0.0) / all.max(f64::MIN_POSITIVE)).sqrt()
}

/// A poke to fit: its frame, its position and a first guess of its radius.
struct Seen<'a> {
    difference: &'a [f64],
    place_m: Point,
    radius_m: f64,
}

/// Fits load and radius of every poke at its known position, by Gauss-Newton steps.
fn fit_spots(skin: &Prepared, pokes: &[Seen<'_>]) -> Result<Vec<Fitted>, Error> {
    if pokes.is_empty() {
        return Ok(Vec::new());
    }
    let spots = Spots::new(skin)?;
    let response = change_response(skin)?;
    pokes
        .par_iter()
        .map(|poke| {
            let (mut load, mut radius_m) = (None, poke.radius_m);
            let mut best: Option<(f64, Fitted)> = None;
            for _ in 0..SPOT_STEPS {
                let Some(step) = SpotStep::of(skin, &spots, &response, poke, load, radius_m) else { break };
                let (size, next) = (step.size, step.next);
                if best.as_ref().is_none_or(|(least, _)| size < *least) {
                    best = Some((size, step.fitted));
                }
                let Some((next_load, log_radius)) = next else { break };
                load = Some(next_load);
                let half_width_m = skin.half_width_m();
                radius_m = (radius_m * log_radius.exp()).clamp(0.03 * half_width_m, 0.8 * half_width_m);
            }
            best.map(|(_, fitted)| fitted).ok_or_else(|| Error::Frames {
                what: "poke".into(),
                expected: "a frame that the model can predict".into(),
                got: "none".into(),
            })
        })
        .collect()
}

/// A spot compared with a frame, and the step towards a better one.
struct SpotStep {
    /// Squared residual.
    size: f64,
    fitted: Fitted,
    /// Next load, and change of the logarithm of the radius.
    next: Option<(f64, f64)>,
}

impl SpotStep {
    /// Starts from the load that fits in proportion if none is given. `None` if the model cannot predict the spot.
    fn of(
        skin: &Prepared,
        spots: &Spots<'_>,
        response: &ChangeResponse,
        poke: &Seen<'_>,
        load: Option<f64>,
        radius_m: f64,
    ) -> Option<Self> {
        let frame = poke.difference;
        let columns = spots.columns(&[(poke.place_m, radius_m)]);
        let linear = skin.jacobian.as_mat() * &columns;
        let dot = |a: &dyn Fn(usize) -> f64, b: &dyn Fn(usize) -> f64| -> f64 {
            (0..frame.len()).filter(|&c| frame[c].is_finite()).map(|c| a(c) * b(c)).sum()
        };
        let alone = |c: usize| linear[(c, LOAD)];
        let in_proportion = || dot(&|c| frame[c], &alone) / dot(&alone, &alone).max(f64::MIN_POSITIVE);
        let load = load.unwrap_or_else(|| in_proportion().clamp(0.0, MOST_LOST)).max(LEAST_LOAD);
        let change: Vec<f64> = (0..columns.nrows()).map(|p| (load * columns[(p, LOAD)]).max(-MOST_LOST)).collect();
        let predicted = response.to(&change)?;
        let left: Vec<f64> = frame.iter().zip(&predicted).map(|(f, p)| f - p).collect();
        let size = left.iter().filter(|v| v.is_finite()).map(|v| v * v).sum();
        // The response to a larger load grows like the response itself.
        let per_load = |c: usize| predicted[c] / load;
        let per_radius = |c: usize| load * linear[(c, RADIUS)];
        let nuisance = Mat::from_fn(frame.len(), 2, |c, k| if k == 0 { per_load(c) } else { per_radius(c) });
        let [aa, ab, bb] = [dot(&per_load, &per_load), dot(&per_load, &per_radius), dot(&per_radius, &per_radius)];
        let [ra, rb] = [dot(&per_load, &|c| left[c]), dot(&per_radius, &|c| left[c])];
        let determinant = aa * bb - ab * ab;
        let next = (determinant > 0.0).then(|| {
            let by = (bb * ra - ab * rb) / determinant;
            let log_radius = (aa * rb - ab * ra) / determinant;
            (load + by.clamp(-0.5 * load, load), log_radius.clamp(-MOST_RADIUS_STEP, MOST_RADIUS_STEP))
        });
        Some(Self { size, fitted: Fitted { load, radius_m, left, nuisance }, next })
    }
}

/// The changes by one deviation of each parameter, on the skin as drawn.
fn modes(
    prepared: &Prepared,
    prior: &BuildPrior,
    known: &[([f64; 2], f64)],
    table_m: &[[f64; 2]],
) -> Result<Modes, Error> {
    let spots = Spots::new(prepared)?;
    let typical_m = TYPICAL_RADIUS * prepared.half_width_m();
    let all: Vec<([f64; 2], f64)> =
        known.iter().copied().chain(table_m.iter().map(|place| (*place, typical_m))).collect();
    let columns = spots.columns(&all);
    let alone = Mat::from_fn(columns.nrows(), all.len(), |p, k| columns[(p, PARAMETERS * k + LOAD)]);
    let drawn = prepared.jacobian.as_mat() * &alone;
    let changed: Vec<Option<(Vec<f64>, Mat<f32>)>> = (0..prior.len())
        .into_par_iter()
        .map(|k| {
            let mut parameters = vec![0.0; prior.len()];
            parameters[k] = 1.0;
            // An error that cannot be built is left out.
            let skin = prepared.as_built(prior.build(&parameters)).ok()?;
            let scale = scale_to_model(prepared, &skin.voltages).ok()?;
            let rest = skin.voltages.iter().zip(&prepared.voltages).map(|(new, old)| new - old).collect();
            let response = skin.jacobian.as_mat() * &alone;
            let change = |c: usize, spot: usize| (scale[c] * response[(c, spot)] - drawn[(c, spot)]) as f32;
            Some((rest, Mat::from_fn(scale.len(), all.len(), change)))
        })
        .collect();
    let of_rest = |c: usize, k: usize| changed[k].as_ref().map_or(0.0, |(rest, _)| rest[c]);
    let rest = Mat::from_fn(prepared.channels(), prior.len(), of_rest);
    let spots = changed.into_iter().map(|changed| changed.map(|(_, spots)| spots)).collect();
    Ok(Modes { rest, spots, pokes: known.len() })
}

/// Normal equations of a step.
struct System {
    normal: Mat<f64>,
    right: Mat<f64>,
}

impl System {
    fn new(count: usize) -> Self {
        Self { normal: Mat::zeros(count, count), right: Mat::zeros(count, 1) }
    }

    /// Adds a poke. `left` is the share of a response that the model of a spot leaves.
    fn add_poke(&mut self, frame: &[f64], fitted: &Fitted, change: &Mat<f64>, noise: &[f64], left: f64) {
        let used = |c: &usize| frame[*c].is_finite() && fitted.left[*c].is_finite();
        let channels: Vec<usize> = (0..frame.len()).filter(used).collect();
        let mean_2 = channels.iter().map(|&c| frame[c] * frame[c]).sum::<f64>() / channels.len().max(1) as f64;
        let deviation: Vec<f64> = noise.iter().map(|noise| (noise * noise + left * left * mean_2).sqrt()).collect();
        let rows = |of: &dyn Fn(usize, usize) -> f64, width: usize| {
            Mat::from_fn(channels.len(), width, |row, k| of(channels[row], k) / deviation[channels[row]])
        };
        let design = rows(&|c, k| fitted.load * change[(c, k)], change.ncols());
        let residual = rows(&|c, _| fitted.left[c], 1);
        self.add(&design, &residual, &rows(&|c, k| fitted.nuisance[(c, k)], 2));
    }

    /// Adds the baseline, whose common gain is unknown. Returns its root mean square difference from the skin, in
    /// standard deviations.
    fn add_rest(&mut self, now: &Prepared, baseline: &[f64], rest: &Mat<f64>) -> f64 {
        let voltages = &now.voltages;
        let largest = voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let gain = 0.01 * now.skin.tolerances.gain_percent;
        let channels: Vec<usize> = (0..baseline.len()).filter(|&c| baseline[c].is_finite()).collect();
        // Rectified readings have the model's sign.
        let is_rectified = now.skin.backend.reads == Reads::Magnitude;
        let signed = |c: usize| if is_rectified { baseline[c].abs() * voltages[c].signum() } else { baseline[c] };
        let product = |a: &dyn Fn(usize) -> f64| channels.iter().map(|&c| signed(c) * a(c)).sum::<f64>();
        let (cross, square) = (product(&|c| voltages[c]), product(&signed));
        let common = if square > 0.0 { cross / square } else { 1.0 };
        let deviation = |c: usize| (gain * voltages[c]).hypot(REST_ERROR * largest).max(f64::MIN_POSITIVE);
        let rows = |of: &dyn Fn(usize, usize) -> f64, width: usize| {
            Mat::from_fn(channels.len(), width, |row, k| of(channels[row], k) / deviation(channels[row]))
        };
        let design = rows(&|c, k| rest[(c, k)], rest.ncols());
        let residual = rows(&|c, _| common * signed(c) - voltages[c], 1);
        self.add(&design, &residual, &rows(&|c, _| voltages[c], 1));
        (residual.squared_norm_l2() / channels.len().max(1) as f64).sqrt()
    }

    /// Adds whitened rows, with nuisances projected out.
    fn add(&mut self, design: &Mat<f64>, residual: &Mat<f64>, nuisance: &Mat<f64>) {
        let units: Vec<f64> = nuisance.col_iter().map(|column| column.norm_l2().max(f64::MIN_POSITIVE)).collect();
        let unit = Mat::from_fn(nuisance.nrows(), nuisance.ncols(), |row, k| nuisance[(row, k)] / units[k]);
        let mut own = unit.transpose() * &unit;
        (0..own.nrows()).for_each(|k| own[(k, k)] += NEARLY_ALIKE);
        let Ok(factor) = own.llt(Side::Lower) else { return };
        let of_design = unit.transpose() * design;
        let of_residual = unit.transpose() * residual;
        self.normal += design.transpose() * design - of_design.transpose() * factor.solve(&of_design);
        self.right += design.transpose() * residual - of_design.transpose() * factor.solve(&of_residual);
    }

    /// The parameters after the step from these, and their covariance. The prior is standard normal.
    fn solve(mut self, from: &[f64]) -> Result<(Vec<f64>, Mat<f64>), Error> {
        for (k, value) in from.iter().enumerate() {
            self.normal[(k, k)] += 1.0;
            self.right[(k, 0)] -= value;
        }
        let singular = |_| Error::Frames {
            what: "pokes".into(),
            expected: "frames that determine how the skin was built".into(),
            got: "a singular system".into(),
        };
        let factor = self.normal.llt(Side::Lower).map_err(singular)?;
        let by = factor.solve(&self.right);
        Ok((from.iter().enumerate().map(|(k, value)| value + by[(k, 0)]).collect(), factor.inverse()))
    }
}
