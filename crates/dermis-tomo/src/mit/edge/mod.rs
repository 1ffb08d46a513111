//! Eddy currents by edge elements on tetrahedra: the reference that multipole bodies are made from and checked against.
//!
//! The potential is split, `A = As + Ar`, with `As` that of the coils alone, in closed form; only `Ar` is discretised:
//! `curl nu curl Ar + j w sigma Ar = -j w sigma As - curl (nu - nu0) curl As`, `n x Ar = 0` on the outer border. No coil is in
//! the mesh. In air the equation is made regular by a mass of 1e-2 nu0 per square metre. The change of the mutual inductance
//! of two sources of 1 A is `dM_mn = -j w int sigma As_m . (As_n + Ar_n) - int (nu - nu0) Bs_m . curl(As_n + Ar_n)`.

mod mesh;
mod space;
mod system;

pub use mesh::{EdgeMesh, Fineness};

use faer::Mat;
use rayon::prelude::*;

use self::space::{LOCAL, Shape, Space, quadrature};
use self::system::{Gather, System};
use super::error::{frequency, positive};
use super::harmonics::{DEGREES, HARMONICS, regular_gradients};
use super::{Body, Complex, MU0, MitError, Vector, cross, dot, norm, scaled, skin_depth_m};

/// Mass of air relative to `nu0`, per square metre.
const AIR: f64 = 1e-2;

/// What a body is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Conductivity, S/m.
    pub conductivity_s_per_m: f64,
    /// Relative permeability.
    pub relative_permeability: f64,
}

/// Order of the elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// First everywhere.
    First,
    /// Second in the body and in air nearer to the origin than this many times the body's radius, first beyond. 2 serves
    /// small bodies; 0 is the body alone.
    SecondWithin(f64),
}

/// A source: vector potential and flux density per ampere at a point.
pub type Source<'a> = dyn Fn(Vector) -> (Vector, Vector) + Sync + 'a;

/// A body in air at one frequency, factored.
#[derive(Debug)]
pub struct EdgeModel {
    mesh: EdgeMesh,
    space: Space,
    system: System,
    material: Material,
    omega: f64,
}

/// Changes of mutual inductance between all sources, and what they cost.
#[derive(Clone, Debug)]
pub struct Responses {
    /// Row by row, henries per square ampere.
    pub changes_h: Vec<Complex>,
    /// Steps of the solver.
    pub steps: usize,
}

impl EdgeModel {
    /// Assembles and factors.
    ///
    /// # Errors
    /// A frequency outside 1 Hz to 1 MHz, a conductivity of zero or below, a permeability below 1, a mesh without body.
    pub fn new(mesh: EdgeMesh, material: Material, frequency_hz: f64, order: Order) -> Result<Self, MitError> {
        frequency(frequency_hz)?;
        positive("conductivity_s_per_m", material.conductivity_s_per_m)?;
        let permeability = material.relative_permeability;
        if !(permeability >= 1.0 && permeability.is_finite()) {
            return Err(MitError::Value { field: "relative_permeability", value: permeability, expected: "1 or more" });
        }
        if !mesh.is_body.contains(&true) {
            return Err(MitError::Count { what: "tetrahedra of the body", expected: 1, got: 0 });
        }
        let omega = 2.0 * std::f64::consts::PI * frequency_hz;
        let reach = match order {
            Order::First => None,
            Order::SecondWithin(times) => Some(times * mesh.body_radius_m),
        };
        let high: Vec<bool> = (0..mesh.tetrahedra.len())
            .map(|t| {
                let centre = Shape::new(mesh.corners(t)).at(&[0.25; 4]);
                reach.is_some_and(|reach| mesh.is_body[t] || norm(centre) < reach)
            })
            .collect();
        let space = Space::new(&mesh, &high);
        let gather = assemble(&mesh, &space, material, omega);
        let named = |error: crate::sparse::SparseError| MitError::Factor { reason: error.to_string() };
        let system = System::new(&space.places, gather).map_err(named)?;
        Ok(Self { mesh, space, system, material, omega })
    }

    /// Unknowns.
    pub fn unknowns(&self) -> usize {
        self.system.size()
    }

    /// The mesh.
    pub fn mesh(&self) -> &EdgeMesh {
        &self.mesh
    }

    /// Memory of the factor, bytes.
    pub fn factor_bytes(&self) -> usize {
        self.system.factor_bytes()
    }

