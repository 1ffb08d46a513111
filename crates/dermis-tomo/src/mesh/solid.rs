//! Solids of tetrahedra: a [`SlabSpec`] cut into boxes of six tetrahedra each (Kuhn's subdivision, conforming by
//! construction), and a [`PrismSpec`], any sheet outline extruded upward, whose prisms split into three tetrahedra by
//! the order of their node numbers (conforming for the same reason). Electrodes are patches of surface triangles.

use super::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
use super::layout::Features;
use super::plane::{Point, distance};
use super::shapes::{ElectrodeShape, Outline, check_coordinate, check_length};
use super::sheet::{SheetSpec, features, rim_edges, span_of, spread};
use super::triangulate::Planar;

/// More tetrahedra than this are refused before any work is done.
const MOST_TETRAHEDRA: usize = 12_000_000;

/// A side of a slab, with the two axes its patches are given in.
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
    /// Axis the face is perpendicular to, and whether it is the upper end of it.
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
    /// All surface triangles whose centroid lies inside; its meshed area is a staircase's, see
    /// [`ElectrodedMesh::electrode_measures`]. For round electrodes of exact area use a [`PrismSpec`].
    Circle {
        /// Centre.
        centre_m: [f64; 2],
        /// Radius.
        radius_m: f64,
    },
    /// Grid lines run along its edges: its area is exact.
    Rectangle {
        /// Centre.
        centre_m: [f64; 2],
        /// Along the face's first axis.
        width_m: f64,
        /// Along the face's second axis.
        height_m: f64,
    },
    /// One node, through which grid lines run.
    Point {
        /// Where.
        position_m: [f64; 2],
    },
}

/// An electrode of a slab.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabElectrode {
    /// The side it is on.
    pub face: SlabFace,
    /// What it covers there.
    pub shape: PatchShape,
}

/// A box, x and y centred at the origin, z from 0 to its thickness.
#[derive(Clone, Debug, PartialEq)]
pub struct SlabSpec {
    /// Width (x), depth (y) and thickness (z), metres.
    pub size_m: [f64; 3],
    /// About how many boxes along each axis; electrodes' grid lines may add some.
    pub cells: [usize; 3],
    /// Its electrodes, in order.
    pub electrodes: Vec<SlabElectrode>,
}

/// An electrode of a prism.
#[derive(Clone, Debug, PartialEq)]
pub enum PrismElectrode {
    /// A patch of the wall: a rim arc or segment between two heights.
    Side {
        /// [`ElectrodeShape::RimArc`] or [`ElectrodeShape::RimSegment`].
        rim: ElectrodeShape,
        /// Its lower edge above the bottom, metres.
        low_m: f64,
        /// Its upper edge above the bottom, metres.
        high_m: f64,
    },
    /// One node of the wall.
    SidePoint {
        /// Position along the rim, metres.
        position_m: f64,
        /// Height above the bottom, metres.
        height_m: f64,
    },
    /// A pad or point on the bottom, z = 0.
    Bottom(ElectrodeShape),
    /// A pad or point on the top.
    Top(ElectrodeShape),
}

/// A sheet's outline extruded from z = 0 to its height: cylinders, tanks, thick skins.
#[derive(Clone, Debug, PartialEq)]
pub struct PrismSpec {
    /// Shape seen from above.
    pub outline: Outline,
    /// Height, metres.
    pub height_m: f64,
    /// Edge length of the triangles seen from above, away from electrodes, metres.
    pub element_size_m: f64,
    /// The same at electrodes, metres.
    pub electrode_element_size_m: f64,
    /// About how many layers; the edges of wall electrodes may add some.
    pub layers: usize,
    /// Its electrodes, in order. Pads on bottom and top must be equal or clear of each other seen from above.
    pub electrodes: Vec<PrismElectrode>,
}

impl SlabSpec {
    /// Meshes the slab; `contact_impedance` in ohm.m^2, one for all electrodes or one each.
    ///
    /// # Errors
    /// Sizes or counts that are not usable, electrodes off their face, overlapping, or too small to hold the centroid
    /// of one surface triangle.
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

