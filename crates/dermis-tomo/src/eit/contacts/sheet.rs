//! The bare sheet, and what patches of contact change of its channels.

use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};

use crate::eit::{EitError, ForwardModel, Measurement};
use crate::sparse::SparseError;

/// A round patch of contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPatch {
    /// Its middle, metres.
    pub position_m: [f64; 2],
    /// Its radius, metres.
    pub radius_m: f64,
    /// Contact conductance per area, S/m^2.
    pub conductance_s_per_m2: f64,
}

/// Nodes of which less than this share is covered by a patch are not touched.
const LEAST_COVERAGE: f64 = 1e-3;

/// The bare sheet, ready for any contacts.
#[derive(Debug)]
pub struct ContactSheet {
    pub(super) positions_m: Vec<[f64; 2]>,
    /// Area of the sheet that goes with each node, m^2.
    pub(super) areas_m2: Vec<f64>,
    /// Width over which the edge of a patch is blurred, metres.
    edge_m: f64,
    /// Nodes x nodes, ohm.
    pub(super) green: Mat<f32>,
    /// Patterns x nodes: potentials for the stimulations, volts, then for the measuring patterns, ohm.
    pub(super) fields: Mat<f64>,
    pub(super) stimulations: usize,
    pub(super) measurements: Vec<Measurement>,
    /// Channels on the bare sheet, volts.
    pub(super) bare_v: Vec<f64>,
}

/// What contacts do: the nodes that are touched and the currents there.
#[derive(Clone, Debug)]
pub(super) struct Touched {
    pub(super) nodes: Vec<u32>,
    pub(super) conductance_s: Vec<f64>,
    /// Touched x patterns: `P f`, the current out of the sheet.
    pub(super) currents: Mat<f64>,
    /// `M^-1 1`, and its sum: the shape of the current of one common potential.
    pub(super) common: Vec<f64>,
}

impl ContactSheet {
    /// Works out the Green's function of a sheet of this conductance (siemens, one value an element). The edge of a
    /// patch is blurred over `edge_m`, or over the distance between nodes where that is more: what a patch does then
    /// changes smoothly with its place, and a cover spreads pressure so.
    ///
    /// # Errors
    /// As [`ForwardModel::solve`]; point electrodes.
    pub fn new(model: &ForwardModel, sheet_s: &[f64], edge_m: f64) -> Result<Self, EitError> {
        let mesh = &model.body.mesh;
        let solution = model.solve(sheet_s)?;
        let unknowns = model.system.node_unknowns.iter().copied().collect::<Option<Vec<usize>>>();
        let unknowns = unknowns.ok_or(EitError::PointElectrode)?;
        let mut values = Vec::new();
        model.system.assemble(sheet_s, &mut values);
        let factor = model.system.factor(&values)?;
        let inverse = model.system.structure.inverse_columns(&factor, &unknowns);
        let nodes = unknowns.len();
        let green = Mat::from_fn(nodes, nodes, |row, column| inverse[(unknowns[row], column)] as f32);
        let protocol = &model.protocol;
        let columns: Vec<Vec<f64>> = protocol
            .stimulations()
            .iter()
            .chain(protocol.patterns())
            .map(|pattern| solution.pattern_potentials(pattern))
            .collect();
        let mut areas_m2 = vec![0.0; nodes];
        for (cell, measure) in mesh.elements().zip(mesh.measures()) {
            cell.iter().for_each(|&node| areas_m2[node as usize] += measure / cell.len() as f64);
        }
        let area: f64 = areas_m2.iter().sum();
        Ok(Self {
            positions_m: mesh.nodes().iter().map(|p| [p[0], p[1]]).collect(),
            edge_m: edge_m.max((area / nodes as f64).sqrt()),
            areas_m2,
            green,
            fields: Mat::from_fn(columns.len(), nodes, |pattern, node| columns[pattern][node]),
            stimulations: protocol.stimulations().len(),
            measurements: protocol.measurements().to_vec(),
            bare_v: solution.voltages(),
        })
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.measurements.len()
    }

    /// Channels on the bare sheet, volts.
    pub fn bare_v(&self) -> &[f64] {
        &self.bare_v
    }

    /// Change of every channel, volts, by these patches. Where patches overlap, their conductances add.
    ///
    /// # Errors
    /// A patch whose radius or conductance is not positive and finite.
    pub fn change_v(&self, patches: &[ContactPatch]) -> Result<Vec<f64>, EitError> {
        let touched = self.touch(patches)?;
        Ok(self.change_of(&touched))
    }

