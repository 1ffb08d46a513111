//! Finds where one more press would explain most of the residual of a fit: a matched filter over usual presses on the
//! centres, edges and corners of the cells.
//!
//! With `r` the whitened residual of fitted presses, `X` the slopes of their readings and `g` the readings of one more
//! press, its best amplitude is `g'r / g'Pg` and lowers the cost by `(g'r)^2 / g'Pg`, if the others adapt to it
//! (Kay, Fundamentals of Statistical Signal Processing II, 1998, section 7.7). `P` removes from `g` the part that the
//! others take up within their priors. Elements respond in proportion here: `g = J x`, with `x` the travels that a
//! linear spring would have and `J` the slopes of the readings at the fitted travels.

use dermis_mit::MitError;
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, MatRef, Side};

use super::fit::{Usual, Way};
use super::mechanics::{Mechanics, Press};
use crate::imager::ElementFrame;

/// Distance between candidates, in cells: centre to edge.
const SPACING_CELLS: f64 = 0.5;
/// Maximum number of positions proposed.
const PROPOSALS: usize = 3;
/// Minimum distance between proposed positions, in cells.
const APART_CELLS: f64 = 1.0;

/// One more press that would lower the cost.
struct Proposal {
    /// The press at its best pressure.
    press: Press,
    /// Drop in cost.
    gain: f64,
}

/// The presses that a filter compares.
#[derive(Debug)]
pub(super) struct PressFilter {
    candidates: Vec<Candidate>,
}

#[derive(Debug)]
struct Candidate {
    press: Press,
    /// Elements that move, and by how much on linear springs, metres.
    travels_m: Vec<(usize, f64)>,
}

/// Responses of single elements, without the part that the fitted presses take up.
struct ElementResponses {
    /// Product of each element's response with the residual.
    products: Vec<f64>,
    /// Products of the responses with each other, element by element.
    squares: Mat<f64>,
}

impl PressFilter {
    /// A filter over the cells of these elements.
    pub fn new(mechanics: &Mechanics, usual: &Usual) -> Self {
        const OFFSETS: [f64; 3] = [-SPACING_CELLS, 0.0, SPACING_CELLS];
        let mut candidates: Vec<Candidate> = Vec::new();
        for place in &mechanics.places_m {
            for (x, y) in OFFSETS.into_iter().flat_map(|x| OFFSETS.map(|y| (x, y))) {
                let centre_m = [place[0] + x * mechanics.cell_m[0], place[1] + y * mechanics.cell_m[1]];
                let press = Press { centre_m, log_radius: usual.log_radius, log_pressure: usual.log_pressure };
                let is_new = |other: &Candidate| mechanics.cells_between(&other.press, &press) > 0.5 * SPACING_CELLS;
                if candidates.iter().all(is_new) {
                    let travels_m = mechanics.linear_travels(&press);
                    candidates.push(Candidate { press, travels_m });
                }
            }
        }
        Self { candidates }
    }

    /// Presses that would lower the cost of fitted ones most, the best first, each apart from the others and worth at
    /// least this drop in cost.
    ///
    /// # Errors
    /// Travels that the model of the coils rejects.
    pub fn seek(
        &self,
        mechanics: &Mechanics,
        usual: &Usual,
        frame: &mut ElementFrame<'_>,
        presses: &[Press],
        least_gain: f64,
    ) -> Result<Vec<Press>, MitError> {
        let Some(responses) = ElementResponses::of(&mut Way::new(mechanics, usual, frame, presses))? else {
            return Ok(Vec::new());
        };
        let is_worth = |one: &Proposal| one.gain >= least_gain;
        let mut all: Vec<Proposal> =
            self.candidates.iter().filter_map(|one| responses.proposal(one)).filter(is_worth).collect();
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let mut found: Vec<Press> = Vec::with_capacity(PROPOSALS);
        for Proposal { press, .. } in all {
            let is_apart = |other: &Press| mechanics.cells_between(other, &press) >= APART_CELLS;
            if found.len() < PROPOSALS && found.iter().all(is_apart) {
                found.push(press);
            }
        }
        Ok(found)
    }
}

impl ElementResponses {
    /// `None` if the equations of the fitted presses are singular.
    fn of(way: &mut Way<'_, '_>) -> Result<Option<Self>, MitError> {
        let point = way.linearised()?;
        let (count, unknowns) = (point.stiffening.len(), point.equations.unknowns());
        let channels = point.residual.len();
        let root: Vec<f64> = point.weights.iter().map(|w| w.sqrt()).collect();
        let of_elements =
            Mat::from_fn(channels, count, |i, k| root[i] * point.jacobian[i * count + k] * point.stiffening[k]);
        let of_presses = Mat::from_fn(channels, unknowns, |i, k| root[i] * point.columns[k * channels + i]);
        let residual = Mat::from_fn(channels, 1, |i, _| root[i] * point.residual[i]);
        let normal = MatRef::from_row_major_slice(&point.equations.normal, unknowns, unknowns);
        let Ok(factor) = Llt::new(normal, Side::Lower) else { return Ok(None) };
        let shared = of_presses.transpose() * &of_elements;
        let taken_up = factor.solve(&shared);
        let right = Mat::from_fn(unknowns, 1, |k, _| point.equations.right[k]);
        let products = of_elements.transpose() * &residual - taken_up.transpose() * &right;
        let squares = of_elements.transpose() * &of_elements - shared.transpose() * &taken_up;
        Ok(Some(Self { products: (0..count).map(|k| products[(k, 0)]).collect(), squares }))
    }

    /// A candidate at its best pressure; `None` if that is below zero.
    fn proposal(&self, candidate: &Candidate) -> Option<Proposal> {
        let travels_m = &candidate.travels_m;
        let product: f64 = travels_m.iter().map(|(k, travel)| travel * self.products[*k]).sum();
        let of_row = |k: usize| travels_m.iter().map(|(j, travel)| travel * self.squares[(k, *j)]).sum::<f64>();
        let square: f64 = travels_m.iter().map(|(k, travel)| travel * of_row(*k)).sum();
        let amplitude = product / square;
        if !(product > 0.0 && square > 0.0 && amplitude.is_finite()) {
            return None;
        }
        let press = Press { log_pressure: candidate.press.log_pressure + amplitude.ln(), ..candidate.press };
        Some(Proposal { press, gain: product * amplitude })
    }
}
