//! Touches on a skin of elements over coils, located by the forces that move the elements. A press between elements
//! moves several of them and is a single touch.
//!
//! With x the travel that a linear spring would have, each element carries `F = k x + c sum (x - x_beside)`
//! (stiffness k, coupling c to the adjacent elements): an element that is merely dragged along by a neighbour carries
//! no force. A touch is located at the centroid of the forces on its elements. Elements whose forces form a line
//! belong to several touches.

use dermis_mit::LiftOffFit;
use dermis_skin::{Layer, Solve};
use dermis_tomo::mesh::{Point, distance};
use dermis_touch::{Contact, ContactSign};

use crate::prepare::Prepared;

/// Forces below this share of the largest, or below this many standard deviations, are ignored.
const LEAST_SHARE: f64 = 0.05;
const LEAST_SIGMA: f64 = 3.0;
/// Elements within this many cells of a touch's own belong to it.
const REACH_CELLS: f64 = 1.1;
/// Elements that carry this share of the largest force are pressed, and their neighbours belong to the same presses.
const PRESSED_SHARE: f64 = 0.25;
/// Forces belong to several presses if their variance along one axis exceeds that across it by this much, cells
/// squared.
const ELONGATED_CELLS2: f64 = 0.4;
/// When forces are divided into presses: minimum share of the force, and minimum distance in cells.
const LEAST_PART: f64 = 0.15;
const LEAST_APART_CELLS: f64 = 1.25;
/// Maximum number of rounds for assigning elements to presses.
const MOST_ROUNDS: usize = 12;
/// Maximum share of the travel at which forces are evaluated, since springs near their end hardly show the force.
const MOST_SHARE: f64 = 0.98;
/// Standard deviation of a press's position about the centroid of forces, in cells: the effect of how a round face
/// covers cells.
const MODEL_ERROR_CELLS: f64 = 0.06;

/// Merges contacts of elements moved by one press.
#[derive(Debug)]
pub(crate) struct ElementContacts {
    places_m: Vec<Point>,
    cell_m: [f64; 2],
    /// Indices of the elements adjacent to each.
    beside: Vec<Vec<usize>>,
    stiffness_n_per_m: f64,
    sharpness: f64,
    coupling_n_per_m: f64,
    limit_m: f64,
    join_cells: f64,
    forces_n: Vec<f64>,
    deviations_n: Vec<f64>,
}

/// Elements moved by one press, or by several adjacent ones.
struct Group {
    /// Elements shown by contacts in the image.
    contacts: Vec<usize>,
    /// All elements that carry a force.
    about: Vec<usize>,
}

impl ElementContacts {
    /// `None` unless the skin file requests it and images are solved for elements.
    pub fn new(prepared: &Prepared) -> Option<Self> {
        let skin = &prepared.skin;
        let (Layer::Elements(layer), Some(elements)) = (&skin.frontend.layer, &skin.frontend.elements) else {
            return None;
        };
        if skin.imaging.solve != Solve::LiftOff || skin.touch.join_cells <= 0.0 {
            return None;
        }
        let (places_m, cell_m) = (elements.places_m(), elements.cell_m());
        Some(Self {
            forces_n: vec![0.0; places_m.len()],
            deviations_n: vec![0.0; places_m.len()],
            beside: beside(&places_m, cell_m),
            stiffness_n_per_m: layer.stiffness_n_per_m,
            sharpness: layer.sharpness,
            coupling_n_per_m: layer.coupling_n_per_m,
            limit_m: elements.travel_mm * 1e-3,
            join_cells: skin.touch.join_cells,
            places_m,
            cell_m,
        })
    }

    /// Merges the contacts of one frame and locates them by the travels of their elements.
    pub fn place(&mut self, fit: &LiftOffFit, contacts: &mut Vec<Contact>) {
        self.read_forces(fit);
        let own: Vec<usize> = contacts.iter().map(|contact| self.nearest(contact.peak_m)).collect();
        let mut kept = Vec::with_capacity(contacts.len());
        for sign in [ContactSign::Positive, ContactSign::Negative] {
            let members: Vec<usize> = (0..contacts.len()).filter(|&k| contacts[k].sign == sign).collect();
            let shown: Vec<usize> = members.iter().map(|&k| own[k]).collect();
            for group in self.groups(&shown) {
                let members: Vec<usize> =
                    members.iter().copied().filter(|&k| group.contacts.contains(&own[k])).collect();
                let parts = self.parts(group.about);
                let alone = parts.len() == 1;
                for part in parts {
                    let of_part: Vec<usize> =
                        members.iter().copied().filter(|&k| alone || part.contains(&own[k])).collect();
                    kept.extend(self.contact(&of_part, &members, &part, &own, fit, contacts));
                }
            }
        }
        kept.sort_by(|a, b| b.amplitude.total_cmp(&a.amplitude));
        *contacts = kept;
    }