    /// Thickness of the body's outermost tetrahedra relative to the skin depth: above about 1 (second order) or 0.5 (first
    /// order) the mesh is too coarse for the frequency. The thickness is three volumes over the largest face.
    pub fn surface_over_skin_depth(&self) -> f64 {
        let frequency_hz = self.omega / (2.0 * std::f64::consts::PI);
        let Material { conductivity_s_per_m, relative_permeability } = self.material;
        let depth = skin_depth_m(conductivity_s_per_m, relative_permeability, frequency_hz).unwrap_or(f64::NAN);
        let thickness = |t: usize| {
            let corners = self.mesh.corners(t);
            let area = |a: usize, b: usize, c: usize| {
                let (p, q) = (super::subtract(corners[b], corners[a]), super::subtract(corners[c], corners[a]));
                0.5 * norm(cross(p, q))
            };
            let largest = area(0, 1, 2).max(area(0, 1, 3)).max(area(0, 2, 3)).max(area(1, 2, 3));
            3.0 * Shape::new(corners).volume_m3 / largest
        };
        let body = (0..self.mesh.tetrahedra.len()).filter(|&t| self.mesh.is_body[t]);
        body.map(thickness).fold(f64::INFINITY, f64::min) / depth
    }

    /// Changes of mutual inductance between all pairs of sources.
    ///
    /// # Errors
    /// A solution that does not converge.
    pub fn responses(&self, sources: &[&Source<'_>]) -> Result<Responses, MitError> {
        let (loads, direct) = self.loads(sources);
        let (fields, steps) = self.system.solve(&loads)?;
        let count = sources.len();
        let mut changes_h = vec![Complex::new(0.0, 0.0); count * count];
        for m in 0..count {
            for n in 0..count {
                let (fr, fi) = (loads.col(2 * m), loads.col(2 * m + 1));
                let (ur, ui) = (fields.col(2 * n), fields.col(2 * n + 1));
                let (re, im) = (fr.transpose() * ur - fi.transpose() * ui, fr.transpose() * ui + fi.transpose() * ur);
                changes_h[m * count + n] = direct[m * count + n] + Complex::new(re, im) * (1.0 / MU0);
            }
        }
        Ok(Responses { changes_h, steps })
    }

    /// The body as a multipole body about the origin: its answers to the 15 regular harmonics up to degree 3.
    ///
    /// # Errors
    /// As [`EdgeModel::responses`].
    pub fn body(&self, label: impl Into<String>) -> Result<Body, MitError> {
        let harmonic = |i: usize| {
            move |p: Vector| {
                let gradient = regular_gradients(p)[i];
                // A = mu0/(l + 1) r x grad h, whose curl is -mu0 grad h.
                (scaled(cross(p, gradient), MU0 / (DEGREES[i] as f64 + 1.0)), scaled(gradient, -MU0))
            }
        };
        let sources: Vec<_> = (0..HARMONICS).map(harmonic).collect();
        let references: Vec<&Source<'_>> = sources.iter().map(|source| source as &Source<'_>).collect();
        let mut tau = self.responses(&references)?.changes_h;
        for i in 0..HARMONICS {
            for j in 0..i {
                let mean = (tau[i * HARMONICS + j] + tau[j * HARMONICS + i]) * 0.5;
                (tau[i * HARMONICS + j], tau[j * HARMONICS + i]) = (mean, mean);
            }
        }
        Body::from_tau(label, self.mesh.body_radius_m, tau)
    }

    /// Induced current density (A/m^2, per ampere of the source) at quadrature points of the body: place, volume, value. From it
    /// the field anywhere outside follows by Biot and Savart.
    ///
    /// # Errors
    /// As [`EdgeModel::responses`].
    pub fn currents(&self, source: &Source<'_>) -> Result<Vec<(Vector, f64, [Complex; 3])>, MitError> {
        let (loads, _) = self.loads(&[source]);
        let (field, _) = self.system.solve(&loads)?;
        let factor = Complex::new(0.0, -self.omega * self.material.conductivity_s_per_m);
        let body: Vec<usize> = (0..self.mesh.tetrahedra.len()).filter(|&t| self.mesh.is_body[t]).collect();
        let of_tetrahedron = |&t: &usize| {
            let shape = Shape::new(self.mesh.corners(t));
            quadrature().map(|(l, weight)| {
                let (values, _) = shape.functions(&l);
                let place = shape.at(&l);
                let mut a = source(place).0.map(|v| Complex::new(v, 0.0));
                for (value, unknown) in values.iter().zip(&self.space.unknowns[t]) {
                    if let Some(unknown) = unknown {
                        let row = *unknown as usize;
                        let u = Complex::new(field[(row, 0)], field[(row, 1)]);
                        (0..3).for_each(|axis| a[axis] += u * value[axis]);
                    }
                }
                (place, weight * shape.volume_m3, a.map(|a| factor * a))
            })
        };
        Ok(body.par_iter().flat_map_iter(of_tetrahedron).collect())
    }

