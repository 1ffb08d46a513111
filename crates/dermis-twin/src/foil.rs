//! A thin metal foil on sponge over coils; a touch deforms it less locally than it moves separate elements. Eddy
//! currents are those of a thin sheet ([`dermis_mit::sheet`]) with a dent. Its deflection w solves
//! `T lap w - k w = -p` for a foil under tension T on sponge of stiffness k, with free rims; the sponge stiffens like
//! the springs do. Each new dent is a new sheet to solve: half a second, so this is for experiments rather than live
//! twins.

use dermis_mit::edge::Source;
use dermis_mit::sheet::{Sheet, SheetMaterial, SheetMesh};
use dermis_mit::{CoilArray, Complex};
use dermis_tomo::mesh::{Outline, Point};

use crate::error::{TwinError, check, check_positive};
use crate::mechanics::{Cover, Indenter};
use crate::twin::Frontend;

/// Smoothing of the pressure, of the order of the vertex spacing.
const COVER: Cover = Cover { smoothing_m: 4e-3 };
/// Over-relaxation factor for the dent's equation.
const RELAXATION: f64 = 1.7;
/// The dent has converged if no vertex changes by more than this, metres.
const SETTLED_M: f64 = 1e-10;
/// Maximum number of sweeps.
const MOST_SWEEPS: usize = 20_000;

/// Description of a foil over coils. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct FoilOptions {
    /// The coils.
    pub coils: CoilArray,
    /// Side of the square foil, metres.
    pub side_m: f64,
    /// Number of cells along a side, two triangles each.
    pub cells: usize,
    /// Thickness and conductivity.
    pub material: SheetMaterial,
    /// Height above the coils at rest, metres.
    pub rest_m: f64,
    /// T: tension, newtons per metre.
    pub tension_n_per_m: f64,
    /// k: pressure of the sponge per metre of deflection.
    pub stiffness_pa_per_m: f64,
    /// Maximum deflection under any pressure, metres.
    pub limit_m: f64,
    /// Current amplitude in the driven coil, amperes.
    pub current_a: f64,
    /// Drive frequency.
    pub frequency_hz: f64,
}

impl FoilOptions {
    fn check(&self) -> Result<(), TwinError> {
        check_positive("side_m", self.side_m)?;
        check("cells", self.cells as f64, 4.0, 64.0, "4 to 64")?;
        check("rest_m", self.rest_m, self.limit_m + 1e-4, 1.0, "above the limit of the way")?;
        check_positive("tension_n_per_m", self.tension_n_per_m)?;
        check_positive("stiffness_pa_per_m", self.stiffness_pa_per_m)?;
        check_positive("limit_m", self.limit_m)?;
        check_positive("current_a", self.current_a)
    }
}

/// The foil; see the module.
#[derive(Clone, Debug)]
pub struct FoilSkin {
    options: FoilOptions,
    mutuals_h: Vec<f64>,
    flat: SheetMesh,
    /// Vertices of the dent's grid, row by row.
    places_m: Vec<Point>,
    pressure_pa: Vec<f64>,
    /// Deflection of each vertex, metres.
    way_m: Vec<f64>,
    solved_m: Vec<f64>,
    changes_h: Vec<Complex>,
}

impl FoilSkin {
    /// A foil at rest.
    ///
    /// # Errors
    /// Invalid parameters.
    pub fn new(options: FoilOptions) -> Result<Self, TwinError> {
        options.check()?;
        let nodes = options.cells + 1;
        let step = options.side_m / options.cells as f64;
        let at = |k: usize| k as f64 * step - 0.5 * options.side_m;
        let places_m: Vec<Point> = (0..nodes * nodes).map(|k| [at(k % nodes), at(k / nodes)]).collect();
        Ok(Self {
            flat: SheetMesh::rectangle([options.side_m; 2], [options.cells; 2])?,
            mutuals_h: options.coils.mutuals_h(),
            pressure_pa: vec![0.0; places_m.len()],
            way_m: vec![0.0; places_m.len()],
            solved_m: Vec::new(),
            changes_h: Vec::new(),
            places_m,
            options,
        })
    }

    /// Deflection of the foil at the nearest vertex after the last frame, metres.
    pub fn way_m(&self, place_m: Point) -> f64 {
        self.way_m[self.nearest(place_m)]
    }

    fn nearest(&self, place_m: Point) -> usize {
        let (cells, step) = (self.options.cells, self.options.side_m / self.options.cells as f64);
        let index = |x: f64| (((x + 0.5 * self.options.side_m) / step).round().max(0.0) as usize).min(cells);
        index(place_m[1]) * (cells + 1) + index(place_m[0])
    }