    /// The contact of one press. It comes from the image's contacts in this part, or from all contacts of the group
    /// if the image shows none here.
    fn contact(
        &self,
        of_part: &[usize],
        members: &[usize],
        part: &[usize],
        own: &[usize],
        fit: &LiftOffFit,
        contacts: &[Contact],
    ) -> Option<Contact> {
        let strongest_of =
            |of: &[usize]| of.iter().copied().max_by(|&a, &b| contacts[a].amplitude.total_cmp(&contacts[b].amplitude));
        let mut contact;
        if let Some(strongest) = strongest_of(of_part) {
            contact = contacts[strongest];
            contact.area_m2 = of_part.iter().map(|&k| contacts[k].area_m2).sum();
            contact.volume = of_part.iter().map(|&k| contacts[k].volume).sum();
        } else {
            // The peak is hidden next to a higher one; scale it by how far its elements moved.
            let strongest = strongest_of(members)?;
            let deepest = part.iter().copied().max_by(|&a, &b| fit.travel_m[a].total_cmp(&fit.travel_m[b]))?;
            let share = (fit.travel_m[deepest] / fit.travel_m[own[strongest]]).clamp(0.0, 1.0);
            contact = contacts[strongest];
            contact.peak_m = self.places_m[deepest];
            contact.amplitude *= share;
            contact.peak_value *= share;
            contact.significance *= share;
            contact.volume *= share;
            contact.centroid_m = contact.peak_m;
        }
        if let Some((centroid_m, covariance_m2)) = self.centroid(part) {
            (contact.centroid_m, contact.covariance_m2) = (centroid_m, covariance_m2);
        }
        Some(contact)
    }

    /// Computes the force on every element, newtons, and its standard deviation.
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

    /// Groups the elements shown by contacts that one press may have moved: at most `join_cells` apart, or with
    /// pressed elements in common.
    fn groups(&self, shown: &[usize]) -> Vec<Group> {
        let mut linked: Vec<Vec<usize>> = Vec::new();
        for &element in shown {
            let is_near =
                |group: &Vec<usize>| group.iter().any(|&other| self.cells_between(element, other) <= self.join_cells);
            let (near, mut apart): (Vec<_>, Vec<_>) = linked.into_iter().partition(is_near);
            apart.push(near.concat().into_iter().chain([element]).collect());
            linked = apart;
        }
        // The elements shown by contacts, and their pressed elements.
        let mut cores: Vec<(Vec<usize>, Vec<usize>)> = Vec::new();
        for contacts in linked {
            let core = self.pressed(&contacts);
            let meets = |other: &(Vec<usize>, Vec<usize>)| other.1.iter().any(|k| core.contains(k));
            let (met, mut apart): (Vec<_>, Vec<_>) = cores.into_iter().partition(meets);
            let mut joined = (contacts, core.clone());
            for (other, pressed) in met {
                joined.0.extend(other);
                joined.1.extend(pressed.into_iter().filter(|k| !core.contains(k)));
            }
            apart.push(joined);
            cores = apart;
        }
        let about = |k: usize| {
            let others: Vec<usize> = (0..cores.len()).filter(|&n| n != k).flat_map(|n| cores[n].1.clone()).collect();
            self.about(&cores[k].1, &others)
        };
        let abouts: Vec<Vec<usize>> = (0..cores.len()).map(about).collect();
        cores.into_iter().zip(abouts).map(|((contacts, _), about)| Group { contacts, about }).collect()
    }

