//! Slabs: boxes cut along grid lines that follow the edges of their electrodes.

use super::super::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
use super::super::plane::{Point, distance};
use super::super::shapes::{check_coordinate, check_length};
use super::super::sheet::spread;
use super::grid::{box_elements, box_nodes, grid_lines, refuse_too_many};

/// A side of a slab, with the two axes of its patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlabFace {
    /// z = 0; patches in (x, y).
    Bottom,
    /// z = thickness; patches in (x, y).
    Top,
    /// x = -width/2; patches in (y, z).
    Left,
    /// x = +width/2; patches in (y, z).
    Right,
    /// y = -depth/2; patches in (x, z).
    Front,
    /// y = +depth/2; patches in (x, z).
    Back,
}

impl SlabFace {
    /// Axis perpendicular to the face, and whether the face is at its upper end.
    fn axis(self) -> (usize, bool) {
        match self {
            SlabFace::Left => (0, false),
            SlabFace::Right => (0, true),
            SlabFace::Front => (1, false),
            SlabFace::Back => (1, true),
            SlabFace::Bottom => (2, false),
            SlabFace::Top => (2, true),
        }
    }

    fn patch_axes(self) -> [usize; 2] {
        match self.axis().0 {
            0 => [1, 2],
            1 => [0, 2],
            _ => [0, 1],
        }
    }
}

/// A patch of a slab's surface, in the two axes of its [`SlabFace`], metres.
#[derive(Clone, Debug, PartialEq)]
pub enum PatchShape {
    /// All surface triangles whose centroid is inside. The meshed area is that of a staircase, see
    /// [`ElectrodedMesh::electrode_measures`]. For round electrodes with exact area use a
    /// [`PrismSpec`](super::PrismSpec).
    Circle {
        /// Centre.
        centre_m: Point,
        /// Radius.
        radius_m: f64,
    },
    /// Grid lines run along its edges, so its area is exact.
    Rectangle {
        /// Centre.
        centre_m: Point,
        /// Along the face's first axis.
        width_m: f64,
        /// Along the face's second axis.
        height_m: f64,
    },
    /// One node, with grid lines through it.
    Point {
        /// Position of the node.
        position_m: Point,
    },
}

/// An electrode of a slab.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabElectrode {
    /// Side of the slab.
    pub face: SlabFace,
    /// Area covered on that side.
    pub shape: PatchShape,
}

/// A box, with x and y centred on the origin and z from 0 to its thickness.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabSpec {
    /// Width (x), depth (y) and thickness (z), metres.
    pub size_m: [f64; 3],
    /// Approximate number of boxes along each axis; grid lines for electrodes may add some.
    pub cells: [usize; 3],
    /// Electrodes, in order.
    pub electrodes: Vec<SlabElectrode>,
}

impl SlabSpec {
    /// Meshes the slab; `contact_impedance` in ohm.m^2, one value for all electrodes or one each.
    ///
    /// # Errors
    /// Invalid sizes or counts, or electrodes that are off their face, overlap, or are too small to contain the
    /// centroid of a surface triangle.
    pub fn build(&self, contact_impedance: &[f64]) -> Result<ElectrodedMesh, MeshError> {
        let impedances = spread(contact_impedance, self.electrodes.len())?;
        for (field, size) in ["size_m[0]", "size_m[1]", "size_m[2]"].into_iter().zip(self.size_m) {
            check_length(field, size)?;
        }
        let mut breaks: [Vec<f64>; 3] = Default::default();
        for (electrode, placed) in self.electrodes.iter().enumerate() {
            self.check(placed).map_err(|reason| MeshError::Electrode { electrode, reason })?;
            for (axis, range) in placed.face.patch_axes().into_iter().zip(placed.shape.exact_ranges()) {
                breaks[axis].extend(range);
            }
        }
        let lines = [0, 1, 2].map(|axis| {
            let (low, high) = self.range(axis);
            grid_lines(low, high, self.cells[axis].max(1), &breaks[axis])
        });
        let boxes = lines.iter().map(|line| (line.len() - 1) as f64).product::<f64>();
        refuse_too_many(6.0 * boxes, "cells", format!("{:?}", self.cells))?;
        let mesh = Mesh::new(CellKind::Tetrahedron, box_nodes(&lines), box_elements(&lines))?;
        let surface = mesh.boundary_faces();
        let electrodes = self
            .electrodes
            .iter()
            .zip(impedances)
            .map(|(placed, contact_impedance)| {
                let contact = self.contact(placed, &mesh, &surface);
                Electrode { contact, contact_impedance }
            })
            .collect();
        ElectrodedMesh::new(mesh, electrodes)
    }

