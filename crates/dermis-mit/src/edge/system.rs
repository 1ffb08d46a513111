//! The finite-element system for one mesh, its materials and one frequency: unknowns, assembly, factorisation and
//! solutions.

use std::f64::consts::TAU;
use std::fmt;

use rayon::prelude::*;

use super::cocg::Preconditioned;
use super::elements::{FUNCTIONS, Point, WHITNEY, quadrature};
use super::gauge::Gauge;
use super::mesh::{EdgeMesh, OUTER};
use super::source::{Samples, Source};
use crate::constants::MU0;
use crate::error::{MitError, frequency, positive};
use crate::sphere::skin_depth_m;
use crate::vector::{Complex, Vector, dot, scaled};
use dermis_tomo::sparse::{Ordering, SpdStructure};

/// Regularisation that makes the potential in air unique, per square metre.
const REGULARISATION: f64 = 1e-2;
/// Marks an unknown that is fixed to zero or left out.
const NONE: u32 = u32::MAX;

/// Material of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Conductivity, S/m.
    pub conductivity_s_per_m: f64,
    /// Relative permeability, 1 or more.
    pub relative_permeability: f64,
}

impl Material {
    fn check(&self) -> Result<(), MitError> {
        positive("conductivity_s_per_m", self.conductivity_s_per_m)?;
        let mu = self.relative_permeability;
        if mu >= 1.0 && mu.is_finite() {
            return Ok(());
        }
        Err(MitError::Value { field: "relative_permeability", value: mu, expected: "1 or more, finite" })
    }
}

/// Order of the elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// 6 functions per element: constant tangential components along edges.
    First,
    /// 20 functions per element: all linear fields and the corresponding curls.
    Second,
}

/// Warning: elements at a body's surface are too thick for its skin depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoarseMesh {
    /// Number of the material, from 1.
    pub region: usize,
    /// Thickness of the thickest surface element, metres.
    pub height_m: f64,
    /// Skin depth, metres.
    pub skin_depth_m: f64,
    /// Maximum thickness of an element of this order, in skin depths.
    pub most: f64,
}

impl fmt::Display for CoarseMesh {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (height, depth) = (1e3 * self.height_m, 1e3 * self.skin_depth_m);
        write!(
            f,
            "mesh too coarse: elements at the surface of material {} are {height:.3} mm thick, {:.2} times the skin depth of \
             {depth:.3} mm; at most {} times is advised",
            self.region,
            height / depth,
            self.most
        )
    }
}

/// Size of a system, and warnings about it.
#[derive(Clone, Debug, PartialEq)]
pub struct SystemInfo {
    /// Number of complex unknowns.
    pub unknowns: usize,
    /// Number of nonzeros in the lower triangle of the matrix.
    pub matrix_len: usize,
    /// Number of nonzeros in the factor.
    pub factor_len: usize,
    /// Memory of matrix and factor, bytes.
    pub bytes: usize,
    /// Meshes too coarse for the skin depth.
    pub warnings: Vec<CoarseMesh>,
}

/// A mesh with materials at one frequency, assembled and factored.
#[derive(Debug)]
pub struct EddySystem<'a> {
    pub(super) mesh: &'a EdgeMesh,
    pub(super) angular_frequency: f64,
    order: Order,
    pub(super) points: Vec<Point>,
    /// `w mu0 sigma` and `1/mu_r` of each region.
    pub(super) coefficients: Vec<(f64, f64)>,
    unknowns: Unknowns,
    pub(super) matrix: Preconditioned,
    pub(super) gauge: Gauge,
    warnings: Vec<CoarseMesh>,
}

impl<'a> EddySystem<'a> {
    /// Assembles and factors the system; `materials[k]` fills region `k + 1` of the mesh.
    ///
    /// # Errors
    /// A frequency outside 1 Hz to 1 MHz, a conductivity that is not positive, a relative permeability below 1, a
    /// number of materials that differs from the mesh, or a system that cannot be factored.
    pub fn new(mesh: &'a EdgeMesh, materials: &[Material], frequency_hz: f64, order: Order) -> Result<Self, MitError> {
        Self::with_fixed(mesh, materials, frequency_hz, order, None)
    }