    /// These elements, and recursively any neighbour that carries a large force.
    fn pressed(&self, shown: &[usize]) -> Vec<usize> {
        let largest = shown.iter().map(|&k| self.forces_n[k]).fold(0.0, f64::max);
        let mut core: Vec<usize> = shown.to_vec();
        let mut next = 0;
        while next < core.len() {
            let from = core[next];
            next += 1;
            for k in 0..self.places_m.len() {
                let beside = self.cells_between(k, from) <= REACH_CELLS;
                if beside && self.carries(k, PRESSED_SHARE * largest) && !core.contains(&k) {
                    core.push(k);
                }
            }
        }
        core
    }

    /// True if an element carries more than a given force, and more than noise.
    fn carries(&self, element: usize, least_n: f64) -> bool {
        let force = self.forces_n[element];
        force > least_n && force > LEAST_SIGMA * self.deviations_n[element]
    }

    /// The elements next to pressed ones that carry a force, closer to them than to those of other groups.
    fn about(&self, core: &[usize], others: &[usize]) -> Vec<usize> {
        let nearest =
            |k: usize, of: &[usize]| of.iter().map(|&m| self.cells_between(k, m)).fold(f64::INFINITY, f64::min);
        let largest = core.iter().map(|&k| self.forces_n[k]).fold(0.0, f64::max);
        let counts = |k: &usize| {
            let near = nearest(*k, core);
            near <= REACH_CELLS && near < nearest(*k, others) && self.carries(*k, LEAST_SHARE * largest)
        };
        (0..self.places_m.len()).filter(counts).collect()
    }

    /// The elements of each press. Wherever a round face lies, it spreads its force equally in all directions, except
    /// for a quarter of a cell squared due to the elements' grid. Forces that extend further along one axis than
    /// across it belong to several presses and are divided, however uniform the forces between them.
    fn parts(&self, about: Vec<usize>) -> Vec<Vec<usize>> {
        match self.divided(&about) {
            Some(parts) => parts.into_iter().flat_map(|part| self.parts(part)).collect(),
            None => vec![about],
        }
    }

