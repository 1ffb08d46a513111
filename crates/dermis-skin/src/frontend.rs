//! The physical part of a skin on the robot: outline, layer, electrodes.

mod electrodes;

pub use electrodes::{Electrodes, Pad, PadRing, RimElectrode};

use std::path::Path;

use dermis_tomo::mesh::{Outline, Point, Surface};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{Checker, MM, MOST_MM};
use crate::error::Error;
use crate::layer::Layer;
use crate::magnetic::{Coils, Elements};
use crate::mesh_source::MeshFile;

/// Maximum number of outline vertices, more than any drawing needs.
const MOST_VERTICES: usize = 2000;

/// The physical part of a skin on the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Frontend {
    /// Outline of the sheet laid flat.
    pub shape: Shape,
    /// Surface that the sheet is bent onto; flat by default. Positions refer to the sheet laid flat.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bend: Option<Bend>,
    /// The conducting layer.
    pub layer: Layer,
    /// Positions of the electrodes.
    #[serde(default, skip_serializing_if = "Electrodes::are_none")]
    pub electrodes: Electrodes,
    /// Specific contact impedance of every electrode, ohm.m^2.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub contact_impedance_ohm_m2: f64,
    /// Coils for magnetic induction, instead of electrodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coils: Option<Coils>,
    /// Conducting elements above the coils.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elements: Option<Elements>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Outline of a skin. Discs, squares and rectangles are centred on the origin; polygons keep their coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Shape {
    /// Round.
    Disc {
        /// Diameter.
        diameter_mm: f64,
    },
    /// Square.
    Square {
        /// Side.
        side_mm: f64,
    },
    /// Rectangle.
    Rectangle {
        /// Along x.
        width_mm: f64,
        /// Along y.
        height_mm: f64,
    },
    /// Any polygon, holes allowed.
    Polygon {
        /// Vertices of the rim.
        outer_mm: Vec<Point>,
        /// Vertices of each hole.
        #[serde(default)]
        holes_mm: Vec<Vec<Point>>,
    },
    /// The rim of a flat mesh in a file, with its electrodes. Reading a skin replaces it with a polygon.
    Mesh(MeshFile),
}

/// Surface that a sheet is bent onto without stretching.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Bend {
    /// A cylinder whose axis runs along y, behind the sheet.
    Cylinder {
        /// Diameter of the cylinder.
        diameter_mm: f64,
    },
}

impl Shape {
    /// The outline in metres.
    pub fn outline(&self) -> Outline {
        match self {
            Shape::Disc { diameter_mm } => Outline::Disc { radius_m: 0.5 * diameter_mm * MM },
            Shape::Square { side_mm } => Outline::Rectangle { width_m: side_mm * MM, height_m: side_mm * MM },
            Shape::Rectangle { width_mm, height_mm } => {
                Outline::Rectangle { width_m: width_mm * MM, height_m: height_mm * MM }
            }
            Shape::Polygon { outer_mm, holes_mm } => {
                let metres = |points: &[Point]| points.iter().map(|p| [p[0] * MM, p[1] * MM]).collect::<Vec<_>>();
                Outline::Polygon { outer: metres(outer_mm), holes: holes_mm.iter().map(|h| metres(h)).collect() }
            }
            // Unreachable in a checked skin.
            Shape::Mesh(_) => Outline::Disc { radius_m: MM },
        }
    }

    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        match self {
            Shape::Mesh(mesh) => {
                let expected = "a polygon: a mesh is read with the skin file that names it";
                Err(checker.refused("frontend.shape.mesh", format!("{:?}", mesh.file), expected))
            }
            Shape::Disc { diameter_mm } => {
                checker.within("frontend.shape.disc.diameter_mm", *diameter_mm, 1.0, MOST_MM)
            }
            Shape::Square { side_mm } => checker.within("frontend.shape.square.side_mm", *side_mm, 1.0, MOST_MM),
            Shape::Rectangle { width_mm, height_mm } => {
                checker.within("frontend.shape.rectangle.width_mm", *width_mm, 1.0, MOST_MM)?;
                checker.within("frontend.shape.rectangle.height_mm", *height_mm, 1.0, MOST_MM)?;
                let (low, high) = (width_mm.min(*height_mm), width_mm.max(*height_mm));
                if high > 50.0 * low {
                    let expected = "a longer side of at most 50 times the shorter";
                    return Err(checker.refused(
                        "frontend.shape.rectangle",
                        format!("{width_mm} x {height_mm}"),
                        expected,
                    ));
                }
                Ok(())
            }
            Shape::Polygon { outer_mm, holes_mm } => {
                let vertices = outer_mm.len() + holes_mm.iter().map(Vec::len).sum::<usize>();
                if vertices > MOST_VERTICES {
                    let expected = format!("at most {MOST_VERTICES} vertices in all");
                    return Err(checker.refused("frontend.shape.polygon", format!("{vertices} vertices"), expected));
                }
                check_ring("frontend.shape.polygon.outer_mm", outer_mm, checker)?;
                for hole in holes_mm {
                    check_ring("frontend.shape.polygon.holes_mm", hole, checker)?;
                    if let Some(p) = hole.iter().find(|p| !contains(outer_mm, **p)) {
                        let expected = "holes within the outer rim";
                        return Err(checker.refused("frontend.shape.polygon.holes_mm", format!("{p:?}"), expected));
                    }
                }
                let (low, high) = self.outline().bounds_m();
                let (width, height) = (high[0] - low[0], high[1] - low[1]);
                if width.min(height) < MM || width.max(height) > 50.0 * width.min(height) {
                    let value = format!("{} x {} mm", width / MM, height / MM);
                    let expected = "an extent of 1 mm and more, the longer side at most 50 times the shorter";
                    return Err(checker.refused("frontend.shape.polygon.outer_mm", value, expected));
                }
                Ok(())
            }
        }
    }
}

