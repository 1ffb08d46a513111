//! Rigid elements on springs or on cut sponge. Each carries the load on its own cell, and a weak elastic coupling
//! drags its neighbours along. Springs are linear at first and stiffen as coils close or foam densifies, so the
//! travel saturates. With x the travel of the linear grid, `(k + c L) x = F` (L is the Laplacian of the grid's
//! graph), the travel is `x / (1 + (x/limit)^n)^(1/n)`.

use dermis_tomo::mesh::Point;
use serde::{Deserialize, Serialize};

use super::{Cover, Indenter};
use crate::error::{TwinError, check, check_positive};

/// Maximum distance between the points at which an indenter's pressure on a cell is sampled, metres.
const SAMPLE_M: f64 = 3e-3;
/// Minimum number of these points along a cell.
const LEAST_SAMPLES: f64 = 4.0;
/// Smoothing of the pressure relative to that distance, so that the sum equals the force.
const SMOOTHING: f64 = 2.5 / 3.0;
/// Maximum number of elements.
const MOST_ELEMENTS: f64 = 1024.0;
/// Permitted deviation of a neighbour's position, as a share of a cell.
const OFF: f64 = 0.1;
/// Relative change below which the linear grid counts as solved.
const SETTLED: f64 = 1e-13;

/// Springs under elements.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Springs {
    /// k: stiffness of each spring at rest, newtons per metre.
    pub stiffness_n_per_m: f64,
    /// Maximum travel under any force, metres.
    pub limit_m: f64,
    /// n: sharpness of the stiffening; 1 stiffens from the start, larger values later.
    pub sharpness: f64,
    /// c: stiffness between neighbours, newtons per metre; 0 for independent springs.
    pub coupling_n_per_m: f64,
}

impl Springs {
    /// Checks the parameters.
    ///
    /// # Errors
    /// A stiffness or limit that is not positive, a sharpness below 1, or a coupling that is negative or above the
    /// stiffness.
    pub fn check(&self) -> Result<(), TwinError> {
        check_positive("springs stiffness_n_per_m", self.stiffness_n_per_m)?;
        check_positive("springs limit_m", self.limit_m)?;
        check("springs sharpness", self.sharpness, 1.0, 100.0, "1 to 100")?;
        check("springs coupling_n_per_m", self.coupling_n_per_m, 0.0, self.stiffness_n_per_m, "0 to the stiffness")
    }

    /// Travel of a single spring under a force, metres.
    pub fn travel_m(&self, force_n: f64) -> f64 {
        self.stiffened_m(force_n.max(0.0) / self.stiffness_n_per_m)
    }

    /// Force on a single spring for this travel, newtons; infinite at the limit and beyond.
    pub fn force_n(&self, travel_m: f64) -> f64 {
        let share = (travel_m / self.limit_m).clamp(0.0, 1.0);
        self.stiffness_n_per_m * travel_m.max(0.0) / (1.0 - share.powf(self.sharpness)).powf(1.0 / self.sharpness)
    }

    fn stiffened_m(&self, linear_m: f64) -> f64 {
        linear_m / (1.0 + (linear_m / self.limit_m).powf(self.sharpness)).powf(1.0 / self.sharpness)
    }
}

/// Elements with their cells and neighbours.
#[derive(Clone, Debug)]
pub struct SpringGrid {
    springs: Springs,
    places_m: Vec<Point>,
    /// Neighbours to the left, right, below and above.
    beside: Vec<[Option<u32>; 4]>,
    cover: Cover,
    samples_m: Vec<Point>,
    pressure_pa: Vec<f64>,
    per_cell: usize,
    sample_area_m2: f64,
}

impl SpringGrid {
    /// Elements in the middle of cells with this width and height, metres. Elements one cell apart along x or y,
    /// within a tenth of a cell, are neighbours.
    ///
    /// # Errors
    /// Invalid springs, no elements or more than 1024, non-finite positions, a cell without area, or overlapping
    /// cells.
    pub fn new(springs: Springs, places_m: Vec<Point>, cell_m: [f64; 2]) -> Result<Self, TwinError> {
        springs.check()?;
        check("number of elements", places_m.len() as f64, 1.0, MOST_ELEMENTS, "1 to 1024")?;
        check_positive("cell_m (width)", cell_m[0])?;
        check_positive("cell_m (height)", cell_m[1])?;
        for value in places_m.iter().flatten() {
            check("places_m", *value, -1e3, 1e3, "a position in metres")?;
        }
        let beside = neighbours(&places_m, cell_m)?;
        let sample_m = SAMPLE_M.min(cell_m[0].min(cell_m[1]) / LEAST_SAMPLES);
        let count = cell_m.map(|length| (length / sample_m).ceil() as usize);
        let step = [0, 1].map(|axis| cell_m[axis] / count[axis] as f64);
        let offset = |axis: usize, k: usize| (k as f64 + 0.5) * step[axis] - 0.5 * cell_m[axis];
        let at = |k: usize| [offset(0, k % count[0]), offset(1, k / count[0])];
        let of_cell = |place: &Point| {
            let [x, y] = *place;
            (0..count[0] * count[1]).map(move |k| [x + at(k)[0], y + at(k)[1]])
        };
        let samples_m: Vec<Point> = places_m.iter().flat_map(of_cell).collect();
        Ok(Self {
            springs,
            beside,
            cover: Cover { smoothing_m: SMOOTHING * sample_m },
            pressure_pa: vec![0.0; samples_m.len()],
            samples_m,
            per_cell: count[0] * count[1],
            sample_area_m2: step[0] * step[1],
            places_m,
        })
    }

