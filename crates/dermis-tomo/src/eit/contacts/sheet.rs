//! The bare sheet, and the effect of patches of contact on its channels.

use std::collections::BTreeMap;
use std::ops::Range;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::cholesky::llt::solve::{solve_in_place, solve_in_place_scratch};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Par, Side};

use crate::eit::forward::balanced;
use crate::eit::{EitError, ForwardModel, Measurement, Pattern};
use crate::mesh::Point;
use crate::sparse::SparseError;

/// Number of parameters by which the channels are differentiated at once.
pub(super) const OF_PRESS: usize = 4;

/// A round patch of contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactPatch {
    /// Centre, metres.
    pub position_m: Point,
    /// Radius, metres.
    pub radius_m: f64,
    /// Contact conductance per area, S/m^2.
    pub conductance_s_per_m2: f64,
}

/// Minimum share of a node's area that a patch must cover for the node to count as touched.
const LEAST_COVERAGE: f64 = 1e-3;
/// Fields that differ by at most this share of the largest potential are considered equal.
const SAME: f64 = 1e-12;

/// The Green's function between all nodes. It is symmetric, so only the lower triangle is stored, column by column.
/// It is the largest object in memory of a live skin.
#[derive(Debug)]
pub(super) struct Green {
    nodes: usize,
    triangle: Vec<f32>,
}

impl Green {
    /// Values for the nodes from `node` on.
    pub(super) fn column(&self, node: usize) -> &[f32] {
        // Earlier columns have nodes, nodes - 1, ... values.
        let start = node * self.nodes - node * node.saturating_sub(1) / 2;
        &self.triangle[start..start + self.nodes - node]
    }

    /// Both triangles, column by column.
    pub(super) fn whole(&self) -> Mat<f32> {
        let mut whole = Mat::zeros(self.nodes, self.nodes);
        for node in 0..self.nodes {
            whole.col_as_slice_mut(node)[node..].copy_from_slice(self.column(node));
            for (row, value) in self.column(node).iter().enumerate() {
                whole[(node, node + row)] = *value;
            }
        }
        whole
    }
}

/// The bare sheet, prepared for any contacts. Nodes are in elimination order.
#[derive(Debug)]
pub struct ContactSheet {
    pub(super) positions_m: Vec<Point>,
    /// Area of the sheet represented by each node, m^2.
    pub(super) areas_m2: Vec<f64>,
    /// Width over which the edge of a patch is blurred, metres.
    edge_m: f64,
    /// Nodes x nodes, ohm.
    pub(super) green: Green,
    /// Fields x nodes: potentials for the stimulations, volts, followed by those that make up the measuring patterns,
    /// ohm. These are the electrodes' own where patterns outnumber electrodes, otherwise those of the patterns that are
    /// not a multiple of a stimulation: a pair that both drives and measures is stored once.
    pub(super) fields: Mat<f64>,
    pub(super) stimulations: usize,
    /// Fields that make up each measuring pattern, with their weights.
    pub(super) patterns: Vec<Vec<(usize, f64)>>,
    pub(super) measurements: Vec<Measurement>,
    /// Channels on the bare sheet, volts.
    pub(super) bare_v: Vec<f64>,
}

/// Effect of contacts: the touched nodes and their currents.
#[derive(Clone, Debug)]
pub(super) struct Touched {
    pub(super) nodes: Vec<u32>,
    pub(super) conductance_s: Vec<f64>,
    /// Touched x fields: `P f`, the current out of the sheet.
    pub(super) currents: Mat<f64>,
    /// `M^-1 1`: the currents for one volt on the first plate.
    pub(super) common: Vec<f64>,
}

