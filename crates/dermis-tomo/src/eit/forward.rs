//! The forward model: from conductivity to potentials and measured voltages. One factorisation and one solve per
//! electrode serve any number of stimulations and measurements by superposition.

use faer::{Mat, MatRef};
use rayon::prelude::*;

use super::error::EitError;
use super::protocol::{Measurement, Pattern, Protocol};
use super::system::{ElementGeometry, System};
use crate::mesh::{Contact, ElectrodedMesh, SlitEdge};
use crate::sparse::SpdFactor;

/// Mesh, electrodes and protocol, prepared to solve for any conductivity.
#[derive(Debug)]
pub struct ForwardModel {
    pub(super) body: ElectrodedMesh,
    pub(super) protocol: Protocol,
    pub(super) geometry: ElementGeometry,
    pub(super) system: System,
}

/// Potentials of a [`ForwardModel`] at one conductivity.
#[derive(Debug)]
pub struct Solution<'a> {
    pub(super) model: &'a ForwardModel,
    /// Unknowns x electrodes without the reference: potentials for 1 A into each electrode and out of the reference.
    pub(super) fields: Mat<f64>,
    /// Transfer impedances in ohm, electrodes x electrodes; row and column of the reference are zero.
    impedance: Mat<f64>,
}

impl ForwardModel {
    /// Prepares the parts that every solve reuses: symbolic factorisation and element matrices.
    ///
    /// # Errors
    /// Fails if the electrode counts disagree.
    pub fn new(body: ElectrodedMesh, protocol: Protocol) -> Result<Self, EitError> {
        Self::with_joints(body, protocol, &[])
    }

    /// As [`ForwardModel::new`], for a sheet with slits ([`crate::mesh::SlitMesh`]) whose listed edges conduct from
    /// one side to the other: siemens per metre of edge.
    ///
    /// # Errors
    /// As [`ForwardModel::new`]; also fails if a conductance is negative or not finite.
    pub fn with_joints(body: ElectrodedMesh, protocol: Protocol, joints: &[(SlitEdge, f64)]) -> Result<Self, EitError> {
        if let Some((index, (_, value))) = joints.iter().enumerate().find(|(_, joint)| !(0.0..1e30).contains(&joint.1))
        {
            return Err(EitError::Joint { index, value: *value });
        }
        if body.electrodes.len() != protocol.electrode_count() || body.electrodes.len() < 2 {
            return Err(EitError::ElectrodeCount { mesh: body.electrodes.len(), protocol: protocol.electrode_count() });
        }
        let geometry = ElementGeometry::new(&body.mesh);
        let system = System::new(&body, &geometry, joints)?;
        Ok(Self { body, protocol, geometry, system })
    }

    /// Mesh and electrodes.
    pub fn body(&self) -> &ElectrodedMesh {
        &self.body
    }

