//! Tetrahedra with their edges, faces and materials.

use std::collections::HashMap;

use super::elements::{EDGES, FACES, Geometry, quadrature};
use crate::error::MitError;
use crate::vector::{Vector, add, cross, dot, scaled, subtract};

/// A tetrahedral mesh. Region 0 is air; region k has the k-th material.
#[derive(Clone, Debug)]
pub struct EdgeMesh {
    /// Vertices, metres.
    pub(super) vertices: Vec<Vector>,
    /// Corners of each tetrahedron, in ascending order.
    pub(super) tetrahedra: Vec<[u32; 4]>,
    /// Region of each tetrahedron.
    pub(super) regions: Vec<u8>,
    pub(super) edges: Vec<[u32; 2]>,
    pub(super) faces: Vec<[u32; 3]>,
    pub(super) edges_of: Vec<[u32; 6]>,
    pub(super) faces_of: Vec<[u32; 4]>,
    /// Midpoint of each edge; off the chord if the mesh follows a curved body.
    pub(super) middles: Vec<Vector>,
    /// True if only the octant with positive coordinates is meshed.
    pub(super) is_octant: bool,
    /// Boundary that edges and faces lie on: [`OUTER`], or bit k for the symmetry plane across axis k.
    pub(super) edge_bounds: Vec<u8>,
    pub(super) face_bounds: Vec<u8>,
}

/// The outer boundary.
pub(super) const OUTER: u8 = 8;

impl EdgeMesh {
    /// Builds a mesh from vertices (metres), corners and regions. `middle` returns the midpoint of a curved edge,
    /// given its ends.
    ///
    /// # Errors
    /// Numbers of regions and tetrahedra that differ, corners that do not exist, or elements without volume.
    pub fn new(
        vertices: Vec<Vector>,
        tetrahedra: Vec<[u32; 4]>,
        regions: Vec<u8>,
        middle: impl Fn(Vector, Vector) -> Vector,
    ) -> Result<Self, MitError> {
        Self::part(vertices, tetrahedra, regions, false, middle)
    }

    /// As [`EdgeMesh::new`], with a flag whether this is an octant.
    fn part(
        vertices: Vec<Vector>,
        mut tetrahedra: Vec<[u32; 4]>,
        regions: Vec<u8>,
        is_octant: bool,
        middle: impl Fn(Vector, Vector) -> Vector,
    ) -> Result<Self, MitError> {
        if regions.len() != tetrahedra.len() {
            let (expected, got) = (tetrahedra.len(), regions.len());
            return Err(MitError::Count { what: "regions of tetrahedra", expected, got });
        }
        tetrahedra.iter_mut().for_each(|corners| corners.sort_unstable());
        if let Some(last) = tetrahedra.iter().map(|corners| corners[3] as usize).find(|&last| last >= vertices.len()) {
            return Err(MitError::Count { what: "vertices", expected: last + 1, got: vertices.len() });
        }
        let (mut edge_numbers, mut face_numbers) = (HashMap::new(), HashMap::new());
        let (mut edges, mut faces, mut shared) = (Vec::new(), Vec::new(), Vec::new());
        let (mut edges_of, mut faces_of) = (Vec::new(), Vec::new());
        for corners in &tetrahedra {
            edges_of.push(EDGES.map(|ends| {
                let key = ends.map(|i| corners[i]);
                *edge_numbers.entry(key).or_insert_with(|| {
                    edges.push(key);
                    edges.len() as u32 - 1
                })
            }));
            faces_of.push(FACES.map(|three| {
                let key = three.map(|i| corners[i]);
                let face = *face_numbers.entry(key).or_insert_with(|| {
                    faces.push(key);
                    shared.push(0_u8);
                    faces.len() as u32 - 1
                });
                shared[face as usize] = shared[face as usize].saturating_add(1);
                face
            }));
        }
        let bound = |face: &[u32; 3]| {
            let flat = |axis: &usize| is_octant && face.iter().all(|&v| vertices[v as usize][*axis] == 0.0);
            (0..3).find(flat).map_or(OUTER, |axis| 1 << axis)
        };
        let (mut face_bounds, mut edge_bounds) = (vec![0; faces.len()], vec![0; edges.len()]);
        for (number, face) in faces.iter().enumerate().filter(|(number, _)| shared[*number] == 1) {
            face_bounds[number] = bound(face);
            for [i, j] in [[0, 1], [0, 2], [1, 2]] {
                edge_bounds[edge_numbers[&[face[i], face[j]]] as usize] |= face_bounds[number];
            }
        }
        let middles = edges.iter().map(|&[a, b]| middle(vertices[a as usize], vertices[b as usize])).collect();
        let mesh = Self {
            vertices,
            tetrahedra,
            regions,
            edges,
            faces,
            edges_of,
            faces_of,
            middles,
            is_octant,
            edge_bounds,
            face_bounds,
        };
        mesh.check()?;
        Ok(mesh)
    }

