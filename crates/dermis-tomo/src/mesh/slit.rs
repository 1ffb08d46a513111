//! Sheets with slits: the nodes along a line are doubled, so the two sides are connected only at the line's ends.

use std::collections::HashMap;

use super::core::{CellKind, ElectrodedMesh, Mesh, MeshError};
use super::plane::{Point, cross2, distance, minus, to_segment};
use super::sheet::SheetSpec;

/// A piece of a slit: the edge on one side and the edge on the other. They share nodes only at the slit's ends.
pub type SlitEdge = [[u32; 2]; 2];

/// Contribution of a slit edge to the stiffness of a sheet if its sides are joined: `int g (u - u')^2 ds` with u and
/// u' linear along the edge and g siemens per metre of edge, as entries of one triangle of a symmetric matrix over
/// the nodes.
pub fn joint_entries([one, other]: SlitEdge, length_m: f64, s_per_m: f64) -> Vec<((u32, u32), f64)> {
    let mass = s_per_m * length_m / 6.0;
    let mut entries = Vec::with_capacity(10);
    for i in 0..2 {
        for j in 0..=i {
            // There is nothing to join at a slit's end.
            if one[i] == other[i] || one[j] == other[j] {
                continue;
            }
            let value = mass * if i == j { 2.0 } else { 1.0 };
            entries.extend([((one[i], one[j]), value), ((other[i], other[j]), value), ((one[i], other[j]), -value)]);
            if i != j {
                entries.push(((other[i], one[j]), -value));
            }
        }
    }
    entries
}

/// A mesh with slits.
#[derive(Clone, Debug, PartialEq)]
pub struct SlitMesh {
    /// Elements and electrodes as before; added nodes come last.
    pub mesh: ElectrodedMesh,
    /// The edges of each slit, in no particular order.
    pub slits: Vec<Vec<SlitEdge>>,
}

impl SheetSpec {
    /// Meshes the sheet with slits along straight lines (both ends, metres), in addition to its own lines. The flags
    /// tell which of them could be slit. Lines that leave the sheet, or meet an electrode or an earlier line, are
    /// left out.
    ///
    /// # Errors
    /// As [`SheetSpec::build`] without slits.
    pub fn build_slit(
        &self,
        contact_impedance: &[f64],
        lines: &[[Point; 2]],
    ) -> Result<(SlitMesh, Vec<bool>), MeshError> {
        let meshed = |lines: &[[Point; 2]]| {
            let spec = Self { lines: [&self.lines, lines].concat(), ..self.clone() };
            spec.build(contact_impedance)?.0.opened_along(lines)
        };
        if let Ok(all) = meshed(lines) {
            return Ok((all, vec![true; lines.len()]));
        }
        let (mut kept, mut best) = (Vec::new(), meshed(&[])?);
        let mut add = |line: &[Point; 2]| {
            kept.push(*line);
            let slit = meshed(&kept).map(|mesh| best = mesh).is_ok();
            if !slit {
                kept.pop();
            }
            slit
        };
        let is_slit = lines.iter().map(&mut add).collect();
        Ok((best, is_slit))
    }
}

