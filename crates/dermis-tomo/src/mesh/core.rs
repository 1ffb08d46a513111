//! The mesh itself: nodes, elements, their measures (area or volume), and electrodes as parts of the mesh. Every mesh
//! is validated on construction, so later code need not check again.

mod error;

pub use error::MeshError;

use std::collections::HashMap;

/// Kind of the elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellKind {
    /// Three nodes per element; flat sheets and surfaces in 3D.
    Triangle,
    /// Four nodes per element; solids.
    Tetrahedron,
}

impl CellKind {
    /// Nodes of one element: 3 or 4.
    pub fn nodes_per_element(self) -> usize {
        match self {
            CellKind::Triangle => 3,
            CellKind::Tetrahedron => 4,
        }
    }

    /// Nodes of one face (edge of a triangle, triangle of a tetrahedron): 2 or 3.
    pub fn nodes_per_face(self) -> usize {
        self.nodes_per_element() - 1
    }
}

/// Contact of an electrode with the mesh.
#[derive(Clone, Debug, PartialEq)]
pub enum Contact {
    /// Faces (edges in 2D, triangles in 3D), `nodes_per_face` node indices each: electrodes on rims and walls, and
    /// lines inside a sheet. Contact impedance in ohm.m^2 (3D) or ohm.m (2D, thickness 1).
    Faces(Vec<Vec<u32>>),
    /// Elements of a sheet above an electrode pad; contact impedance in ohm.m^2 of pad.
    Area(Vec<u32>),
    /// One node; no contact impedance.
    Point(u32),
}

/// An electrode: its contact and contact impedance.
#[derive(Clone, Debug, PartialEq)]
pub struct Electrode {
    /// Contact with the mesh.
    pub contact: Contact,
    /// Specific contact impedance; ignored by point electrodes. Units: see [`Contact`].
    pub contact_impedance: f64,
}

/// A connected mesh of triangles or tetrahedra with positive measures, where at most two elements share a face.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    kind: CellKind,
    nodes: Vec<[f64; 3]>,
    elements: Vec<u32>,
    measures: Vec<f64>,
}

/// A mesh with its electrodes, validated together.
#[derive(Clone, Debug, PartialEq)]
pub struct ElectrodedMesh {
    /// The mesh.
    pub mesh: Mesh,
    /// The electrodes. Electrode 1 in the user's numbering has index 0 here.
    pub electrodes: Vec<Electrode>,
}

impl Mesh {
    /// Builds a mesh from node coordinates in metres and a flat list of zero-based node indices,
    /// `kind.nodes_per_element()` per element, in any orientation. Flat meshes have `z = 0` (or any constant).
    ///
    /// # Errors
    /// Indices out of range, non-finite coordinates, elements without measure, elements that fold over each other,
    /// faces shared by more than two elements, nodes in no element, or a mesh with several unconnected parts.
    pub fn new(kind: CellKind, nodes: Vec<[f64; 3]>, elements: Vec<u32>) -> Result<Self, MeshError> {
        let per = kind.nodes_per_element();
        if elements.is_empty() || !elements.len().is_multiple_of(per) {
            return Err(MeshError::Count {
                what: "element node indices",
                expected: format!("a positive multiple of {per}"),
                got: elements.len(),
            });
        }
        for (node, xyz) in nodes.iter().enumerate() {
            if let Some(&value) = xyz.iter().find(|v| !v.is_finite()) {
                return Err(MeshError::NotFinite { node, value });
            }
        }
        for (position, &node) in elements.iter().enumerate() {
            if node as usize >= nodes.len() {
                return Err(MeshError::NodeOutOfRange {
                    what: "element",
                    index: position / per,
                    node: node as usize,
                    node_count: nodes.len(),
                });
            }
        }
        let measures: Vec<f64> = elements.chunks_exact(per).map(|cell| measure(&nodes, cell)).collect();
        let mesh = Self { kind, nodes, elements, measures };
        mesh.check_measures()?;
        mesh.check_topology()?;
        Ok(mesh)
    }

    /// Triangles or tetrahedra.
    pub fn kind(&self) -> CellKind {
        self.kind
    }

