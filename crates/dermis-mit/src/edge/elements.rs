//! The reference tetrahedron: hierarchical edge functions, quadrature, and the parabolic map to an element.
//!
//! The vertices of an element are sorted by their number in the mesh, so edges and faces have the same direction in
//! every element that shares them. Order of the functions: 6 Whitney functions `l_i grad l_j - l_j grad l_i`, 6
//! gradients of `l_i l_j`, 8 face functions `l_k w_ij` and `l_i w_jk` (Savage and Peterson, IEEE Trans. Antennas
//! Propag. 44, 1996).

use crate::vector::{Vector, add, cross, dot, scaled, subtract};

/// Ends of the edges of an element.
pub(super) const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// Corners of the faces of an element.
pub(super) const FACES: [[usize; 3]; 4] = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
/// Number of functions of second order.
pub(super) const FUNCTIONS: usize = 20;
/// Number of functions of first order.
pub(super) const WHITNEY: usize = 6;

const GRADIENTS: [Vector; 4] = [[-1.0, -1.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Values and curls of all functions at a point of the reference tetrahedron, and the derivatives of the parabolic
/// shape functions.
#[derive(Clone, Debug)]
pub(super) struct Point {
    pub(super) weight: f64,
    pub(super) barycentric: [f64; 4],
    pub(super) values: [Vector; FUNCTIONS],
    pub(super) curls: [Vector; FUNCTIONS],
}

impl Point {
    pub(super) fn new(l: [f64; 4], weight: f64) -> Self {
        let g = GRADIENTS;
        let mut values = [[0.0; 3]; FUNCTIONS];
        let mut curls = [[0.0; 3]; FUNCTIONS];
        let whitney = |i: usize, j: usize| subtract(scaled(g[j], l[i]), scaled(g[i], l[j]));
        for (e, &[i, j]) in EDGES.iter().enumerate() {
            values[e] = whitney(i, j);
            curls[e] = scaled(cross(g[i], g[j]), 2.0);
            values[WHITNEY + e] = add(scaled(g[j], l[i]), scaled(g[i], l[j]));
        }
        for (f, &[i, j, k]) in FACES.iter().enumerate() {
            for (n, [i, j, k]) in [[i, j, k], [j, k, i]].into_iter().enumerate() {
                let at = 2 * WHITNEY + 2 * f + n;
                values[at] = scaled(whitney(i, j), l[k]);
                curls[at] = add(cross(g[k], whitney(i, j)), scaled(cross(g[i], g[j]), 2.0 * l[k]));
            }
        }
        Self { weight, barycentric: l, values, curls }
    }
}

/// 14 points, exact to degree 5 (Walkington; Grundmann and Moeller's orbits); the weights sum to 1/6.
pub(super) fn quadrature() -> Vec<Point> {
    const CORNERS: [(f64, f64); 2] =
        [(0.092_735_250_310_891_23, 0.012_248_840_519_393_66), (0.310_885_919_263_300_6, 0.018_781_320_953_002_64)];
    const MIDDLES: (f64, f64) = (0.045_503_704_125_649_65, 0.007_091_003_462_846_91);
    let mut points = Vec::with_capacity(14);
    for (a, weight) in CORNERS {
        for corner in 0..4 {
            let mut l = [a; 4];
            l[corner] = 1.0 - 3.0 * a;
            points.push(Point::new(l, weight));
        }
    }
    for [i, j] in EDGES {
        let mut l = [MIDDLES.0; 4];
        (l[i], l[j]) = (0.5 - MIDDLES.0, 0.5 - MIDDLES.0);
        points.push(Point::new(l, MIDDLES.1));
    }
    points
}

/// Corners of an element, and midpoints of its edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    pub(super) corners: [Vector; 4],
    pub(super) middles: [Vector; 6],
}

/// The map at one point: the columns of the Jacobian, its determinant, and the columns of its inverse transpose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Map {
    pub(super) position_m: Vector,
    pub(super) jacobian: [Vector; 3],
    pub(super) determinant: f64,
    dual: [Vector; 3],
}