    /// Where grid lines must run.
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

impl PrismSpec {
    /// An upright cylinder with elements of one size.
    pub fn cylinder(
        radius_m: f64,
        height_m: f64,
        element_size_m: f64,
        layers: usize,
        electrodes: Vec<PrismElectrode>,
    ) -> Self {
        let outline = Outline::Disc { radius_m };
        Self { outline, height_m, element_size_m, electrode_element_size_m: element_size_m, layers, electrodes }
    }

    /// Meshes the prism; `contact_impedance` in ohm.m^2, one for all electrodes or one each.
    ///
    /// # Errors
    /// As [`SheetSpec::build`], and wall electrodes that reach above or below the wall.
    pub fn build(&self, contact_impedance: &[f64]) -> Result<ElectrodedMesh, MeshError> {
        let impedances = spread(contact_impedance, self.electrodes.len())?;
        check_length("height_m", self.height_m)?;
        let heights = self.heights()?;
        super::layout::check_outline(&self.outline)?;
        let (shapes, shape_of) = self.distinct_shapes();
        let planar = self.plan(&shapes, &shape_of)?;
        let count = planar.triangles.len() as f64 * (heights.len() - 1) as f64 * 3.0;
        refuse_too_many(count, "layers", self.layers.to_string())?;
        let mesh = extrude(&planar, &heights)?;
        let place = Place { outline: &self.outline, planar: &planar, heights: &heights };
        let pads = |index: usize| shapes[..shape_of[index]].iter().filter(is_pad).count() as u32;
        let points = |index: usize| {
            let alike = |shape: &&ElectrodeShape| matches!(shape, ElectrodeShape::Point { .. });
            planar.point_nodes[shapes[..shape_of[index]].iter().filter(alike).count()]
        };
        let rim_points = |index: usize| {
            let alike = |shape: &&ElectrodeShape| matches!(shape, ElectrodeShape::RimPoint { .. });
            planar.rim_point_nodes[shapes[..shape_of[index]].iter().filter(alike).count()]
        };
        let contact = |index: usize, electrode: &PrismElectrode| match electrode {
            PrismElectrode::Side { rim, low_m, high_m } => Contact::Faces(place.wall(rim, *low_m, *high_m)),
            PrismElectrode::SidePoint { height_m, .. } => Contact::Point(place.raised(rim_points(index), *height_m)),
            PrismElectrode::Bottom(shape) | PrismElectrode::Top(shape) => {
                let height = if matches!(electrode, PrismElectrode::Top(_)) { self.height_m } else { 0.0 };
                match shape {
                    ElectrodeShape::Point { .. } => Contact::Point(place.raised(points(index), height)),
                    ElectrodeShape::RimPoint { .. } => Contact::Point(place.raised(rim_points(index), height)),
                    _ => Contact::Faces(place.flat(pads(index), height)),
                }
            }
        };
        let electrodes = self
            .electrodes
            .iter()
            .enumerate()
            .zip(impedances)
            .map(|((index, electrode), contact_impedance)| Electrode {
                contact: contact(index, electrode),
                contact_impedance,
            })
            .collect();
        ElectrodedMesh::new(mesh, electrodes)
    }

    /// The heights of the layers' faces.
    fn heights(&self) -> Result<Vec<f64>, MeshError> {
        let mut breaks = Vec::new();
        for (electrode, shape) in self.electrodes.iter().enumerate() {
            let off = |reason: String| Err(MeshError::Electrode { electrode, reason });
            let top = self.height_m;
            match *shape {
                PrismElectrode::Side { low_m, high_m, .. } => {
                    if !(low_m >= 0.0 && low_m < high_m && high_m <= top * (1.0 + 1e-9)) {
                        return off(format!("heights {low_m} to {high_m} m are not a range within 0 to {top} m"));
                    }
                    breaks.extend([low_m, high_m]);
                }
                PrismElectrode::SidePoint { height_m, .. } => {
                    if !(0.0..=top).contains(&height_m) {
                        return off(format!("height {height_m} m is not within 0 to {top} m"));
                    }
                    breaks.push(height_m);
                }
                _ => {}
            }
        }
        refuse_too_many(self.layers as f64, "layers", self.layers.to_string())?;
        Ok(grid_lines(0.0, self.height_m, self.layers.max(1), &breaks))
    }