    /// Space dimension of the elements: 2 for sheets (flat or curved), 3 for solids.
    pub fn dimension(&self) -> usize {
        self.kind.nodes_per_face()
    }

    /// Node coordinates in metres.
    pub fn nodes(&self) -> &[[f64; 3]] {
        &self.nodes
    }

    /// Number of elements.
    pub fn element_count(&self) -> usize {
        self.measures.len()
    }

    /// The node indices of one element.
    pub fn element(&self, index: usize) -> &[u32] {
        let per = self.kind.nodes_per_element();
        &self.elements[index * per..(index + 1) * per]
    }

    /// All elements in order, as slices of node indices.
    pub fn elements(&self) -> std::slice::ChunksExact<'_, u32> {
        self.elements.chunks_exact(self.kind.nodes_per_element())
    }

    /// Area (m^2) or volume (m^3) of each element.
    pub fn measures(&self) -> &[f64] {
        &self.measures
    }

    /// Side of a square with the elements' mean area, metres; for a mesh of triangles.
    pub fn element_size_m(&self) -> f64 {
        (self.measures.iter().sum::<f64>() / self.measures.len().max(1) as f64).sqrt()
    }

    /// Centroid of one element, metres.
    pub fn centroid(&self, index: usize) -> [f64; 3] {
        let cell = self.element(index);
        let mut centre = [0.0; 3];
        for &node in cell {
            for axis in 0..3 {
                centre[axis] += self.nodes[node as usize][axis] / cell.len() as f64;
            }
        }
        centre
    }

    /// Length (m) or area (m^2) of a face given by its nodes.
    pub fn face_measure(&self, face: &[u32]) -> f64 {
        measure(&self.nodes, face)
    }

    /// Minimum and maximum coordinates, metres.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for node in &self.nodes {
            for axis in 0..3 {
                low[axis] = low[axis].min(node[axis]);
                high[axis] = high[axis].max(node[axis]);
            }
        }
        (low, high)
    }

    /// Faces that belong to only one element, sorted by node indices, each with its element.
    pub fn boundary_faces(&self) -> Vec<(Vec<u32>, u32)> {
        let per = self.kind.nodes_per_face();
        let table = self.face_table();
        let alone = table.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() == 1);
        alone.map(|group| (group[0].0[..per].to_vec(), group[0].1)).collect()
    }

    /// Pairs of elements that share a face, smaller index first, sorted.
    pub fn neighbours(&self) -> Vec<[u32; 2]> {
        let table = self.face_table();
        let shared = table.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() == 2);
        let mut pairs: Vec<[u32; 2]> = shared.map(|group| [group[0].1, group[1].1]).collect();
        pairs.sort_unstable();
        pairs
    }

    /// Every face of every element as its sorted nodes (padded to three in 2D) and the element, sorted.
    fn face_table(&self) -> Vec<([u32; 3], u32)> {
        let mut table = Vec::with_capacity(self.elements.len());
        for (index, cell) in self.elements().enumerate() {
            for omitted in 0..cell.len() {
                let mut face = [u32::MAX; 3];
                let corners = cell.iter().enumerate().filter(|(corner, _)| *corner != omitted);
                face.iter_mut().zip(corners).for_each(|(slot, (_, &node))| *slot = node);
                face.sort_unstable();
                table.push((face, index as u32));
            }
        }
        table.sort_unstable();
        table
    }

    fn check_measures(&self) -> Result<(), MeshError> {
        let mean = self.measures.iter().sum::<f64>() / self.measures.len() as f64;
        match self.measures.iter().position(|m| m.is_nan() || *m <= 1e-12 * mean) {
            Some(element) => Err(MeshError::Degenerate { element, measure: self.measures[element], mean }),
            None => Ok(()),
        }
    }

    fn check_topology(&self) -> Result<(), MeshError> {
        let per = self.kind.nodes_per_face();
        for group in self.face_table().chunk_by(|a, b| a.0 == b.0) {
            let face = &group[0].0[..per];
            if group.len() > 2 {
                return Err(MeshError::Overlapping { nodes: face.to_vec(), count: group.len() });
            }
            if group.len() == 2 && self.folds(face, group[0].1, group[1].1) {
                let (first, second) = (group[0].1 as usize, group[1].1 as usize);
                return Err(MeshError::Folded { first, second, nodes: face.to_vec() });
            }
        }
        self.check_connected()
    }

    /// True if two elements that share a face lie on the same side of it (in-plane, for triangles in 3D).
    fn folds(&self, face: &[u32], first: u32, second: u32) -> bool {
        let apex = |element: u32| {
            let node = self.element(element as usize).iter().find(|node| !face.contains(node));
            node.map(|&node| self.nodes[node as usize])
        };
        let (Some(a), Some(b)) = (apex(first), apex(second)) else { return true };
        let origin = self.nodes[face[0] as usize];
        let along = subtract(self.nodes[face[1] as usize], origin);
        let (to_a, to_b) = (subtract(a, origin), subtract(b, origin));
        if face.len() == 2 {
            // The components perpendicular to the shared edge must point to opposite sides.
            let perpendicular = |v: [f64; 3]| {
                let share = dot(v, along) / dot(along, along);
                [v[0] - share * along[0], v[1] - share * along[1], v[2] - share * along[2]]
            };
            let (p, q) = (perpendicular(to_a), perpendicular(to_b));
            dot(p, q) > 0.999_999 * (dot(p, p) * dot(q, q)).sqrt()
        } else {
            let normal = cross(along, subtract(self.nodes[face[2] as usize], origin));
            dot(normal, to_a) * dot(normal, to_b) > 0.0
        }
    }

    fn check_connected(&self) -> Result<(), MeshError> {
        let mut parent: Vec<u32> = (0..self.nodes.len() as u32).collect();
        fn root(parent: &mut [u32], mut node: u32) -> u32 {
            while parent[node as usize] != node {
                parent[node as usize] = parent[parent[node as usize] as usize];
                node = parent[node as usize];
            }
            node
        }
        let mut used = vec![false; self.nodes.len()];
        for cell in self.elements() {
            let first = root(&mut parent, cell[0]);
            for &node in cell {
                used[node as usize] = true;
                let other = root(&mut parent, node);
                parent[other as usize] = first;
            }
        }
        if let Some(node) = used.iter().position(|used| !used) {
            return Err(MeshError::Orphan { node });
        }
        let from = root(&mut parent, 0);
        let mut roots: Vec<u32> = (0..self.nodes.len() as u32).map(|node| root(&mut parent, node)).collect();
        let stranded = roots.iter().position(|&r| r != from);
        roots.sort_unstable();
        roots.dedup();
        match stranded {
            Some(node) => Err(MeshError::Disconnected { parts: roots.len(), node, from: 0 }),
            None => Ok(()),
        }
    }
}

