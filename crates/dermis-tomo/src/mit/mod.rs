//! Magnetic induction tomography: coils, the small conducting bodies that they sense, and the changes of mutual inductance
//! that these make.
//!
//! Conventions: `e^{+j w t}`, SI, `mu0 = 4e-7 pi`. The change of the impedance between two coils is `dZ = j w dM`; `dM`
//! (henries, complex) is negative in its real part where flux is pushed out of a coil's own loop, and in its imaginary
//! part of a self term where power is lost. Positions are metres, x right, y up, z out of the skin toward the toucher.

mod anywhere;
mod array;
mod bodies;
mod body;
mod coil;
pub mod edge;
mod error;
mod harmonics;
mod heights;
mod plate;
mod quadrature;
mod ring;
mod ring_body;
mod segment;
pub mod sensitivity;
pub mod sheet;
mod sphere;

pub use anywhere::{Tier, changes_anywhere};
pub use array::CoilArray;
pub use bodies::{Bodies, CoilTables, Coupling};
pub use body::Body;
pub use coil::{Coil, Filament};
pub use error::MitError;
pub use harmonics::{HARMONICS, MOST_DEGREE, expansion, regular, regular_gradients};
pub use heights::{Heights, HeightsFit, HeightsOptions};
pub use plate::{ConductingPlate, RoundWinding};
pub use ring::{Ring, complete_elliptic};
pub use ring_body::{RingBody, Section};
pub use segment::Segment;
pub use sphere::{Sphere, skin_depth_m};

/// Complex numbers.
pub type Complex = faer::c64;

/// Magnetic constant, H/m, as all references here take it.
pub const MU0: f64 = 4e-7 * std::f64::consts::PI;

pub(crate) type Vector = [f64; 3];

pub(crate) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn subtract(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn norm(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

pub(crate) fn scaled(a: Vector, factor: f64) -> Vector {
    a.map(|v| factor * v)
}

pub(crate) fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}