/// Checks a ring: three or more vertices, no crossing or touching itself.
fn check_ring(field: &str, ring: &[Point], checker: &Checker<'_>) -> Result<(), Error> {
    if ring.len() < 3 {
        return Err(checker.refused(field, format!("{} vertices", ring.len()), "3 or more"));
    }
    ring.iter().try_for_each(|p| checker.place_mm(field, p))?;
    let edge = |k: usize| (ring[k], ring[(k + 1) % ring.len()]);
    for a in 0..ring.len() {
        let (p, q) = edge(a);
        if p == q {
            return Err(checker.refused(field, format!("{p:?} twice in a row"), "vertices that differ"));
        }
        for b in a + 1..ring.len() {
            let beside = b == a + 1 || (a == 0 && b == ring.len() - 1);
            let (r, s) = edge(b);
            if !beside && cross(p, q, r, s) {
                let value = format!("{p:?} to {q:?} crosses {r:?} to {s:?}");
                return Err(checker.refused(field, value, "a rim that does not cross itself"));
            }
        }
    }
    Ok(())
}

/// True if two segments intersect.
fn cross(p: Point, q: Point, r: Point, s: Point) -> bool {
    let side = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let within =
        |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (0..2).all(|k| c[k] >= a[k].min(b[k]) && c[k] <= a[k].max(b[k]));
    let [d1, d2, d3, d4] = [side(r, s, p), side(r, s, q), side(p, q, r), side(p, q, s)];
    if d1 * d2 < 0.0 && d3 * d4 < 0.0 {
        return true;
    }
    (d1 == 0.0 && within(r, s, p))
        || (d2 == 0.0 && within(r, s, q))
        || (d3 == 0.0 && within(p, q, r))
        || (d4 == 0.0 && within(p, q, s))
}

/// True if a point is inside a ring, by counting the edges to its right.
fn contains(ring: &[Point], p: Point) -> bool {
    let mut inside = false;
    for k in 0..ring.len() {
        let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

impl Frontend {
    /// Surface of the sheet in space. Maps positions on the sheet laid flat, which everything else uses, to points in
    /// space, for drawing. Bending without stretching changes no field, see [`Surface`].
    pub fn surface(&self) -> Surface {
        match self.bend {
            Some(Bend::Cylinder { diameter_mm }) => Surface::Cylinder { radius_m: 0.5 * diameter_mm * MM },
            None => Surface::Flat,
        }
    }

    /// Reads the outline and electrodes from a mesh file in `folder`.
    pub(crate) fn read_mesh(&mut self, file: &str, folder: Option<&Path>) -> Result<(), Error> {
        let Shape::Mesh(mesh) = &self.shape else { return Ok(()) };
        let (shape, electrodes) = mesh.read(self.electrodes.are_none() && self.coils.is_none(), file, folder)?;
        self.shape = shape;
        if let Some(electrodes) = electrodes {
            self.electrodes = electrodes;
        }
        Ok(())
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        self.shape.check(checker)?;
        self.layer.check(checker)?;
        if let Some(Bend::Cylinder { diameter_mm }) = self.bend {
            let (low, high) = self.shape.outline().bounds_m();
            let least = 1e3 * (high[0] - low[0]) / std::f64::consts::PI;
            if !(diameter_mm > least && diameter_mm <= 1e6) {
                let expected = format!("above {least:.1}, below which the sheet would overlap itself, to 1e6");
                return Err(checker.refused("frontend.bend.cylinder.diameter_mm", diameter_mm, expected));
            }
        }
        if let Layer::Elements(layer) = &self.layer {
            return self.check_elements(layer.height_tolerance_mm, checker);
        }
        let only = |key: &str| checker.refused(key, "given", "coils and elements only with layer.kind = \"elements\"");
        if self.coils.is_some() {
            return Err(only("frontend.coils"));
        }
        if self.elements.is_some() {
            return Err(only("frontend.elements"));
        }
        if let (Layer::Liquid(layer), Shape::Polygon { holes_mm, .. }) = (&self.layer, &self.shape)
            && !holes_mm.is_empty()
            && !layer.hole_walls
        {
            let expected = "no holes in a liquid: it would run out; hole_walls = true in the layer gives them walls";
            return Err(checker.refused(
                "frontend.shape.polygon.holes_mm",
                format!("{} holes", holes_mm.len()),
                expected,
            ));
        }
        checker.within("frontend.contact_impedance_ohm_m2", self.contact_impedance_ohm_m2, 1e-12, 1e6)?;
        self.electrodes.check(&self.shape.outline(), checker)
    }

    fn check_elements(&self, tolerance_mm: f64, checker: &Checker<'_>) -> Result<(), Error> {
        let missing = |key: &str| checker.refused(key, "left out", "coils and elements with layer.kind = \"elements\"");
        let coils = self.coils.as_ref().ok_or_else(|| missing("frontend.coils"))?;
        let elements = self.elements.as_ref().ok_or_else(|| missing("frontend.elements"))?;
        let none = |key: &str| checker.refused(key, "given", "none with layer.kind = \"elements\"");
        if !self.electrodes.are_none() {
            return Err(none("frontend.electrodes"));
        }
        if self.contact_impedance_ohm_m2 != 0.0 {
            return Err(none("frontend.contact_impedance_ohm_m2"));
        }
        if self.bend.is_some() {
            return Err(none("frontend.bend"));
        }
        coils.check(checker)?;
        elements.check(tolerance_mm, &self.shape.outline(), checker)
    }
}