    fn check(&self) -> Result<(), MitError> {
        for element in 0..self.tetrahedra.len() {
            let geometry = self.geometry(element);
            let centre = geometry.map([0.25; 4]).determinant;
            for corner in 0..4 {
                let mut l = [0.0; 4];
                l[corner] = 1.0;
                let value = geometry.map(l).determinant / centre;
                if value <= 0.0 || !value.is_finite() {
                    let expected = "above 0: an element is folded or flat";
                    return Err(MitError::Value {
                        field: "Jacobian at a corner over that at the centre",
                        value,
                        expected,
                    });
                }
            }
        }
        Ok(())
    }

    /// The octant with positive coordinates, for a mesh whose body is symmetric about the three coordinate planes.
    ///
    /// # Errors
    /// A mesh with elements cut by these planes.
    pub fn octant(&self) -> Result<Self, MitError> {
        let slack = 1e-9 * self.vertices.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
        let snapped = |v: &Vector| v.map(|x| if x.abs() < slack { 0.0 } else { x });
        let all: Vec<Vector> = self.vertices.iter().map(snapped).collect();
        let inside = |&t: &usize| {
            let corners = self.tetrahedra[t].map(|v| all[v as usize]);
            corners.iter().flatten().all(|&x| x >= 0.0)
        };
        let kept: Vec<usize> = (0..self.tetrahedra.len()).filter(inside).collect();
        if 8 * kept.len() != self.tetrahedra.len() {
            let (expected, got) = (self.tetrahedra.len() / 8, kept.len());
            return Err(MitError::Count { what: "tetrahedra in an eighth of a symmetric mesh", expected, got });
        }
        let mut number = vec![u32::MAX; all.len()];
        let (mut vertices, mut tetrahedra) = (Vec::new(), Vec::new());
        let mut middles = HashMap::new();
        for &t in &kept {
            for v in self.tetrahedra[t].map(|v| v as usize) {
                if number[v] == u32::MAX {
                    number[v] = vertices.len() as u32;
                    vertices.push(all[v]);
                }
            }
            tetrahedra.push(self.tetrahedra[t].map(|v| number[v as usize]));
            for edge in self.edges_of[t].map(|e| e as usize) {
                let mut ends = self.edges[edge].map(|v| number[v as usize]);
                ends.sort_unstable();
                middles.insert(ends, snapped(&self.middles[edge]));
            }
        }
        let regions = kept.iter().map(|&t| self.regions[t]).collect();
        let mut mesh = Self::part(vertices, tetrahedra, regions, true, chord)?;
        mesh.middles = mesh.edges.iter().map(|ends| middles[ends]).collect();
        mesh.check()?;
        Ok(mesh)
    }

    /// Number of tetrahedra.
    pub fn tetrahedron_count(&self) -> usize {
        self.tetrahedra.len()
    }

