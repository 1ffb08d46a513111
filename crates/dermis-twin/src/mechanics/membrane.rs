//! Indenters on the membrane of a liquid ([`dermis_tomo::membrane`]).

use dermis_tomo::membrane::{Membrane, MembraneSpec};
use dermis_tomo::mesh::distance;

use super::indenter::{Cover, Indenter};
use crate::error::{TwinError, check, check_positive};

/// Number of parts into which each edge of a triangle is divided to integrate pressures: 9 points per triangle.
const SUBDIVISION: usize = 3;

/// A membrane that can be pressed.
pub trait PressedMembrane {
    /// Adds the nodal forces of an indenter, newtons: `integral p phi`. Pressure beyond the rim is lost.
    fn add_load(&self, indenter: &Indenter, cover: Cover, load_n: &mut [f64]);
}

impl PressedMembrane for Membrane {
    fn add_load(&self, indenter: &Indenter, cover: Cover, load_n: &mut [f64]) {
        let field = indenter.field(cover);
        let positions = self.positions_m();
        for (triangle, area) in self.triangles().iter().zip(self.areas_m2()) {
            let corners = triangle.map(|node| positions[node as usize]);
            let reach = |k: usize| distance(corners[k], corners[0]);
            if !field.reaches(corners[0], reach(1).max(reach(2))) {
                continue;
            }
            for [a, b, c] in quadrature() {
                let at = [0, 1].map(|axis| a * corners[0][axis] + b * corners[1][axis] + c * corners[2][axis]);
                let force = field.pressure_pa(at) * area / (SUBDIVISION * SUBDIVISION) as f64;
                for (&node, share) in triangle.iter().zip([a, b, c]) {
                    load_n[node as usize] += share * force;
                }
            }
        }
    }
}

/// Refuses an invalid membrane.
///
/// # Errors
/// The number, its value and what was expected.
pub fn check_membrane(spec: &MembraneSpec) -> Result<(), TwinError> {
    check("tension_n_per_m", spec.tension_n_per_m, 0.0, f64::MAX, "zero (an open tank) or more, finite")?;
    check("density_kg_per_m3", spec.density_kg_per_m3, 0.0, 1e5, "0 to 1e5 kg/m^3")?;
    let mut components = spec.gravity_m_per_s2.iter();
    components.try_for_each(|&g| check("gravity_m_per_s2", g, -1e3, 1e3, "components of -1000 to 1000 m/s^2"))?;
    if spec.is_open() {
        check_positive("density_kg_per_m3 of an open tank (tension_n_per_m = 0)", spec.density_kg_per_m3)?;
        let expected = "below 0, into the skin, where tension_n_per_m is 0 (an open tank)";
        check("gravity_m_per_s2 along z", spec.gravity_m_per_s2[2], -1e3, -f64::MIN_POSITIVE, expected)?;
    }
    Ok(())
}

/// Barycentric coordinates of the centroids of a triangle's equal parts.
fn quadrature() -> impl Iterator<Item = [f64; 3]> {
    const N: usize = SUBDIVISION;
    (0..N).flat_map(|i| {
        (0..N - i).flat_map(move |j| {
            let third = |a: f64, b: f64| [a / N as f64, b / N as f64, 1.0 - (a + b) / N as f64];
            let upright = third(i as f64 + 1.0 / 3.0, j as f64 + 1.0 / 3.0);
            let inverted = third(i as f64 + 2.0 / 3.0, j as f64 + 2.0 / 3.0);
            std::iter::once(upright).chain((i + j + 1 < N).then_some(inverted))
        })
    })
}

#[cfg(test)]
mod tests;