    pub(super) fn patterns(&self) -> usize {
        self.fields.nrows()
    }

    /// Share of a node that a patch covers, and its derivative with the distance from the middle (1/m).
    pub(super) fn coverage(&self, radius_m: f64, distance_m: f64) -> (f64, f64) {
        let width_m = self.edge_m;
        let x = (radius_m - distance_m) / width_m + 0.5;
        if x <= 0.0 {
            (0.0, 0.0)
        } else if x >= 1.0 {
            (1.0, 0.0)
        } else {
            (x * x * (3.0 - 2.0 * x), -6.0 * x * (1.0 - x) / width_m)
        }
    }

    /// Solves the contacts of these patches.
    pub(super) fn touch(&self, patches: &[ContactPatch]) -> Result<Touched, EitError> {
        for patch in patches {
            let sound = |value: f64| value > 0.0 && value.is_finite();
            if !sound(patch.radius_m) || !sound(patch.conductance_s_per_m2) {
                let ContactPatch { radius_m, conductance_s_per_m2, .. } = *patch;
                return Err(EitError::Contact { radius_m, conductance_s_per_m2 });
            }
        }
        let (mut nodes, mut conductance_s) = (Vec::new(), Vec::new());
        for (node, (at, area)) in self.positions_m.iter().zip(&self.areas_m2).enumerate() {
            let mut conductance = 0.0;
            for patch in patches {
                let (dx, dy) = (at[0] - patch.position_m[0], at[1] - patch.position_m[1]);
                let (square, reach_m) = (dx * dx + dy * dy, patch.radius_m + 0.5 * self.edge_m);
                if square >= reach_m * reach_m {
                    continue;
                }
                let (share, _) = self.coverage(patch.radius_m, square.sqrt());
                if share > LEAST_COVERAGE {
                    conductance += share * patch.conductance_s_per_m2 * area;
                }
            }
            if conductance > 0.0 {
                nodes.push(node as u32);
                conductance_s.push(conductance);
            }
        }
        self.solve(nodes, conductance_s)
    }

    fn solve(&self, nodes: Vec<u32>, conductance_s: Vec<f64>) -> Result<Touched, EitError> {
        let (count, patterns) = (nodes.len(), self.patterns());
        if count == 0 {
            return Ok(Touched { nodes, conductance_s, currents: Mat::zeros(0, patterns), common: Vec::new() });
        }
        // Only the lower triangle is read.
        let mut matrix = Mat::zeros(count, count);
        for (b, &node) in nodes.iter().enumerate() {
            let green = self.green.col(node as usize);
            for (a, &other) in nodes.iter().enumerate().skip(b) {
                matrix[(a, b)] = f64::from(green[other as usize]);
            }
            matrix[(b, b)] += 1.0 / conductance_s[b];
        }
        let singular = |_| EitError::System(SparseError::NotPositiveDefinite { pivot: 0, size: count });
        let factor = Llt::new(matrix.as_ref(), Side::Lower).map_err(singular)?;
        let mut right = Mat::from_fn(count, patterns + 1, |row, pattern| {
            if pattern < patterns { self.fields[(pattern, nodes[row] as usize)] } else { 1.0 }
        });
        factor.solve_in_place(&mut right);
        let common: Vec<f64> = right.col(patterns).iter().copied().collect();
        let total: f64 = common.iter().sum();
        let mut currents = right.subcols(0, patterns).to_owned();
        for column in currents.col_iter_mut() {
            let potential = column.as_ref().iter().sum::<f64>() / total;
            column.iter_mut().zip(&common).for_each(|(current, share)| *current -= potential * share);
        }
        Ok(Touched { nodes, conductance_s, currents, common })
    }

    pub(super) fn change_of(&self, touched: &Touched) -> Vec<f64> {
        let measuring = self.patterns() - self.stimulations;
        let fields = Mat::from_fn(measuring, touched.nodes.len(), |pattern, row| {
            self.fields[(self.stimulations + pattern, touched.nodes[row] as usize)]
        });
        let exchange = &fields * touched.currents.subcols(0, self.stimulations);
        self.measurements.iter().map(|c| -exchange[(c.pattern as usize, c.stimulation as usize)]).collect()
    }
}
