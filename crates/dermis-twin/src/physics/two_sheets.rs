//! The coupled two-sheet problem, solved once per frame for the transfer impedances between electrodes.
//!
//! A floating metal sheet is nearly an equipotential: v = c + w with w of order `s_s / s_c` of u. Eliminating u and c
//! leaves `(K_v + B) w = r`, where B is bounded by the sensing sheet's conductance. So the expansion in
//! `B / K_v ~ s_s / s_c` starts with the exact equipotential problem and converges immediately:
//! `Z = Z_equipotential + r' K_v^-1 r + O((s_s/s_c)^2)`. K_v is factored once, the single sheet plus contact once per
//! frame. With 35 um of copper over 5 mS, `(s_s/s_c)^2` is 6e-12. Tests compare with [`super::direct_impedance`],
//! which solves all unknowns at once.

mod copper;

use std::collections::HashMap;

use dermis_tomo::mesh::{self, ElectrodedMesh, Point, SlitEdge};
use dermis_tomo::sparse::{LocalMemory, Ordering, SparseError, SpdFactor, SpdStructure};
use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use super::cut::{Cut, NearCuts};
use super::element::{PAIRS, SheetConductance, stiffness, weighted_mass};
use super::paths::SlitPath;
use super::sheet_body::{ContactEntry, contact_entries, coordinates, refuse, triangles_of};

/// The shortcut sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shortcut {
    /// A perfect conductor: one potential for the whole sheet.
    Equipotential,
    /// A continuous sheet with this conductance in siemens (thickness times conductivity), much higher than the
    /// sensing sheet's.
    Sheet {
        /// Sheet conductance.
        conductance_s: f64,
    },
}

/// Two sheets on one mesh, with electrodes on the sensing sheet. The last electrode is the reference.
#[derive(Debug)]
pub struct TwoSheets {
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) positions: Vec<Point>,
    pub(super) areas: Vec<f64>,
    pub(super) electrode_count: usize,
    pub(super) contacts: Vec<ContactEntry>,
    pub(super) sensing: Vec<SheetConductance>,
    /// Edges of slits, with the conductance across them per length, S/m.
    pub(super) joints: Vec<(SlitEdge, f64)>,
    joint_slots: Vec<u32>,
    /// Second values of slits along the mesh's edges.
    pub(super) second: SecondValues,
    shortcut: Shortcut,
    structure: SpdStructure,
    /// Slots of the element pairs, in the order of [`PAIRS`].
    slots: Vec<[u32; 6]>,
    contact_slots: Vec<u32>,
    /// The system without contact between the sheets; stale after the sensing sheet has changed.
    open_values: Vec<f64>,
    open_is_stale: bool,
    values: Vec<f64>,
    factor: SpdFactor,
    /// One row per electrode with its unit current, then one with the contact's load; solved in place. Rows, so that
    /// the values at a node are adjacent.
    fields: Mat<f64>,
    /// Net current from u into v at the touching nodes, by node and then electrode.
    exchange: Vec<f64>,
    /// Electrodes x nodes: first that current at all nodes, then the potential it causes in the shortcut.
    spread: Mat<f64>,
    copper: Option<Copper>,
    impedance: Mat<f64>,
    load: Vec<f64>,
    touching: Vec<u32>,
    /// Unknowns at which `fields` may differ from zero.
    solved_at: Vec<u32>,
    memory: LocalMemory,
}

/// Addition of paths to the system `K u = r`: an element on the slit's side has the potential `u + w` at the path's
/// inner nodes, so `K u + B w = r` and `B' u + D w = s`.
#[derive(Debug)]
pub(super) struct SecondValues {
    /// Elements with at least one second value, and the indices of their corners among the second values.
    elements: Vec<(u32, [Option<u32>; 3])>,
    /// Entries of D that join the sides.
    joined: Vec<(u32, u32, f64)>,
    pub(super) count: usize,
    /// s for unit potential of the shortcut.
    load: Vec<f64>,
    /// w, second values x right-hand sides.
    solved: Mat<f64>,
}

impl SecondValues {
    fn none() -> Self {
        Self { elements: Vec::new(), joined: Vec::new(), count: 0, load: Vec::new(), solved: Mat::zeros(0, 0) }
    }
}

#[derive(Debug)]
struct Copper {
    structure: SpdStructure,
    factor: SpdFactor,
}

