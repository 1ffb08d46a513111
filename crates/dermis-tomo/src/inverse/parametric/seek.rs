//! Finds where one more spot would explain most of a fit's residual: a matched filter over the table.
//!
//! With the whitened residual `r` and the whitened response `g(p, radius)` of a spot, orthogonal to the uniform
//! change, the least-squares amplitude is `g'r / g'g`, and it lowers the cost by `(g'r)^2 / g'g` (Kay, Fundamentals
//! of Statistical Signal Processing II, 1998, section 4.3). The filter covers every second position of the table, at
//! a few radii.

use pulp::Arch;

use super::fit::{FitOutcome, UNIFORM_DEVIATION, take_off};
use super::scratch::FitScratch;
use super::spot::{OF_SPOT, State};
use super::{Spot, SpotModel};
use crate::inner_product;
use crate::inverse::InverseError;
use crate::least_squares::{factorise, solve_factored};
use crate::mesh::{Point, distance};

/// Radii of the filter, as shares of the logarithmic range from the typical radius to the largest of the table.
const RADII: [f64; 3] = [0.0, 0.35, 0.7];
/// The filter uses every n-th position of the table along each side.
const STRIDE: usize = 2;

/// Maximum number of positions proposed.
const PROPOSALS: usize = 3;
/// Minimum distance between proposed positions, in typical radii.
const APART: f64 = 2.5;

/// Maximum number of candidates taken into a non-negative combination, and least product with the residual, in
/// standard deviations, of the next.
const MOST_ROUNDS: usize = 60;
const LEAST_PRODUCT: f64 = 2.0;
/// Candidates whose responses have a larger cosine than this belong to one spot.
const ALIKE: f32 = 0.9;
/// Added to the diagonal of the normal equations, for candidates that resemble each other.
const RIDGE: f64 = 1e-6;

/// A position where one more spot would lower the cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotProposal {
    /// Centre, metres.
    pub position_m: Point,
    /// Radius, metres.
    pub radius_m: f64,
    /// Least-squares amplitude with the other spots held fixed.
    pub amplitude: f64,
    /// Drop in the whitened cost.
    pub gain: f64,
}

/// The matched filter of one model: whitened responses at the candidate positions.
#[derive(Clone, Debug)]
pub struct SpotFilter {
    places: Vec<(Point, f64)>,
    /// Responses one after the other, each of unit length and orthogonal to the uniform change.
    unit: Vec<f32>,
    norms: Vec<f32>,
    length: usize,
}

impl SpotModel {
    /// The matched filter of this model over the positions of the table for which `is_inside` holds.
    pub fn filter(&self, is_inside: impl Fn(Point) -> bool) -> SpotFilter {
        let length = self.combinations();
        let [_, most] = self.responses.log_radii();
        let typical = self.options().typical_radius_m.ln();
        let mut filter = SpotFilter { places: Vec::new(), unit: Vec::new(), norms: Vec::new(), length };
        let (mut tabulated, mut rows) = (self.responses.scratch(), vec![0.0_f32; OF_SPOT * length]);
        // The uniform change has a prior, so only the part that it can take up is removed.
        let of_uniform = 1.0 / (square(&self.uniform) + UNIFORM_DEVIATION.powi(-2));
        for share in RADII {
            let log_radius = typical + share * (most - typical);
            for place in self.responses.places(STRIDE).filter(|place| is_inside(*place)) {
                if self.responses.evaluate(place, log_radius, &mut tabulated, &mut rows).is_none() {
                    continue;
                }
                let response = &mut rows[..length];
                let along: f64 = response.iter().zip(&self.uniform).map(|(r, u)| f64::from(*r) * f64::from(*u)).sum();
                let share = (along * of_uniform) as f32;
                response.iter_mut().zip(&self.uniform).for_each(|(r, u)| *r -= share * u);
                let norm = square(response).sqrt() as f32;
                if norm > 0.0 {
                    filter.places.push((place, log_radius.exp()));
                    filter.norms.push(norm);
                    filter.unit.extend(response.iter().map(|r| r / norm));
                }
            }
        }
        filter
    }