    /// As [`EddySystem::new`], for an octant of a symmetric body. The potential is odd across the planes of these
    /// bits, where its tangential component is zero; it is even across the others, where the tangential field is
    /// zero.
    pub(super) fn with_fixed(
        mesh: &'a EdgeMesh,
        materials: &[Material],
        frequency_hz: f64,
        order: Order,
        odd: Option<u8>,
    ) -> Result<Self, MitError> {
        frequency(frequency_hz)?;
        materials.iter().try_for_each(Material::check)?;
        if materials.len() != mesh.region_count() {
            return Err(MitError::Count { what: "materials", expected: mesh.region_count(), got: materials.len() });
        }
        let mut coefficients = vec![(0.0, 1.0)];
        for material in materials {
            let loss = TAU * frequency_hz * MU0 * material.conductivity_s_per_m;
            coefficients.push((loss, 1.0 / material.relative_permeability));
        }
        let (points, unknowns) = (quadrature(), Unknowns::new(mesh, order, odd.map_or(u8::MAX, |odd| odd | OUTER)));
        let matrix = assemble(mesh, &points, &unknowns, &coefficients)?;
        let warnings = coarse(mesh, materials, frequency_hz, order)?;
        let gauge = gauge(mesh, &points, odd);
        let angular_frequency = TAU * frequency_hz;
        Ok(Self { mesh, angular_frequency, order, points, coefficients, unknowns, matrix, gauge, warnings })
    }

    /// Size and warnings.
    pub fn info(&self) -> SystemInfo {
        let (matrix_len, factor_len) = (self.matrix.structure.value_count(), self.matrix.structure.factor_len());
        // Two values and a row index per nonzero of the matrix, and a value per nonzero of the factor.
        let bytes = matrix_len * 20 + factor_len * 8;
        SystemInfo {
            unknowns: self.matrix.structure.size(),
            matrix_len,
            factor_len,
            bytes,
            warnings: self.warnings.clone(),
        }
    }

    /// A source's field at the quadrature points of all bodies, with these signs applied to the coordinates.
    pub(super) fn sample(&self, source: &dyn Source, signs: Vector) -> Samples {
        let of_element = |&element: &usize| {
            let magnetic = self.coefficients[self.mesh.regions[element] as usize].1 != 1.0;
            let geometry = self.mesh.geometry(element);
            let at = |point: &Point| {
                let p = geometry.map(point.barycentric).position_m;
                let p = [signs[0] * p[0], signs[1] * p[1], signs[2] * p[2]];
                (source.vector_potential(p), if magnetic { source.flux_density(p) } else { [0.0; 3] })
            };
            self.points.iter().map(at).collect::<Vec<_>>()
        };
        self.bodies().par_iter().flat_map_iter(of_element).collect()
    }

    /// Volume weight of each quadrature point in an element.
    pub(super) fn volumes(&self, element: usize) -> Vec<f64> {
        let geometry = self.mesh.geometry(element);
        self.points.iter().map(|point| point.weight * geometry.map(point.barycentric).determinant.abs()).collect()
    }

    /// Elements in bodies.
    pub(super) fn bodies(&self) -> Vec<usize> {
        (0..self.mesh.tetrahedra.len()).filter(|&t| self.mesh.regions[t] != 0).collect()
    }

    /// Coefficients of an element's functions in a solution.
    pub(super) fn local(&self, element: usize, potential: &[Complex]) -> [Complex; FUNCTIONS] {
        let numbers = self.unknowns.of(self.mesh, element);
        numbers.map(|n| if n == NONE { Complex::new(0.0, 0.0) } else { potential[n as usize] })
    }