    /// Right-hand sides times mu0 (columns real and imaginary), and what sources make of each other without `Ar`.
    fn loads(&self, sources: &[&Source<'_>]) -> (Mat<f64>, Vec<Complex>) {
        let count = sources.len();
        let body: Vec<usize> = (0..self.mesh.tetrahedra.len()).filter(|&t| self.mesh.is_body[t]).collect();
        let eddy = self.omega * self.material.conductivity_s_per_m;
        let magnetic = (1.0 / self.material.relative_permeability - 1.0) / MU0;
        /// Loads on the functions of a tetrahedron, real and imaginary, and products of the sources.
        struct Local {
            tetrahedron: usize,
            loads: Vec<[f64; 2]>,
            direct: Vec<Complex>,
        }
        let of_tetrahedron = |&t: &usize| {
            let shape = Shape::new(self.mesh.corners(t));
            let zero = Complex::new(0.0, 0.0);
            let mut local =
                Local { tetrahedron: t, loads: vec![[0.0; 2]; LOCAL * count], direct: vec![zero; count * count] };
            for (l, weight) in quadrature() {
                let (place, volume) = (shape.at(&l), weight * shape.volume_m3);
                let (values, curls) = shape.functions(&l);
                let fields: Vec<(Vector, Vector)> = sources.iter().map(|source| source(place)).collect();
                for (m, (a, b)) in fields.iter().enumerate() {
                    for k in 0..LOCAL {
                        local.loads[k * count + m][0] -= volume * magnetic * MU0 * dot(*b, curls[k]);
                        local.loads[k * count + m][1] -= volume * eddy * MU0 * dot(*a, values[k]);
                    }
                    for (n, (a2, b2)) in fields.iter().enumerate() {
                        local.direct[m * count + n] -=
                            Complex::new(volume * magnetic * dot(*b, *b2), volume * eddy * dot(*a, *a2));
                    }
                }
            }
            local
        };
        let locals: Vec<Local> = body.par_iter().map(of_tetrahedron).collect();
        let mut loads = Mat::zeros(self.system.size(), 2 * count);
        let mut direct = vec![Complex::new(0.0, 0.0); count * count];
        for local in locals {
            for (k, unknown) in self.space.unknowns[local.tetrahedron].iter().enumerate() {
                if let Some(unknown) = unknown {
                    for m in 0..count {
                        let [re, im] = local.loads[k * count + m];
                        loads[(*unknown as usize, 2 * m)] += re;
                        loads[(*unknown as usize, 2 * m + 1)] += im;
                    }
                }
            }
            direct.iter_mut().zip(local.direct).for_each(|(sum, value)| *sum += value);
        }
        (loads, direct)
    }
}

/// `curl curl` and masses, times mu0, of all tetrahedra.
fn assemble(mesh: &EdgeMesh, space: &Space, material: Material, omega: f64) -> Gather {
    let of_tetrahedron = |t: usize| {
        let shape = Shape::new(mesh.corners(t));
        let (mut stiffness, mut mass) = ([[0.0; LOCAL]; LOCAL], [[0.0; LOCAL]; LOCAL]);
        for (l, weight) in quadrature() {
            let (values, curls) = shape.functions(&l);
            let volume = weight * shape.volume_m3;
            for a in 0..LOCAL {
                for b in 0..=a {
                    stiffness[a][b] += volume * dot(curls[a], curls[b]);
                    mass[a][b] += volume * dot(values[a], values[b]);
                }
            }
        }
        let (reluctivity, loss, air) = if mesh.is_body[t] {
            (1.0 / material.relative_permeability, omega * MU0 * material.conductivity_s_per_m, 0.0)
        } else {
            (1.0, 0.0, AIR)
        };
        let mut local = Gather::default();
        for a in 0..LOCAL {
            for b in 0..=a {
                if let (Some(row), Some(column)) = (space.unknowns[t][a], space.unknowns[t][b]) {
                    local.positions.push((row.max(column), row.min(column)));
                    local.real.push(reluctivity * stiffness[a][b] + air * mass[a][b]);
                    local.imaginary.push(loss * mass[a][b]);
                }
            }
        }
        local
    };
    let locals: Vec<Gather> = (0..mesh.tetrahedra.len()).into_par_iter().map(of_tetrahedron).collect();
    let mut all = Gather::default();
    for local in locals {
        all.positions.extend(local.positions);
        all.real.extend(local.real);
        all.imaginary.extend(local.imaginary);
    }
    all
}