impl ElectrodedMesh {
    /// Combines a mesh and its electrodes.
    ///
    /// # Errors
    /// An electrode that touches nothing, names faces, elements or nodes that do not exist, shares a face, an element
    /// or (points) a node with another electrode, or has a contact impedance that is not positive and finite.
    pub fn new(mesh: Mesh, electrodes: Vec<Electrode>) -> Result<Self, MeshError> {
        let per_face = mesh.kind().nodes_per_face();
        let touched = |electrode: &Electrode| matches!(electrode.contact, Contact::Faces(_));
        let table = if electrodes.iter().any(touched) { mesh.face_table() } else { Vec::new() };
        let has_face = |face: &[u32]| {
            let mut padded = [u32::MAX; 3];
            padded[..per_face].copy_from_slice(face);
            table.binary_search_by(|entry| entry.0.cmp(&padded)).is_ok()
        };
        let mut taken: HashMap<Vec<u32>, usize> = HashMap::new();
        for (index, electrode) in electrodes.iter().enumerate() {
            let refuse = |reason: String| Err(MeshError::Electrode { electrode: index, reason });
            let z = electrode.contact_impedance;
            let keys: Vec<Vec<u32>> = match &electrode.contact {
                Contact::Faces(faces) => faces
                    .iter()
                    .map(|face| {
                        let mut key = face.clone();
                        key.sort_unstable();
                        key
                    })
                    .collect(),
                Contact::Area(elements) => elements.iter().map(|&element| vec![u32::MAX, element]).collect(),
                Contact::Point(node) => vec![vec![*node]],
            };
            let is_usable = z > 0.0 && z.is_finite();
            if !is_usable && !matches!(electrode.contact, Contact::Point(_)) {
                return refuse(format!("contact impedance {z} must be positive and finite"));
            }
            if keys.is_empty() {
                return refuse("touches no part of the mesh".into());
            }
            for key in keys {
                match &electrode.contact {
                    Contact::Faces(_) if key.len() != per_face => {
                        return refuse(format!("a face has {} nodes, expected {per_face}", key.len()));
                    }
                    Contact::Faces(_) if !has_face(&key) => {
                        return refuse(format!("face {key:?} is not a face of the mesh"));
                    }
                    Contact::Area(_) if mesh.kind() != CellKind::Triangle => {
                        return refuse("area contacts are for sheets; use faces on a solid".into());
                    }
                    Contact::Area(_) if key[1] as usize >= mesh.element_count() => {
                        return refuse(format!("element {} of {} does not exist", key[1], mesh.element_count()));
                    }
                    Contact::Point(node) if *node as usize >= mesh.nodes().len() => {
                        return refuse(format!("node {node} of {} does not exist", mesh.nodes().len()));
                    }
                    _ => {}
                }
                if let Some(other) = taken.insert(key, index) {
                    return refuse(format!("overlaps electrode {other}"));
                }
            }
        }
        Ok(Self { mesh, electrodes })
    }

