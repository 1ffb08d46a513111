//! Touches of a skin of elements over coils, placed by the forces that move the elements: a press between elements moves
//! several of them and is one touch.
//!
//! With x the travel that a linear spring would have, each element carries `F = k x + c sum (x - x_beside)` (stiffness k,
//! coupling c to the elements beside it): what a neighbour drags along carries nothing. A touch lies at the centroid of the
//! forces about its elements.

use dermis_mit::LiftOffFit;
use dermis_skin::{Layer, Solve};
use dermis_touch::Contact;

use crate::prepare::Prepared;

/// Forces below this share of the largest, or below so many standard deviations, are none.
const LEAST_SHARE: f64 = 0.05;
const LEAST_SIGMA: f64 = 3.0;
/// Elements within so many cells of a touch's own belong to it.
const REACH_CELLS: f64 = 1.1;
/// Springs near their end say little of the force: the share of the travel at which it is read at most.
const MOST_SHARE: f64 = 0.98;
/// What the centroid of forces misses of a press's place, a standard deviation in cells: how a round face spreads over cells.
const MODEL_ERROR_CELLS: f64 = 0.06;

/// Joins contacts of elements that one press moves.
#[derive(Debug)]
pub(crate) struct ElementContacts {
    places_m: Vec<[f64; 2]>,
    cell_m: [f64; 2],
    /// Numbers of the elements beside each.
    beside: Vec<Vec<usize>>,
    stiffness_n_per_m: f64,
    sharpness: f64,
    coupling_n_per_m: f64,
    limit_m: f64,
    join_cells: f64,
    forces_n: Vec<f64>,
    deviations_n: Vec<f64>,
}

impl ElementContacts {
    /// `None` where the skin file does not ask for it, or images are not solved for elements.
    pub fn new(prepared: &Prepared) -> Option<Self> {
        let skin = &prepared.skin;
        let (Layer::Elements(layer), Some(elements)) = (&skin.frontend.layer, &skin.frontend.elements) else {
            return None;
        };
        if skin.imaging.solve != Solve::LiftOff || skin.touch.join_cells <= 0.0 {
            return None;
        }
        let (places_m, cell_m) = (elements.places_m(), elements.cell_m());
        let is_beside = |a: [f64; 2], b: [f64; 2]| {
            let [x, y] = [0, 1].map(|axis| ((a[axis] - b[axis]) / cell_m[axis]).abs());
            (x + y - 1.0).abs() < 0.1 && x.min(y) < 0.1
        };
        let beside =
            places_m.iter().map(|a| (0..places_m.len()).filter(|&b| is_beside(*a, places_m[b])).collect()).collect();
        Some(Self {
            forces_n: vec![0.0; places_m.len()],
            deviations_n: vec![0.0; places_m.len()],
            beside,
            stiffness_n_per_m: layer.stiffness_n_per_m,
            sharpness: layer.sharpness,
            coupling_n_per_m: layer.coupling_n_per_m,
            limit_m: elements.travel_mm * 1e-3,
            join_cells: skin.touch.join_cells,
            places_m,
            cell_m,
        })
    }

    /// Joins the contacts of one frame and places them by its elements' travels.
    pub fn place(&mut self, fit: &LiftOffFit, contacts: &mut Vec<Contact>) {
        self.read_forces(fit);
        let own: Vec<usize> = contacts.iter().map(|contact| self.nearest(contact.peak_m)).collect();
        let mut group: Vec<usize> = (0..contacts.len()).collect();
        for a in 0..contacts.len() {
            for b in 0..a {
                let same_sign = contacts[a].sign == contacts[b].sign;
                if same_sign && self.cells_between(own[a], own[b]) <= self.join_cells {
                    let (from, to) = (group[a].max(group[b]), group[a].min(group[b]));
                    group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
                }
            }
        }
        let mut kept = Vec::with_capacity(contacts.len());
        for first in 0..contacts.len() {
            if group[first] != first {
                continue;
            }
            let members = || (0..contacts.len()).filter(|&k| group[k] == first);
            let Some(strongest) = members().max_by(|&a, &b| contacts[a].amplitude.total_cmp(&contacts[b].amplitude))
            else {
                continue;
            };
            let mut contact = contacts[strongest];
            let mine: Vec<usize> = members().map(|k| own[k]).collect();
            let others: Vec<usize> = (0..contacts.len()).filter(|&k| group[k] != first).map(|k| own[k]).collect();
            if let Some((centroid_m, covariance_m2)) = self.centroid(&mine, &others) {
                (contact.centroid_m, contact.covariance_m2) = (centroid_m, covariance_m2);
            }
            contact.area_m2 = members().map(|k| contacts[k].area_m2).sum();
            contact.volume = members().map(|k| contacts[k].volume).sum();
            kept.push(contact);
        }
        *contacts = kept;
    }

