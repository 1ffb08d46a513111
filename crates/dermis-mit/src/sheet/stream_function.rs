//! The system of a sheet's stream function at one frequency: assembly, factorisation and the resulting changes. The
//! equations are in the module above.

use std::f64::consts::TAU;

use faer::Mat;
use faer::linalg::solvers::PartialPivLu;
use faer::prelude::Solve;
use rayon::prelude::*;

use super::mesh::SheetMesh;
use super::triangle::{Panel, THREE_POINTS, place};
use crate::constants::MU0;
use crate::edge::Source;
use crate::error::{MitError, positive};
use crate::sphere::skin_depth_m;
use crate::vector::{Complex, Vector, cross, dot, norm, scaled, subtract};

/// Ratio of thickness to width above which a sheet is not thin.
const THIN: f64 = 0.2;

/// Material of a sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetMaterial {
    /// Thickness, metres.
    pub thickness_m: f64,
    /// Conductivity, S/m.
    pub conductivity_s_per_m: f64,
}

impl SheetMaterial {
    /// `k t / 2` with `k = (1 + j)/delta`.
    fn half_depths(&self, frequency_hz: f64) -> Result<Complex, MitError> {
        positive("thickness_m", self.thickness_m)?;
        let depth = skin_depth_m(self.conductivity_s_per_m, 1.0, frequency_hz)?;
        Ok(Complex::new(1.0, 1.0) * (0.5 * self.thickness_m / depth))
    }

    /// Surface impedance Z, ohms: the tangential field at the faces divided by the current through the whole
    /// thickness.
    ///
    /// # Errors
    /// A thickness or conductivity that is not positive, or a frequency outside 1 Hz to 1 MHz.
    pub fn impedance_ohm(&self, frequency_hz: f64) -> Result<Complex, MitError> {
        let x = self.half_depths(frequency_hz)?;
        Ok(x / tanh(x) / (self.conductivity_s_per_m * self.thickness_m))
    }

    /// Share of the thickness from which a tangential field is excluded.
    fn excluded(&self, frequency_hz: f64) -> Result<Complex, MitError> {
        let x = self.half_depths(frequency_hz)?;
        // The difference loses digits for small x, so use x^2/3 - 2 x^4/15.
        Ok(if x.norm() < 1e-2 { x * x / 3.0 - x * x * x * x * (2.0 / 15.0) } else { -tanh(x) / x + 1.0 })
    }
}

/// Hyperbolic tangent for arguments in the first octant.
fn tanh(x: Complex) -> Complex {
    let decay = Complex::new((2.0 * x.im).cos(), -(2.0 * x.im).sin()) * (-2.0 * x.re).exp();
    if x.norm() < 1e-4 { x } else { (-decay + 1.0) / (decay + 1.0) }
}

/// A quadrature point on a sheet.
#[derive(Clone, Copy, Debug)]
struct Spot {
    place_m: Vector,
    normal: Vector,
    /// Area represented by the point.
    area: f64,
    unknowns: [Option<u32>; 3],
}

/// Sheets at one frequency, assembled and factored.
#[derive(Debug)]
pub struct Sheet {
    spots: Vec<Spot>,
    unknowns: usize,
    pub(super) angular_frequency: f64,
    /// `mu0 t (1 - tanh(k t/2)/(k t/2))`, H.
    pub(super) odd: Complex,
    pub(super) factor: PartialPivLu<Complex>,
}

impl Sheet {
    /// Assembles all pieces of one mesh, with the same material; they excite each other. Needs 16 bytes for each pair
    /// of vertices that are not on rims, and twice as much during the computation. The time grows with their square
    /// (assembly) and cube (factorisation).
    ///
    /// # Errors
    /// A thickness or conductivity that is not positive, a frequency outside 1 Hz to 1 MHz, a sheet thicker than a
    /// fifth of its width, or a mesh with no vertices off its rims.
    pub fn new(mesh: &SheetMesh, material: &SheetMaterial, frequency_hz: f64) -> Result<Self, MitError> {
        let (impedance, excluded) = (material.impedance_ohm(frequency_hz)?, material.excluded(frequency_hz)?);
        let share = material.thickness_m / mesh.width_m();
        if share > THIN {
            return Err(MitError::Value {
                field: "thickness over width of a sheet",
                value: share,
                expected: "0.2 or less",
            });
        }
        let (numbers, count) = mesh.unknowns();
        positive("vertices off the rims", count as f64)?;
        let w = TAU * frequency_hz;
        let (resistance, inductance) = assemble(mesh, &numbers, count, 0.5 * material.thickness_m);
        let system = Mat::from_fn(count, count, |i, j| {
            let mutual = 0.5 * (inductance[(i, j)] + inductance[(j, i)]);
            impedance * resistance[(i, j)] + Complex::new(0.0, w * mutual)
        });
        // Complex symmetric, not Hermitian: only a factorisation for general matrices is correct.
        let factor = system.partial_piv_lu();
        let odd = excluded * (MU0 * material.thickness_m);
        Ok(Self { spots: spots(mesh, &numbers), unknowns: count, angular_frequency: w, odd, factor })
    }

