//! Element matrices of linear triangles in the plane: stiffness with an anisotropic sheet conductance, and the mass
//! matrix weighted by a linear function.

use dermis_tomo::mesh::Point;

/// Symmetric sheet conductance tensor of an element, siemens: thickness times conductivity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetConductance {
    /// Along x.
    pub xx: f64,
    /// Off the diagonal.
    pub xy: f64,
    /// Along y.
    pub yy: f64,
}

impl SheetConductance {
    /// The same in all directions.
    pub fn isotropic(siemens: f64) -> Self {
        Self { xx: siemens, xy: 0.0, yy: siemens }
    }
}

/// Pairs (a, b), a >= b, of a triangle's corners, in the storage order of local matrices.
pub(super) const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

/// `integral grad phi_a . S grad phi_b` for each of [`PAIRS`].
pub(super) fn stiffness(corners: [Point; 3], conductance: SheetConductance) -> [f64; 6] {
    let edge = |k: usize| {
        let (from, to) = (corners[(k + 1) % 3], corners[(k + 2) % 3]);
        // Gradient of phi_k times twice the signed area: the opposite edge rotated by a right angle.
        [from[1] - to[1], to[0] - from[0]]
    };
    let edges = [edge(0), edge(1), edge(2)];
    let twice_area = (edges[0][0] * edges[1][1] - edges[0][1] * edges[1][0]).abs();
    PAIRS.map(|(a, b)| {
        let (p, q) = (edges[a], edges[b]);
        let flux = [conductance.xx * q[0] + conductance.xy * q[1], conductance.xy * q[0] + conductance.yy * q[1]];
        (p[0] * flux[0] + p[1] * flux[1]) / (2.0 * twice_area)
    })
}

/// `integral g phi_a phi_b` for each of [`PAIRS`], with g linear between these corner values, from
/// `integral phi_0^i phi_1^j phi_2^k = 2 A i! j! k! / (i + j + k + 2)!`.
pub(super) fn weighted_mass(area: f64, g: [f64; 3]) -> [f64; 6] {
    let sum = g[0] + g[1] + g[2];
    PAIRS.map(|(a, b)| {
        let share = if a == b { 2.0 * (sum + 2.0 * g[a]) } else { sum + g[a] + g[b] };
        area * share / 60.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(local: &[f64; 6], a: usize, b: usize) -> f64 {
        let pair = (a.max(b), a.min(b));
        PAIRS.iter().position(|p| *p == pair).map_or(f64::NAN, |k| local[k])
    }

    #[test]
    fn stiffness_gives_the_energy_of_linear_fields_in_either_orientation() {
        let corners = [[0.1, 0.2], [1.3, 0.4], [0.5, 1.7]];
        let tensor = SheetConductance { xx: 2.0, xy: 0.3, yy: 0.7 };
        let area = 0.5 * (1.2 * 1.5 - 0.2 * 0.4_f64).abs();
        for order in [[0, 1, 2], [2, 1, 0]] {
            let triangle = order.map(|k| corners[k]);
            let local = stiffness(triangle, tensor);
            // The field 3x - 2y has energy density S : grad grad.
            let values = triangle.map(|p| 3.0 * p[0] - 2.0 * p[1]);
            let energy: f64 = (0..9).map(|k| at(&local, k / 3, k % 3) * values[k / 3] * values[k % 3]).sum();
            let expected = area * (2.0 * 9.0 - 2.0 * 0.3 * 6.0 + 0.7 * 4.0);
            assert!((energy - expected).abs() < 1e-12, "{energy} {expected}");
        }
    }

    #[test]
    fn mass_is_exact() {
        // Moments are sufficient instead of a full quadrature rule: the sum over all pairs is the integral of g, and
        // the row sums are integral g phi_a.
        let local = weighted_mass(3.0, [1.0, 2.0, 6.0]);
        let total: f64 = (0..9).map(|k| at(&local, k / 3, k % 3)).sum();
        assert!((total - 9.0).abs() < 1e-12, "{total}");
        for (a, g) in [1.0, 2.0, 6.0].into_iter().enumerate() {
            let row: f64 = (0..3).map(|b| at(&local, a, b)).sum();
            assert!((row - 3.0 * (9.0 + g) / 12.0).abs() < 1e-12, "{row}");
        }
        // integral g phi_0 phi_1 is (9 + 1 + 2)/60 of the area, by Stroud's seven-point rule.
        assert!((at(&local, 0, 1) - 3.0 * 12.0 / 60.0).abs() < 1e-12);
    }
}