    /// Whitens a frame (volts, all finite) into the scratch and fits only the uniform change: the outcome without
    /// spots. Later calls of [`SpotModel::fit_from`] fit this frame.
    ///
    /// # Errors
    /// A frame of the wrong length, or values that are not finite.
    pub fn take_frame(&self, difference: &[f64], scratch: &mut FitScratch) -> Result<FitOutcome, InverseError> {
        scratch.large.work = 0.0;
        if difference.len() != self.channels() {
            let (expected, got) = (self.channels(), difference.len());
            return Err(InverseError::Size { what: "channels of the frame", expected, got });
        }
        crate::inverse::check_finite("channel", difference)?;
        self.project(difference, &mut scratch.data);
        scratch.linear.copy_from_slice(&scratch.data);
        Ok(self.fit_nothing(scratch))
    }

    /// Linearises the model about these spots for linear fits to this frame: the nonlinear part of the response stays
    /// that of these spots. Without spots, if they are small, and after a full fit, it is linear about the skin at rest.
    pub fn linearise_about(&self, spots: &[Spot], scratch: &mut FitScratch) {
        scratch.linear.copy_from_slice(&scratch.data);
        let Some(model) = &self.large else { return };
        if self.begin_from(spots, scratch).is_some() {
            let FitScratch { state, rows, linear, large, beyond, .. } = &mut *scratch;
            let are_large = model.are_large(state.iter().map(State::spot), large);
            // Out of work, it stays linear about the skin at rest.
            if let Some(part) = are_large.then(|| self.beyond(state, rows, model, beyond, large)).flatten() {
                take_off(part, linear);
            }
        }
    }

    /// Fits only the uniform change to the frame of the last [`SpotModel::take_frame`].
    pub fn fit_nothing(&self, scratch: &mut FitScratch) -> FitOutcome {
        scratch.state.clear();
        scratch.spots.clear();
        scratch.looks_beyond = false;
        scratch.residual.copy_from_slice(&scratch.linear);
        self.fit_uniform(scratch)
    }

    /// Fits the uniform change to the residual, and takes it off.
    fn fit_uniform(&self, scratch: &mut FitScratch) -> FitOutcome {
        let product = |a: &[f32], b: &[f32]| f64::from(inner_product(a, b));
        let own = product(&self.uniform, &self.uniform) + UNIFORM_DEVIATION.powi(-2);
        let uniform = product(&scratch.residual, &self.uniform) / own;
        scratch.residual.iter_mut().zip(&self.uniform).for_each(|(r, v)| *r -= uniform as f32 * v);
        let energy = product(&scratch.data, &scratch.data) / self.combinations() as f64;
        let residual = self.mean_square(scratch);
        FitOutcome { energy, residual, in_proportion: residual, uniform, steps: 0 }
    }

    /// Fits spots to the frame of the last [`SpotModel::take_frame`], starting from these positions, radii and
    /// amplitudes (their covariances are ignored). `None` if a start is outside the table, there are too many, or the
    /// equations cannot be solved. This is the linear fit; [`SpotModel::go_beyond_proportion`] continues it.
    /// Allocates nothing.
    pub fn fit_from(&self, starts: &[Spot], uniform: f64, scratch: &mut FitScratch) -> Option<FitOutcome> {
        self.begin_from(starts, scratch)?;
        let FitScratch { state, rows, data, linear, residual, .. } = &mut *scratch;
        self.residual(state, rows, linear, uniform, residual);
        let energy = square(data) / self.combinations() as f64;
        let mut uniform = uniform;
        let steps = self.improve(&mut uniform, scratch).ok()?;
        let residual = self.mean_square(scratch);
        self.finish(residual, uniform, scratch);
        Some(FitOutcome { energy, residual, in_proportion: residual, uniform, steps })
    }

