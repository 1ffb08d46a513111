//! External fields acting on bodies: fields of coils, rings, dipoles and windings of straight wires.

use crate::coil::Coil;
use crate::ring::Ring;
use crate::segment::Segment;
use crate::vector::{Vector, add, cross, dot, norm, scaled, subtract};

/// Vector potential and flux density of a source at all quadrature points in bodies.
pub(super) type Samples = Vec<(Vector, Vector)>;

/// An external field acting on bodies, in free space.
pub trait Source: Sync {
    /// Vector potential, V.s/m (per ampere for coils).
    fn vector_potential(&self, point_m: Vector) -> Vector;
    /// Flux density, the curl of the vector potential, T (per ampere for coils).
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

/// A magnetic dipole, the limit of a small coil.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dipole {
    /// Position, metres.
    pub position_m: Vector,
    /// Moment, A.m^2.
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

/// A winding of straight wires, each with its current in amperes; together they must form closed loops.
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