    /// Stimulation and measurement.
    pub fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    /// Solves for one conductivity, one value per element (S/m in 3D; sheet conductance in S, i.e. sigma times
    /// thickness, for sheets).
    ///
    /// # Errors
    /// Wrong count, values not positive and finite, or a singular system.
    pub fn solve(&self, conductivity: &[f64]) -> Result<Solution<'_>, EitError> {
        let factor = self.factor(conductivity)?;
        let (sources, unknowns) = self.sources();
        let columns = self.system.structure.inverse_columns(&factor, &unknowns);
        let fields = if sources.len() == self.body.electrodes.len() - 1 {
            columns
        } else {
            // The reference shares the node of a point electrode, where a source has no field relative to it.
            let mut fields = Mat::zeros(columns.nrows(), self.body.electrodes.len() - 1);
            for (&source, column) in sources.iter().zip(columns.col_iter()) {
                fields.col_mut(source).copy_from(column);
            }
            fields
        };
        let impedance = self.impedance(|row, column| fields[(row, column)]);
        Ok(Solution { model: self, fields, impedance })
    }

    /// One voltage per channel for one conductivity, volts: [`Solution::voltages`] without the fields inside the
    /// body, which is faster.
    ///
    /// # Errors
    /// As [`ForwardModel::solve`].
    pub fn voltages(&self, conductivity: &[f64]) -> Result<Vec<f64>, EitError> {
        let factor = self.factor(conductivity)?;
        let (sources, unknowns) = self.sources();
        let block = self.system.structure.inverse_block(&factor, &unknowns);
        let mut place = vec![None; self.system.structure.size()];
        unknowns.iter().enumerate().for_each(|(k, &unknown)| place[unknown] = Some(k));
        let mut column_of = vec![None; self.body.electrodes.len()];
        sources.iter().enumerate().for_each(|(k, &electrode)| column_of[electrode] = Some(k));
        let impedance = self.impedance(|row, column| match (place[row], column_of[column]) {
            (Some(row), Some(column)) => block[(row, column)],
            _ => 0.0,
        });
        Ok(self.channels(&impedance))
    }

    /// About the operations of [`ForwardModel::voltages`]: factorisation, substitution for each electrode, assembly.
    pub fn operations(&self) -> f64 {
        let structure = &self.system.structure;
        let sources = self.body.electrodes.len() as f64;
        structure.factor_operations() + sources * structure.factor_len() as f64 + structure.value_count() as f64
    }

    /// Voltages for many conductivities, in parallel over the samples.
    ///
    /// # Errors
    /// As [`ForwardModel::solve`], for the first sample that failed.
    pub fn voltages_of_many(&self, conductivities: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, EitError> {
        conductivities.par_iter().map(|sigma| self.voltages(sigma)).collect()
    }

    fn factor(&self, conductivity: &[f64]) -> Result<SpdFactor, EitError> {
        self.check_conductivity(conductivity)?;
        let mut values = Vec::with_capacity(self.system.structure.value_count());
        self.system.assemble(conductivity, &mut values);
        self.system.factor(&values)
    }

    /// Electrodes except the last that have an unknown (all, unless one shares its node with a point reference), and
    /// the unknowns.
    fn sources(&self) -> (Vec<usize>, Vec<usize>) {
        let unknowns = &self.system.electrode_unknowns;
        unknowns[..unknowns.len() - 1].iter().enumerate().filter_map(|(k, unknown)| Some((k, (*unknown)?))).unzip()
    }

    /// Transfer impedances, given the field at an electrode's unknown (first argument) due to a source electrode
    /// (second).
    fn impedance(&self, field: impl Fn(usize, usize) -> f64) -> Mat<f64> {
        let electrodes = self.body.electrodes.len();
        Mat::from_fn(electrodes, electrodes, |row, column| {
            match (self.system.electrode_unknowns[row], column + 1 < electrodes) {
                (Some(unknown), true) => field(unknown, column),
                _ => 0.0,
            }
        })
    }

    /// `v[m] = meas[m] . U(stim of m)`.
    fn channels(&self, impedance: &Mat<f64>) -> Vec<f64> {
        let potentials: Vec<Vec<f64>> = self
            .protocol
            .stimulations()
            .iter()
            .map(|stimulation| electrode_potentials(impedance, stimulation))
            .collect();
        let read = |channel: &Measurement| {
            let potential = &potentials[channel.stimulation as usize];
            let pattern = &self.protocol.patterns()[channel.pattern as usize];
            pattern.entries().iter().map(|&(electrode, weight)| weight * potential[electrode as usize]).sum()
        };
        self.protocol.measurements().iter().map(read).collect()
    }

    fn check_conductivity(&self, conductivity: &[f64]) -> Result<(), EitError> {
        let expected = self.body.mesh.element_count();
        if conductivity.len() != expected {
            return Err(EitError::ConductivityCount { expected, got: conductivity.len() });
        }
        match conductivity.iter().position(|&sigma| !(sigma > 0.0 && sigma.is_finite())) {
            Some(element) => Err(EitError::Conductivity { element, value: conductivity[element] }),
            None => Ok(()),
        }
    }
}