    /// Every different plan shape once, and which of them each electrode has: rings of electrodes above each other,
    /// or pads on bottom and top, share theirs.
    fn distinct_shapes(&self) -> (Vec<ElectrodeShape>, Vec<usize>) {
        let mut shapes: Vec<ElectrodeShape> = Vec::new();
        let shape_of = |electrode: &PrismElectrode| {
            let shape = match electrode {
                PrismElectrode::Side { rim: shape, .. } => shape.clone(),
                PrismElectrode::SidePoint { position_m, .. } => ElectrodeShape::RimPoint { position_m: *position_m },
                PrismElectrode::Bottom(shape) | PrismElectrode::Top(shape) => shape.clone(),
            };
            shapes.iter().position(|known| *known == shape).unwrap_or_else(|| {
                shapes.push(shape);
                shapes.len() - 1
            })
        };
        let indices = self.electrodes.iter().map(shape_of).collect();
        (shapes, indices)
    }

    fn plan(&self, shapes: &[ElectrodeShape], shape_of: &[usize]) -> Result<Planar, MeshError> {
        for (electrode, shape) in self.electrodes.iter().enumerate() {
            let fits = match shape {
                PrismElectrode::Side { rim, .. } => is_span(rim),
                PrismElectrode::SidePoint { .. } => true,
                PrismElectrode::Bottom(shape) | PrismElectrode::Top(shape) => !is_span(shape),
            };
            if !fits {
                let reason = "rim stretches belong on the side, pads and points on bottom or top".to_string();
                return Err(MeshError::Electrode { electrode, reason });
            }
        }
        let owner = |shape: usize| shape_of.iter().position(|&s| s == shape).unwrap_or(shape);
        let renumber = |error: MeshError| match error {
            MeshError::Electrode { electrode, reason } => MeshError::Electrode { electrode: owner(electrode), reason },
            other => other,
        };
        let mut sheet = SheetSpec::new(self.outline.clone(), Vec::new(), self.element_size_m);
        sheet.electrode_element_size_m = self.electrode_element_size_m;
        let mut plan: Features = features(&self.outline, shapes, self.electrode_element_size_m).map_err(renumber)?;
        for list in [&mut plan.span_owner, &mut plan.rim_point_owner, &mut plan.pad_owner, &mut plan.point_owner] {
            list.iter_mut().for_each(|shape| *shape = owner(*shape));
        }
        sheet.mesh_features(&plan)
    }
}

fn is_pad(shape: &&ElectrodeShape) -> bool {
    matches!(shape, ElectrodeShape::PadCircle { .. } | ElectrodeShape::PadRectangle { .. })
}

fn is_span(shape: &ElectrodeShape) -> bool {
    matches!(shape, ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. })
}

/// An extruded plan, for finding nodes and faces of the solid.
struct Place<'a> {
    outline: &'a Outline,
    planar: &'a Planar,
    heights: &'a [f64],
}

impl Place<'_> {
    /// The solid's node above a node of the plan.
    fn raised(&self, node: u32, height: f64) -> u32 {
        let gap = |level: &usize| (self.heights[*level] - height).abs();
        let level = (0..self.heights.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(0);
        node + (level * self.planar.nodes.len()) as u32
    }

    fn wall(&self, rim: &ElectrodeShape, low: f64, high: f64) -> Vec<Vec<u32>> {
        let perimeter = self.outline.perimeter_m();
        let Some(span) = span_of(self.outline, rim) else { return Vec::new() };
        let per_level = self.planar.nodes.len() as u32;
        let mut faces = Vec::new();
        for (level, pair) in self.heights.windows(2).enumerate() {
            let middle = (pair[0] + pair[1]) / 2.0;
            if middle < low || middle > high {
                continue;
            }
            for edge in rim_edges(self.planar, span, perimeter) {
                // The diagonal of a wall's quadrilateral runs up from its smaller node number, as in `extrude`.
                let [a, b] = [edge[0].min(edge[1]), edge[0].max(edge[1])].map(|n| n + level as u32 * per_level);
                faces.push(vec![a, b, b + per_level]);
                faces.push(vec![a, a + per_level, b + per_level]);
            }
        }
        faces
    }

    fn flat(&self, pad: u32, height: f64) -> Vec<Vec<u32>> {
        let lift = self.raised(0, height);
        let in_pad = self.planar.triangles.iter().zip(&self.planar.pad).filter(|(_, p)| **p == Some(pad));
        in_pad.map(|(triangle, _)| triangle.iter().map(|node| node + lift).collect()).collect()
    }
}

