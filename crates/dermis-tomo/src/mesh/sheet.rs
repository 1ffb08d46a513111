//! Flat sheets: a [`SheetSpec`] describes the outline, the electrodes and the sizes; [`SheetSpec::build`] meshes it
//! by constrained Delaunay refinement (Ruppert 1995) and reports the quality of the triangles. The same specification
//! always gives the same mesh.

use super::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
use super::layout::{Border, Features, Layout, Sizes, Span};
use super::plane::{Point, distance, smallest_angle};
use super::shapes::{ElectrodeShape, Outline, check_coordinate, check_length};
use super::triangulate::{self, Planar};

/// Maximum value of the minimum angle; above it refinement does not terminate.
const LARGEST_MIN_ANGLE_DEG: f64 = 33.0;
/// Minimum number of sides of the polygon that represents a round pad.
const LEAST_PAD_SIDES: f64 = 12.0;
/// Maximum number of element sizes tried to reach a target number of elements.
const MOST_PLANS: usize = 6;

/// A flat sheet to be meshed.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetSpec {
    /// Outline.
    pub outline: Outline,
    /// Electrodes, in order.
    pub electrodes: Vec<ElectrodeShape>,
    /// Edge length of the triangles away from electrodes, metres.
    pub element_size_m: f64,
    /// Edge length at electrodes, metres; grows by 0.35 per unit distance from them up to `element_size_m`. Narrow
    /// electrodes get smaller elements automatically.
    pub electrode_element_size_m: f64,
    /// Minimum number of rim edges under an electrode.
    pub least_electrode_segments: usize,
    /// Minimum angle of any triangle, degrees, at most 33 (above 30 refinement may not complete). Sharper corners of
    /// the outline stay as they are.
    pub min_angle_deg: f64,
    /// Straight lines inside the sheet (both ends, metres), clear of electrodes and of each other. Edges follow them,
    /// so that [`ElectrodedMesh::opened_along`] can open them. Edges on a line are at most a tenth of its length, and
    /// 0.3 % of it at its ends, where the field around a slit is singular.
    pub lines: Vec<[Point; 2]>,
}

/// Quality of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshQuality {
    /// Measured minimum angle of any triangle (of any face, for tetrahedra), degrees.
    pub min_angle_deg: f64,
    /// Number of elements.
    pub element_count: usize,
    /// False if refinement ran out of nodes before every angle was large enough.
    pub refinement_complete: bool,
}

impl MeshQuality {
    /// Measures a mesh that needed no refinement.
    pub fn of(mesh: &Mesh) -> Self {
        let corner = |node: u32| mesh.nodes()[node as usize];
        let angle = |cell: &[u32]| match *cell {
            [a, b, c] => smallest_angle([corner(a), corner(b), corner(c)]),
            [a, b, c, d] => [[a, b, c], [a, b, d], [a, c, d], [b, c, d]]
                .map(|face| smallest_angle(face.map(corner)))
                .into_iter()
                .fold(f64::INFINITY, f64::min),
            _ => f64::INFINITY,
        };
        let min_angle_deg = mesh.elements().map(angle).fold(f64::INFINITY, f64::min).to_degrees();
        Self { min_angle_deg, element_count: mesh.element_count(), refinement_complete: true }
    }
}

impl SheetSpec {
    /// A sheet with half the element size at the electrodes, at least 4 rim edges under each, and no angle below 25
    /// degrees.
    pub fn new(outline: Outline, electrodes: Vec<ElectrodeShape>, element_size_m: f64) -> Self {
        Self {
            outline,
            electrodes,
            element_size_m,
            electrode_element_size_m: element_size_m / 2.0,
            least_electrode_segments: 4,
            min_angle_deg: 25.0,
            lines: Vec::new(),
        }
    }

    /// The same sheet with both element sizes scaled to about `count` elements (within 3 %, unless its electrodes
    /// require more).
    ///
    /// # Errors
    /// As [`SheetSpec::build`]; also fails for a count of 0 or above 1,000,000.
    pub fn with_target_elements(self, count: usize) -> Result<Self, MeshError> {
        Ok(self.planned_to(count)?.0)
    }

    /// [`SheetSpec::with_target_elements`] and [`SheetSpec::build`] in one call, which saves one meshing.
    ///
    /// # Errors
    /// As these.
    pub fn build_to(
        self,
        count: usize,
        contact_impedance: &[f64],
    ) -> Result<(Self, ElectrodedMesh, MeshQuality), MeshError> {
        let impedances = spread(contact_impedance, self.electrodes.len())?;
        let (spec, planar) = self.planned_to(count)?;
        let (mesh, quality) = spec.build_of(planar, impedances)?;
        Ok((spec, mesh, quality))
    }

