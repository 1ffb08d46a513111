//! Effect of round presses on elements on sponge or springs. A press is a disc of uniform pressure with a soft edge.
//! Each element carries the load on its cell, `F = p area(disc within cell)`. It drags its neighbours along,
//! `(k + c L) x = F` with L the Laplacian of the grid's graph, and its spring stiffens near the end of its travel,
//! `t = x / (1 + (x/l)^n)^(1/n)`.

use dermis_mit::MitError;
use dermis_skin::{Elements, ElementsLayer};
use dermis_tomo::mesh::Point;
use faer::linalg::solvers::{DenseSolveCore, Llt};
use faer::{Mat, Side};

use crate::Error;

/// Number of unknowns of a press: x and y in cells, the logarithms of its radius and of its pressure.
pub(super) const OF_PRESS: usize = 4;
/// Nodes and weights of the eight-point Gauss-Legendre rule on -1 to 1; only the positive half.
const NODES: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_47),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
];
/// Softness of a press's edge, a standard deviation in cells. Without it, a small press within one cell could lie
/// anywhere on it. Discs of three radii with these weights represent it (Gauss-Hermite rule).
const SOFTNESS_CELLS: f64 = 0.125;
const SOFT_EDGE: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];
/// Relative step for differentiating areas by the radius.
const RADIUS_STEP: f64 = 1e-3;

/// A round press.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Press {
    /// Centre, metres.
    pub centre_m: Point,
    /// Logarithm of the radius in metres.
    pub log_radius: f64,
    /// Logarithm of the pressure in pascals.
    pub log_pressure: f64,
}

impl Press {
    pub(super) fn radius_m(&self) -> f64 {
        self.log_radius.exp()
    }
}

/// Elements, their cells and their springs.
#[derive(Clone, Debug)]
pub(super) struct Mechanics {
    pub places_m: Vec<Point>,
    pub cell_m: [f64; 2],
    /// Inverse of `k + c L`, metres per newton: travel of each element per force on another, row by row.
    compliance_m_per_n: Vec<f64>,
    limit_m: f64,
    sharpness: f64,
}

/// Travels under presses and their derivatives.
#[derive(Clone, Debug, Default)]
pub(super) struct Travels {
    /// Travel of each element, metres.
    pub travel_m: Vec<f64>,
    /// Total force of each press on all elements, newtons.
    pub forces_n: Vec<f64>,
    /// Derivative of each element's travel by a linear spring's travel.
    pub stiffening: Vec<f64>,
    /// Derivatives by each unknown of each press: unknown by unknown, element by element.
    pub slopes: Vec<f64>,
}

