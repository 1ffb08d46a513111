//! What is sewn on the robot: outline, layer, electrodes.

use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline, Surface, square_to_disc};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{Checker, MOST_MM};
use crate::error::Error;
use crate::layer::Layer;
use crate::magnetic::{Coils, Elements};
use crate::pair::Pair;

const MM: f64 = 1e-3;
/// More electrodes than any multiplexer has are a typing error.
pub(crate) const MOST_ELECTRODES: usize = 1024;
/// More vertices of an outline than any drawing needs.
const MOST_VERTICES: usize = 2000;

/// What is sewn on the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Frontend {
    /// Outline, laid flat.
    pub shape: Shape,
    /// What the sheet is bent on; flat where left out. Positions are those of the sheet laid flat.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bend: Option<Bend>,
    /// The conducting layer.
    pub layer: Layer,
    /// Where the electrodes are.
    #[serde(default, skip_serializing_if = "Electrodes::are_none")]
    pub electrodes: Electrodes,
    /// Specific contact impedance of every electrode, ohm.m^2.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub contact_impedance_ohm_m2: f64,
    /// The coils of magnetic induction, in place of electrodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coils: Option<Coils>,
    /// The conducting elements over the coils.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elements: Option<Elements>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Outline of a skin, centred at the origin.
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
        outer_mm: Vec<[f64; 2]>,
        /// Vertices of each hole.
        #[serde(default)]
        holes_mm: Vec<Vec<[f64; 2]>>,
    },
}

/// What a sheet is bent on, without stretching it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Bend {
    /// A cylinder whose axis runs along y, behind the sheet.
    Cylinder {
        /// Its diameter.
        diameter_mm: f64,
    },
}

/// Electrodes of a skin; numbered from 1 in the order that the generator says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Electrodes {
    /// Evenly round the rim of a disc (or any outline, by arc length).
    Rim {
        /// How many.
        count: usize,
        /// Length of each along the rim.
        width_mm: f64,
        /// Angle of the middle of electrode 1, counter-clockwise from +x. On other outlines than discs: its place along
        /// the rim in terms of a full turn, from the first vertex (of a rectangle: bottom left) counter-clockwise.
        /// Default: half the distance of two electrodes.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        start_deg: Option<f64>,
        /// Numbered clockwise seen from the toucher.
        #[serde(default)]
        clockwise: bool,
    },
    /// Square pads under the sheet in a rectangular ring round its middle, `per_side + 1` to a side counting both
    /// corners, counter-clockwise from the bottom left corner.
    RimPads {
        /// Intervals a side, one number or [along x, along y].
        per_side: Pair<usize>,
        /// Distance between neighbouring centres, one number or [along x, along y].
        pitch_mm: Pair<f64>,
        /// Side of a pad.
        size_mm: f64,
    },
    /// Listed electrodes on the rim.
    RimList(Vec<RimElectrode>),
    /// Round pads under the sheet all over it: in the middles of an even division of a square or rectangle into rows
    /// and columns, on a disc at their image under the equal-area concentric map; row by row to and fro from the bottom
    /// left, so that neighbours in number are neighbours in place.
    PadGrid {
        /// Pads in a row and rows, one number or [in a row, rows].
        per_side: Pair<usize>,
        /// Diameter of a pad.
        diameter_mm: f64,
    },
    /// Round pads under the sheet on circles round its middle, the innermost first, each counter-clockwise.
    PadRings {
        /// The circles.
        rings: Vec<PadRing>,
        /// Diameter of a pad.
        diameter_mm: f64,
    },
    /// Listed pads.
    Pads(Vec<Pad>),
}

impl Default for Electrodes {
    fn default() -> Self {
        Self::Pads(Vec::new())
    }
}

impl Electrodes {
    pub(crate) fn are_none(&self) -> bool {
        matches!(self, Self::Pads(pads) if pads.is_empty())
    }
}