    /// The sheet scaled to about `count` elements, and its mesh without electrodes.
    fn planned_to(mut self, count: usize) -> Result<(Self, Planar), MeshError> {
        if !(1..=1_000_000).contains(&count) {
            let expected = "between 1 and 1,000,000".to_string();
            return Err(MeshError::Shape { field: "target elements", value: count.to_string(), expected });
        }
        let ratio = self.electrode_element_size_m / self.element_size_m;
        check_length("element_size_m", self.element_size_m)?;
        check_length("electrode_element_size_m", self.electrode_element_size_m)?;
        super::layout::check_outline(&self.outline)?;
        // An equilateral triangle with edge h covers sqrt(3)/4 h^2; electrodes and rims need more elements.
        let mut size = (self.outline.area_m2() / count as f64 / 0.433).sqrt();
        let mut best: Option<(f64, f64, Planar)> = None;
        for _ in 0..MOST_PLANS {
            (self.element_size_m, self.electrode_element_size_m) = (size, ratio * size);
            let planar = self.plan()?;
            let got = planar.triangles.len() as f64 / count as f64;
            let off = got.ln().abs();
            if best.as_ref().is_none_or(|best| off < best.0) {
                best = Some((off, size, planar));
            }
            if off < 0.03 {
                break;
            }
            size *= got.sqrt();
        }
        let Some((_, size, planar)) = best else {
            let planar = self.plan()?;
            return Ok((self, planar));
        };
        (self.element_size_m, self.electrode_element_size_m) = (size, ratio * size);
        Ok((self, planar))
    }

    /// Meshes the sheet. `contact_impedance` holds one value for all electrodes or one each, in the unit of
    /// [`Contact`] (ohm.m on the rim, ohm.m^2 under pads); points ignore it.
    ///
    /// # Errors
    /// Invalid sizes or coordinates, polygons that cross themselves, holes off the sheet, electrodes off the sheet or
    /// overlapping, a minimum angle above 33 degrees, or the wrong number of impedances.
    pub fn build(&self, contact_impedance: &[f64]) -> Result<(ElectrodedMesh, MeshQuality), MeshError> {
        let impedances = spread(contact_impedance, self.electrodes.len())?;
        self.build_of(self.plan()?, impedances)
    }

    fn build_of(&self, planar: Planar, impedances: Vec<f64>) -> Result<(ElectrodedMesh, MeshQuality), MeshError> {
        let contacts = self.contacts(&planar);
        let refinement_complete = planar.refinement_complete;
        let nodes = planar.nodes.iter().map(|p| [p[0], p[1], 0.0]).collect();
        let mesh = Mesh::new(CellKind::Triangle, nodes, planar.triangles.into_flattened())?;
        let quality = MeshQuality { refinement_complete, ..MeshQuality::of(&mesh) };
        let electrodes = contacts
            .into_iter()
            .zip(impedances)
            .map(|(contact, contact_impedance)| Electrode { contact, contact_impedance })
            .collect();
        Ok((ElectrodedMesh::new(mesh, electrodes)?, quality))
    }

    fn plan(&self) -> Result<Planar, MeshError> {
        super::layout::check_outline(&self.outline)?;
        for &[a, b] in &self.lines {
            [a, b].iter().flatten().try_for_each(|&value| check_coordinate("lines", value))?;
            check_length("lines", distance(a, b))?;
        }
        let mut features = features(&self.outline, &self.electrodes, self.electrode_element_size_m)?;
        features.lines.clone_from(&self.lines);
        refuse_overlapping_spans(&features, self.outline.perimeter_m())?;
        self.mesh_features(&features)
    }

    /// Meshes the outline with these features; `electrodes` is ignored.
    pub(super) fn mesh_features(&self, features: &Features) -> Result<Planar, MeshError> {
        check_length("element_size_m", self.element_size_m)?;
        check_length("electrode_element_size_m", self.electrode_element_size_m)?;
        if !(0.0..=LARGEST_MIN_ANGLE_DEG).contains(&self.min_angle_deg) {
            let expected = format!("between 0 and {LARGEST_MIN_ANGLE_DEG} degrees");
            return Err(MeshError::Shape { field: "min_angle_deg", value: self.min_angle_deg.to_string(), expected });
        }
        if !(1..=1000).contains(&self.least_electrode_segments) {
            let value = self.least_electrode_segments.to_string();
            let expected = "between 1 and 1000".into();
            return Err(MeshError::Shape { field: "least_electrode_segments", value, expected });
        }
        let sizes = Sizes {
            base: self.element_size_m,
            electrode: self.electrode_element_size_m,
            least_segments: self.least_electrode_segments,
        };
        triangulate::mesh(&Layout::new(&self.outline, features, sizes)?, self.min_angle_deg)
    }

