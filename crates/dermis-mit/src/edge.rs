//! Eddy currents with edge elements: Nedelec's first kind (Numerische Mathematik 35, 1980), of first and second
//! order, on tetrahedra with straight or parabolic edges, around conducting and permeable bodies in the field of
//! given coils.
//!
//! With `A = As + Ar`, where `As` is the coils' potential in free space, and everything divided by `nu0 = 1/mu0`:
//! `int 1/mu_r curl Ar.curl v + j w mu0 sigma Ar.v + eps Ar.v = -int j w mu0 sigma As.v + (1/mu_r - 1) Bs.curl v`. So
//! the coils are not in the mesh, and `Ar` has no tangential component on the outer boundary. The regularisation
//! `eps` (per square metre) makes the potential in air unique. By reciprocity, the change of a mutual inductance
//! (lossy: its imaginary part is negative) is
//! `dM_mn = -1/mu0 int j w mu0 sigma (As_m + Ar_m).As_n + (1/mu_r - 1)(Bs_m + Br_m).Bs_n`.

mod cocg;
mod elements;
mod gauge;
mod mesh;
mod shapes;
mod solution;
mod source;
mod symmetry;
mod system;
mod tau;

pub use mesh::EdgeMesh;
pub use shapes::{Grading, TETRAHEDRON_BYTES, box_mesh, cylinder_mesh, plate_mesh, sphere_mesh};
pub use solution::{Fields, Sensitivity};
pub use source::{Dipole, Source, Wires};
pub use symmetry::SymmetricBody;
pub use system::{CoarseMesh, EddySystem, Material, Order, SystemInfo};
pub use tau::{Harmonic, Shape, body_tau, round_tau, symmetric_tau, tau};