impl Mechanics {
    /// # Errors
    /// Springs with invalid stiffness.
    pub(super) fn new(elements: &Elements, layer: &ElementsLayer, beside: &[Vec<usize>]) -> Result<Self, Error> {
        let places_m = elements.places_m();
        let count = places_m.len();
        let (k, c) = (layer.stiffness_n_per_m, layer.coupling_n_per_m);
        let stiffness = Mat::from_fn(count, count, |i, j| {
            if i == j {
                k + c * beside[i].len() as f64
            } else if beside[i].contains(&j) {
                -c
            } else {
                0.0
            }
        });
        let expected = "a stiffness above zero";
        let refused = |_| MitError::Value { field: "stiffness_n_per_m", value: k, expected };
        let inverse = Llt::new(stiffness.as_ref(), Side::Lower).map_err(refused)?.inverse();
        let compliance_m_per_n = (0..count * count).map(|at| inverse[(at / count, at % count)]).collect();
        Ok(Self {
            places_m,
            cell_m: elements.cell_m(),
            compliance_m_per_n,
            limit_m: elements.travel_mm * 1e-3,
            sharpness: layer.sharpness,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.places_m.len()
    }

    /// True if a position is on the cell of an element.
    pub(super) fn is_felt(&self, at_m: Point) -> bool {
        self.places_m.iter().any(|place| (0..2).all(|k| (at_m[k] - place[k]).abs() <= 0.5 * self.cell_m[k]))
    }

    /// Computes the travels of all elements under these presses, and optionally their derivatives.
    pub(super) fn travels(&self, presses: &[Press], with_slopes: bool, out: &mut Travels) {
        let count = self.count();
        out.travel_m.clear();
        out.travel_m.resize(count, 0.0);
        out.forces_n.clear();
        out.forces_n.resize(presses.len(), 0.0);
        out.slopes.clear();
        out.slopes.resize(if with_slopes { OF_PRESS * presses.len() * count } else { 0 }, 0.0);
        for (number, press) in presses.iter().enumerate() {
            let all = OF_PRESS * number * count;
            for element in 0..count {
                let Some(load) = self.load(press, element, with_slopes) else { continue };
                out.forces_n[number] += load[0];
                for other in 0..count {
                    let compliance = self.compliance_m_per_n[element * count + other];
                    out.travel_m[other] += compliance * load[0];
                    if with_slopes {
                        (0..OF_PRESS).for_each(|k| out.slopes[all + k * count + other] += compliance * load[1 + k]);
                    }
                }
            }
        }
        out.stiffening.clear();
        for element in 0..count {
            let share = (out.travel_m[element].max(0.0) / self.limit_m).powf(self.sharpness);
            let stiffened = (1.0 + share).powf(-1.0 / self.sharpness);
            out.travel_m[element] *= stiffened;
            let slope = stiffened / (1.0 + share);
            out.stiffening.push(slope);
            out.slopes.iter_mut().skip(element).step_by(count).for_each(|value| *value *= slope);
        }
    }

    /// The elements that a press moves, and their travels on linear springs, metres.
    pub(super) fn linear_travels(&self, press: &Press) -> Vec<(usize, f64)> {
        let count = self.count();
        let mut travels_m = vec![0.0; count];
        for element in 0..count {
            let Some([force_n, ..]) = self.load(press, element, false) else { continue };
            let row = &self.compliance_m_per_n[element * count..(element + 1) * count];
            travels_m.iter_mut().zip(row).for_each(|(travel, compliance)| *travel += compliance * force_n);
        }
        travels_m.into_iter().enumerate().filter(|(_, travel)| *travel != 0.0).collect()
    }

    /// Distance of the centres of two presses, in cells.
    pub(super) fn cells_between(&self, a: &Press, b: &Press) -> f64 {
        let [x, y] = [0, 1].map(|axis| (a.centre_m[axis] - b.centre_m[axis]) / self.cell_m[axis]);
        x.hypot(y)
    }

    /// Force of a press on an element and its derivatives by x and y (in cells) and both logarithms; `None` if it
    /// does not reach the element's cell.
    fn load(&self, press: &Press, element: usize, with_slopes: bool) -> Option<[f64; 1 + OF_PRESS]> {
        let cell = [0, 1].map(|axis| {
            let middle = self.places_m[element][axis] - press.centre_m[axis];
            [middle - 0.5 * self.cell_m[axis], middle + 0.5 * self.cell_m[axis]]
        });
        let (radius, soft) = (press.radius_m(), SOFTNESS_CELLS * self.cell_m[0].min(self.cell_m[1]));
        let nearest = |[low, high]: [f64; 2]| if low > 0.0 { low } else { (-high).max(0.0) };
        let distance = nearest(cell[0]).hypot(nearest(cell[1]));
        let mut load = None;
        for (off, weight) in SOFT_EDGE {
            let radius = radius + off * soft;
            if radius > distance {
                let sum = load.get_or_insert([0.0; 1 + OF_PRESS]);
                self.add_disc(press, weight * press.log_pressure.exp(), radius, cell, with_slopes, sum);
            }
        }
        load
    }

    /// Adds the contribution of a disc with this radius and pressure.
    fn add_disc(
        &self,
        press: &Press,
        pressure: f64,
        radius: f64,
        cell: [[f64; 2]; 2],
        with_slopes: bool,
        sum: &mut [f64; 1 + OF_PRESS],
    ) {
        let force = pressure * area_within(radius, cell);
        sum[0] += force;
        if !with_slopes {
            return;
        }
        // A moving disc gains the length of its chord at one edge of the cell, and loses that at the other.
        for axis in 0..2 {
            let chord = |at: f64| chord_within(radius, at, cell[1 - axis]);
            sum[1 + axis] += pressure * (chord(cell[axis][0]) - chord(cell[axis][1])) * self.cell_m[axis];
        }
        let step = RADIUS_STEP * press.radius_m();
        let [wider, narrower] = [step, -step].map(|step| area_within(radius + step, cell));
        sum[3] += pressure * (wider - narrower) / (2.0 * RADIUS_STEP);
        sum[4] += force;
    }
}

/// Length within two bounds of a chord of a disc about the origin, at this distance from its centre.
fn chord_within(radius: f64, at: f64, [low, high]: [f64; 2]) -> f64 {
    let half = (radius * radius - at * at).max(0.0).sqrt();
    (high.min(half) - low.max(-half)).max(0.0)
}

/// Area of a disc about the origin within a rectangle: chords integrated over the angle by the Gauss-Legendre rule.
fn area_within(radius: f64, [x, y]: [[f64; 2]; 2]) -> f64 {
    let angle = |at: f64| (at / radius).clamp(-1.0, 1.0).asin();
    // The rule is accurate where chords have no kink, so split at the angles where they meet the bounds.
    let kink = |bound: f64| (bound.abs() < radius).then(|| (bound / radius).acos());
    let mut ends = [angle(x[0]), angle(x[1]), 0.0, 0.0, 0.0, 0.0];
    let mut used = 2;
    for bound in y {
        for at in kink(bound.abs()).into_iter().flat_map(|angle| [-angle, angle]) {
            if at > ends[0] && at < ends[1] {
                ends[used] = at;
                used += 1;
            }
        }
    }
    ends[..used].sort_by(f64::total_cmp);
    ends[..used].windows(2).map(|pair| piece(radius, pair[0], pair[1], y)).sum()
}

/// The part of that area between two angles.
fn piece(radius: f64, from: f64, to: f64, y: [f64; 2]) -> f64 {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let at = |angle: f64| chord_within(radius, radius * angle.sin(), y) * radius * angle.cos();
    let sum = |(node, weight): &(f64, f64)| weight * (at(middle - half * node) + at(middle + half * node));
    half * NODES.iter().map(sum).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skin() -> dermis_skin::Skin {
        dermis_skin::Skin::open("em-8").unwrap()
    }

    pub(in crate::stages) fn of(skin: &dermis_skin::Skin) -> Mechanics {
        let dermis_skin::Layer::Elements(layer) = &skin.frontend.layer else { panic!("no elements") };
        let elements = skin.frontend.elements.as_ref().unwrap();
        let beside = crate::stages::element_contacts::beside(&elements.places_m(), elements.cell_m());
        Mechanics::new(elements, layer, &beside).unwrap()
    }

    #[test]
    fn areas_within_a_cell_are_those_of_geometry() {
        let whole = std::f64::consts::PI * 0.25;
        assert!((area_within(0.5, [[-1.0, 1.0], [-1.0, 1.0]]) - whole).abs() < 1e-9);
        assert!((area_within(0.5, [[0.0, 1.0], [-1.0, 1.0]]) - 0.5 * whole).abs() < 1e-9);
        assert!((area_within(0.5, [[0.0, 1.0], [0.0, 1.0]]) - 0.25 * whole).abs() < 1e-9);
        // A square within the disc, and a segment of a unit circle beyond 1/2: acos(1/2) - sqrt(3)/4.
        assert!((area_within(2.0, [[-1.0, 1.0], [-1.0, 1.0]]) - 4.0).abs() < 1e-9);
        let segment = 0.5_f64.acos() - 0.75_f64.sqrt() * 0.5;
        for cell in [[[0.5, 2.0], [-2.0, 2.0]], [[-2.0, 2.0], [0.5, 2.0]], [[-2.0, 2.0], [-2.0, -0.5]]] {
            assert!((area_within(1.0, cell) - segment).abs() < 1e-6, "{} {segment}", area_within(1.0, cell));
        }
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let mechanics = of(&skin());
        let press = |by: [f64; 4]| Press {
            centre_m: [0.013 + 0.02 * by[0], -0.006 + 0.02 * by[1]],
            log_radius: 0.009_f64.ln() + by[2],
            log_pressure: 9e3_f64.ln() + by[3],
        };
        let (mut here, mut low, mut high) = (Travels::default(), Travels::default(), Travels::default());
        mechanics.travels(&[press([0.0; 4])], true, &mut here);
        for unknown in 0..OF_PRESS {
            let mut by = [0.0; 4];
            by[unknown] = 1e-4;
            mechanics.travels(&[press(by)], false, &mut high);
            mechanics.travels(&[press(by.map(|v| -v))], false, &mut low);
            for element in 0..mechanics.count() {
                let slope = (high.travel_m[element] - low.travel_m[element]) / 2e-4;
                let given = here.slopes[unknown * mechanics.count() + element];
                assert!((slope - given).abs() < 2e-5, "{unknown} {element}: {slope} {given}");
            }
        }
        assert!(here.travel_m.iter().any(|travel| *travel > 1e-3));
    }
}