    fn contacts(&self, planar: &Planar) -> Vec<Contact> {
        let perimeter = self.outline.perimeter_m();
        let (mut pads, mut points, mut rim_points) = (0, 0, 0);
        let next = |counter: &mut usize| {
            *counter += 1;
            *counter - 1
        };
        let contact = |shape: &ElectrodeShape| match shape {
            ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. } => {
                Contact::Faces(rim_faces(planar, span_of(&self.outline, shape), perimeter))
            }
            ElectrodeShape::PadCircle { .. } | ElectrodeShape::PadRectangle { .. } => {
                let pad = next(&mut pads) as u32;
                Contact::Area(
                    (0..).zip(&planar.pad).filter(|(_, in_pad)| **in_pad == Some(pad)).map(|(k, _)| k).collect(),
                )
            }
            ElectrodeShape::Point { .. } => Contact::Point(planar.point_nodes[next(&mut points)]),
            ElectrodeShape::RimPoint { .. } => Contact::Point(planar.rim_point_nodes[next(&mut rim_points)]),
        };
        self.electrodes.iter().map(contact).collect()
    }
}

/// Expands one value for all, or passes on one each.
pub(super) fn spread(contact_impedance: &[f64], count: usize) -> Result<Vec<f64>, MeshError> {
    match contact_impedance {
        [one] => Ok(vec![*one; count]),
        each if each.len() == count => Ok(each.to_vec()),
        _ => Err(MeshError::Count {
            what: "contact impedances",
            expected: format!("1 or {count}, one per electrode"),
            got: contact_impedance.len(),
        }),
    }
}

/// Rim edges within a span, in order along it.
pub(super) fn rim_edges(planar: &Planar, span: Span, perimeter: f64) -> Vec<[u32; 2]> {
    let mut edges: Vec<(f64, [u32; 2])> = planar
        .rim
        .iter()
        .filter(|(_, position)| span.holds(*position, perimeter))
        .map(|(edge, position)| ((position - span.start).rem_euclid(perimeter), *edge))
        .collect();
    edges.sort_by(|a, b| a.0.total_cmp(&b.0));
    edges.into_iter().map(|(_, edge)| edge).collect()
}

fn rim_faces(planar: &Planar, span: Option<Span>, perimeter: f64) -> Vec<Vec<u32>> {
    let edges = span.map(|span| rim_edges(planar, span, perimeter)).unwrap_or_default();
    edges.into_iter().map(|edge| edge.to_vec()).collect()
}

/// The stretch of rim covered by a rim electrode.
pub(super) fn span_of(outline: &Outline, shape: &ElectrodeShape) -> Option<Span> {
    let (centre, width) = match (shape, outline) {
        (ElectrodeShape::RimArc { centre_rad, width_m }, Outline::Disc { radius_m }) => {
            (centre_rad * radius_m, width_m)
        }
        (ElectrodeShape::RimSegment { centre_m, width_m }, _) => (*centre_m, width_m),
        _ => return None,
    };
    let start = (centre - width / 2.0).rem_euclid(outline.perimeter_m());
    Some(Span { start, end: start + width })
}

/// Corners of a round pad's polygon. The number of sides depends on the size (a multiple of 4, at least 12), and the
/// circumradius gives it exactly the circle's area, `n/2 R^2 sin(2 pi/n) = pi r^2`.
pub(super) fn pad_polygon(centre: Point, radius: f64, element_size: f64) -> Vec<Point> {
    let sides = (std::f64::consts::TAU * radius / element_size).clamp(LEAST_PAD_SIDES, 4096.0);
    let count = 4 * (sides / 4.0).ceil() as usize;
    let step = std::f64::consts::TAU / count as f64;
    let reach = radius * (step / step.sin()).sqrt();
    (0..count)
        .map(|k| [centre[0] + reach * (k as f64 * step).cos(), centre[1] + reach * (k as f64 * step).sin()])
        .collect()
}