    /// Bends a flat sheet around a cylinder whose axis runs along y, `radius_m` below the sheet. x becomes arc
    /// length, the line x = 0 stays in place, and elements and electrodes keep their numbers. Nodes keep their
    /// distances along the surface; elements are the chords between them, narrower by a share `(h / radius)^2 / 24`.
    ///
    /// # Errors
    /// A mesh of tetrahedra, or a radius that is not positive and finite or so small that the sheet would reach all
    /// the way round.
    pub fn bent_onto_cylinder(&self, radius_m: f64) -> Result<Self, MeshError> {
        let (low, high) = self.mesh.bounds();
        let shape =
            |field: &'static str, value: String, expected: String| Err(MeshError::Shape { field, value, expected });
        if self.mesh.kind() != CellKind::Triangle {
            return shape("mesh", "a mesh of tetrahedra".into(), "a sheet that can be bent".into());
        }
        let least = (high[0] - low[0]) / std::f64::consts::TAU;
        if !radius_m.is_finite() || radius_m <= least {
            return shape("radius_m", radius_m.to_string(), format!("a finite radius above {least} m"));
        }
        let bend = |p: &[f64; 3]| {
            let (sine, cosine) = (p[0] / radius_m).sin_cos();
            [(radius_m + p[2]) * sine, p[1], (radius_m + p[2]) * cosine - radius_m]
        };
        let nodes = self.mesh.nodes.iter().map(bend).collect();
        let mesh = Mesh::new(CellKind::Triangle, nodes, self.mesh.elements.clone())?;
        Ok(Self { mesh, electrodes: self.electrodes.clone() })
    }

    /// Length (m) or area (m^2) of every electrode in the mesh; 0 for points.
    pub fn electrode_measures(&self) -> Vec<f64> {
        let measure = |electrode: &Electrode| match &electrode.contact {
            Contact::Faces(faces) => faces.iter().map(|face| self.mesh.face_measure(face)).sum(),
            Contact::Area(elements) => elements.iter().map(|&element| self.mesh.measures()[element as usize]).sum(),
            Contact::Point(_) => 0.0,
        };
        self.electrodes.iter().map(measure).collect()
    }
}

/// Length, area or volume of the simplex over 2, 3 or 4 nodes in 3D: sqrt(det(E'E)) / d!, where E holds its edge
/// vectors.
fn measure(nodes: &[[f64; 3]], simplex: &[u32]) -> f64 {
    let edge = |corner: usize| subtract(nodes[simplex[corner] as usize], nodes[simplex[0] as usize]);
    match simplex.len() {
        2 => dot(edge(1), edge(1)).sqrt(),
        3 => {
            let normal = cross(edge(1), edge(2));
            0.5 * dot(normal, normal).sqrt()
        }
        _ => dot(cross(edge(1), edge(2)), edge(3)).abs() / 6.0,
    }
}

pub(crate) fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests;
