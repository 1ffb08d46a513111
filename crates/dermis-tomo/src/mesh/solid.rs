//! Solids of tetrahedra: a [`SlabSpec`] is cut into boxes of six tetrahedra each (Kuhn's subdivision, conforming by
//! construction), and a [`PrismSpec`] extrudes any sheet outline upward and splits its prisms into three tetrahedra
//! by the order of their node numbers (conforming for the same reason). Electrodes are patches of surface triangles.

mod grid;
mod slab;

pub use slab::{PatchShape, SlabElectrode, SlabFace, SlabSpec};

use super::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
use super::layout::Features;
use super::shapes::{ElectrodeShape, Outline, check_length};
use super::sheet::{SheetSpec, features, rim_edges, span_of, spread};
use super::triangulate::Planar;
use grid::{grid_lines, refuse_too_many};

/// An electrode of a prism.
#[derive(Clone, Debug, PartialEq)]
pub enum PrismElectrode {
    /// A patch of the wall: a rim arc or segment between two heights.
    Side {
        /// [`ElectrodeShape::RimArc`] or [`ElectrodeShape::RimSegment`].
        rim: ElectrodeShape,
        /// Height of its lower edge above the bottom, metres.
        low_m: f64,
        /// Height of its upper edge above the bottom, metres.
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
    /// Outline seen from above.
    pub outline: Outline,
    /// Height, metres.
    pub height_m: f64,
    /// Edge length of the triangles seen from above, away from electrodes, metres.
    pub element_size_m: f64,
    /// Edge length at electrodes, metres.
    pub electrode_element_size_m: f64,
    /// Approximate number of layers; the edges of wall electrodes may add some.
    pub layers: usize,
    /// Electrodes, in order. Pads on bottom and top must be identical or disjoint, seen from above.
    pub electrodes: Vec<PrismElectrode>,
}

impl PrismSpec {
    /// An upright cylinder with uniform element size.
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

    /// Meshes the prism; `contact_impedance` in ohm.m^2, one value for all electrodes or one each.
    ///
    /// # Errors
    /// As [`SheetSpec::build`]; also fails if wall electrodes reach above or below the wall.
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

    /// Heights of the interfaces between layers.
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

    /// The distinct plan shapes, and the shape of each electrode: rings of electrodes above each other, or pads on
    /// bottom and top, share theirs.
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
                // The diagonal of a wall's quadrilateral starts at its smaller node number and rises, as in
                // `extrude`.
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

/// Extrudes triangles into prisms and splits each into three tetrahedra. With corners a < b < c and a', b', c' above
/// them: abcc', abb'c', aa'b'c'. Neighbours agree on every diagonal because it depends only on the numbers.
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

#[cfg(test)]
mod tests;