impl Solution<'_> {
    /// The model that was solved.
    pub fn model(&self) -> &ForwardModel {
        self.model
    }

    /// Transfer impedances in ohm, electrodes x electrodes, symmetric: the potential of the row's electrode relative
    /// to the last, for 1 A into the column's electrode and out of the last. Row and column of the last electrode are
    /// zero.
    pub fn transfer_impedance(&self) -> MatRef<'_, f64> {
        self.impedance.as_ref()
    }

    /// One voltage per channel, volts: `v[m] = meas[m] . U(stim of m)`.
    pub fn voltages(&self) -> Vec<f64> {
        self.model.channels(&self.impedance)
    }

    /// Electrode potentials in volts during one stimulation, shifted to sum to zero.
    pub fn electrode_potentials(&self, stimulation: usize) -> Vec<f64> {
        electrode_potentials(&self.impedance, &self.model.protocol.stimulations()[stimulation])
    }

    /// Node potentials in volts during one stimulation, relative to the last electrode.
    pub fn node_potentials(&self, stimulation: usize) -> Vec<f64> {
        self.pattern_potentials(&self.model.protocol.stimulations()[stimulation])
    }

    /// Current density in A/m^2 (A/m on a sheet) in each element during one stimulation: `-sigma grad u`.
    pub fn current_density(&self, stimulation: usize, conductivity: &[f64]) -> Vec<[f64; 3]> {
        let potentials = self.node_potentials(stimulation);
        let mesh = &self.model.body.mesh;
        (0..mesh.element_count())
            .map(|element| {
                let gradient = gradient(mesh, element, &potentials);
                gradient.map(|component| -conductivity[element] * component)
            })
            .collect()
    }

    /// Node potentials for any pattern of electrode currents. An unbalanced pattern returns evenly through all
    /// electrodes, which makes it the adjoint field of a voltage measured against their mean.
    pub(super) fn pattern_potentials(&self, pattern: &Pattern) -> Vec<f64> {
        let mut unknowns = vec![0.0; self.fields.nrows()];
        for (electrode, weight) in balanced(pattern, self.impedance.nrows()) {
            if electrode < self.fields.ncols() {
                let field = self.fields.col(electrode);
                unknowns.iter_mut().zip(field.iter()).for_each(|(sum, value)| *sum += weight * value);
            }
        }
        self.model.system.node_unknowns.iter().map(|unknown| unknown.map_or(0.0, |u| unknowns[u])).collect()
    }
}

/// Electrode potentials for a stimulation, shifted to sum to zero.
fn electrode_potentials(impedance: &Mat<f64>, stimulation: &Pattern) -> Vec<f64> {
    let count = impedance.nrows();
    let mut potential = vec![0.0; count];
    for &(electrode, current) in stimulation.entries() {
        for (row, value) in potential.iter_mut().enumerate() {
            *value += current * impedance[(row, electrode as usize)];
        }
    }
    let mean = potential.iter().sum::<f64>() / count as f64;
    potential.iter_mut().for_each(|value| *value -= mean);
    potential
}

/// The pattern, minus its mean over all electrodes if it does not sum to zero.
pub(super) fn balanced(pattern: &Pattern, count: usize) -> Vec<(usize, f64)> {
    let sum = pattern.sum();
    let scale = pattern.entries().iter().map(|entry| entry.1.abs()).fold(0.0, f64::max);
    if sum.abs() <= 1e-12 * scale {
        return pattern.entries().iter().map(|&(electrode, weight)| (electrode as usize, weight)).collect();
    }
    let mut dense = vec![-sum / count as f64; count];
    for &(electrode, weight) in pattern.entries() {
        dense[electrode as usize] += weight;
    }
    dense.into_iter().enumerate().collect()
}