    /// Force on every element, newtons, and its standard deviation.
    fn read_forces(&mut self, fit: &LiftOffFit) {
        let linear = |travel_m: f64| {
            let share = (travel_m / self.limit_m).clamp(0.0, MOST_SHARE);
            travel_m.max(0.0) / (1.0 - share.powf(self.sharpness)).powf(1.0 / self.sharpness)
        };
        let travel: Vec<f64> = fit.travel_m.iter().map(|t| linear(*t)).collect();
        for (k, beside) in self.beside.iter().enumerate() {
            let drag: f64 = beside.iter().map(|&other| travel[k] - travel[other]).sum();
            self.forces_n[k] = (self.stiffness_n_per_m * travel[k] + self.coupling_n_per_m * drag).max(0.0);
            self.deviations_n[k] = self.stiffness_n_per_m * fit.deviation_m[k];
        }
    }

    /// Centroid of the forces on the elements about these, nearer to them than to the others, and its covariance.
    fn centroid(&self, mine: &[usize], others: &[usize]) -> Option<([f64; 2], [[f64; 2]; 2])> {
        let nearest =
            |k: usize, of: &[usize]| of.iter().map(|&m| self.cells_between(k, m)).fold(f64::INFINITY, f64::min);
        let largest = mine.iter().map(|&k| self.forces_n[k]).fold(0.0, f64::max);
        let counts = |k: &usize| {
            let near = nearest(*k, mine);
            let force = self.forces_n[*k];
            near <= REACH_CELLS
                && near <= nearest(*k, others)
                && force > LEAST_SHARE * largest
                && force > LEAST_SIGMA * self.deviations_n[*k]
        };
        let about: Vec<usize> = (0..self.places_m.len()).filter(counts).collect();
        let sum: f64 = about.iter().map(|&k| self.forces_n[k]).sum();
        if sum <= 0.0 {
            return None;
        }
        let centroid =
            [0, 1].map(|axis| about.iter().map(|&k| self.forces_n[k] * self.places_m[k][axis]).sum::<f64>() / sum);
        let mut covariance = [[0.0; 2]; 2];
        for a in 0..2 {
            for b in 0..2 {
                let spread = |k: &usize| {
                    let off = |axis: usize| (self.places_m[*k][axis] - centroid[axis]) / sum;
                    off(a) * off(b) * self.deviations_n[*k].powi(2)
                };
                covariance[a][b] = about.iter().map(spread).sum();
            }
            covariance[a][a] += (MODEL_ERROR_CELLS * self.cell_m[a]).powi(2);
        }
        Some((centroid, covariance))
    }

    fn nearest(&self, at_m: [f64; 2]) -> usize {
        let distance = |k: &usize| (self.places_m[*k][0] - at_m[0]).hypot(self.places_m[*k][1] - at_m[1]);
        (0..self.places_m.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// Distance of two elements in cells, the larger of both directions.
    fn cells_between(&self, a: usize, b: usize) -> f64 {
        let [x, y] = [0, 1].map(|axis| ((self.places_m[a][axis] - self.places_m[b][axis]) / self.cell_m[axis]).abs());
        x.max(y)
    }
}