    /// Positions of the elements, metres.
    pub fn places_m(&self) -> &[Point] {
        &self.places_m
    }

    /// The springs.
    pub fn springs(&self) -> &Springs {
        &self.springs
    }

    /// Forces of these indenters on each element, newtons: the load on its cell. Loads off all cells are lost.
    pub fn forces_n(&mut self, indenters: &[Indenter], forces_n: &mut [f64]) {
        self.pressure_pa.fill(0.0);
        for indenter in indenters {
            indenter.add_pressure(self.cover, &self.samples_m, &mut self.pressure_pa);
        }
        for (force, cell) in forces_n.iter_mut().zip(self.pressure_pa.chunks_exact(self.per_cell)) {
            *force = cell.iter().sum::<f64>() * self.sample_area_m2;
        }
    }

    /// Travel of each element under these forces, metres, by Gauss-Seidel sweeps.
    pub fn travel_m(&self, forces_n: &[f64], travel_m: &mut [f64]) {
        let Springs { stiffness_n_per_m: k, coupling_n_per_m: c, .. } = self.springs;
        travel_m.iter_mut().zip(forces_n).for_each(|(x, f)| *x = f / k);
        let scale = forces_n.iter().fold(0.0, |most: f64, f| most.max(*f)) / k;
        for _ in 0..200 {
            let mut moved: f64 = 0.0;
            for element in 0..travel_m.len() {
                let (mut beside, mut count) = (0.0, 0.0);
                for other in self.beside[element].iter().flatten() {
                    beside += travel_m[*other as usize];
                    count += 1.0;
                }
                let next = (forces_n[element] + c * beside) / (k + c * count);
                moved = moved.max((next - travel_m[element]).abs());
                travel_m[element] = next;
            }
            if moved <= SETTLED * scale {
                break;
            }
        }
        travel_m.iter_mut().for_each(|x| *x = self.springs.stiffened_m(*x));
    }
}