/// Gradient within an element of a linear field given at the nodes: E G^-1 du.
fn gradient(mesh: &crate::mesh::Mesh, element: usize, potentials: &[f64]) -> [f64; 3] {
    let cell = mesh.element(element);
    let (mut axes, mut sum) = ([[0.0; 3]; 3], [0.0; 3]);
    // Orthogonalise the edges one by one. Along each remaining part, the potential rises by the part of its rise not
    // yet explained by the others.
    for (k, &node) in cell[1..].iter().enumerate() {
        let mut edge = crate::mesh::subtract(mesh.nodes()[node as usize], mesh.nodes()[cell[0] as usize]);
        let rise = potentials[node as usize] - potentials[cell[0] as usize] - crate::mesh::dot(sum, edge);
        for axis in &axes[..k] {
            let along = crate::mesh::dot(*axis, edge);
            (0..3).for_each(|i| edge[i] -= along * axis[i]);
        }
        let square = crate::mesh::dot(edge, edge);
        // A simplex with positive measure always has a remainder.
        if square > 0.0 {
            (0..3).for_each(|i| sum[i] += rise / square * edge[i]);
            axes[k] = edge.map(|component| component / square.sqrt());
        }
    }
    sum
}

/// The nodes under an electrode, sorted, for drawing.
pub(crate) fn electrode_nodes(body: &ElectrodedMesh, electrode: usize) -> Vec<u32> {
    let mut nodes: Vec<u32> = match &body.electrodes[electrode].contact {
        Contact::Faces(faces) => faces.iter().flatten().copied().collect(),
        Contact::Area(elements) => {
            elements.iter().flat_map(|&element| body.mesh.element(element as usize).iter().copied()).collect()
        }
        Contact::Point(node) => vec![*node],
    };
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

impl ElectrodedMesh {
    /// The nodes under an electrode, sorted.
    pub fn electrode_nodes(&self, electrode: usize) -> Vec<u32> {
        electrode_nodes(self, electrode)
    }

    /// Mean position of an electrode's nodes, metres.
    pub fn electrode_centre(&self, electrode: usize) -> [f64; 3] {
        let nodes = self.electrode_nodes(electrode);
        let mut centre = [0.0; 3];
        for &node in &nodes {
            for axis in 0..3 {
                centre[axis] += self.mesh.nodes()[node as usize][axis] / nodes.len() as f64;
            }
        }
        centre
    }
}

#[cfg(test)]
mod tests {
    use super::gradient;
    use crate::mesh::{CellKind, Mesh, dot};

    #[test]
    fn gradients_of_linear_fields_are_theirs_along_the_cell() {
        let slope = [0.3, -1.2, 0.7];
        let corners = [[0.1, 0.0, 0.2], [1.3, 0.2, 0.1], [0.4, 0.9, -0.3], [0.2, 0.3, 1.1]];
        let potentials = corners.map(|p| dot(slope, p) + 5.0);
        let solid = Mesh::new(CellKind::Tetrahedron, corners.to_vec(), vec![0, 1, 2, 3]).unwrap();
        let found = gradient(&solid, 0, &potentials);
        // Rounding errors of numbers of order one.
        (0..3).for_each(|axis| assert!((found[axis] - slope[axis]).abs() < 1e-13, "{found:?}"));
        let tilted = Mesh::new(CellKind::Triangle, corners[..3].to_vec(), vec![0, 1, 2]).unwrap();
        let found = gradient(&tilted, 0, &potentials);
        // The gradient lies in the triangle's plane and has the slope's components along both edges.
        for corner in [corners[1], corners[2]] {
            let edge = crate::mesh::subtract(corner, corners[0]);
            assert!((dot(found, edge) - dot(slope, edge)).abs() < 1e-13, "{found:?}");
        }
        let [a, b] = [1, 2].map(|k: usize| crate::mesh::subtract(corners[k], corners[0]));
        let normal = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        assert!(dot(found, normal).abs() < 1e-13, "{found:?}");
    }
}
