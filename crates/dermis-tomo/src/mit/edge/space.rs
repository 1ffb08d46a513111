//! Edge elements on tetrahedra: Nedelec's first kind of first and second order (Numer. Math. 35, 1980, 315), in a hierarchical
//! basis.
//!
//! On the edge ij (i < j): the Whitney function `l_i grad l_j - l_j grad l_i` and, for second order, the gradient
//! `grad(l_i l_j)`; on the face ijk (i < j < k): `l_k w_ij` and `l_i w_jk`. With nodes in ascending order all elements agree
//! on the direction. Gradients in air see neither curl nor conductor and are left out.

use std::collections::HashMap;

use super::EdgeMesh;
use crate::mit::{Vector, add, cross, dot, scaled, subtract};

/// Functions of a tetrahedron of second order.
pub(super) const LOCAL: usize = 20;
/// Corners of the edges of a tetrahedron.
pub(super) const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// Corners of the faces.
const FACES: [[usize; 3]; 4] = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];

/// Barycentric coordinates and weights (sum 1) of a rule exact to degree 5 with 14 points (Walkington, Quadrature on
/// simplices of arbitrary dimension, 2000).
pub(super) fn quadrature() -> [([f64; 4], f64); 14] {
    const A: f64 = 0.310_885_919_263_300_6;
    const B: f64 = 0.092_735_250_310_891_23;
    const C: f64 = 0.045_503_704_125_649_65;
    const WEIGHTS: [f64; 3] = [0.112_687_925_718_015_85, 0.073_493_043_116_361_95, 0.042_546_020_777_081_47];
    let mut rule = [([0.0; 4], 0.0); 14];
    for k in 0..4 {
        for (from, value, weight) in [(0, A, WEIGHTS[0]), (4, B, WEIGHTS[1])] {
            let mut l = [value; 4];
            l[k] = 1.0 - 3.0 * value;
            rule[from + k] = (l, weight);
        }
    }
    for (k, [a, b]) in EDGES.into_iter().enumerate() {
        let mut l = [0.5 - C; 4];
        (l[a], l[b]) = (C, C);
        rule[8 + k] = (l, WEIGHTS[2]);
    }
    rule
}

/// Which functions are unknowns.
#[derive(Clone, Debug)]
pub(super) struct Space {
    /// Unknown of every function of every tetrahedron; `None` on the border and where a function is left out.
    pub(super) unknowns: Vec<[Option<u32>; LOCAL]>,
    pub(super) count: usize,
    /// Where each unknown lies, to order the elimination.
    pub(super) places: Vec<Vector>,
}

impl Space {
    /// Second order where `high` says so for either tetrahedron of a face; gradients where the edge touches the body.
    pub(super) fn new(mesh: &EdgeMesh, high: &[bool]) -> Self {
        // Bit 0: of second order; bit 1: at the body.
        let mut edges: HashMap<[u32; 2], u8> = HashMap::new();
        let mut faces: HashMap<[u32; 3], bool> = HashMap::new();
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            for edge in EDGES {
                let flags = u8::from(high[t]) | (u8::from(mesh.is_body[t]) << 1);
                *edges.entry(edge.map(|k| nodes[k])).or_default() |= flags;
            }
            for face in FACES {
                *faces.entry(face.map(|k| nodes[k])).or_default() |= high[t];
            }
        }
        let mut space = Self { unknowns: Vec::with_capacity(mesh.tetrahedra.len()), count: 0, places: Vec::new() };
        let mut first: HashMap<[u32; 2], Option<u32>> = HashMap::new();
        let mut first_of_face: HashMap<[u32; 3], Option<u32>> = HashMap::new();
        for nodes in &mesh.tetrahedra {
            let mut local = [None; LOCAL];
            for (k, edge) in EDGES.into_iter().enumerate() {
                let key = edge.map(|k| nodes[k]);
                let flags = edges[&key];
                let at = *first.entry(key).or_insert_with(|| space.add(mesh, &key, 1 + usize::from(flags == 3)));
                local[k] = at;
                local[6 + k] = at.filter(|_| flags == 3).map(|at| at + 1);
            }
            for (k, face) in FACES.into_iter().enumerate() {
                let key = face.map(|k| nodes[k]);
                if faces[&key] {
                    let at = *first_of_face.entry(key).or_insert_with(|| space.add(mesh, &key, 2));
                    local[12 + 2 * k] = at;
                    local[13 + 2 * k] = at.map(|at| at + 1);
                }
            }
            space.unknowns.push(local);
        }
        space
    }

    fn add(&mut self, mesh: &EdgeMesh, nodes: &[u32], functions: usize) -> Option<u32> {
        if nodes.iter().all(|&node| mesh.on_border[node as usize]) {
            return None;
        }
        let first = self.count as u32;
        self.count += functions;
        let sum = nodes.iter().fold([0.0; 3], |sum, &node| add(sum, mesh.nodes[node as usize]));
        self.places.extend(std::iter::repeat_n(scaled(sum, 1.0 / nodes.len() as f64), functions));
        Some(first)
    }
}

/// A tetrahedron's gradients of the barycentric coordinates, and its volume.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    gradients: [Vector; 4],
    pub(super) volume_m3: f64,
    corners: [Vector; 4],
}

impl Shape {
    pub(super) fn new(corners: [Vector; 4]) -> Self {
        let [a, b, c] = [1, 2, 3].map(|k| subtract(corners[k], corners[0]));
        let determinant = dot(a, cross(b, c));
        let of = |p: Vector, q: Vector| scaled(cross(p, q), 1.0 / determinant);
        let (g1, g2, g3) = (of(b, c), of(c, a), of(a, b));
        let g0 = scaled(add(g1, add(g2, g3)), -1.0);
        Self { gradients: [g0, g1, g2, g3], volume_m3: determinant.abs() / 6.0, corners }
    }

    /// The point of barycentric coordinates.
    pub(super) fn at(&self, l: &[f64; 4]) -> Vector {
        (0..4).fold([0.0; 3], |sum, k| add(sum, scaled(self.corners[k], l[k])))
    }

    /// All functions and their curls there.
    pub(super) fn functions(&self, l: &[f64; 4]) -> ([Vector; LOCAL], [Vector; LOCAL]) {
        let (mut values, mut curls) = ([[0.0; 3]; LOCAL], [[0.0; 3]; LOCAL]);
        let g = &self.gradients;
        let whitney = |i: usize, j: usize| subtract(scaled(g[j], l[i]), scaled(g[i], l[j]));
        let curl = |i: usize, j: usize| scaled(cross(g[i], g[j]), 2.0);
        for (k, [i, j]) in EDGES.into_iter().enumerate() {
            values[k] = whitney(i, j);
            curls[k] = curl(i, j);
            values[6 + k] = add(scaled(g[j], l[i]), scaled(g[i], l[j]));
        }
        for (k, [i, j, m]) in FACES.into_iter().enumerate() {
            for (place, of, [from, to]) in [(12 + 2 * k, m, [i, j]), (13 + 2 * k, i, [j, m])] {
                let w = whitney(from, to);
                values[place] = scaled(w, l[of]);
                curls[place] = add(cross(g[of], w), scaled(curl(from, to), l[of]));
            }
        }
        (values, curls)
    }
}