/// Raises triangles into prisms and splits each into three tetrahedra. With corners numbered a < b < c and a', b', c'
/// above them: abcc', abb'c', aa'b'c'. Neighbours agree on every diagonal because it depends on numbers alone.
fn extrude(planar: &Planar, heights: &[f64]) -> Result<Mesh, MeshError> {
    let per_level = planar.nodes.len() as u32;
    let nodes = heights.iter().flat_map(|&z| planar.nodes.iter().map(move |p| [p[0], p[1], z])).collect();
    let mut elements = Vec::with_capacity(planar.triangles.len() * (heights.len() - 1) * 12);
    for level in 0..heights.len() as u32 - 1 {
        for triangle in &planar.triangles {
            let mut corners = *triangle;
            corners.sort_unstable();
            let [a, b, c] = corners.map(|node| node + level * per_level);
            let [above_a, above_b, above_c] = [a + per_level, b + per_level, c + per_level];
            elements.extend([a, b, c, above_c, a, b, above_b, above_c, a, above_a, above_b, above_c]);
        }
    }
    Mesh::new(CellKind::Tetrahedron, nodes, elements)
}

fn refuse_too_many(tetrahedra: f64, field: &'static str, value: String) -> Result<(), MeshError> {
    if tetrahedra <= MOST_TETRAHEDRA as f64 {
        return Ok(());
    }
    let expected = format!("few enough for {MOST_TETRAHEDRA} tetrahedra ({tetrahedra:.0} would result)");
    Err(MeshError::Shape { field, value, expected })
}

/// Grid lines from `low` to `high`: all the breaks, and between them steps of about one `cells`-th of the whole.
fn grid_lines(low: f64, high: f64, cells: usize, breaks: &[f64]) -> Vec<f64> {
    let slack = 1e-9 * (high - low);
    let mut fixed = vec![low, high];
    fixed.extend(breaks.iter().copied().filter(|&at| at > low + slack && at < high - slack));
    fixed.sort_by(f64::total_cmp);
    fixed.dedup_by(|later, earlier| *later - *earlier <= slack);
    let mut lines = vec![low];
    for pair in fixed.windows(2) {
        let steps = (cells as f64 * (pair[1] - pair[0]) / (high - low)).round().max(1.0) as usize;
        lines.extend((1..steps).map(|k| pair[0] + (pair[1] - pair[0]) * k as f64 / steps as f64));
        lines.push(pair[1]);
    }
    lines
}

fn box_nodes(lines: &[Vec<f64>; 3]) -> Vec<[f64; 3]> {
    let [xs, ys, zs] = lines;
    let mut nodes = Vec::with_capacity(xs.len() * ys.len() * zs.len());
    for &z in zs {
        for &y in ys {
            nodes.extend(xs.iter().map(|&x| [x, y, z]));
        }
    }
    nodes
}

/// Six tetrahedra a box, one for every order in which a path can step along x, y and z from its lowest corner to its
/// highest.
fn box_elements(lines: &[Vec<f64>; 3]) -> Vec<u32> {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let counts = [0, 1, 2].map(|axis| lines[axis].len() as u32);
    let stride = [1, counts[0], counts[0] * counts[1]];
    let mut elements = Vec::new();
    for k in 0..counts[2] - 1 {
        for j in 0..counts[1] - 1 {
            for i in 0..counts[0] - 1 {
                let corner = i * stride[0] + j * stride[1] + k * stride[2];
                for order in ORDERS {
                    let first = corner + stride[order[0]];
                    let second = first + stride[order[1]];
                    elements.extend([corner, first, second, second + stride[order[2]]]);
                }
            }
        }
    }
    elements
}

fn nearest(nodes: &[[f64; 3]], wanted: [f64; 3]) -> u32 {
    let gap = |p: &[f64; 3]| (0..3).map(|axis| (p[axis] - wanted[axis]).powi(2)).sum::<f64>();
    let order = |a: &usize, b: &usize| gap(&nodes[*a]).total_cmp(&gap(&nodes[*b]));
    (0..nodes.len()).min_by(order).unwrap_or(0) as u32
}

#[cfg(test)]
mod tests;
