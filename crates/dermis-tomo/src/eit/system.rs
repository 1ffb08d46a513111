//! The CEM finite-element system. It precomputes where every element's stiffness and every electrode's contact goes,
//! so a new conductivity costs one pass over the elements and one numeric factorisation.
//!
//! Unknowns are the node potentials, then one voltage per electrode with a contact impedance; point electrodes use
//! their node. The last electrode is the reference (0 V). Its unknown is left out, which changes no measured value
//! because every stimulation is balanced.

use super::error::EitError;
use crate::mesh::{Contact, ElectrodedMesh, Mesh, SlitEdge, joint_entries};
use crate::sparse::{Ordering, SpdFactor, SpdStructure};

const DROPPED: u32 = u32::MAX;

/// `grad phi_a . grad phi_b` times the element's measure, and the square root used by the Jacobian.
#[derive(Debug)]
pub(super) struct ElementGeometry {
    /// Lower-triangular C (row-major, d(d+1)/2 values per element) with `measure * G^-1 = C C'`, where G is the Gram
    /// matrix of the edges.
    pub(super) roots: Vec<f64>,
    /// d, the dimension of the elements.
    pub(super) dimension: usize,
}

#[derive(Debug)]
pub(super) struct System {
    pub(super) structure: SpdStructure,
    /// Values that do not depend on conductivity: contacts, and joints of slits.
    contact_values: Vec<f64>,
    /// Local stiffness of each element per unit conductivity, pairs (a >= b).
    stiffness: Vec<f64>,
    /// Destination slots of these values; `DROPPED` for entries of the reference.
    slots: Vec<u32>,
    pairs_per_element: usize,
    /// Unknown of each electrode (`None`: the reference).
    pub(super) electrode_unknowns: Vec<Option<usize>>,
    /// Unknown of each node (`None`: the reference, where the last electrode is a point).
    pub(super) node_unknowns: Vec<Option<usize>>,
}

impl System {
    pub(super) fn new(
        body: &ElectrodedMesh,
        geometry: &ElementGeometry,
        joints: &[(SlitEdge, f64)],
    ) -> Result<Self, EitError> {
        let mesh = &body.mesh;
        let (node_unknowns, electrode_unknowns, size) = number_unknowns(body);
        let as_index = |unknown: Option<usize>| unknown.map_or(DROPPED, |u| u as u32);
        let mut entries = Entries::default();
        let local = mesh.kind().nodes_per_element();
        for cell in mesh.elements() {
            for a in 0..local {
                for b in 0..=a {
                    let node = |corner: usize| as_index(node_unknowns[cell[corner] as usize]);
                    entries.push(node(a), node(b), 0.0);
                }
            }
        }
        let element_entries = entries.values.len();
        for (electrode, unknown) in body.electrodes.iter().zip(&electrode_unknowns) {
            let to_unknown = |node: u32| as_index(node_unknowns[node as usize]);
            add_contact(mesh, electrode, as_index(*unknown), &to_unknown, &mut entries);
        }
        for &(edge, s_per_m) in joints {
            let to_unknown = |node: u32| as_index(node_unknowns[node as usize]);
            let joined = joint_entries(edge, mesh.face_measure(&edge[0]), s_per_m);
            joined
                .into_iter()
                .for_each(|((row, column), value)| entries.push(to_unknown(row), to_unknown(column), value));
        }
        let positions: Vec<(u32, u32)> =
            entries.positions.iter().copied().filter(|p| p.0 != DROPPED && p.1 != DROPPED).collect();
        let coordinates = unknown_coordinates(body, &node_unknowns, &electrode_unknowns, size);
        // Sources and readings are at the electrodes. Eliminated last, they need only a short substitution.
        let last: Vec<u32> = electrode_unknowns.iter().flatten().map(|&unknown| unknown as u32).collect();
        let ordering = Ordering::DissectionWithLast(&coordinates, &last);
        let (structure, kept_slots) = SpdStructure::new(size, &positions, ordering)?;
        let mut kept = kept_slots.into_iter();
        let slots: Vec<u32> = entries
            .positions
            .iter()
            .map(|p| if p.0 == DROPPED || p.1 == DROPPED { DROPPED } else { kept.next().unwrap_or(DROPPED) })
            .collect();
        let mut contact_values = vec![0.0; structure.value_count()];
        for (slot, value) in slots.iter().zip(&entries.values).skip(element_entries) {
            if *slot != DROPPED {
                contact_values[*slot as usize] += value;
            }
        }
        Ok(Self {
            structure,
            contact_values,
            stiffness: unit_stiffness(mesh, geometry),
            slots: slots[..element_entries].to_vec(),
            pairs_per_element: local * (local + 1) / 2,
            electrode_unknowns,
            node_unknowns,
        })
    }