/// Pads on a circle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PadRing {
    /// How many.
    pub count: usize,
    /// Radius of the circle.
    pub radius_mm: f64,
    /// Angle of the first, counter-clockwise from +x.
    #[serde(default)]
    pub start_deg: f64,
}

/// One listed electrode on the rim.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RimElectrode {
    /// Angle of its middle, counter-clockwise from +x (on other outlines than discs: position along the rim in terms of
    /// a full turn).
    pub at_deg: f64,
    /// Length along the rim.
    pub width_mm: f64,
}

/// One listed pad under the sheet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Pad {
    /// Round pad.
    Circle {
        /// Centre.
        centre_mm: [f64; 2],
        /// Diameter.
        diameter_mm: f64,
    },
    /// Rectangular pad.
    Rectangle {
        /// Centre.
        centre_mm: [f64; 2],
        /// Along x.
        width_mm: f64,
        /// Along y.
        height_mm: f64,
    },
    /// A single node.
    Point {
        /// Where.
        at_mm: [f64; 2],
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
                let metres = |points: &[[f64; 2]]| points.iter().map(|p| [p[0] * MM, p[1] * MM]).collect::<Vec<_>>();
                Outline::Polygon { outer: metres(outer_mm), holes: holes_mm.iter().map(|h| metres(h)).collect() }
            }
        }
    }

    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        match self {
            Shape::Disc { diameter_mm } => {
                checker.within("frontend.shape.disc.diameter_mm", *diameter_mm, 1.0, MOST_MM)
            }
            Shape::Square { side_mm } => checker.within("frontend.shape.square.side_mm", *side_mm, 1.0, MOST_MM),
            Shape::Rectangle { width_mm, height_mm } => {
                checker.within("frontend.shape.rectangle.width_mm", *width_mm, 1.0, MOST_MM)?;
                checker.within("frontend.shape.rectangle.height_mm", *height_mm, 1.0, MOST_MM)?;
                let (low, high) = (width_mm.min(*height_mm), width_mm.max(*height_mm));
                if high > 50.0 * low {
                    let expected = "sides of which the longer is at most 50 times the shorter";
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

/// A ring of three or more vertices that does not cross or touch itself.
fn check_ring(field: &str, ring: &[[f64; 2]], checker: &Checker<'_>) -> Result<(), Error> {
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

/// Whether two segments meet.
fn cross(p: [f64; 2], q: [f64; 2], r: [f64; 2], s: [f64; 2]) -> bool {
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

/// Whether a point lies inside a ring, by the number of edges to its right.
fn contains(ring: &[[f64; 2]], p: [f64; 2]) -> bool {
    let mut inside = false;
    for k in 0..ring.len() {
        let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

impl Electrodes {
    /// How many there are.
    pub fn count(&self) -> usize {
        match self {
            Self::Rim { count, .. } => *count,
            Self::RimPads { per_side, .. } => {
                let [x, y] = per_side.both();
                x.saturating_add(y).saturating_mul(2)
            }
            Self::PadGrid { per_side, .. } => {
                let [x, y] = per_side.both();
                x.saturating_mul(y)
            }
            Self::PadRings { rings, .. } => rings.iter().fold(0, |sum, ring| sum.saturating_add(ring.count)),
            Self::RimList(list) => list.len(),
            Self::Pads(pads) => pads.len(),
        }
    }

    /// Their shapes on an outline, metres, in order.
    pub fn shapes(&self, outline: &Outline) -> Vec<ElectrodeShape> {
        let circle =
            |diameter_mm: f64| move |centre_m| ElectrodeShape::PadCircle { centre_m, radius_m: 0.5 * diameter_mm * MM };
        match self {
            Self::Rim { count, width_mm, start_deg, clockwise } => {
                let direction = if *clockwise { Direction::Clockwise } else { Direction::CounterClockwise };
                let start_deg = start_deg.unwrap_or(180.0 / *count as f64);
                match outline {
                    Outline::Disc { .. } => Outline::rim_arcs(*count, width_mm * MM, start_deg.to_radians(), direction),
                    _ => {
                        let start_m = start_deg / 360.0 * outline.perimeter_m();
                        outline.rim_segments(*count, width_mm * MM, start_m, direction)
                    }
                }
            }
            Self::RimPads { per_side, pitch_mm, size_mm } => {
                let (centre_m, side_m) = ([0.0, 0.0], size_mm * MM);
                let pad = ElectrodeShape::PadRectangle { centre_m, width_m: side_m, height_m: side_m, angle_rad: 0.0 };
                let [x, y] = per_side.both();
                pad.ring(x + 1, y + 1, pitch_mm.both().map(|pitch| pitch * MM), Direction::CounterClockwise)
            }
            Self::RimList(list) => {
                let on_disc = matches!(outline, Outline::Disc { .. });
                let place = |electrode: &RimElectrode| {
                    let width_m = electrode.width_mm * MM;
                    if on_disc {
                        ElectrodeShape::RimArc { centre_rad: electrode.at_deg.to_radians(), width_m }
                    } else {
                        let turn = (electrode.at_deg / 360.0).rem_euclid(1.0);
                        ElectrodeShape::RimSegment { centre_m: turn * outline.perimeter_m(), width_m }
                    }
                };
                list.iter().map(place).collect()
            }
            Self::PadGrid { per_side, diameter_mm } => {
                pad_grid(outline, per_side.both()).into_iter().map(circle(*diameter_mm)).collect()
            }
            Self::PadRings { rings, diameter_mm } => {
                let (low, high) = outline.bounds_m();
                let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
                let place = |ring: &PadRing, k: usize| {
                    let angle = ring.start_deg.to_radians() + k as f64 * std::f64::consts::TAU / ring.count as f64;
                    [middle[0] + ring.radius_mm * MM * angle.cos(), middle[1] + ring.radius_mm * MM * angle.sin()]
                };
                let places = rings.iter().flat_map(|ring| (0..ring.count).map(move |k| place(ring, k)));
                places.map(circle(*diameter_mm)).collect()
            }
            Self::Pads(pads) => pads.iter().map(Pad::shape).collect(),
        }
    }

    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let count = self.count();
        if !(2..=MOST_ELECTRODES).contains(&count) {
            let expected = format!("2 to {MOST_ELECTRODES} electrodes");
            return Err(checker.refused("frontend.electrodes", count, expected));
        }
        let key = |name: &str| format!("frontend.electrodes.{name}");
        match self {
            Self::Rim { width_mm, start_deg, .. } => {
                checker.length_mm(&key("rim.width_mm"), *width_mm)?;
                checker.within(&key("rim.start_deg"), start_deg.unwrap_or(0.0), -360.0, 360.0)
            }
            Self::RimPads { per_side, pitch_mm, size_mm } => {
                per_side.both().iter().try_for_each(|n| checker.count(&key("rim-pads.per_side"), *n, 1, 256))?;
                pitch_mm.both().iter().try_for_each(|p| checker.length_mm(&key("rim-pads.pitch_mm"), *p))?;
                checker.length_mm(&key("rim-pads.size_mm"), *size_mm)
            }
            Self::RimList(list) => list.iter().try_for_each(|electrode| {
                checker.within(&key("rim-list.at_deg"), electrode.at_deg, -360.0, 360.0)?;
                checker.length_mm(&key("rim-list.width_mm"), electrode.width_mm)
            }),
            Self::PadGrid { per_side, diameter_mm } => {
                per_side.both().iter().try_for_each(|n| checker.count(&key("pad-grid.per_side"), *n, 1, 256))?;
                checker.length_mm(&key("pad-grid.diameter_mm"), *diameter_mm)
            }
            Self::PadRings { rings, diameter_mm } => {
                for ring in rings {
                    checker.count(&key("pad-rings.rings.count"), ring.count, 1, MOST_ELECTRODES)?;
                    checker.within(&key("pad-rings.rings.radius_mm"), ring.radius_mm, 0.0, MOST_MM)?;
                    checker.within(&key("pad-rings.rings.start_deg"), ring.start_deg, -360.0, 360.0)?;
                }
                checker.length_mm(&key("pad-rings.diameter_mm"), *diameter_mm)
            }
            Self::Pads(pads) => pads.iter().try_for_each(|pad| pad.check(checker)),
        }
    }
}

impl Pad {
    fn shape(&self) -> ElectrodeShape {
        let metres = |p: &[f64; 2]| [p[0] * MM, p[1] * MM];
        match self {
            Pad::Circle { centre_mm, diameter_mm } => {
                ElectrodeShape::PadCircle { centre_m: metres(centre_mm), radius_m: 0.5 * diameter_mm * MM }
            }
            Pad::Rectangle { centre_mm, width_mm, height_mm } => ElectrodeShape::PadRectangle {
                centre_m: metres(centre_mm),
                width_m: width_mm * MM,
                height_m: height_mm * MM,
                angle_rad: 0.0,
            },
            Pad::Point { at_mm } => ElectrodeShape::Point { position_m: metres(at_mm) },
        }
    }

    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("frontend.electrodes.pads.{name}");
        match self {
            Pad::Circle { centre_mm, diameter_mm } => {
                checker.place_mm(&key("circle.centre_mm"), centre_mm)?;
                checker.length_mm(&key("circle.diameter_mm"), *diameter_mm)
            }
            Pad::Rectangle { centre_mm, width_mm, height_mm } => {
                checker.place_mm(&key("rectangle.centre_mm"), centre_mm)?;
                checker.length_mm(&key("rectangle.width_mm"), *width_mm)?;
                checker.length_mm(&key("rectangle.height_mm"), *height_mm)
            }
            Pad::Point { at_mm } => checker.place_mm(&key("point.at_mm"), at_mm),
        }
    }
}

/// Places of [`Electrodes::PadGrid`], metres.
fn pad_grid(outline: &Outline, [columns, rows]: [usize; 2]) -> Vec<[f64; 2]> {
    let (low, high) = outline.bounds_m();
    let unit = |k: usize, of: usize| (2.0 * k as f64 + 1.0) / of as f64 - 1.0;
    let place = |row: usize, step: usize| {
        let column = if row.is_multiple_of(2) { step } else { columns - 1 - step };
        let [x, y] = match outline {
            Outline::Disc { .. } => square_to_disc([unit(column, columns), unit(row, rows)]),
            _ => [unit(column, columns), unit(row, rows)],
        };
        let along = |axis: usize, unit: f64| 0.5 * (low[axis] + high[axis] + unit * (high[axis] - low[axis]));
        [along(0, x), along(1, y)]
    };
    (0..rows).flat_map(|row| (0..columns).map(move |step| place(row, step))).collect()
}

impl Frontend {
    /// How the sheet lies in space: maps between positions on the sheet laid flat, in which everything else is given,
    /// and points in space, for drawing. Bending without stretching changes no field, see [`Surface`].
    pub fn surface(&self) -> Surface {
        match self.bend {
            Some(Bend::Cylinder { diameter_mm }) => Surface::Cylinder { radius_m: 0.5 * diameter_mm * MM },
            None => Surface::Flat,
        }
    }

    pub(crate) fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        self.shape.check(checker)?;
        self.layer.check(checker)?;
        if let Some(Bend::Cylinder { diameter_mm }) = self.bend {
            let (low, high) = self.shape.outline().bounds_m();
            let least = 1e3 * (high[0] - low[0]) / std::f64::consts::PI;
            if !(diameter_mm > least && diameter_mm <= 1e6) {
                let expected = format!("above {least:.1}, which the sheet would reach round, to 1e6");
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
        self.electrodes.check(checker)
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