/// Neighbours of each element to the left, right, below and above.
fn neighbours(places_m: &[Point], cell_m: [f64; 2]) -> Result<Vec<[Option<u32>; 4]>, TwinError> {
    let mut beside = vec![[None; 4]; places_m.len()];
    for (element, place) in places_m.iter().enumerate() {
        for (other, there) in places_m.iter().enumerate().filter(|(other, _)| *other != element) {
            let cells = [0, 1].map(|axis| (there[axis] - place[axis]) / cell_m[axis]);
            if cells.iter().all(|away| away.abs() < 1.0 - OFF) {
                let expected = "elements at least one cell apart along x or y";
                return Err(TwinError::Place { what: "element", x_m: there[0], y_m: there[1], expected });
            }
            for (side, to) in [[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]].iter().enumerate() {
                if (0..2).all(|axis| (cells[axis] - to[axis]).abs() <= OFF) {
                    beside[element][side] = Some(other as u32);
                }
            }
        }
    }
    Ok(beside)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPONGE: Springs = Springs { stiffness_n_per_m: 400.0, limit_m: 0.01, sharpness: 2.0, coupling_n_per_m: 20.0 };

    /// `n` x `n` elements around the origin, row by row from the bottom left.
    fn square(springs: Springs, n: usize, pitch_m: f64) -> Result<SpringGrid, TwinError> {
        let at = |k: usize| (k as f64 - 0.5 * (n as f64 - 1.0)) * pitch_m;
        SpringGrid::new(springs, (0..n * n).map(|k| [at(k % n), at(k / n)]).collect(), [pitch_m; 2])
    }

    #[test]
    fn travel_rises_with_force_ever_less_and_stays_below_the_limit() {
        let travel: Vec<f64> = (0..400).map(|k| SPONGE.travel_m(0.1 * f64::from(k))).collect();
        assert!((SPONGE.travel_m(0.04) / 1e-4 - 1.0).abs() < 1e-4);
        for three in travel.windows(3) {
            assert!(three[1] > three[0] && three[2] - three[1] < three[1] - three[0] + 1e-15);
        }
        assert!(travel[399] < 0.01 && travel[399] > 0.0099);
        for force in [0.1, 2.0, 20.0] {
            assert!((SPONGE.force_n(SPONGE.travel_m(force)) / force - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn cells_carry_the_load_on_them() {
        let mut grid = square(SPONGE, 5, 0.02).unwrap();
        let mut forces = [0.0; 25];
        let press = |x, y| Indenter::disc([x, y], 0.004, 1.0 / (std::f64::consts::PI * 0.004 * 0.004));
        grid.forces_n(&[press(0.02, -0.04)], &mut forces);
        let total: f64 = forces.iter().sum();
        // Cut off at the edge of the skin at 10 mm, six millimetres or 2.4 deviations beyond the indenter; sampled at
        // the smoothing length.
        assert!((total - 1.0).abs() < 0.01 && forces[3] > 0.98, "{total} {forces:?}");
        // Between two elements, each carries half.
        grid.forces_n(&[press(0.01, 0.0)], &mut forces);
        assert!((forces[12] - forces[13]).abs() < 1e-9 && (forces[12] - 0.5).abs() < 0.01, "{forces:?}");
        // On the rim half of the force is lost, off the skin all of it.
        grid.forces_n(&[press(0.05, 0.0)], &mut forces);
        assert!((forces.iter().sum::<f64>() - 0.5).abs() < 0.01, "{forces:?}");
        grid.forces_n(&[press(0.08, 0.0)], &mut forces);
        assert_eq!(forces, [0.0; 25]);
    }

    #[test]
    fn neighbours_are_dragged_along_weakly_and_evenly() {
        let grid = square(SPONGE, 5, 0.02).unwrap();
        let (mut forces, mut travel) = ([0.0; 25], [0.0; 25]);
        forces[12] = 0.4;
        grid.travel_m(&forces, &mut travel);
        for k in [7, 11, 13, 17] {
            assert!((travel[k] - travel[7]).abs() < 1e-12);
            assert!(travel[k] > 0.02 * travel[12] && travel[k] < 0.06 * travel[12], "{travel:?}");
        }
        // In the linear grid the springs carry the whole force, since the coupling only transfers it.
        let carried: f64 = travel.iter().map(|x| SPONGE.force_n(*x)).sum();
        assert!((carried / 0.4 - 1.0).abs() < 1e-9, "{carried}");
    }

    #[test]
    fn bad_input_is_refused() {
        assert!(square(Springs { stiffness_n_per_m: 0.0, ..SPONGE }, 5, 0.02).is_err());
        assert!(square(Springs { coupling_n_per_m: 500.0, ..SPONGE }, 5, 0.02).is_err());
        assert!(square(Springs { sharpness: 0.5, ..SPONGE }, 5, 0.02).is_err());
        assert!(square(SPONGE, 0, 0.02).is_err() && square(SPONGE, 5, -1.0).is_err());
    }

    #[test]
    fn a_list_in_any_order_finds_its_neighbours() {
        let cell_m = [0.01, 0.02];
        // Three elements in an L, with the corner last and half a millimetre off, and one isolated element.
        let places = vec![[0.01, 0.0], [0.0, 0.02], [0.05, 0.05], [0.0005, 0.0]];
        let grid = SpringGrid::new(SPONGE, places, cell_m).unwrap();
        assert_eq!(grid.beside[3], [None, Some(0), None, Some(1)]);
        assert_eq!((grid.beside[0], grid.beside[1]), ([Some(3), None, None, None], [None, None, Some(3), None]));
        assert_eq!(grid.beside[2], [None; 4]);
        let error = SpringGrid::new(SPONGE, vec![[0.0; 2], [0.004, 0.01]], cell_m).unwrap_err().to_string();
        assert!(error.starts_with("element at (0.004, 0.01) m refused"), "{error}");
        assert!(SpringGrid::new(SPONGE, vec![[f64::NAN, 0.0]], cell_m).is_err());
        assert!(SpringGrid::new(SPONGE, vec![[0.0; 2]], [0.01, 0.0]).is_err());
    }

    #[test]
    fn small_and_oblong_cells_carry_the_load_on_them() {
        for cell_m in [[2e-3, 2e-3], [4e-3, 1e-3], [0.02, 0.03]] {
            let at = |k: usize, n: usize, pitch: f64| (k as f64 - 0.5 * (n as f64 - 1.0)) * pitch;
            let places = (0..54).map(|k| [at(k % 9, 9, cell_m[0]), at(k / 9, 6, cell_m[1])]).collect();
            let mut grid = SpringGrid::new(SPONGE, places, cell_m).unwrap();
            let mut forces = [0.0; 54];
            let radius_m = 1.2 * cell_m[1];
            let area_m2 = std::f64::consts::PI * radius_m * radius_m;
            grid.forces_n(&[Indenter::disc([0.0; 2], radius_m, 1.0 / area_m2)], &mut forces);
            let total: f64 = forces.iter().sum();
            assert!((total - 1.0).abs() < 0.01, "{cell_m:?}: {total}");
        }
    }
}