    /// Assembles the system for this conductivity into `values`.
    pub(super) fn assemble(&self, conductivity: &[f64], values: &mut Vec<f64>) {
        values.clear();
        values.extend_from_slice(&self.contact_values);
        let pairs = self.pairs_per_element;
        for (element, &sigma) in conductivity.iter().enumerate() {
            let range = element * pairs..(element + 1) * pairs;
            for (slot, stiffness) in self.slots[range.clone()].iter().zip(&self.stiffness[range]) {
                if *slot != DROPPED {
                    values[*slot as usize] += sigma * stiffness;
                }
            }
        }
    }

    pub(super) fn factor(&self, values: &[f64]) -> Result<SpdFactor, EitError> {
        Ok(self.structure.factor(values)?)
    }
}

impl ElementGeometry {
    pub(super) fn new(mesh: &Mesh) -> Self {
        let dimension = mesh.dimension();
        let per = dimension * (dimension + 1) / 2;
        let mut roots = Vec::with_capacity(mesh.element_count() * per);
        for (cell, measure) in mesh.elements().zip(mesh.measures()) {
            let point = |corner: usize| mesh.nodes()[cell[corner] as usize];
            let edges: Vec<[f64; 3]> =
                (1..=dimension).map(|corner| crate::mesh::subtract(point(corner), point(0))).collect();
            roots.extend(inverse_gram_root(&edges, *measure));
        }
        Self { roots, dimension }
    }

    /// Row-major lower-triangular entries of an element.
    pub(super) fn root(&self, element: usize) -> &[f64] {
        let per = self.dimension * (self.dimension + 1) / 2;
        &self.roots[element * per..(element + 1) * per]
    }
}

/// Lower-triangular C with `measure * (E'E)^-1 = C C'` for the edge vectors E of a simplex.
fn inverse_gram_root(edges: &[[f64; 3]], measure: f64) -> Vec<f64> {
    let dot = |a: usize, b: usize| crate::mesh::dot(edges[a], edges[b]);
    if edges.len() == 2 {
        let (g00, g01, g11) = (dot(0, 0), dot(0, 1), dot(1, 1));
        let scale = measure / (g00 * g11 - g01 * g01);
        cholesky2(g11 * scale, -g01 * scale, g00 * scale).to_vec()
    } else {
        let g = |a: usize, b: usize| dot(a, b);
        let cofactor = |r: usize, c: usize| {
            let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
            g(r1, c1) * g(r2, c2) - g(r1, c2) * g(r2, c1)
        };
        let determinant = g(0, 0) * cofactor(0, 0) + g(0, 1) * cofactor(0, 1) + g(0, 2) * cofactor(0, 2);
        let a = |r: usize, c: usize| cofactor(r, c) * measure / determinant;
        let l00 = a(0, 0).sqrt();
        let (l10, l20) = (a(1, 0) / l00, a(2, 0) / l00);
        let l11 = (a(1, 1) - l10 * l10).sqrt();
        let l21 = (a(2, 1) - l20 * l10) / l11;
        vec![l00, l10, l11, l20, l21, (a(2, 2) - l20 * l20 - l21 * l21).sqrt()]
    }
}

fn cholesky2(a00: f64, a10: f64, a11: f64) -> [f64; 3] {
    let l00 = a00.sqrt();
    let l10 = a10 / l00;
    [l00, l10, (a11 - l10 * l10).sqrt()]
}

