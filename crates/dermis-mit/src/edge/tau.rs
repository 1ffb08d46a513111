//! The multipole matrix of a body from edge elements: each harmonic field is imposed in turn, and tau is the change
//! of mutual inductance between any two of them.

use super::mesh::EdgeMesh;
use super::shapes::{Grading, cylinder_mesh, plate_mesh, sphere_mesh};
use super::source::Source;
use super::symmetry::SymmetricBody;
use super::system::{EddySystem, Material, Order};
use crate::constants::MU0;
use crate::error::{MitError, positive};
use crate::harmonics::{DEGREES, HARMONICS, MOST_DEGREE, index, regular_gradients};
use crate::polarizability::Polarizability;
use crate::sphere::skin_depth_m;
use crate::vector::{Complex, Vector, cross, scaled};

/// The field of one solid harmonic h of degree l about the origin: `B = -mu0 grad h`, `A = mu0/(l + 1) r x grad h`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Harmonic(usize);

impl Harmonic {
    /// The harmonic of an index below [`HARMONICS`], in the order of [`crate::regular`].
    pub fn new(index: usize) -> Option<Self> {
        (index < HARMONICS).then_some(Self(index))
    }
}

impl Source for Harmonic {
    fn vector_potential(&self, point_m: Vector) -> Vector {
        let gradient = regular_gradients(point_m)[self.0];
        scaled(cross(point_m, gradient), MU0 / (DEGREES[self.0] as f64 + 1.0))
    }

    fn flux_density(&self, point_m: Vector) -> Vector {
        scaled(regular_gradients(point_m)[self.0], -MU0)
    }
}

/// A body for which tau is computed, centred on the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Around the z axis.
    Cylinder {
        /// Radius, metres.
        radius_m: f64,
        /// Height, metres.
        height_m: f64,
    },
    /// Sides along x, y and z.
    Plate {
        /// Sides, metres.
        size_m: [f64; 3],
    },
    /// A ball.
    Sphere {
        /// Radius, metres.
        radius_m: f64,
    },
}

impl Shape {
    /// Radius of its bounding sphere, metres.
    pub fn radius_m(&self) -> f64 {
        match *self {
            Self::Cylinder { radius_m, height_m } => radius_m.hypot(0.5 * height_m),
            Self::Plate { size_m: [x, y, z] } => 0.5 * x.hypot(y).hypot(z),
            Self::Sphere { radius_m } => radius_m,
        }
    }

    fn label(&self) -> &'static str {
        match self {
            Self::Cylinder { .. } => "cylinder",
            Self::Plate { .. } => "plate",
            Self::Sphere { .. } => "sphere",
        }
    }

    /// Minimum and maximum half width, metres.
    fn half_widths_m(&self) -> (f64, f64) {
        let sizes = match *self {
            Self::Cylinder { radius_m, height_m } => [radius_m, radius_m, 0.5 * height_m],
            Self::Plate { size_m } => size_m.map(|size| 0.5 * size),
            Self::Sphere { radius_m } => [radius_m; 3],
        };
        (sizes.iter().copied().fold(f64::INFINITY, f64::min), sizes.iter().copied().fold(0.0, f64::max))
    }

    /// A grading for the shape at a skin depth.
    pub fn grading(&self, skin_depth_m: f64) -> Grading {
        let (least, greatest) = self.half_widths_m();
        Grading::for_body(skin_depth_m, least, greatest)
    }

    /// Upper estimate of the number of tetrahedra in [`Shape::mesh`], without generating it.
    pub fn tetrahedron_count(&self, grading: &Grading) -> f64 {
        match *self {
            Self::Cylinder { radius_m, height_m } => grading.cylinder_count(radius_m, height_m),
            Self::Plate { size_m } => grading.plate_count(size_m),
            Self::Sphere { radius_m } => grading.sphere_count(radius_m),
        }
    }

    /// A mesh around the shape.
    ///
    /// # Errors
    /// Sizes that are not positive, or a grading that does not fit.
    pub fn mesh(&self, grading: &Grading) -> Result<EdgeMesh, MitError> {
        match *self {
            Self::Cylinder { radius_m, height_m } => cylinder_mesh(radius_m, height_m, grading),
            Self::Plate { size_m } => plate_mesh(size_m, grading),
            Self::Sphere { radius_m } => sphere_mesh(radius_m, grading),
        }
    }
}