impl Geometry {
    /// Parabolic shape functions: `l (2l - 1)` at corners, `4 l_i l_j` at midpoints.
    pub(super) fn map(&self, l: [f64; 4]) -> Map {
        let mut position_m = [0.0; 3];
        // Derivatives with respect to each barycentric coordinate, treated as independent.
        let mut by = [[0.0; 3]; 4];
        for i in 0..4 {
            position_m = add(position_m, scaled(self.corners[i], l[i] * (2.0 * l[i] - 1.0)));
            by[i] = scaled(self.corners[i], 4.0 * l[i] - 1.0);
        }
        for (middle, &[i, j]) in self.middles.iter().zip(&EDGES) {
            position_m = add(position_m, scaled(*middle, 4.0 * l[i] * l[j]));
            by[i] = add(by[i], scaled(*middle, 4.0 * l[j]));
            by[j] = add(by[j], scaled(*middle, 4.0 * l[i]));
        }
        let jacobian = [1, 2, 3].map(|k| subtract(by[k], by[0]));
        let [a, b, c] = jacobian;
        let determinant = dot(a, cross(b, c));
        let dual = [cross(b, c), cross(c, a), cross(a, b)].map(|v| scaled(v, 1.0 / determinant));
        Map { position_m, jacobian, determinant, dual }
    }
}

impl Map {
    /// Maps a covariant vector from the reference element to space.
    pub(super) fn value(&self, v: Vector) -> Vector {
        let [a, b, c] = self.dual;
        add(scaled(a, v[0]), add(scaled(b, v[1]), scaled(c, v[2])))
    }

    /// Maps the curl of a covariant vector from the reference element to space.
    pub(super) fn curl(&self, v: Vector) -> Vector {
        let [a, b, c] = self.jacobian;
        scaled(add(scaled(a, v[0]), add(scaled(b, v[1]), scaled(c, v[2]))), 1.0 / self.determinant)
    }

    /// Step in barycentric coordinates 1 to 3 that moves the point by an offset, to first order.
    pub(super) fn step(&self, offset_m: Vector) -> Vector {
        self.dual.map(|d| dot(d, offset_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadrature_is_exact_to_degree_five() {
        // int x^a y^b z^c = a! b! c! / (a + b + c + 3)!.
        for (a, b, c, exact) in [(0, 0, 0, 1.0 / 6.0), (2, 1, 0, 2.0 / 720.0), (2, 2, 1, 4.0 / 40_320.0)] {
            let found: f64 = quadrature()
                .iter()
                .map(|p| p.weight * p.barycentric[1].powi(a) * p.barycentric[2].powi(b) * p.barycentric[3].powi(c))
                .sum();
            assert!((found - exact).abs() < 1e-15, "{a} {b} {c}: {found} {exact}");
        }
    }

    #[test]
    fn curls_agree_with_differences_of_the_values() {
        let at = |x: Vector| Point::new([1.0 - x[0] - x[1] - x[2], x[0], x[1], x[2]], 1.0);
        let (x, step) = ([0.2, 0.3, 0.1], 1e-5);
        let moved = |axis: usize, by: f64| {
            let mut y = x;
            y[axis] += by;
            at(y).values
        };
        let slopes = [0, 1, 2].map(|axis| (moved(axis, step), moved(axis, -step)));
        for f in 0..FUNCTIONS {
            let d = |axis: usize, of: usize| (slopes[axis].0[f][of] - slopes[axis].1[f][of]) / (2.0 * step);
            let curl = [d(1, 2) - d(2, 1), d(2, 0) - d(0, 2), d(0, 1) - d(1, 0)];
            // For quadratic functions, central differences are exact up to rounding.
            (0..3).for_each(|k| assert!((curl[k] - at(x).curls[f][k]).abs() < 1e-9, "{f} {k}"));
        }
    }
}