impl ElectrodedMesh {
    /// The mesh, opened along straight lines (both ends, metres) that its edges follow ([`super::SheetSpec::lines`]).
    ///
    /// # Errors
    /// A mesh that is not a flat sheet, or a line that edges do not follow from end to end.
    pub fn opened_along(&self, lines: &[[Point; 2]]) -> Result<SlitMesh, MeshError> {
        let refuse =
            |value: String, expected: &str| Err(MeshError::Shape { field: "lines", value, expected: expected.into() });
        if self.mesh.kind() != CellKind::Triangle || self.mesh.nodes().iter().any(|p| p[2] != self.mesh.nodes()[0][2]) {
            return refuse("a mesh that is not flat".into(), "a flat sheet to open");
        }
        let (low, high) = self.mesh.bounds();
        let tolerance = 1e-9 * distance([low[0], low[1]], [high[0], high[1]]);
        let mut nodes = self.mesh.nodes().to_vec();
        let mut elements: Vec<u32> = self.mesh.elements().flatten().copied().collect();
        let mut slits = Vec::with_capacity(lines.len());
        for &[a, b] in lines {
            let along = minus(b, a);
            let within = |p: Point| to_segment(p, a, b).0 <= tolerance;
            let is_end = |p: Point| distance(p, a) <= tolerance || distance(p, b) <= tolerance;
            let mut on_line = vec![false; nodes.len()];
            for (on, node) in on_line.iter_mut().zip(&nodes) {
                *on = within([node[0], node[1]]);
            }
            let at = |node: u32| [nodes[node as usize][0], nodes[node as usize][1]];
            let mut edges = Vec::new();
            let mut twins: HashMap<u32, u32> = HashMap::new();
            let mut moved = Vec::new();
            for (position, corner) in elements.iter().enumerate() {
                let cell = &elements[position / 3 * 3..position / 3 * 3 + 3];
                let middle = [0, 1].map(|axis| cell.iter().map(|&node| at(node)[axis]).sum::<f64>() / 3.0);
                let left = cross2(along, minus(middle, a)) > 0.0;
                let next = cell[(position + 1) % 3];
                if left && on_line[*corner as usize] && on_line[next as usize] {
                    edges.push([*corner, next]);
                }
                if left && on_line[*corner as usize] && !is_end(at(*corner)) {
                    let count = (nodes.len() + twins.len()) as u32;
                    moved.push((position, *twins.entry(*corner).or_insert(count)));
                }
            }
            let covered: f64 = edges.iter().map(|&[from, to]| distance(at(from), at(to))).sum();
            if (covered - distance(a, b)).abs() > 4.0 * tolerance {
                let value = format!("line from ({}, {}) to ({}, {}) m,", a[0], a[1], b[0], b[1]);
                return refuse(value, "a line that edges follow from end to end");
            }
            slits.push(
                edges.into_iter().map(|edge| [edge, edge.map(|node| *twins.get(&node).unwrap_or(&node))]).collect(),
            );
            let mut added = vec![[0.0; 3]; twins.len()];
            twins.iter().for_each(|(&node, &twin)| added[twin as usize - nodes.len()] = nodes[node as usize]);
            nodes.extend(added);
            moved.into_iter().for_each(|(position, twin)| elements[position] = twin);
        }
        let mesh = Mesh::new(CellKind::Triangle, nodes, elements)?;
        Ok(SlitMesh { mesh: Self::new(mesh, self.electrodes.clone())?, slits })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eit::{ForwardModel, Pattern, Protocol};
    use crate::mesh::{ElectrodeShape, Outline, SheetSpec};

    const LINE: [Point; 2] = [[-0.012, 0.004], [0.009, 0.018]];

    fn spec() -> SheetSpec {
        let outline = Outline::Rectangle { width_m: 0.1, height_m: 0.1 };
        let pads = ElectrodeShape::PadCircle { centre_m: [0.0; 2], radius_m: 4e-3 }.grid(2, 2, [0.08; 2]);
        SheetSpec { lines: vec![LINE], ..SheetSpec::new(outline, pads, 4e-3) }
    }

    #[test]
    fn a_slit_has_two_sides_and_its_ends_are_joined() {
        let (mesh, quality) = spec().build(&[1e-3]).unwrap();
        assert!(quality.refinement_complete && quality.min_angle_deg >= 25.0, "{quality:?}");
        let SlitMesh { mesh: open, slits } = mesh.opened_along(&[LINE]).unwrap();
        assert_eq!(open.mesh.element_count(), mesh.mesh.element_count());
        let added = open.mesh.nodes().len() - mesh.mesh.nodes().len();
        // Count both faces: there is one more edge than nodes between the ends.
        let faces = open.mesh.boundary_faces().len() - mesh.mesh.boundary_faces().len();
        assert_eq!(faces, 2 * (added + 1));
        let length: f64 = open.mesh.boundary_faces().iter().map(|(face, _)| open.mesh.face_measure(face)).sum();
        let expected = 0.4 + 2.0 * distance(LINE[0], LINE[1]);
        assert!((length - expected).abs() < 1e-9, "{length} {expected}");
        let nodes = open.mesh.nodes();
        assert_eq!(slits[0].len(), added + 1);
        for [one, other] in &slits[0] {
            for (a, b) in one.iter().zip(other) {
                let p = nodes[*a as usize];
                assert_eq!(p, nodes[*b as usize]);
                let is_end = LINE.iter().any(|end| distance(*end, [p[0], p[1]]) < 1e-12);
                assert_eq!(a == b, is_end);
            }
        }
        for line in [[[0.0, 0.0], [0.01, 0.0]], [LINE[0], [0.03, 0.032]]] {
            let error = mesh.opened_along(&[line]).unwrap_err().to_string();
            assert!(error.contains("edges follow"), "{error}");
        }
    }

    #[test]
    fn the_field_of_a_slit_agrees_with_the_closed_form() {
        // Along a strip of width W with insulating sides, the current meets a row of slits of half length a at
        // spacing W. Their resistance equals that of (2 W / pi) ln sec(pi a / W) more of strip (conformal map by the
        // sine; Smythe, Static and Dynamic Electricity, 1950). At ends four half widths away, 0.2 % of it is uneven.
        let outline = Outline::Rectangle { width_m: 0.2, height_m: 0.1 };
        let line = [[0.0, -0.02], [0.0, 0.02]];
        // Rim positions start at the bottom left corner and run counter-clockwise.
        let side = |centre_m: f64| ElectrodeShape::RimSegment { centre_m, width_m: 0.1 };
        let sides = vec![side(0.25), side(0.55)];
        let spec = SheetSpec { lines: vec![line], ..SheetSpec::new(outline, sides, 4e-3) };
        let (sewn, _) = spec.build(&[1e-6]).unwrap();
        let open = sewn.opened_along(&[line]).unwrap().mesh;
        let drive = || Pattern::new(vec![(0, 1.0), (1, -1.0)]);
        let protocol = Protocol::from_patterns(2, vec![drive()], vec![(drive(), 0)]).unwrap();
        let ohm = |body: &ElectrodedMesh| {
            let model = ForwardModel::new(body.clone(), protocol.clone()).unwrap();
            model.voltages(&vec![5e-3; body.mesh.element_count()]).unwrap()[0]
        };
        let found_m = (ohm(&open) - ohm(&sewn)) * 5e-3 * 0.1;
        let expected_m = 0.2 / std::f64::consts::PI * -(0.2 * std::f64::consts::PI).cos().ln();
        // Linear elements of 4 mm, graded by 0.35 from the ends, are 2.4 % too stiff (0.9 % for 2 mm graded by 0.15).
        assert!((found_m / expected_m - 1.0).abs() < 0.03, "{found_m} {expected_m}");
    }

    #[test]
    fn impossible_slits_are_left_out() {
        let across = [[-0.01, 0.018], [0.01, 0.0]];
        let off = [[0.0, 0.0], [0.06, 0.0]];
        let clear = [[0.0, -0.02], [0.02, -0.02]];
        let spec = SheetSpec { lines: Vec::new(), ..spec() };
        let (mesh, is_slit) = spec.build_slit(&[1e-3], &[LINE, across, off, clear]).unwrap();
        assert_eq!(is_slit, [true, false, false, true]);
        assert_eq!(mesh.slits.len(), 2);
        assert!(spec.build_slit(&[1e-3, 1e-3], &[LINE]).is_err());
    }

    #[test]
    fn lines_off_the_sheet_on_electrodes_and_across_each_other_are_refused() {
        for (lines, expected) in [
            (vec![[[0.0, 0.0], [0.06, 0.0]]], "inside the sheet"),
            (vec![[[0.0, 0.0], [0.04, 0.04]]], "clear of holes and electrodes"),
            (vec![LINE, [[-0.01, 0.018], [0.01, 0.0]]], "other lines"),
            (vec![[[0.0, 0.0], [0.0, 0.0]]], "lines"),
            (vec![[[0.0, f64::NAN], [0.01, 0.0]]], "lines"),
        ] {
            let error = SheetSpec { lines, ..spec() }.build(&[1e-3]).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