/// tau of the contents of a mesh, about its origin, row by row ([`HARMONICS`] squared), made exactly symmetric.
///
/// # Errors
/// See [`EddySystem::solve`].
pub fn tau(system: &EddySystem<'_>) -> Result<Vec<Complex>, MitError> {
    of_harmonics(|sources| Ok(system.solve(sources)?.changes_h().to_vec()))
}

/// [`tau`] for a body that is symmetric about the coordinate planes.
///
/// # Errors
/// See [`SymmetricBody::changes_h`].
pub fn symmetric_tau(body: &SymmetricBody<'_>) -> Result<Vec<Complex>, MitError> {
    of_harmonics(|sources| body.changes_h(sources))
}

fn of_harmonics(
    changes: impl FnOnce(&[&dyn Source]) -> Result<Vec<Complex>, MitError>,
) -> Result<Vec<Complex>, MitError> {
    let harmonics: Vec<Harmonic> = (0..HARMONICS).map(Harmonic).collect();
    let sources: Vec<&dyn Source> = harmonics.iter().map(|h| h as &dyn Source).collect();
    let changes = changes(&sources)?;
    let at = |i: usize, j: usize| changes[i * HARMONICS + j];
    Ok((0..HARMONICS * HARMONICS)
        .map(|k| (at(k / HARMONICS, k % HARMONICS) + at(k % HARMONICS, k / HARMONICS)) * 0.5)
        .collect())
}

/// tau of a body of revolution about the z axis, from its response to cosine harmonics: sine harmonics of the same
/// order have the same response, and different orders do not mix. Takes an [`EdgeMesh::octant`].
///
/// # Errors
/// See [`SymmetricBody::new`].
pub fn round_tau(octant: &EdgeMesh, material: &Material, frequency_hz: f64) -> Result<Vec<Complex>, MitError> {
    let body = SymmetricBody::of_cosines(octant, &[*material], frequency_hz, Order::Second)?;
    let places: Vec<(usize, usize)> = (1..=MOST_DEGREE).flat_map(|l| (0..=l).map(move |m| (l, m))).collect();
    let harmonics: Vec<Harmonic> = places.iter().map(|&(l, m)| Harmonic(index(l, m))).collect();
    let sources: Vec<&dyn Source> = harmonics.iter().map(|h| h as &dyn Source).collect();
    let changes = body.changes_h(&sources)?;
    let mut tau = vec![Complex::new(0.0, 0.0); HARMONICS * HARMONICS];
    for (i, &(l, m)) in places.iter().enumerate() {
        for (j, &(k, _)) in places.iter().enumerate().filter(|(_, (_, n))| *n == m) {
            let mean = (changes[i * places.len() + j] + changes[j * places.len() + i]) * 0.5;
            for sine in 0..=usize::from(m > 0) {
                tau[(index(l, m) + sine) * HARMONICS + index(k, m) + sine] = mean;
            }
        }
    }
    Ok(tau)
}

/// The multipole body for a shape, material and frequency, by second-order elements on a mesh matched to the skin
/// depth.
///
/// # Errors
/// Sizes or a conductivity that are not positive, a relative permeability below 1, or a frequency outside 1 Hz to 1
/// MHz.
pub fn body_tau(shape: &Shape, material: &Material, frequency_hz: f64) -> Result<Polarizability, MitError> {
    positive("radius_m", shape.radius_m())?;
    let depth = skin_depth_m(material.conductivity_s_per_m, material.relative_permeability, frequency_hz)?;
    let mesh = shape.mesh(&shape.grading(depth))?;
    let tau = match shape {
        Shape::Sphere { .. } => tau(&EddySystem::new(&mesh, &[*material], frequency_hz, Order::Second)?)?,
        Shape::Cylinder { .. } => round_tau(&mesh.octant()?, material, frequency_hz)?,
        Shape::Plate { .. } => {
            symmetric_tau(&SymmetricBody::new(&mesh.octant()?, &[*material], frequency_hz, Order::Second)?)?
        }
    };
    Ok(Polarizability::from_tau(shape.label(), shape.radius_m(), tau)?.with_inner_radius(shape.half_widths_m().0))
}
