//! Triangle meshes of thin sheets: rectangles and discs graded towards their edges, bent sheets, and several separate
//! sheets.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use crate::error::{MitError, positive};
use crate::vector::{Vector, add, cross, norm, subtract};

/// Middle surfaces of sheets. The corners of every triangle run counter-clockwise seen from the side that the normals
/// point to.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetMesh {
    pub(super) vertices: Vec<Vector>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl SheetMesh {
    /// Builds a mesh from vertices (metres) and the corners of triangles.
    ///
    /// # Errors
    /// No triangles, corners that do not exist, triangles without area, an edge shared by more than two triangles or
    /// by two of opposite orientation, or pieces that are closed or have holes (whose rims would need their own
    /// currents).
    pub fn new(vertices: Vec<Vector>, triangles: Vec<[u32; 3]>) -> Result<Self, MitError> {
        let mesh = Self { vertices, triangles };
        mesh.check()?;
        Ok(mesh)
    }

    /// A flat rectangle around the origin at z = 0, with cells that narrow towards the edges: the mean of equal steps
    /// and cosine steps.
    ///
    /// # Errors
    /// Sides that are not positive, or fewer than two cells along a side.
    pub fn rectangle(size_m: [f64; 2], cells: [usize; 2]) -> Result<Self, MitError> {
        for axis in 0..2 {
            positive("size_m", size_m[axis])?;
            if cells[axis] < 2 {
                return Err(MitError::Count { what: "cells along a side", expected: 2, got: cells[axis] });
            }
        }
        let at = |axis: usize, k: usize| {
            let share = k as f64 / cells[axis] as f64;
            0.5 * size_m[axis] * (share - 0.5 - 0.5 * (PI * share).cos())
        };
        let rows = (0..=cells[1]).flat_map(|j| (0..=cells[0]).map(move |i| (i, j)));
        let vertices = rows.map(|(i, j)| [at(0, i), at(1, j), 0.0]).collect();
        let number = |i: usize, j: usize| (i + j * (cells[0] + 1)) as u32;
        let mut triangles = Vec::with_capacity(2 * cells[0] * cells[1]);
        for j in 0..cells[1] {
            for i in 0..cells[0] {
                let [a, b, c, d] = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)];
                // Alternating diagonals, so that the mesh has no preferred direction.
                triangles.extend(if (i + j).is_multiple_of(2) {
                    [[a, b, c], [a, c, d]]
                } else {
                    [[a, b, d], [b, c, d]]
                });
            }
        }
        Self::new(vertices, triangles)
    }

    /// A flat disc around the origin at z = 0, with 6 n vertices on ring n, and rings that are narrower towards
    /// the rim. The polygon has the disc's area.
    ///
    /// # Errors
    /// A radius that is not positive, or fewer than two rings.
    pub fn disc(radius_m: f64, rings: usize) -> Result<Self, MitError> {
        positive("radius_m", radius_m)?;
        if rings < 2 {
            return Err(MitError::Count { what: "rings of a disc", expected: 2, got: rings });
        }
        let step = TAU / (6 * rings) as f64;
        let outer_m = radius_m * (step / step.sin()).sqrt();
        let (mut vertices, mut triangles) = (vec![[0.0; 3]], Vec::new());
        let number =
            |ring: usize, k: usize| if ring == 0 { 0 } else { (1 + 3 * ring * (ring - 1) + k % (6 * ring)) as u32 };
        for ring in 1..=rings {
            let r = outer_m * (0.5 * PI * ring as f64 / rings as f64).sin();
            for k in 0..6 * ring {
                let (sine, cosine) = (TAU * k as f64 / (6 * ring) as f64).sin_cos();
                vertices.push([r * cosine, r * sine, 0.0]);
            }
            for sector in 0..6 {
                for k in 0..ring {
                    let (outer, inner) = (sector * ring + k, sector * (ring - 1) + k);
                    triangles.push([number(ring - 1, inner), number(ring, outer), number(ring, outer + 1)]);
                    if k + 1 < ring {
                        triangles.push([number(ring - 1, inner), number(ring, outer + 1), number(ring - 1, inner + 1)]);
                    }
                }
            }
        }
        Self::new(vertices, triangles)
    }

    /// The same mesh, displaced.
    pub fn moved(mut self, by_m: Vector) -> Self {
        self.vertices.iter_mut().for_each(|v| *v = add(*v, by_m));
        self
    }

    /// The same mesh with the height of every vertex given by a function of its x and y, like a dented foil.
    ///
    /// # Errors
    /// As [`SheetMesh::new`].
    pub fn with_heights(mut self, height_m: impl Fn([f64; 2]) -> f64) -> Result<Self, MitError> {
        self.vertices.iter_mut().for_each(|v| v[2] = height_m([v[0], v[1]]));
        self.check()?;
        Ok(self)
    }

    /// This mesh and a separate second one.
    pub fn and(mut self, other: &Self) -> Self {
        let first = self.vertices.len() as u32;
        self.vertices.extend(&other.vertices);
        self.triangles.extend(other.triangles.iter().map(|corners| corners.map(|v| v + first)));
        self
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Vertices, metres.
    pub fn vertices_m(&self) -> &[Vector] {
        &self.vertices
    }

    pub(super) fn corners(&self, triangle: usize) -> [Vector; 3] {
        self.triangles[triangle].map(|v| self.vertices[v as usize])
    }

    /// Number of the unknown of each vertex; `None` on rims, which no current crosses.
    pub(super) fn unknowns(&self) -> (Vec<Option<u32>>, usize) {
        let mut on_rim = vec![false; self.vertices.len()];
        for (edge, count) in self.edges() {
            if count == 1 {
                edge.iter().for_each(|&v| on_rim[v as usize] = true);
            }
        }
        let mut count = 0;
        let number = |rim: bool| {
            (!rim).then(|| {
                count += 1;
                count - 1
            })
        };
        let numbers = on_rim.into_iter().map(number).collect();
        (numbers, count as usize)
    }

    /// Four times the area divided by the length of the rim: the side of a square, the diameter of a disc.
    pub(super) fn width_m(&self) -> f64 {
        let area: f64 = (0..self.triangles.len()).map(|t| area(self.corners(t))).sum();
        let length = |[a, b]: [u32; 2]| norm(subtract(self.vertices[a as usize], self.vertices[b as usize]));
        let rim: f64 = self.edges().into_iter().filter(|(_, count)| *count == 1).map(|(edge, _)| length(edge)).sum();
        4.0 * area / rim
    }

    /// Edges and the number of triangles at each.
    fn edges(&self) -> HashMap<[u32; 2], usize> {
        let mut edges = HashMap::new();
        for &[a, b, c] in &self.triangles {
            for [p, q] in [[a, b], [b, c], [c, a]] {
                *edges.entry([p.min(q), p.max(q)]).or_insert(0) += 1;
            }
        }
        edges
    }

    fn check(&self) -> Result<(), MitError> {
        positive("triangles", self.triangles.len() as f64)?;
        let mut directed = HashMap::new();
        // Identify each piece by the smallest vertex that can be reached.
        let mut parent: Vec<u32> = (0..self.vertices.len() as u32).collect();
        for (t, corners) in self.triangles.iter().enumerate() {
            if let Some(&last) = corners.iter().find(|&&v| v as usize >= self.vertices.len()) {
                let (expected, got) = (last as usize + 1, self.vertices.len());
                return Err(MitError::Count { what: "vertices", expected, got });
            }
            positive("area of a triangle (m^2)", area(self.corners(t)))?;
            let [a, b, c] = *corners;
            for [p, q] in [[a, b], [b, c], [c, a]] {
                *directed.entry([p, q]).or_insert(0) += 1;
                let (p, q) = (root(&mut parent, p), root(&mut parent, q));
                parent[p.max(q) as usize] = p.min(q);
            }
        }
        if let Some(most) = directed.values().copied().max().filter(|most| *most > 1) {
            return Err(MitError::Count { what: "triangles on one side of an edge", expected: 1, got: most });
        }
        let mut used = vec![false; self.vertices.len()];
        self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        let pieces = (0..used.len()).filter(|&v| used[v] && root(&mut parent, v as u32) as usize == v).count();
        let corners = used.iter().filter(|used| **used).count();
        // Euler: vertices - edges + triangles is 1 for a piece with one rim, 2 for a closed one, and less with holes.
        let euler = corners as f64 - self.edges().len() as f64 + self.triangles.len() as f64;
        if euler != pieces as f64 {
            let field = "vertices less edges plus triangles over the pieces of a sheet";
            let expected = "1: one rim each, no holes";
            return Err(MitError::Value { field, value: euler / pieces as f64, expected });
        }
        Ok(())
    }
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

pub(super) fn area([a, b, c]: [Vector; 3]) -> f64 {
    0.5 * norm(cross(subtract(b, a), subtract(c, a)))
}