/// Corners of a rectangle, counter-clockwise.
pub(super) fn pad_rectangle(centre: Point, width: f64, height: f64, angle: f64) -> Vec<Point> {
    let (sine, cosine) = angle.sin_cos();
    let corner = |x: f64, y: f64| [centre[0] + x * cosine - y * sine, centre[1] + x * sine + y * cosine];
    let (x, y) = (width / 2.0, height / 2.0);
    vec![corner(-x, -y), corner(x, -y), corner(x, y), corner(-x, y)]
}

/// Constraints on the mesh due to the electrodes.
pub(super) fn features(outline: &Outline, electrodes: &[ElectrodeShape], pad_size: f64) -> Result<Features, MeshError> {
    let perimeter = Border::new(outline).perimeter();
    let mut features = Features::default();
    for (index, shape) in electrodes.iter().enumerate() {
        check_shape(outline, shape, perimeter)
            .map_err(|error| MeshError::Electrode { electrode: index, reason: error.to_string() })?;
        if let Some(span) = span_of(outline, shape) {
            features.spans.push(span);
            features.span_owner.push(index);
        }
        match *shape {
            ElectrodeShape::PadCircle { centre_m, radius_m } => {
                features.pads.push(pad_polygon(centre_m, radius_m, pad_size));
                features.pad_owner.push(index);
            }
            ElectrodeShape::PadRectangle { centre_m, width_m, height_m, angle_rad } => {
                features.pads.push(pad_rectangle(centre_m, width_m, height_m, angle_rad));
                features.pad_owner.push(index);
            }
            ElectrodeShape::Point { position_m } => {
                features.points.push(position_m);
                features.point_owner.push(index);
            }
            ElectrodeShape::RimPoint { position_m } => {
                features.rim_points.push(position_m.rem_euclid(perimeter));
                features.rim_point_owner.push(index);
            }
            ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. } => {}
        }
    }
    Ok(features)
}

fn check_shape(outline: &Outline, shape: &ElectrodeShape, perimeter: f64) -> Result<(), MeshError> {
    let check_width = |width: f64| {
        check_length("width_m", width)?;
        if width < perimeter * (1.0 - 1e-6) {
            return Ok(());
        }
        let expected = format!("less than the rim's {perimeter} m");
        Err(MeshError::Shape { field: "width_m", value: width.to_string(), expected })
    };
    match shape {
        ElectrodeShape::RimArc { centre_rad, width_m } => {
            if !matches!(outline, Outline::Disc { .. }) {
                let expected = "for discs only; use a rim segment".into();
                return Err(MeshError::Shape { field: "electrode", value: "a rim arc".into(), expected });
            }
            check_coordinate("centre_rad", *centre_rad)?;
            check_width(*width_m)
        }
        ElectrodeShape::RimSegment { centre_m, width_m } => {
            check_coordinate("centre_m", *centre_m)?;
            check_width(*width_m)
        }
        ElectrodeShape::RimPoint { position_m } => check_coordinate("position_m", *position_m),
        ElectrodeShape::PadCircle { centre_m, radius_m } => {
            centre_m.iter().try_for_each(|&value| check_coordinate("centre_m", value))?;
            check_length("radius_m", *radius_m)
        }
        ElectrodeShape::PadRectangle { centre_m, width_m, height_m, angle_rad } => {
            centre_m.iter().try_for_each(|&value| check_coordinate("centre_m", value))?;
            check_coordinate("angle_rad", *angle_rad)?;
            check_length("width_m", *width_m)?;
            check_length("height_m", *height_m)
        }
        ElectrodeShape::Point { position_m } => {
            position_m.iter().try_for_each(|&value| check_coordinate("position_m", value))
        }
    }
}

fn refuse_overlapping_spans(features: &Features, perimeter: f64) -> Result<(), MeshError> {
    let slack = 1e-9 * perimeter;
    let mut pieces: Vec<(Span, usize)> =
        features.spans.iter().copied().zip(features.span_owner.iter().copied()).collect();
    let points = features.rim_points.iter().zip(&features.rim_point_owner);
    pieces.extend(points.map(|(&s, &owner)| (Span { start: s, end: s + 2.0 * slack }, owner)));
    pieces.sort_by(|a, b| a.0.start.total_cmp(&b.0.start));
    for (k, (span, owner)) in pieces.iter().enumerate() {
        let (next, other) = pieces[(k + 1) % pieces.len()];
        let begins = if k + 1 == pieces.len() { next.start + perimeter } else { next.start };
        if pieces.len() > 1 && span.end > begins + slack {
            let (first, second) = ((*owner).min(other), (*owner).max(other));
            return Err(MeshError::Electrode { electrode: second, reason: format!("overlaps electrode {first}") });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