    /// Number of unknowns: vertices that are not on rims.
    pub fn unknown_count(&self) -> usize {
        self.unknowns
    }

    /// Changes of mutual inductance between any two sources, henries, row by row.
    pub fn changes_h(&self, sources: &[&dyn Source]) -> Vec<Complex> {
        let at_spots = |source: &&dyn Source| -> Vec<Vector> {
            self.spots.par_iter().map(|spot| source.flux_density(spot.place_m)).collect()
        };
        let fields: Vec<Vec<Vector>> = sources.iter().map(at_spots).collect();
        let fluxes: Vec<Vec<f64>> = fields.iter().map(|field| self.fluxes(field)).collect();
        let w = self.angular_frequency;
        let sides = Mat::from_fn(self.unknowns, sources.len(), |i, n| Complex::new(0.0, -w * fluxes[n][i]));
        let streams = self.factor.solve(&sides);
        let change = |m: usize, n: usize| {
            let even: Complex = (0..self.unknowns).map(|i| streams[(i, n)] * fluxes[m][i]).sum();
            even - self.odd * self.tangential(&fields[m], &fields[n])
        };
        (0..sources.len() * sources.len()).map(|k| change(k / sources.len(), k % sources.len())).collect()
    }

    /// b: flux of a field, weighted by the hat functions.
    fn fluxes(&self, field: &[Vector]) -> Vec<f64> {
        let mut fluxes = vec![0.0; self.unknowns];
        for (k, (spot, b)) in self.spots.iter().zip(field).enumerate() {
            let through = spot.area * dot(*b, spot.normal);
            for (number, share) in spot.unknowns.iter().zip(THREE_POINTS[k % 3]) {
                if let Some(number) = number {
                    fluxes[*number as usize] += share * through;
                }
            }
        }
        fluxes
    }

    /// `int H_m.H_n dS` over the tangential fields.
    fn tangential(&self, first: &[Vector], second: &[Vector]) -> f64 {
        let product = |(spot, (a, b)): (&Spot, (&Vector, &Vector))| {
            spot.area * (dot(*a, *b) - dot(*a, spot.normal) * dot(*b, spot.normal))
        };
        self.spots.iter().zip(first.iter().zip(second)).map(product).sum::<f64>() / (MU0 * MU0)
    }
}

fn spots(mesh: &SheetMesh, numbers: &[Option<u32>]) -> Vec<Spot> {
    let of_triangle = |t: usize| {
        let corners = mesh.corners(t);
        let [a, b, c] = corners;
        let normal = cross(subtract(b, a), subtract(c, a));
        let twice = norm(normal);
        let unknowns = mesh.triangles[t].map(|v| numbers[v as usize]);
        let spot = move |l: [f64; 3]| Spot {
            place_m: place(corners, l),
            normal: scaled(normal, 1.0 / twice),
            area: twice / 6.0,
            unknowns,
        };
        THREE_POINTS.map(spot)
    };
    (0..mesh.triangle_count()).flat_map(of_triangle).collect()
}

/// R and L; L is not made exactly symmetric yet.
fn assemble(mesh: &SheetMesh, numbers: &[Option<u32>], count: usize, blur: f64) -> (Mat<f64>, Mat<f64>) {
    let panels: Vec<Panel> = (0..mesh.triangle_count()).map(|t| Panel::new(mesh.corners(t))).collect();
    // K of each corner's hat function points along the opposite side.
    let currents: Vec<[Vector; 3]> = panels
        .iter()
        .map(|panel| {
            let [a, b, c] = panel.corners;
            [[b, c], [c, a], [a, b]].map(|[from, to]| scaled(subtract(to, from), 0.5 / panel.area))
        })
        .collect();
    let unknown = |t: usize, corner: usize| numbers[mesh.triangles[t][corner] as usize].map(|n| n as usize);
    let (mut resistance, mut inductance) = (Mat::zeros(count, count), Mat::zeros(count, count));
    // Potentials of all unknowns' currents in one triangle, row by row.
    let row = |t: usize| -> Vec<Vector> {
        let mut row = vec![[0.0; 3]; count];
        for (s, other) in panels.iter().enumerate() {
            let product = 1e-7 * panels[t].product(other, blur);
            for corner in 0..3 {
                if let Some(j) = unknown(s, corner) {
                    (0..3).for_each(|k| row[j][k] += product * currents[s][corner][k]);
                }
            }
        }
        row
    };
    for block in (0..panels.len()).collect::<Vec<_>>().chunks(256) {
        let rows: Vec<Vec<Vector>> = block.par_iter().map(|&t| row(t)).collect();
        for (&t, row) in block.iter().zip(&rows) {
            for (corner, current) in currents[t].iter().enumerate() {
                let Some(i) = unknown(t, corner) else { continue };
                row.iter().enumerate().for_each(|(j, potential)| inductance[(i, j)] += dot(*current, *potential));
                for other in 0..3 {
                    if let Some(j) = unknown(t, other) {
                        resistance[(i, j)] += panels[t].area * dot(*current, currents[t][other]);
                    }
                }
            }
        }
    }
    (resistance, inductance)
}