fn unit_stiffness(mesh: &Mesh, geometry: &ElementGeometry) -> Vec<f64> {
    let dimension = geometry.dimension;
    let mut all = Vec::with_capacity(mesh.element_count() * (dimension + 1) * (dimension + 2) / 2);
    for element in 0..mesh.element_count() {
        let root = geometry.root(element);
        // Rows of C for nodes 1..=d; the row of node 0 is minus their sum, because the shape functions sum to one.
        let mut rows = [[0.0; 3]; 4];
        for r in 0..dimension {
            for c in 0..=r {
                rows[r + 1][c] = root[r * (r + 1) / 2 + c];
                rows[0][c] -= rows[r + 1][c];
            }
        }
        for a in 0..=dimension {
            for b in 0..=a {
                all.push((0..dimension).map(|c| rows[a][c] * rows[b][c]).sum());
            }
        }
    }
    all
}

#[derive(Default)]
struct Entries {
    positions: Vec<(u32, u32)>,
    values: Vec<f64>,
}

impl Entries {
    fn push(&mut self, row: u32, column: u32, value: f64) {
        self.positions.push((row, column));
        self.values.push(value);
    }
}

/// Exact integrals of products of linear functions over each face or pad element (CEM;
/// `measure (1 + delta_ij) / (n (n + 1))` over n nodes).
fn add_contact(
    mesh: &Mesh,
    electrode: &crate::mesh::Electrode,
    unknown: u32,
    to_unknown: &dyn Fn(u32) -> u32,
    entries: &mut Entries,
) {
    let patches: Vec<(Vec<u32>, f64)> = match &electrode.contact {
        Contact::Point(_) => return,
        Contact::Faces(faces) => faces.iter().map(|face| (face.clone(), mesh.face_measure(face))).collect(),
        Contact::Area(elements) => elements
            .iter()
            .map(|&element| (mesh.element(element as usize).to_vec(), mesh.measures()[element as usize]))
            .collect(),
    };
    for (nodes, measure) in patches {
        let conductance = measure / electrode.contact_impedance;
        let count = nodes.len() as f64;
        for (i, &a) in nodes.iter().enumerate() {
            for &b in &nodes[..=i] {
                let weight = if a == b { 2.0 } else { 1.0 };
                entries.push(to_unknown(a), to_unknown(b), conductance * weight / (count * (count + 1.0)));
            }
            entries.push(to_unknown(a), unknown, -conductance / count);
        }
        entries.push(unknown, unknown, conductance);
    }
}

type Numbering = (Vec<Option<usize>>, Vec<Option<usize>>, usize);

fn number_unknowns(body: &ElectrodedMesh) -> Numbering {
    let last = body.electrodes.len() - 1;
    let reference_node = match body.electrodes[last].contact {
        Contact::Point(node) => Some(node as usize),
        _ => None,
    };
    let mut next = 0;
    let mut take = |skip: bool| {
        if skip {
            return None;
        }
        next += 1;
        Some(next - 1)
    };
    let nodes: Vec<_> = (0..body.mesh.nodes().len()).map(|node| take(reference_node == Some(node))).collect();
    let electrodes = body
        .electrodes
        .iter()
        .enumerate()
        .map(|(index, electrode)| match electrode.contact {
            Contact::Point(node) => nodes[node as usize],
            _ => take(index == last),
        })
        .collect();
    (nodes, electrodes, next)
}

fn unknown_coordinates(
    body: &ElectrodedMesh,
    node_unknowns: &[Option<usize>],
    electrode_unknowns: &[Option<usize>],
    size: usize,
) -> Vec<[f64; 3]> {
    let mut coordinates = vec![[0.0; 3]; size];
    for (electrode, unknown) in body.electrodes.iter().zip(electrode_unknowns) {
        let first = match &electrode.contact {
            Contact::Faces(faces) => faces[0][0],
            Contact::Area(elements) => body.mesh.element(elements[0] as usize)[0],
            Contact::Point(node) => *node,
        };
        if let Some(unknown) = unknown {
            coordinates[*unknown] = body.mesh.nodes()[first as usize];
        }
    }
    for (node, unknown) in node_unknowns.iter().enumerate() {
        if let Some(unknown) = unknown {
            coordinates[*unknown] = body.mesh.nodes()[node];
        }
    }
    coordinates
}