impl ContactSheet {
    /// Computes the Green's function of a sheet with this conductance (siemens, one value per element). The edge of a
    /// patch is blurred over `edge_m`, or over the distance between nodes if that is larger, so that its effect
    /// varies smoothly with its position; a cover layer spreads pressure in the same way.
    ///
    /// # Errors
    /// As [`ForwardModel::solve`]; also fails with point electrodes.
    pub fn new(model: &ForwardModel, sheet_s: &[f64], edge_m: f64) -> Result<Self, EitError> {
        Ok(Self::with_order(model, sheet_s, edge_m)?.0)
    }

    /// As [`ContactSheet::new`], with the index in the mesh of each of its nodes.
    pub(super) fn with_order(
        model: &ForwardModel,
        sheet_s: &[f64],
        edge_m: f64,
    ) -> Result<(Self, Vec<usize>), EitError> {
        let mesh = &model.body.mesh;
        let solution = model.solve(sheet_s)?;
        let unknowns = model.system.node_unknowns.iter().copied().collect::<Option<Vec<usize>>>();
        let unknowns = unknowns.ok_or(EitError::PointElectrode)?;
        let mut values = Vec::new();
        model.system.assemble(sheet_s, &mut values);
        let factor = model.system.factor(&values)?;
        let nodes = unknowns.len();
        let (order, triangle) = model.system.structure.inverse_triangle(&factor, &unknowns);
        let protocol = &model.protocol;
        let potentials = |patterns: &[Pattern]| -> Vec<Vec<f64>> {
            patterns.iter().map(|pattern| solution.pattern_potentials(pattern)).collect()
        };
        let mut columns = potentials(protocol.stimulations());
        let stimulations = columns.len();
        let electrodes = model.body.electrodes.len();
        let mut patterns: Vec<Vec<(usize, f64)>> = Vec::with_capacity(protocol.patterns().len());
        if protocol.patterns().len() > electrodes {
            // Their potentials are sums of those of the electrodes, which are fewer. The last electrode is the
            // reference.
            let first = columns.len();
            let alone = |electrode: u32| Pattern::new(vec![(electrode, 1.0), (electrodes as u32 - 1, -1.0)]);
            columns.extend(potentials(&(0..electrodes as u32 - 1).map(alone).collect::<Vec<_>>()));
            let parts = |pattern: &Pattern| {
                let parts =
                    balanced(pattern, electrodes).into_iter().filter(|(electrode, _)| *electrode + 1 < electrodes);
                parts.map(|(electrode, weight)| (first + electrode, weight)).collect()
            };
            patterns.extend(protocol.patterns().iter().map(parts));
        } else {
            for measured in potentials(protocol.patterns()) {
                let mut driven = columns[..stimulations].iter().enumerate();
                let found = driven.find_map(|(field, driven)| Some((field, multiple_of(driven, &measured)?)));
                patterns.push(vec![found.unwrap_or((columns.len(), 1.0))]);
                if found.is_none() {
                    columns.push(measured);
                }
            }
        }
        let mut areas_m2 = vec![0.0; nodes];
        for (cell, measure) in mesh.elements().zip(mesh.measures()) {
            cell.iter().for_each(|&node| areas_m2[node as usize] += measure / cell.len() as f64);
        }
        let position = |&node: &usize| [mesh.nodes()[node][0], mesh.nodes()[node][1]];
        let mut sheet = Self {
            positions_m: order.iter().map(position).collect(),
            edge_m,
            areas_m2: order.iter().map(|&node| areas_m2[node]).collect(),
            green: Green { nodes, triangle },
            fields: Mat::from_fn(columns.len(), nodes, |pattern, node| columns[pattern][order[node]]),
            stimulations,
            patterns,
            measurements: protocol.measurements().to_vec(),
            bare_v: solution.voltages(),
        };
        sheet.edge_m = edge_m.max(sheet.node_spacing_m());
        Ok((sheet, order))
    }