impl TwoSheets {
    /// Prepares both sheets. `intact_s` is the sensing sheet's conductance in siemens. Electrodes must be pads
    /// ([`Contact::Area`](dermis_tomo::mesh::Contact::Area)) or rim faces on a flat triangle mesh.
    ///
    /// # Errors
    /// Point electrodes, fewer than two electrodes, or a singular system.
    pub fn new(body: &ElectrodedMesh, intact_s: f64, shortcut: Shortcut) -> Result<Self, SparseError> {
        Self::with_slits(body, &[], intact_s, shortcut)
    }

    /// As [`TwoSheets::new`], for a sheet with these slits ([`dermis_tomo::mesh::SlitMesh`]), open until changed by
    /// [`TwoSheets::set_joints`]. The shortcut has the same slits, which changes its loss by less than the loss
    /// itself.
    ///
    /// # Errors
    /// As [`TwoSheets::new`].
    pub fn with_slits(
        body: &ElectrodedMesh,
        slits: &[SlitEdge],
        intact_s: f64,
        shortcut: Shortcut,
    ) -> Result<Self, SparseError> {
        let mesh = &body.mesh;
        let positions: Vec<Point> = mesh.nodes().iter().map(|p| [p[0], p[1]]).collect();
        let triangles = triangles_of(body)?;
        let contacts = contact_entries(body)?;
        let (nodes, electrodes) = (positions.len(), body.electrodes.len());
        let size = nodes + electrodes - 1;
        let mut entries: Vec<(u32, u32)> = triangles.iter().flat_map(|t| PAIRS.map(|(a, b)| (t[a], t[b]))).collect();
        entries.extend(contacts.iter().map(|entry| (entry.row, entry.column)));
        let joints: Vec<(SlitEdge, f64)> = slits.iter().map(|&edge| (edge, 0.0)).collect();
        entries.extend(joints.iter().flat_map(|joint| joint_entries(joint, &positions)).map(|entry| entry.0));
        let coordinates = coordinates(body, &positions);
        // Sources at electrodes then take part near the end of the elimination only.
        let last: Vec<u32> = (nodes as u32..size as u32).collect();
        let ordering = Ordering::DissectionWithLast(&coordinates, &last);
        let (structure, slots) = SpdStructure::new(size, &entries, ordering)?;
        let (element_slots, other_slots) = slots.split_at(6 * triangles.len());
        let (contact_slots, joint_slots) = other_slots.split_at(contacts.len());
        let element_slots = element_slots.chunks_exact(6).map(|c| [c[0], c[1], c[2], c[3], c[4], c[5]]).collect();
        let mut sheets = Self {
            sensing: vec![SheetConductance::isotropic(intact_s); triangles.len()],
            areas: mesh.measures().to_vec(),
            electrode_count: electrodes,
            contact_slots: contact_slots.to_vec(),
            joint_slots: joint_slots.to_vec(),
            joints,
            second: SecondValues::none(),
            slots: element_slots,
            open_values: vec![0.0; structure.value_count()],
            open_is_stale: true,
            values: vec![0.0; structure.value_count()],
            factor: unit_factor(&structure)?,
            fields: Mat::zeros(electrodes, size),
            exchange: Vec::new(),
            spread: Mat::zeros(electrodes - 1, nodes),
            touching: Vec::new(),
            solved_at: Vec::new(),
            memory: LocalMemory::default(),
            impedance: Mat::zeros(electrodes, electrodes),
            load: vec![0.0; nodes],
            copper: None,
            triangles,
            positions,
            contacts,
            shortcut,
            structure,
        };
        sheets.copper = sheets.make_copper()?;
        Ok(sheets)
    }

    /// Node positions, metres.
    pub fn positions_m(&self) -> &[Point] {
        &self.positions
    }

    /// Number of triangles.
    pub fn element_count(&self) -> usize {
        self.triangles.len()
    }

    /// The shortcut sheet.
    pub fn shortcut(&self) -> Shortcut {
        self.shortcut
    }

    /// Sets the sensing sheet to a uniform conductance with cuts.
    pub fn set_sensing(&mut self, intact_s: f64, cuts: &[Cut]) {
        self.set_sensing_by(|_| intact_s, cuts);
    }