    /// Solves `T lap w - k w = -p` by successive over-relaxation, then applies the stiffening of the sponge.
    fn dent(&mut self) {
        let (nodes, step) = (self.options.cells + 1, self.options.side_m / self.options.cells as f64);
        let tension = self.options.tension_n_per_m / (step * step);
        let mut way = vec![0.0; self.way_m.len()];
        for _ in 0..MOST_SWEEPS {
            let mut moved: f64 = 0.0;
            for k in 0..way.len() {
                let (column, row) = (k % nodes, k / nodes);
                // A free rim mirrors the interior.
                let beside = |inside: bool, at: usize, mirror: usize| if inside { at } else { mirror };
                let around = way[beside(column > 0, k.wrapping_sub(1), k + 1)]
                    + way[beside(column + 1 < nodes, k + 1, k.wrapping_sub(1))]
                    + way[beside(row > 0, k.wrapping_sub(nodes), k + nodes)]
                    + way[beside(row + 1 < nodes, k + nodes, k.wrapping_sub(nodes))];
                let settled =
                    (self.pressure_pa[k] + tension * around) / (4.0 * tension + self.options.stiffness_pa_per_m);
                let change = RELAXATION * (settled - way[k]);
                way[k] += change;
                moved = moved.max(change.abs());
            }
            if moved < SETTLED_M {
                break;
            }
        }
        let limit = self.options.limit_m;
        self.way_m.clear();
        self.way_m.extend(way.iter().map(|w| w.max(0.0) / (1.0 + (w / limit).powi(2)).sqrt()));
    }

    fn solve(&mut self) -> Result<(), TwinError> {
        let mesh = self.flat.clone().with_heights(|place| self.options.rest_m - self.way_m(place))?;
        let sheet = Sheet::new(&mesh, &self.options.material, self.options.frequency_hz)?;
        let sources: Vec<&dyn Source> = self.options.coils.coils().iter().map(|coil| coil as &dyn Source).collect();
        let (count, all) = (sources.len(), sheet.changes_h(&sources));
        self.changes_h.clear();
        self.changes_h.extend((0..count).flat_map(|m| (m + 1..count).map(move |n| m * count + n)).map(|at| all[at]));
        self.solved_m.clone_from(&self.way_m);
        Ok(())
    }
}

impl Frontend for FoilSkin {
    fn channel_count(&self) -> usize {
        self.mutuals_h.len()
    }

    fn extent(&self) -> Outline {
        Outline::Rectangle { width_m: self.options.side_m, height_m: self.options.side_m }
    }

    fn voltages(&mut self, indenters: &[Indenter], _dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        self.pressure_pa.fill(0.0);
        for indenter in indenters {
            indenter.add_pressure(COVER, &self.places_m, &mut self.pressure_pa);
        }
        self.dent();
        if self.solved_m != self.way_m {
            self.solve()?;
        }
        let volts_per_h = std::f64::consts::TAU * self.options.frequency_hz * self.options.current_a;
        for ((voltage, mutual), change) in voltages_v.iter_mut().zip(&self.mutuals_h).zip(&self.changes_h) {
            *voltage = volts_per_h * (*change + *mutual).norm();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use dermis_mit::Coil;

    use super::*;
    use crate::mechanics::{Load, Shape};

    #[test]
    fn a_dent_carries_the_force_and_spreads_over_the_root_of_tension_over_stiffness() {
        // An unreachable limit keeps the equation linear; the height must be above it.
        let options = FoilOptions {
            coils: CoilArray::of_coils(
                [0.0, 0.5].map(|x| Coil::solenoid([x, 0.0, 0.0], 0.034, 0.0005, 6, 6).unwrap()).to_vec(),
            )
            .unwrap(),
            side_m: 0.14,
            cells: 24,
            material: SheetMaterial { thickness_m: 35e-6, conductivity_s_per_m: 5.8e7 },
            rest_m: 1.0,
            tension_n_per_m: 300.0,
            stiffness_pa_per_m: 1e6,
            limit_m: 0.9,
            current_a: 0.1,
            frequency_hz: 55e3,
        };
        let mut foil = FoilSkin::new(options.clone()).unwrap();
        let press = Indenter { centre_m: [0.0; 2], shape: Shape::Disc { radius_m: 0.01 }, load: Load::ForceN(0.2) };
        press.add_pressure(COVER, &foil.places_m, &mut foil.pressure_pa);
        foil.dent();
        let cell = (options.side_m / options.cells as f64).powi(2);
        // Free rims carry nothing, so the sponge carries everything: k times the volume of the dent is its force.
        let nodes = options.cells + 1;
        let share = |k: usize| {
            let half = |at: usize| if at == 0 || at + 1 == nodes { 0.5 } else { 1.0 };
            half(k % nodes) * half(k / nodes)
        };
        let sum = |values: &[f64]| values.iter().enumerate().map(|(k, v)| share(k) * v * cell).sum::<f64>();
        let (carried, pressed) = (options.stiffness_pa_per_m * sum(&foil.way_m), sum(&foil.pressure_pa));
        assert!((carried / pressed - 1.0).abs() < 1e-3, "{carried} {pressed}");
        // Far from the press w decays as K0(r/l) with l = 17.3 mm: from 30 to 45 mm by 0.348
        // (K0(2.598)/K0(1.732) = 0.0553/0.1588).
        let step = options.side_m / options.cells as f64;
        let fall = foil.way_m([6.0 * step, 0.0]) / foil.way_m([4.0 * step, 0.0]);
        let k0 = |x: f64| (std::f64::consts::FRAC_PI_2 / x).sqrt() * (-x).exp() * (1.0 - 0.125 / x + 0.0703 / (x * x));
        let length = (options.tension_n_per_m / options.stiffness_pa_per_m).sqrt();
        let expected = k0(6.0 * step / length) / k0(4.0 * step / length);
        // Errors of the 5.8 mm grid and of the rim at 70 mm.
        assert!((fall / expected - 1.0).abs() < 0.05, "{fall} {expected}");
    }
}
