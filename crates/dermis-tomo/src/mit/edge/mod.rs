//! Eddy currents by edge elements: Nedelec's first kind (Numerische Mathematik 35, 1980), of first and second order, on
//! tetrahedra with straight or parabolic edges, around conducting and permeable bodies in the field of given coils.
//!
//! With `A = As + Ar`, `As` that of the coils in free space, and everything divided by `nu0 = 1/mu0`:
//! `int 1/mu_r curl Ar.curl v + j w mu0 sigma Ar.v + eps Ar.v = -int j w mu0 sigma As.v + (1/mu_r - 1) Bs.curl v`, so no coil is
//! in the mesh; `Ar` has no tangential part on the outer boundary. The regularisation `eps` (per square metre) makes the
//! potential in air unique. The change of a mutual inductance (lossy: its imaginary part is negative) is, by reciprocity,
//! `dM_mn = -1/mu0 int j w mu0 sigma (As_m + Ar_m).As_n + (1/mu_r - 1)(Bs_m + Br_m).Bs_n`.

mod cocg;
mod elements;
mod gauge;
mod mesh;
mod shapes;
mod solution;
mod symmetry;
mod system;
mod tau;

pub use mesh::EdgeMesh;
pub use shapes::{Grading, box_mesh, cylinder_mesh, plate_mesh, sphere_mesh};
pub use solution::{Fields, Sensitivity};
pub use symmetry::SymmetricBody;
pub use system::{CoarseMesh, EddySystem, Material, Order, SystemInfo};
pub use tau::{Harmonic, Shape, body_tau, round_tau, symmetric_tau, tau};

use super::{Coil, Ring, Segment, Vector, add, cross, dot, norm, scaled, subtract};

/// A field that bodies are put into, in free space.
pub trait Source: Sync {
    /// Vector potential, V.s/m (per ampere for coils).
    fn vector_potential(&self, point_m: Vector) -> Vector;
    /// Flux density, its curl, T (per ampere for coils).
    fn flux_density(&self, point_m: Vector) -> Vector;
}

impl Source for Coil {
    fn vector_potential(&self, point_m: Vector) -> Vector {
        Coil::vector_potential(self, point_m)
    }

    fn flux_density(&self, point_m: Vector) -> Vector {
        Coil::flux_density(self, point_m)
    }
}

impl Source for Ring {
    fn vector_potential(&self, point_m: Vector) -> Vector {
        Ring::vector_potential(self, point_m)
    }

    fn flux_density(&self, point_m: Vector) -> Vector {
        Ring::flux_density(self, point_m)
    }
}

/// A magnetic dipole: the smallest of coils.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dipole {
    /// Its place, metres.
    pub position_m: Vector,
    /// Its moment, A.m^2.
    pub moment: Vector,
}

impl Source for Dipole {
    fn vector_potential(&self, point_m: Vector) -> Vector {
        let r = subtract(point_m, self.position_m);
        scaled(cross(self.moment, r), 1e-7 / norm(r).powi(3))
    }

    fn flux_density(&self, point_m: Vector) -> Vector {
        let r = subtract(point_m, self.position_m);
        let distance = norm(r);
        let along = scaled(r, 3.0 * dot(self.moment, r) / distance.powi(2));
        scaled(subtract(along, self.moment), 1e-7 / distance.powi(3))
    }
}

/// A winding of straight wires, each with its current in amperes; together they must close.
#[derive(Clone, Debug, PartialEq)]
pub struct Wires(pub Vec<(Segment, f64)>);

impl Wires {
    fn sum(&self, of: impl Fn(&Segment) -> Vector) -> Vector {
        self.0.iter().fold([0.0; 3], |all, (segment, amperes)| add(all, scaled(of(segment), *amperes)))
    }
}

impl Source for Wires {
    fn vector_potential(&self, point_m: Vector) -> Vector {
        self.sum(|segment| segment.vector_potential(point_m))
    }

    fn flux_density(&self, point_m: Vector) -> Vector {
        self.sum(|segment| segment.flux_density(point_m))
    }
}