    /// Compares the frame of the last [`SpotModel::take_frame`] with these spots as they are, and fits only the uniform
    /// change. `None` if a spot is outside the table, if all are small, or if the model does not correct for large
    /// changes.
    pub fn left_by(&self, spots: &[Spot], scratch: &mut FitScratch) -> Option<FitOutcome> {
        self.begin_from(spots, scratch)?;
        self.look_beyond(0.0, scratch)?;
        Some(self.fit_uniform(scratch))
    }

    /// Like [`SpotModel::fit_from`], followed by [`SpotModel::go_beyond_proportion`]. Large starts come from an earlier
    /// nonlinear fit, such as the last frame's, so the linear fit is left out for them.
    pub fn fit_in_full(&self, starts: &[Spot], uniform: f64, scratch: &mut FitScratch) -> Option<FitOutcome> {
        let Some(mut outcome) = self.left_by(starts, scratch) else {
            scratch.linear.copy_from_slice(&scratch.data);
            let outcome = self.fit_from(starts, uniform, scratch)?;
            return self.go_beyond_proportion(outcome, scratch).ok();
        };
        outcome.steps = self.improve(&mut outcome.uniform, scratch).ok()?;
        outcome.residual = self.mean_square(scratch);
        self.finish(outcome.residual, outcome.uniform, scratch);
        Some(outcome)
    }

    /// Like [`SpotModel::fit_in_full`], with the positions and radii of some spots fixed. Also returns the amount by
    /// which a step of all parameters would lower the whitened energy of the residual. Covariances are those without
    /// fixed parameters.
    pub fn fit_fixed(
        &self,
        starts: &[Spot],
        fixed: &[bool],
        uniform: f64,
        scratch: &mut FitScratch,
    ) -> Option<(FitOutcome, f64)> {
        scratch.fixed.clear();
        scratch.fixed.extend_from_slice(fixed);
        let outcome = self.fit_in_full(starts, uniform, scratch);
        scratch.fixed.clear();
        let outcome = outcome?;
        Some((outcome, self.gain_of_step(outcome.uniform, scratch)))
    }

    /// Fits only the amplitudes of spots, at fixed positions and radii, to the frame of the last
    /// [`SpotModel::take_frame`], with the linear model. `None` as in [`SpotModel::fit_from`].
    pub fn fit_amplitudes(&self, starts: &[Spot], scratch: &mut FitScratch) -> Option<FitOutcome> {
        self.begin_from(starts, scratch)?;
        let length = self.combinations();
        let count = starts.len() + 1;
        for k in 0..starts.len() {
            let from = OF_SPOT * length * k;
            scratch.columns[k * length..(k + 1) * length].copy_from_slice(&scratch.rows[from..from + length]);
        }
        let uniform = self.solve_amplitudes(count, scratch)?;
        let energy = f64::from(inner_product(&scratch.data, &scratch.data)) / length as f64;
        let residual = self.mean_square(scratch);
        self.finish(residual, uniform, scratch);
        Some(FitOutcome { energy, residual, in_proportion: residual, uniform, steps: 0 })
    }

    /// True if fits correct for large changes.
    pub fn looks_beyond_proportion(&self) -> bool {
        self.large.is_some()
    }

    /// Largest change caused by a spot of amplitude 1. A membrane makes it larger under a wide spot than under a narrow
    /// one; on a sheet, and in models without large changes, it is 1.
    pub fn largest_change(&self, position_m: Point, radius_m: f64, scratch: &mut FitScratch) -> f64 {
        self.loads.as_ref().map_or(1.0, |loads| loads.largest(position_m, radius_m, &mut scratch.large))
    }