    /// The same sheet seen in cells: each is the mean over nodes (with these weights), and takes the place of a node.
    /// The weights of a cell add up to its area, m^2.
    pub(super) fn averaged(&self, cells: &[Vec<(u32, f64)>]) -> Self {
        let areas_m2: Vec<f64> = cells.iter().map(|cell| cell.iter().map(|(_, weight)| weight).sum()).collect();
        let shares: Vec<Vec<(usize, f64)>> = cells
            .iter()
            .zip(&areas_m2)
            .map(|(cell, area)| {
                let mut shares: BTreeMap<usize, f64> = BTreeMap::new();
                cell.iter().for_each(|(node, weight)| *shares.entry(*node as usize).or_default() += weight / area);
                shares.into_iter().collect()
            })
            .collect();
        let mean = |cell: usize, value: &dyn Fn(usize) -> f64| -> f64 {
            shares[cell].iter().map(|&(node, share)| share * value(node)).sum()
        };
        let green = self.green.whole();
        let mut triangle = Vec::with_capacity(cells.len() * (cells.len() + 1) / 2);
        let mut potential = vec![0.0; self.positions_m.len()];
        for (cell, of_cell) in shares.iter().enumerate() {
            potential.fill(0.0);
            for &(node, share) in of_cell {
                let column = green.col_as_slice(node);
                potential.iter_mut().zip(column).for_each(|(sum, value)| *sum += share * f64::from(*value));
            }
            triangle.extend((cell..cells.len()).map(|other| mean(other, &|node| potential[node]) as f32));
        }
        let position = |cell| [0, 1].map(|axis| mean(cell, &|node| self.positions_m[node][axis]));
        Self {
            positions_m: (0..cells.len()).map(position).collect(),
            areas_m2,
            edge_m: self.edge_m,
            green: Green { nodes: cells.len(), triangle },
            fields: Mat::from_fn(self.fields.nrows(), cells.len(), |field, cell| {
                mean(cell, &|node| self.fields[(field, node)])
            }),
            stimulations: self.stimulations,
            patterns: self.patterns.clone(),
            measurements: self.measurements.clone(),
            bare_v: self.bare_v.clone(),
        }
    }

    /// Distance between neighbouring nodes, on average, metres.
    pub(super) fn node_spacing_m(&self) -> f64 {
        let area: f64 = self.areas_m2.iter().sum();
        (area / self.areas_m2.len() as f64).sqrt()
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.measurements.len()
    }

    /// Channels on the bare sheet, volts.
    pub fn bare_v(&self) -> &[f64] {
        &self.bare_v
    }

    /// Change of every channel due to these patches, volts. Conductances of overlapping patches add up.
    ///
    /// # Errors
    /// Fails if a radius or conductance is not positive and finite.
    pub fn change_v(&self, patches: &[ContactPatch]) -> Result<Vec<f64>, EitError> {
        let touched = self.touch(patches)?;
        Ok(self.change_of(&touched))
    }

    /// Number of fields.
    pub(super) fn field_count(&self) -> usize {
        self.fields.nrows()
    }

    /// The range of fields of the measuring patterns; some or all of them may also belong to stimulations.
    pub(super) fn measuring(&self) -> Range<usize> {
        let fields = || self.patterns.iter().flatten().map(|(field, _)| *field);
        fields().min().unwrap_or(0)..fields().max().map_or(0, |last| last + 1)
    }

    /// Share of a node that a patch covers, and its derivative with respect to the distance from the centre (1/m).
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