    /// Right-hand side of a source.
    pub(super) fn side(&self, samples: &Samples) -> Vec<Complex> {
        let mut side = vec![Complex::new(0.0, 0.0); self.matrix.structure.size()];
        let elements = self.bodies();
        for (&element, samples) in elements.iter().zip(samples.chunks_exact(self.points.len())) {
            let numbers = self.unknowns.of(self.mesh, element);
            let (loss, reluctivity) = self.coefficients[self.mesh.regions[element] as usize];
            let (magnetic, geometry) = (reluctivity - 1.0, self.mesh.geometry(element));
            for (point, &(a, b)) in self.points.iter().zip(samples) {
                let map = geometry.map(point.barycentric);
                let volume = point.weight * map.determinant.abs();
                for (f, &number) in numbers.iter().enumerate().filter(|(_, number)| **number != NONE) {
                    let value = -loss * volume * dot(map.value(point.values[f]), a);
                    let curl = -magnetic * volume * dot(map.curl(point.curls[f]), b);
                    side[number as usize] += Complex::new(curl, value);
                }
            }
        }
        side
    }

    /// The part of `dM` (divided by nu0) of two sources that needs no solution.
    pub(super) fn direct(&self, first: &Samples, second: &Samples) -> Complex {
        let (mut sum, count) = (Complex::new(0.0, 0.0), self.points.len());
        for (body, element) in self.bodies().into_iter().enumerate() {
            let (loss, reluctivity) = self.coefficients[self.mesh.regions[element] as usize];
            let geometry = self.mesh.geometry(element);
            for (q, point) in self.points.iter().enumerate() {
                let volume = point.weight * geometry.map(point.barycentric).determinant.abs();
                let ((a, b), (c, d)) = (first[body * count + q], second[body * count + q]);
                sum += Complex::new((1.0 - reluctivity) * dot(b, d), -loss * dot(a, c)) * volume;
            }
        }
        sum
    }

    pub(super) fn functions(&self) -> usize {
        if self.order == Order::First { WHITNEY } else { FUNCTIONS }
    }
}

/// Numbering of the unknowns. Second-order gradients are kept only in conductors; in air they change no field.
#[derive(Debug)]
struct Unknowns {
    count: usize,
    whitney: Vec<u32>,
    gradients: Vec<u32>,
    faces: Vec<[u32; 2]>,
}

impl Unknowns {
    fn new(mesh: &EdgeMesh, order: Order, fixed: u8) -> Self {
        let mut conducting = vec![false; mesh.edges.len()];
        for (edges, _) in mesh.edges_of.iter().zip(&mesh.regions).filter(|(_, region)| **region != 0) {
            edges.iter().for_each(|&edge| conducting[edge as usize] = true);
        }
        let mut count = 0;
        let mut number = |take: bool| {
            if !take {
                return NONE;
            }
            count += 1;
            count - 1
        };
        let second = order == Order::Second;
        let (mut whitney, mut gradients) = (Vec::new(), Vec::new());
        for (bounds, conducting) in mesh.edge_bounds.iter().zip(conducting) {
            let inside = bounds & fixed == 0;
            whitney.push(number(inside));
            gradients.push(number(inside && second && conducting));
        }
        let mut faces = Vec::new();
        for bounds in &mesh.face_bounds {
            let take = second && bounds & fixed == 0;
            faces.push([number(take), number(take)]);
        }
        Self { count: count as usize, whitney, gradients, faces }
    }

    fn of(&self, mesh: &EdgeMesh, element: usize) -> [u32; FUNCTIONS] {
        let (edges, faces) = (&mesh.edges_of[element], &mesh.faces_of[element]);
        std::array::from_fn(|f| match f {
            0..6 => self.whitney[edges[f] as usize],
            6..12 => self.gradients[edges[f - 6] as usize],
            _ => self.faces[faces[(f - 12) / 2] as usize][f % 2],
        })
    }
}

/// Uses gradients of higher degree if symmetry leaves few per degree, and none if currents may leave through the
/// outer boundary.
fn gauge(mesh: &EdgeMesh, points: &[Point], odd: Option<u8>) -> Gauge {
    let (mut places_m, mut volumes) = (Vec::new(), Vec::new());
    for element in (0..mesh.tetrahedra.len()).filter(|&t| mesh.regions[t] != 0) {
        let geometry = mesh.geometry(element);
        for point in points {
            let map = geometry.map(point.barycentric);
            places_m.push(map.position_m);
            volumes.push(point.weight * map.determinant.abs());
        }
    }
    let leaves = |t: usize| mesh.edges_of[t].iter().any(|&edge| mesh.edge_bounds[edge as usize] & OUTER != 0);
    let degree = match odd {
        _ if (0..mesh.tetrahedra.len()).any(|t| mesh.regions[t] != 0 && leaves(t)) => 0,
        Some(_) => 7,
        None => 4,
    };
    Gauge::new(&places_m, volumes, degree, odd)
}