    fn divided(&self, about: &[usize]) -> Option<[Vec<usize>; 2]> {
        let at = |k: usize| [0, 1].map(|axis| self.places_m[k][axis] / self.cell_m[axis]);
        let middle = |of: &[usize]| {
            let sum: f64 = of.iter().map(|&k| self.forces_n[k]).sum();
            ([0, 1].map(|axis| of.iter().map(|&k| self.forces_n[k] * at(k)[axis]).sum::<f64>() / sum), sum)
        };
        let (centre, all_n) = middle(about);
        let moment = |a: usize, b: usize| {
            let of = |k: &usize| self.forces_n[*k] * (at(*k)[a] - centre[a]) * (at(*k)[b] - centre[b]);
            about.iter().map(of).sum::<f64>() / all_n
        };
        let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
        let half = (0.5 * (xx - yy)).hypot(xy);
        if half.is_nan() || 2.0 * half <= ELONGATED_CELLS2 {
            return None;
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let reach = (0.5 * (xx + yy) + half).sqrt();
        let along = [reach * angle.cos(), reach * angle.sin()];
        let mut seeds = [-1.0, 1.0].map(|sign| [0, 1].map(|axis| centre[axis] + sign * along[axis]));
        let mut parts = [Vec::new(), Vec::new()];
        for _ in 0..MOST_ROUNDS {
            let (one, other): (Vec<usize>, Vec<usize>) =
                about.iter().partition(|&&k| distance(at(k), seeds[0]) <= distance(at(k), seeds[1]));
            let same = parts[0] == one;
            parts = [one, other];
            if same || parts.iter().any(Vec::is_empty) {
                break;
            }
            seeds = [0, 1].map(|part| middle(&parts[part]).0);
        }
        let least_n = parts.iter().map(|part| middle(part).1).fold(f64::INFINITY, f64::min);
        let apart = distance(seeds[0], seeds[1]);
        (parts.iter().all(|part| !part.is_empty()) && least_n >= LEAST_PART * all_n && apart >= LEAST_APART_CELLS)
            .then_some(parts)
    }

    /// Centroid of the forces on these elements, and its covariance.
    fn centroid(&self, about: &[usize]) -> Option<([f64; 2], [[f64; 2]; 2])> {
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

    fn nearest(&self, at_m: Point) -> usize {
        let away_m = |k: usize| distance(self.places_m[k], at_m);
        (0..self.places_m.len()).min_by(|&a, &b| away_m(a).total_cmp(&away_m(b))).unwrap_or(0)
    }

    /// Distance of two elements in cells, the larger of both directions.
    fn cells_between(&self, a: usize, b: usize) -> f64 {
        let [x, y] = [0, 1].map(|axis| ((self.places_m[a][axis] - self.places_m[b][axis]) / self.cell_m[axis]).abs());
        x.max(y)
    }
}

/// For each element, the indices of those one cell away along x or y, to within a tenth of a cell.
pub(crate) fn beside(places_m: &[Point], cell_m: [f64; 2]) -> Vec<Vec<usize>> {
    let is_beside = |a: [f64; 2], b: [f64; 2]| {
        let [x, y] = [0, 1].map(|axis| ((a[axis] - b[axis]) / cell_m[axis]).abs());
        (x + y - 1.0).abs() < 0.1 && x.min(y) < 0.1
    };
    places_m.iter().map(|a| (0..places_m.len()).filter(|&b| is_beside(*a, places_m[b])).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: usize = 8;

    /// Elements in 6 x 8 unit cells, with the forces of round faces of given centres and radii, in cells.
    fn pressed(faces: &[([f64; 2], f64)]) -> ElementContacts {
        let places_m: Vec<Point> = (0..48).map(|k| [(k % COLUMNS) as f64, (k / COLUMNS) as f64]).collect();
        const FINE: usize = 20;
        let share = |place: &Point| -> f64 {
            let at = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
            let points = (0..FINE * FINE).map(|k| [place[0] + at(k % FINE), place[1] + at(k / FINE)]);
            let covered = |p: Point| faces.iter().any(|(c, r)| distance(p, *c) < *r);
            points.filter(|p| covered(*p)).count() as f64 / (FINE * FINE) as f64
        };
        ElementContacts {
            forces_n: places_m.iter().map(share).collect(),
            deviations_n: vec![1e-3; places_m.len()],
            beside: vec![Vec::new(); places_m.len()],
            stiffness_n_per_m: 1.0,
            sharpness: 2.0,
            coupling_n_per_m: 0.0,
            limit_m: 1.0,
            join_cells: 1.5,
            cell_m: [1.0; 2],
            places_m,
        }
    }

    /// Positions of the presses found, if the image shows the elements with the largest forces as contacts.
    fn presses(faces: &[([f64; 2], f64)]) -> Vec<[f64; 2]> {
        let contacts = pressed(faces);
        let largest = contacts.forces_n.iter().copied().fold(0.0, f64::max);
        let shown: Vec<usize> = (0..48).filter(|k| contacts.forces_n[*k] > 0.25 * largest).collect();
        let parts = contacts.groups(&shown).into_iter().flat_map(|group| contacts.parts(group.about));
        parts.map(|part| contacts.centroid(&part).unwrap().0).collect()
    }

    /// Centres between 2 and 3 cells from the left and below.
    fn middles() -> impl Iterator<Item = Point> {
        (0..36).map(|k| [2.0 + (k % 6) as f64 / 6.0, 2.0 + (k / 6) as f64 / 6.0])
    }

    #[test]
    fn one_round_press_is_one_wherever_it_lies() {
        for middle in middles() {
            for radius in [0.3, 0.44, 0.8, 1.3] {
                let found = presses(&[(middle, radius)]);
                assert_eq!(found.len(), 1, "{middle:?} {radius}: {found:?}");
            }
        }
    }

    #[test]
    fn two_presses_beside_each_other_are_two_though_no_element_between_them_is_free() {
        for middle in middles() {
            for turn in 0..10 {
                let (angle, apart) = (0.1 + 0.3 * f64::from(turn % 5), if turn < 5 { 2.1 } else { 1.7 });
                let other = [middle[0] + apart * angle.cos(), middle[1] + apart * angle.sin()];
                let found = presses(&[(middle, 0.44), (other, 0.44)]);
                assert_eq!(found.len(), 2, "{middle:?} {other:?}: {found:?}");
                for place in [middle, other] {
                    let off = found.iter().map(|p| distance(*p, place)).fold(9.0, f64::min);
                    assert!(off < 0.5, "{place:?}: {found:?}");
                }
            }
        }
    }
}