    /// Sets the spots to their starts and evaluates their responses into the scratch.
    fn begin_from(&self, starts: &[Spot], scratch: &mut FitScratch) -> Option<()> {
        let length = self.combinations();
        if starts.is_empty() || starts.len() > self.options().most_spots {
            return None;
        }
        scratch.state.clear();
        scratch.looks_beyond = false;
        let [least, most] = self.responses.log_radii();
        for (k, start) in starts.iter().enumerate() {
            let log_radius = start.radius_m.ln().clamp(least, most);
            let rows = &mut scratch.rows[OF_SPOT * length * k..OF_SPOT * length * (k + 1)];
            self.responses.evaluate(start.position_m, log_radius, &mut scratch.tabulated, rows)?;
            scratch.state.push(State { position_m: start.position_m, amplitude: start.amplitude, log_radius });
        }
        Some(())
    }

    /// Positions where one more spot explains most of the residual of the last fit, the best first, each apart from
    /// the others. The spot must be positive, unless `negative` allows either sign.
    pub fn seek(&self, filter: &SpotFilter, negative: bool, scratch: &FitScratch) -> Vec<SpotProposal> {
        let values: Vec<f32> =
            filter.unit.chunks_exact(filter.length).map(|unit| inner_product(unit, &scratch.residual)).collect();
        let apart = APART * self.options().typical_radius_m;
        let mut found: Vec<SpotProposal> = Vec::with_capacity(PROPOSALS);
        while found.len() < PROPOSALS {
            let mut best: Option<(usize, f32)> = None;
            for (k, product) in values.iter().enumerate() {
                let value = if negative { product.abs() } else { *product };
                let is_apart = |other: &SpotProposal| distance(filter.places[k].0, other.position_m) >= apart;
                if value > best.map_or(0.0, |(_, most)| most) && found.iter().all(is_apart) {
                    best = Some((k, value));
                }
            }
            let Some((k, value)) = best else { break };
            let (position_m, radius_m) = filter.places[k];
            let amplitude = f64::from(values[k] / filter.norms[k]);
            found.push(SpotProposal { position_m, radius_m, amplitude, gain: f64::from(value).powi(2) });
        }
        found
    }

    /// The spots of the non-negative combination of all candidates that comes nearest to the residual of the last fit,
    /// strongest first. Candidates whose responses are alike count as one spot. The combination is the solution of a
    /// convex problem (Lawson & Hanson, Solving Least Squares Problems, 1974, chapter 23), so it cannot miss a spot
    /// because another was placed before it.
    pub fn seek_together(&self, filter: &SpotFilter, scratch: &FitScratch) -> Vec<SpotProposal> {
        let mut parts = filter.combination(&scratch.residual);
        parts.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut found: Vec<(usize, SpotProposal)> = Vec::new();
        for (candidate, share) in parts {
            let (position_m, radius_m) = filter.places[candidate];
            let amplitude = share / f64::from(filter.norms[candidate]);
            let is_alike = |other: usize| inner_product(filter.unit(other), filter.unit(candidate)) > ALIKE;
            let Some((_, spot)) = found.iter_mut().find(|(other, _)| is_alike(*other)) else {
                found.push((candidate, SpotProposal { position_m, radius_m, amplitude, gain: share.powi(2) }));
                continue;
            };
            let [before, strength] = [(spot.amplitude, spot.radius_m), (amplitude, radius_m)].map(|(a, r)| a * r * r);
            let part = strength / (before + strength);
            (0..2).for_each(|axis| spot.position_m[axis] += part * (position_m[axis] - spot.position_m[axis]));
            spot.amplitude = (before + strength) / (spot.radius_m * spot.radius_m);
            spot.gain = (spot.gain.sqrt() + share).powi(2);
        }
        let mut found: Vec<SpotProposal> = found.into_iter().map(|(_, spot)| spot).collect();
        found.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        found
    }

    /// The gain of the best position of [`SpotModel::seek`]. Allocates nothing.
    pub fn most_gain(&self, filter: &SpotFilter, negative: bool, scratch: &FitScratch) -> f64 {
        let products = filter.unit.chunks_exact(filter.length).map(|unit| inner_product(unit, &scratch.residual));
        let most = products.map(|product| if negative { product.abs() } else { product }).fold(0.0, f32::max);
        f64::from(most).powi(2)
    }