    /// Number of edges.
    pub fn edge_count(&self) -> usize {
        self.edges.len()
    }

    /// Highest region.
    pub(super) fn region_count(&self) -> usize {
        self.regions.iter().copied().max().unwrap_or(0) as usize
    }

    pub(super) fn geometry(&self, element: usize) -> Geometry {
        Geometry {
            corners: self.tetrahedra[element].map(|v| self.vertices[v as usize]),
            middles: self.edges_of[element].map(|e| self.middles[e as usize]),
        }
    }

    /// Volume of a region, cubic metres, and its maximum distance from the origin, metres.
    pub fn extent(&self, region: u8) -> (f64, f64) {
        let (mut volume, mut radius) = (0.0, 0.0_f64);
        let points = quadrature();
        for element in (0..self.tetrahedra.len()).filter(|&element| self.regions[element] == region) {
            let geometry = self.geometry(element);
            volume += points.iter().map(|p| p.weight * geometry.map(p.barycentric).determinant.abs()).sum::<f64>();
            radius = geometry.corners.iter().map(|c| dot(*c, *c).sqrt()).fold(radius, f64::max);
        }
        (volume, radius)
    }

    /// Thickness of the thickest surface element of a region: height over its outer face, metres.
    pub(super) fn surface_height_m(&self, region: u8) -> f64 {
        let mut sides = vec![[u8::MAX; 2]; self.faces.len()];
        for (faces, &region) in self.faces_of.iter().zip(&self.regions) {
            for &face in faces {
                let sides = &mut sides[face as usize];
                let free = usize::from(sides[0] != u8::MAX);
                sides[free] = region;
            }
        }
        let mut worst = 0.0_f64;
        for element in (0..self.tetrahedra.len()).filter(|&element| self.regions[element] == region) {
            let corners = self.geometry(element).corners;
            for (three, &face) in FACES.iter().zip(&self.faces_of[element]) {
                let [a, b] = sides[face as usize];
                // An interior face, or one on a plane of symmetry.
                if a == b || b == u8::MAX {
                    continue;
                }
                let [p, q, r] = three.map(|i| corners[i]);
                let normal = cross(subtract(q, p), subtract(r, p));
                let opposite = corners[(0..4).find(|i| !three.contains(i)).unwrap_or(0)];
                worst = worst.max((dot(subtract(opposite, p), normal) / dot(normal, normal).sqrt()).abs());
            }
        }
        worst
    }

    /// The element that contains a point, and the point's barycentric coordinates in it.
    pub(super) fn locate(&self, point_m: Vector) -> Option<(usize, [f64; 4])> {
        const SLACK: f64 = 1e-9;
        (0..self.tetrahedra.len()).find_map(|element| {
            let geometry = self.geometry(element);
            let reach = geometry.corners.iter().fold([f64::INFINITY; 6], |box_, c| {
                std::array::from_fn(|k| if k < 3 { box_[k].min(c[k]) } else { box_[k].min(-c[k - 3]) })
            });
            let size = (0..3).map(|k| -reach[k + 3] - reach[k]).fold(0.0, f64::max);
            let near = |k: usize| point_m[k] >= reach[k] - 0.2 * size && point_m[k] <= -reach[k + 3] + 0.2 * size;
            if !(0..3).all(near) {
                return None;
            }
            let mut l = [0.25; 4];
            for _ in 0..12 {
                let map = geometry.map(l);
                let step = map.step(subtract(point_m, map.position_m));
                (0..3).for_each(|k| l[k + 1] += step[k]);
                l[0] = 1.0 - l[1] - l[2] - l[3];
            }
            l.iter().all(|&l| l >= -SLACK).then_some((element, l))
        })
    }
}

/// Midpoint of a straight edge.
pub(super) fn chord(a: Vector, b: Vector) -> Vector {
    scaled(add(a, b), 0.5)
}
