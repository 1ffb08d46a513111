//! Thin conducting sheets, flat or bent. Their current is the curl of a stream function on triangles,
//! `K = grad psi x n`, which vanishes on their rims (boundary elements with surface impedance).
//!
//! A sheet of thickness t carries `K = int J dz`. With `k^2 = j w mu0 sigma`, its even part `cosh(k z)` has `E = Z K`
//! at both faces, with `Z = k/(2 sigma) coth(k t/2)`: `1/(sigma t)` for thin sheets, `(1 + j)/(2 sigma delta)` for
//! sheets far thicker than the skin depth. The field of all of K at a face is that at t/2 from the middle surface, so
//! `E = -j w (As + mu0/(4 pi) int K/sqrt(R^2 + t^2/4) dS)`. With the hat functions of psi this is
//! `(Z R + j w L) psi = -j w b`, `R = int K_i.K_j dS`, `L = mu0/(4 pi) int int K_i.K_j / sqrt(R^2 + t^2/4)`,
//! `b = int psi_i Bs.n dS`; `dM_mn = b_m' psi_n`. The odd part, currents that flow one way on one face and back on
//! the other, keeps the tangential field out: `-mu0 t (1 - tanh(k t/2)/(k t/2)) int H_m.H_n dS` over the coils'
//! tangential fields.

mod mesh;
mod plates;
mod stream_function;
mod triangle;

pub use mesh::SheetMesh;
pub use plates::{Plate, PlateCoupling, Plates};
pub use stream_function::{Sheet, SheetMaterial};