    /// Solves for the contacts of these patches.
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
        let plates = vec![0; nodes.len()];
        self.solve(nodes, conductance_s, &plates)
    }

    /// Solves for contacts at these nodes, in ascending order. `plates` is the conductor above each.
    pub(super) fn solve(&self, nodes: Vec<u32>, conductance_s: Vec<f64>, plates: &[u32]) -> Result<Touched, EitError> {
        let (count, fields) = (nodes.len(), self.field_count());
        if count == 0 {
            return Ok(Touched { nodes, conductance_s, currents: Mat::zeros(0, fields), common: Vec::new() });
        }
        let mut touched_plates = plates.to_vec();
        touched_plates.sort_unstable();
        touched_plates.dedup();
        let plates: Vec<usize> =
            plates.iter().map(|plate| touched_plates.partition_point(|other| other < plate)).collect();
        // Sum of some columns under each plate.
        let sums = |of: &Mat<f64>, columns: Range<usize>| {
            let mut totals = Mat::<f64>::zeros(touched_plates.len(), columns.len());
            for (k, column) in columns.enumerate() {
                let under = totals.col_as_slice_mut(k);
                plates.iter().zip(of.col_as_slice(column)).for_each(|(&plate, value)| under[plate] += value);
            }
            totals
        };
        // A plate's potential adjusts, so only differences from the mean under it matter. Without the mean, rounding
        // errors are a share of these differences.
        let mut means = vec![vec![0.0; fields]; touched_plates.len()];
        let mut under = vec![0.0; touched_plates.len()];
        for (&node, &plate) in nodes.iter().zip(&plates) {
            under[plate] += 1.0;
            let driving = self.fields.col_as_slice(node as usize);
            means[plate].iter_mut().zip(driving).for_each(|(sum, value)| *sum += value);
        }
        means.iter_mut().zip(&under).for_each(|(means, under)| means.iter_mut().for_each(|mean| *mean /= under));
        let mut right = Mat::<f32>::zeros(count, fields + touched_plates.len());
        for (row, (&node, &plate)) in nodes.iter().zip(&plates).enumerate() {
            let driving = self.fields.col_as_slice(node as usize).iter().zip(&means[plate]);
            driving.enumerate().for_each(|(field, (value, mean))| right[(row, field)] = (value - mean) as f32);
            right[(row, fields + plate)] = 1.0;
        }
        let singular = || EitError::System(SparseError::NotPositiveDefinite { pivot: 0, size: count });
        let solved = self.solve_contacts(&nodes, &conductance_s, right).ok_or_else(singular)?;
        let (driven, alone) = (solved.subcols(0, fields), solved.subcols(fields, touched_plates.len()));
        let common = solved.col_as_slice(fields).to_vec();
        // No net current enters a plate.
        let level = Llt::new(sums(&solved, fields..solved.ncols()).as_ref(), Side::Lower).map_err(|_| singular())?;
        let currents = driven - alone * level.solve(sums(&solved, 0..fields));
        Ok(Touched { nodes, conductance_s, currents, common })
    }

    /// `M^-1` times some columns; `None` if M is not positive definite. Single precision takes half the time of double
    /// precision, and fits of presses to simulated frames end at the same places.
    fn solve_contacts(&self, nodes: &[u32], conductance_s: &[f64], mut columns: Mat<f32>) -> Option<Mat<f64>> {
        let count = nodes.len();
        // Only the lower triangle is read.
        let mut matrix = Mat::<f32>::zeros(count, count);
        for (b, &node) in nodes.iter().enumerate() {
            // Nodes are in ascending order.
            let green = self.green.column(node as usize);
            let column = &mut matrix.col_as_slice_mut(b)[b..];
            column.iter_mut().zip(&nodes[b..]).for_each(|(value, other)| *value = green[(other - node) as usize]);
            column[0] += (1.0 / conductance_s[b]) as f32;
        }
        let mut memory = MemBuffer::new(StackReq::any_of(&[
            cholesky_in_place_scratch::<f32>(count, Par::Seq, Default::default()),
            solve_in_place_scratch::<f32>(count, columns.ncols(), Par::Seq),
        ]));
        let stack = MemStack::new(&mut memory);
        cholesky_in_place(matrix.as_mut(), Default::default(), Par::Seq, stack, Default::default()).ok()?;
        solve_in_place(matrix.as_ref(), columns.as_mut(), Par::Seq, stack);
        let mut solved = Mat::zeros(count, columns.ncols());
        for column in 0..columns.ncols() {
            let values = solved.col_as_slice_mut(column).iter_mut().zip(columns.col_as_slice(column));
            values.for_each(|(value, single)| *value = f64::from(*single));
        }
        Some(solved)
    }

    /// Derivatives of the channels with respect to [`OF_PRESS`] parameters. `rows` are the touched nodes that
    /// depend on them, and `moves` the derivatives of their conductances, divided by the conductances.
    pub(super) fn exchange(
        &self,
        touched: &Touched,
        rows: &[usize],
        moves: &[[f64; OF_PRESS]],
        mut set: impl FnMut(usize, usize, f64),
    ) {
        let (measuring, stimulations) = (self.measuring(), self.stimulations);
        let mut measured = Mat::<f64>::zeros(rows.len(), measuring.len());
        for field in 0..measuring.len() {
            let currents = touched.currents.col_as_slice(measuring.start + field);
            let values = measured.col_as_slice_mut(field);
            values.iter_mut().zip(rows).for_each(|(v, &row)| *v = currents[row] / touched.conductance_s[row]);
        }
        let mut driven = Mat::<f64>::zeros(rows.len(), OF_PRESS * stimulations);
        for column in 0..OF_PRESS * stimulations {
            let (j, stimulation) = (column / stimulations, column % stimulations);
            let currents = touched.currents.col_as_slice(stimulation);
            for ((value, &row), by) in driven.col_as_slice_mut(column).iter_mut().zip(rows).zip(moves) {
                *value = by[j] * currents[row];
            }
        }
        let exchange = measured.transpose() * &driven;
        for (number, channel) in self.measurements.iter().enumerate() {
            for j in 0..OF_PRESS {
                let column = j * stimulations + channel.stimulation as usize;
                set(number, j, -self.measured(channel, |field| exchange[(field - measuring.start, column)]));
            }
        }
    }

    pub(super) fn check_frame(&self, change_v: &[f64], deviation_v: &[f64]) -> Result<(), EitError> {
        let expected = self.channels();
        match [change_v.len(), deviation_v.len()].into_iter().find(|length| *length != expected) {
            Some(got) => Err(EitError::ChannelCount { expected, got }),
            None => Ok(()),
        }
    }

    pub(super) fn change_of(&self, touched: &Touched) -> Vec<f64> {
        let measuring = self.measuring();
        let mut fields = Mat::<f64>::zeros(measuring.len(), touched.nodes.len());
        for (row, &node) in touched.nodes.iter().enumerate() {
            fields.col_as_slice_mut(row).copy_from_slice(&self.fields.col_as_slice(node as usize)[measuring.clone()]);
        }
        let exchange = &fields * touched.currents.subcols(0, self.stimulations);
        let change =
            |c: &Measurement| -self.measured(c, |field| exchange[(field - measuring.start, c.stimulation as usize)]);
        self.measurements.iter().map(change).collect()
    }

    /// What a channel's measuring pattern reads of a quantity that is linear in the fields.
    pub(super) fn measured(&self, channel: &Measurement, of_field: impl Fn(usize) -> f64) -> f64 {
        self.patterns[channel.pattern as usize].iter().map(|&(field, weight)| weight * of_field(field)).sum()
    }
}

/// The factor between two sets of potentials; `None` if they are not multiples of each other.
fn multiple_of(driven: &[f64], measured: &[f64]) -> Option<f64> {
    let largest = |values: &[f64]| (0..values.len()).max_by(|&a, &b| values[a].abs().total_cmp(&values[b].abs()));
    let at = largest(driven)?;
    let multiple = measured[at] / driven[at];
    let close = SAME * measured[largest(measured)?].abs();
    let is_same = || measured.iter().zip(driven).all(|(m, d)| (m - multiple * d).abs() <= close);
    (multiple.is_finite() && multiple != 0.0 && is_same()).then_some(multiple)
}