    fn range(&self, axis: usize) -> (f64, f64) {
        let size = self.size_m[axis];
        if axis == 2 { (0.0, size) } else { (-size / 2.0, size / 2.0) }
    }

    fn check(&self, placed: &SlabElectrode) -> Result<(), String> {
        placed.shape.check().map_err(|error| error.to_string())?;
        for (axis, [low, high]) in placed.face.patch_axes().into_iter().zip(placed.shape.ranges()) {
            let (from, to) = self.range(axis);
            let slack = 1e-9 * self.size_m[axis];
            if low < from - slack || high > to + slack {
                let name = ["x", "y", "z"][axis];
                return Err(format!("reaches from {low} to {high} m along {name}, off the face's {from} to {to} m"));
            }
        }
        Ok(())
    }

    fn contact(&self, placed: &SlabElectrode, mesh: &Mesh, surface: &[(Vec<u32>, u32)]) -> Contact {
        let (axis, upper) = placed.face.axis();
        let level = if upper { self.range(axis).1 } else { self.range(axis).0 };
        let [u, v] = placed.face.patch_axes();
        if let PatchShape::Point { position_m } = placed.shape {
            let mut wanted = [level; 3];
            (wanted[u], wanted[v]) = (position_m[0], position_m[1]);
            return Contact::Point(nearest(mesh.nodes(), wanted));
        }
        let slack = 1e-9 * self.size_m[axis];
        let covered = |face: &&(Vec<u32>, u32)| {
            let corners = face.0.iter().map(|&node| mesh.nodes()[node as usize]);
            let mut centre = [0.0; 2];
            for corner in corners {
                if (corner[axis] - level).abs() > slack {
                    return false;
                }
                centre = [centre[0] + corner[u] / 3.0, centre[1] + corner[v] / 3.0];
            }
            placed.shape.covers(centre)
        };
        Contact::Faces(surface.iter().filter(covered).map(|(face, _)| face.clone()).collect())
    }
}

impl PatchShape {
    fn check(&self) -> Result<(), MeshError> {
        let (place, lengths) = match self {
            PatchShape::Circle { centre_m, radius_m } => (centre_m, vec![("radius_m", *radius_m)]),
            PatchShape::Rectangle { centre_m, width_m, height_m } => {
                (centre_m, vec![("width_m", *width_m), ("height_m", *height_m)])
            }
            PatchShape::Point { position_m } => (position_m, Vec::new()),
        };
        place.iter().try_for_each(|&value| check_coordinate("position", value))?;
        lengths.into_iter().try_for_each(|(field, length)| check_length(field, length))
    }

    /// Extent along the face's two axes.
    fn ranges(&self) -> [[f64; 2]; 2] {
        let (centre, half) = match self {
            PatchShape::Circle { centre_m, radius_m } => (centre_m, [*radius_m, *radius_m]),
            PatchShape::Rectangle { centre_m, width_m, height_m } => (centre_m, [width_m / 2.0, height_m / 2.0]),
            PatchShape::Point { position_m } => (position_m, [0.0, 0.0]),
        };
        [0, 1].map(|k| [centre[k] - half[k], centre[k] + half[k]])
    }

    /// Required positions of grid lines.
    fn exact_ranges(&self) -> [Vec<f64>; 2] {
        match self {
            PatchShape::Circle { .. } => [Vec::new(), Vec::new()],
            _ => self.ranges().map(|range| range.to_vec()),
        }
    }

    fn covers(&self, p: Point) -> bool {
        match self {
            PatchShape::Circle { centre_m, radius_m } => distance(*centre_m, p) < *radius_m,
            _ => self.ranges().iter().zip(p).all(|(range, value)| range[0] < value && value < range[1]),
        }
    }
}

fn nearest(nodes: &[[f64; 3]], wanted: [f64; 3]) -> u32 {
    let gap = |p: &[f64; 3]| (0..3).map(|axis| (p[axis] - wanted[axis]).powi(2)).sum::<f64>();
    let order = |a: &usize, b: &usize| gap(&nodes[*a]).total_cmp(&gap(&nodes[*b]));
    (0..nodes.len()).min_by(order).unwrap_or(0) as u32
}