    /// The change of the channels by these spots, volts, within the combinations of the model; 0 for channels that
    /// are left out.
    pub fn channels_of(&self, spots: &[Spot], scratch: &mut FitScratch, volts: &mut Vec<f64>) {
        let length = self.combinations();
        let mut sum = vec![0.0_f64; length];
        for spot in spots {
            let rows = &mut scratch.trial_rows[..length];
            if self.responses.value(spot.position_m, spot.radius_m.ln(), &mut scratch.tabulated, rows).is_some() {
                sum.iter_mut().zip(rows.iter()).for_each(|(sum, r)| *sum += spot.amplitude * f64::from(*r));
            }
        }
        volts.clear();
        volts.resize(self.lift.nrows(), 0.0);
        Arch::new().dispatch(|| {
            for (column, sum) in sum.iter().enumerate() {
                let entries = self.lift.col_as_slice(column);
                volts.iter_mut().zip(entries).for_each(|(volt, entry)| *volt += entry * sum);
            }
        });
    }
}

impl SpotFilter {
    fn unit(&self, candidate: usize) -> &[f32] {
        &self.unit[candidate * self.length..(candidate + 1) * self.length]
    }

    /// Candidates and their shares, all positive, whose sum comes nearest to a residual.
    fn combination(&self, residual: &[f32]) -> Vec<(usize, f64)> {
        let mut parts: Vec<(usize, f64)> = Vec::new();
        let mut left = residual.to_vec();
        for _ in 0..MOST_ROUNDS {
            let products = self.unit.chunks_exact(self.length).map(|unit| inner_product(unit, &left));
            let Some((best, gain)) = products.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
            let is_new = parts.iter().all(|(candidate, _)| *candidate != best);
            if gain.is_nan() || f64::from(gain) < LEAST_PRODUCT || !is_new {
                break;
            }
            parts.push((best, 0.0));
            while let Some(solved) = self.solve(&parts, residual) {
                // Go towards the solution until a share becomes 0, and drop that candidate.
                let shares = parts.iter().zip(&solved).enumerate();
                let ended = shares
                    .filter(|(_, (_, solved))| **solved <= 0.0)
                    .map(|(k, ((_, share), solved))| (k, if *share > 0.0 { share / (share - solved) } else { 0.0 }))
                    .min_by(|a, b| a.1.total_cmp(&b.1));
                let step = ended.map_or(1.0, |(_, step)| step);
                parts.iter_mut().zip(&solved).for_each(|((_, share), solved)| *share += step * (solved - *share));
                let Some((ended, _)) = ended else { break };
                parts.remove(ended);
            }
            left.copy_from_slice(residual);
            for (candidate, share) in &parts {
                left.iter_mut().zip(self.unit(*candidate)).for_each(|(left, unit)| *left -= *share as f32 * unit);
            }
        }
        parts
    }

    /// Shares of the candidates in use, of either sign, that come nearest to a residual. `None` without any, or if they
    /// cannot be told apart.
    fn solve(&self, parts: &[(usize, f64)], residual: &[f32]) -> Option<Vec<f64>> {
        let count = parts.len();
        let mut normal = vec![0.0; count * count];
        for (row, (a, _)) in parts.iter().enumerate() {
            for (column, (b, _)) in parts.iter().enumerate() {
                normal[row * count + column] = f64::from(inner_product(self.unit(*a), self.unit(*b)));
            }
            normal[row * count + row] += RIDGE;
        }
        let mut shares: Vec<f64> =
            parts.iter().map(|(k, _)| f64::from(inner_product(self.unit(*k), residual))).collect();
        (count > 0 && factorise(&mut normal, count)).then(|| solve_factored(&normal, &mut shares, count))?;
        Some(shares)
    }
}

/// Sum of squares.
fn square(v: &[f32]) -> f64 {
    v.iter().map(|v| f64::from(*v).powi(2)).sum()
}