fn assemble(
    mesh: &EdgeMesh,
    points: &[Point],
    unknowns: &Unknowns,
    coefficients: &[(f64, f64)],
) -> Result<Preconditioned, MitError> {
    let mut positions = Vec::new();
    for element in 0..mesh.tetrahedra.len() {
        let numbers = unknowns.of(mesh, element);
        each_pair(&numbers, |_, _, i, j| positions.push((i, j)));
    }
    // Two to three times less fill than nested dissection by coordinates, which produces thick separators here.
    let (structure, slots) = SpdStructure::new(unknowns.count, &positions, Ordering::MinimumDegree)?;
    drop(positions);
    let (mut real, mut imaginary) = (vec![0.0; structure.value_count()], vec![0.0; structure.value_count()]);
    let mut slots = slots.into_iter();
    for element in 0..mesh.tetrahedra.len() {
        let (loss, reluctivity) = coefficients[mesh.regions[element] as usize];
        let (stiffness, mass) = element_matrices(mesh, element, points);
        each_pair(&unknowns.of(mesh, element), |i, j, _, _| {
            let Some(slot) = slots.next() else { return };
            real[slot as usize] += reluctivity * stiffness[i][j] + REGULARISATION * mass[i][j];
            imaginary[slot as usize] += loss * mass[i][j];
        });
    }
    let sum: Vec<f64> = real.iter().zip(&imaginary).map(|(re, im)| re + im).collect();
    let factor = structure.factor(&sum)?;
    Ok(Preconditioned { structure, real, imaginary, factor })
}

/// Visits each pair of an element's functions that have unknowns, once: local numbers, then unknowns.
fn each_pair(numbers: &[u32; FUNCTIONS], mut of: impl FnMut(usize, usize, u32, u32)) {
    for i in 0..FUNCTIONS {
        for j in 0..=i {
            if numbers[i] != NONE && numbers[j] != NONE {
                of(i, j, numbers[i], numbers[j]);
            }
        }
    }
}

type Local = [[f64; FUNCTIONS]; FUNCTIONS];

/// Products of curls and of values (lower triangles).
fn element_matrices(mesh: &EdgeMesh, element: usize, points: &[Point]) -> (Local, Local) {
    let geometry = mesh.geometry(element);
    let (mut stiffness, mut mass) = ([[0.0; FUNCTIONS]; FUNCTIONS], [[0.0; FUNCTIONS]; FUNCTIONS]);
    for point in points {
        let map = geometry.map(point.barycentric);
        let volume = point.weight * map.determinant.abs();
        let values = point.values.map(|v| map.value(v));
        let curls = point.curls.map(|v| map.curl(v));
        for i in 0..FUNCTIONS {
            let (value, curl) = (scaled(values[i], volume), scaled(curls[i], volume));
            for j in 0..=i {
                mass[i][j] += dot(value, values[j]);
                stiffness[i][j] += dot(curl, curls[j]);
            }
        }
    }
    (stiffness, mass)
}

fn coarse(
    mesh: &EdgeMesh,
    materials: &[Material],
    frequency_hz: f64,
    order: Order,
) -> Result<Vec<CoarseMesh>, MitError> {
    let most = if order == Order::First { 0.5 } else { 1.2 };
    let mut warnings = Vec::new();
    for (k, material) in materials.iter().enumerate() {
        let depth = skin_depth_m(material.conductivity_s_per_m, material.relative_permeability, frequency_hz)?;
        let (region, height_m) = (k + 1, mesh.surface_height_m(k as u8 + 1));
        if height_m > most * depth {
            warnings.push(CoarseMesh { region, height_m, skin_depth_m: depth, most });
        }
    }
    Ok(warnings)
}