    /// Sets the sensing sheet to a position-dependent conductance (siemens) with cuts.
    pub fn set_sensing_by(&mut self, intact_s: impl Fn(Point) -> f64, cuts: &[Cut]) {
        let (near, mut numbers) = (NearCuts::new(cuts), Vec::new());
        for (element, tensor) in self.sensing.iter_mut().enumerate() {
            let corners = self.triangles[element].map(|node| self.positions[node as usize]);
            let centroid = [0, 1].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 3.0);
            *tensor = near.damaged_conductance(intact_s(centroid), corners, &mut numbers);
        }
        self.open_is_stale = true;
    }

    /// Sets the sensing sheet triangle by triangle, in the mesh's order.
    ///
    /// # Errors
    /// The wrong number of triangles.
    pub fn set_sensing_elements(&mut self, sensing: &[SheetConductance]) -> Result<(), SparseError> {
        if sensing.len() != self.triangles.len() {
            return Err(refuse(format!("expected {} conductances, got {}", self.triangles.len(), sensing.len())));
        }
        self.sensing.copy_from_slice(sensing);
        self.open_is_stale = true;
        Ok(())
    }

    /// Sets the conductance across the slits, in siemens per metre of edge, as a function of each edge's index and
    /// midpoint (metres).
    pub fn set_joints(&mut self, mut s_per_m: impl FnMut(usize, [f64; 2]) -> f64) {
        for (index, (edge, conductance)) in self.joints.iter_mut().enumerate() {
            let [a, b] = edge[0].map(|node| self.positions[node as usize]);
            *conductance = s_per_m(index, [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
        }
        self.open_is_stale = true;
    }

    /// Slits the sheet along edges of its mesh, replacing earlier slits of this kind. The loss of a resistive
    /// shortcut is computed from the values on one side, an error of a share of that loss.
    ///
    /// # Errors
    /// Paths of another mesh, or two paths with a common node.
    pub fn set_slit_paths(&mut self, paths: &[SlitPath]) -> Result<(), SparseError> {
        let mut second = SecondValues::none();
        let mut number = vec![None; self.positions.len()];
        let mut of_element: HashMap<u32, [Option<u32>; 3]> = HashMap::new();
        for path in paths {
            let inner = &path.nodes[1..path.nodes.len() - 1];
            let largest = path.side.iter().flatten().max().map_or(0, |element| *element as usize);
            if path.nodes.iter().any(|&node| node as usize >= number.len()) || largest >= self.triangles.len() {
                return Err(refuse("expected slits along edges of this mesh".into()));
            }
            for &node in inner {
                if number[node as usize].replace(second.count as u32).is_some() {
                    return Err(refuse(format!("expected slits without common nodes, got two through node {node}")));
                }
                second.count += 1;
            }
            for (&node, elements) in inner.iter().zip(&path.side) {
                for element in elements {
                    let corner = self.triangles[*element as usize].iter().position(|other| *other == node);
                    let corner = corner.ok_or_else(|| refuse("expected slits along edges of this mesh".into()))?;
                    of_element.entry(*element).or_default()[corner] = number[node as usize];
                }
            }
            for ends in path.nodes.windows(2) {
                // Like a joint whose other side uses second values, which are not nodes of the mesh.
                let nodes = number.len() as u32;
                let one = [ends[0], ends[1]];
                let own = |node: &u32| number[*node as usize].filter(|_| inner.contains(node));
                let other = one.map(|node| own(&node).map_or(node, |second| nodes + second));
                let entries = joint_entries(&([one, other], path.s_per_m), &self.positions).into_iter();
                let among = entries.filter(|((row, column), _)| *row >= nodes && *column >= nodes);
                second.joined.extend(among.map(|((row, column), value)| (row - nodes, column - nodes, value)));
            }
        }
        second.elements = of_element.into_iter().collect();
        // Sorted, so that sums are reproducible.
        second.elements.sort_unstable_by_key(|entry| entry.0);
        self.second = second;
        Ok(())
    }

    /// Transfer impedances in ohm, electrodes x electrodes: the potential of the row's electrode for 1 A into the
    /// column's electrode and out of the last. `contact_s_per_m2` is g at each node, linear in between. The shortcut
    /// sheet floats: no net current enters it. If nothing touches, its potential has no meaning and no influence.
    ///
    /// # Errors
    /// A singular system, for instance if a cut isolates an electrode.
    pub fn impedance(&mut self, contact_s_per_m2: &[f64]) -> Result<MatRef<'_, f64>, SparseError> {
        let (nodes, electrodes) = (self.positions.len(), self.electrode_count - 1);
        if std::mem::take(&mut self.open_is_stale) {
            self.assemble_open();
        }
        self.assemble_contact(contact_s_per_m2);
        self.structure.refactor(&self.values, &mut self.factor)?;
        for unknown in self.solved_at.drain(..) {
            self.fields.as_mut().col_mut(unknown as usize).fill(0.0);
        }
        for electrode in 0..electrodes {
            self.fields[(electrode, nodes + electrode)] = 1.0;
        }
        for &node in &self.touching {
            self.fields[(electrodes, node as usize)] = self.load[node as usize];
        }
        let solved = if self.touching.is_empty() { electrodes } else { electrodes + 1 };
        let right = self.fields.as_mut().subrows_mut(0, solved).transpose_mut();
        if self.second.count > 0 {
            self.solved_at.extend(0..self.structure.size() as u32);
            self.structure.solve_in_place(&self.factor, right);
            self.open_paths(contact_s_per_m2, solved)?;
        } else {
            // The fields are read at touching nodes and electrodes only.
            self.solved_at.extend(self.touching.iter().copied().chain((nodes as u32..).take(electrodes)));
            self.structure.solve_at(&self.factor, &self.solved_at, right, &mut self.memory);
        }
        for row in 0..electrodes {
            for column in 0..electrodes {
                self.impedance[(row, column)] = self.fields[(column, nodes + row)];
            }
        }
        if !self.touching.is_empty() {
            let potentials = self.connect_equipotential();
            self.add_copper_loss(contact_s_per_m2, &potentials);
        }
        Ok(self.impedance.as_ref())
    }

    /// Corrects the fields for slits along edges, at the places where they are read.
    fn open_paths(&mut self, contact_s_per_m2: &[f64], solved: usize) -> Result<(), SparseError> {
        let (nodes, electrodes) = (self.positions.len(), self.electrode_count - 1);
        let second = &mut self.second;
        let mut system: Mat<f64> = Mat::zeros(second.count, second.count);
        // Only the lower triangle is read.
        second.joined.iter().for_each(|&(i, j, value)| system[(i.max(j) as usize, i.min(j) as usize)] += value);
        // B, by node and second value.
        let mut coupling: Vec<(u32, u32, f64)> = Vec::new();
        second.load.clear();
        second.load.resize(second.count, 0.0);
        for (element, numbers) in &second.elements {
            let triangle = self.triangles[*element as usize];
            let g = triangle.map(|node| contact_s_per_m2[node as usize]);
            let corners = triangle.map(|node| self.positions[node as usize]);
            let area = self.areas[*element as usize];
            let local = stiffness(corners, self.sensing[*element as usize]).into_iter().zip(weighted_mass(area, g));
            for (&(a, b), (stiffness, mass)) in PAIRS.iter().zip(local) {
                let both = [(a, b), (b, a)];
                for &(a, b) in &both[..if a == b { 1 } else { 2 }] {
                    let Some(column) = numbers[b] else { continue };
                    coupling.push((triangle[a], column, stiffness + mass));
                    if let Some(row) = numbers[a] {
                        system[(row as usize, column as usize)] += stiffness + mass;
                    }
                }
            }
            let sum: f64 = g.iter().sum();
            for (corner, number) in numbers.iter().enumerate().filter_map(|(c, n)| n.map(|n| (c, n))) {
                second.load[number as usize] += area * (sum + g[corner]) / 12.0;
            }
        }
        // K^-1 B, one row per second value.
        let mut lifted: Mat<f64> = Mat::zeros(second.count, nodes + electrodes);
        for &(node, column, value) in &coupling {
            lifted[(column as usize, node as usize)] += value;
        }
        self.structure.solve_in_place(&self.factor, lifted.as_mut().transpose_mut());
        let mut right: Mat<f64> = Mat::zeros(second.count, solved);
        if solved > electrodes {
            second.load.iter().enumerate().for_each(|(row, load)| right[(row, electrodes)] = *load);
        }
        for &(node, row, value) in &coupling {
            let (row, node) = (row as usize, node as usize);
            for column in 0..second.count {
                system[(row, column)] -= value * lifted[(column, node)];
            }
            for column in 0..solved {
                right[(row, column)] -= value * self.fields[(column, node)];
            }
        }
        let factor =
            system.llt(Side::Lower).map_err(|_| refuse("slits that leave a part of the sheet alone".into()))?;
        second.solved = factor.solve(&right);
        let read = self.touching.iter().map(|&node| node as usize).chain(nodes..nodes + electrodes);
        for place in read {
            for row in 0..solved {
                let change: f64 = (0..second.count).map(|k| lifted[(k, place)] * second.solved[(k, row)]).sum();
                self.fields[(row, place)] -= change;
            }
        }
        Ok(())
    }

    /// Adds the current through an equipotential shortcut; returns its potential for each electrode's unit current.
    /// With `u = u_0 + c y`, c follows from zero net current: `integral g (u - c) = 0`.
    fn connect_equipotential(&mut self) -> Vec<f64> {
        let (nodes, electrodes) = (self.positions.len(), self.electrode_count - 1);
        let mut inflow = vec![0.0; electrodes];
        let mut shortfall = 0.0;
        for &node in &self.touching {
            let (load, field) = (self.load[node as usize], self.fields.as_ref().col(node as usize));
            shortfall += load * (1.0 - field[electrodes]);
            for (electrode, sum) in inflow.iter_mut().enumerate() {
                *sum += load * field[electrode];
            }
        }
        for (number, load) in self.second.load.iter().enumerate() {
            shortfall -= load * self.second.solved[(number, electrodes)];
            for (electrode, sum) in inflow.iter_mut().enumerate() {
                *sum += load * self.second.solved[(number, electrode)];
            }
        }
        let potentials: Vec<f64> = inflow.into_iter().map(|current| current / shortfall).collect();
        for row in 0..electrodes {
            let response = self.fields[(electrodes, nodes + row)];
            for column in 0..electrodes {
                self.impedance[(row, column)] += response * potentials[column];
            }
        }
        potentials
    }

    /// Assembles contacts and sensing sheet into `open_values`.
    fn assemble_open(&mut self) {
        self.open_values.fill(0.0);
        for (slot, entry) in self.contact_slots.iter().zip(&self.contacts) {
            self.open_values[*slot as usize] += entry.value;
        }
        let joints = self.joints.iter().flat_map(|joint| joint_entries(joint, &self.positions));
        for (slot, (_, value)) in self.joint_slots.iter().zip(joints) {
            self.open_values[*slot as usize] += value;
        }
        for (element, slots) in self.slots.iter().enumerate() {
            let corners = self.triangles[element].map(|node| self.positions[node as usize]);
            for (slot, value) in slots.iter().zip(stiffness(corners, self.sensing[element])) {
                self.open_values[*slot as usize] += value;
            }
        }
    }

    /// Assembles the open system plus contact into `values`, the contact's load `integral g phi` into `load`, and the
    /// nodes with a load into `touching`.
    fn assemble_contact(&mut self, contact_s_per_m2: &[f64]) {
        self.values.copy_from_slice(&self.open_values);
        self.load.fill(0.0);
        self.touching.clear();
        for (element, triangle) in self.triangles.iter().enumerate() {
            let g = triangle.map(|node| contact_s_per_m2[node as usize]);
            if g == [0.0; 3] {
                continue;
            }
            let area = self.areas[element];
            for (slot, value) in self.slots[element].iter().zip(weighted_mass(area, g)) {
                self.values[*slot as usize] += value;
            }
            let sum: f64 = g.iter().sum();
            for (corner, &node) in triangle.iter().enumerate() {
                if self.load[node as usize] == 0.0 {
                    self.touching.push(node);
                }
                self.load[node as usize] += area * (sum + g[corner]) / 12.0;
            }
        }
    }
}

/// Contribution of a joined edge, siemens.
pub(super) fn joint_entries(&(edge, s_per_m): &(SlitEdge, f64), positions: &[Point]) -> Vec<((u32, u32), f64)> {
    let [p, q] = edge[0].map(|node| positions[node as usize]);
    mesh::joint_entries(edge, mesh::distance(p, q), s_per_m)
}

/// A factor to be overwritten, initially of the identity.
fn unit_factor(structure: &SpdStructure) -> Result<SpdFactor, SparseError> {
    let mut values = vec![0.0; structure.value_count()];
    structure.add_to_diagonal(&mut values, 1.0);
    structure.factor(&values)
}
