//! Positions of a skin's electrodes: rims, rings, grids and explicit lists.

use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline, Point, square_to_disc};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{Checker, MM, MOST_MM};
use crate::error::Error;
use crate::pair::Pair;

/// Maximum number of electrodes. No multiplexer has more, so a larger number is a typing error.
const MOST_ELECTRODES: usize = 1024;
/// Maximum distance of a rim electrode given by position from the rim, as a share of the skin's longer side.
const FARTHEST: f64 = 0.05;

/// Electrodes of a skin, numbered from 1 in the order of the generator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Electrodes {
    /// Evenly spaced along the rim of a disc, or of any outline by arc length.
    Rim {
        /// Number of electrodes.
        count: usize,
        /// Length of each electrode along the rim.
        width_mm: f64,
        /// Angle of the middle of electrode 1, counter-clockwise from +x. On outlines other than discs: its position
        /// along the rim, where 360 is the whole rim, counter-clockwise from the first vertex (bottom left for a
        /// rectangle). Default: half the distance between two electrodes.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        start_deg: Option<f64>,
        /// True to number clockwise, seen from outside.
        #[serde(default)]
        clockwise: bool,
    },
    /// Square pads under the sheet in a rectangular ring around its middle, `per_side + 1` per side including both
    /// corners, counter-clockwise from the bottom left corner.
    RimPads {
        /// Intervals per side, one number or [along x, along y].
        per_side: Pair<usize>,
        /// Distance between neighbouring centres, one number or [along x, along y].
        pitch_mm: Pair<f64>,
        /// Side of a pad.
        size_mm: f64,
    },
    /// Explicit list of electrodes on the rim.
    RimList(Vec<RimElectrode>),
    /// Electrodes on the rim given by position. Each moves to the nearest point of the rim; `dermis skins show`
    /// prints the distance.
    RimPlaces {
        /// Position [x, y] of each electrode.
        places_mm: Vec<Point>,
        /// Length of each electrode along the rim.
        width_mm: f64,
    },
    /// Round pads under the whole sheet. On a square or rectangle, at the centres of evenly divided rows and columns;
    /// on a disc, at their images under the equal-area concentric map. Rows alternate in direction from the bottom
    /// left, so that pads with neighbouring numbers are neighbours.
    PadGrid {
        /// Pads per row and number of rows; one number or [per row, rows].
        per_side: Pair<usize>,
        /// Diameter of a pad.
        diameter_mm: f64,
    },
    /// Round pads under the sheet on concentric circles, innermost first, each numbered counter-clockwise.
    PadRings {
        /// The circles.
        rings: Vec<PadRing>,
        /// Diameter of a pad.
        diameter_mm: f64,
    },
    /// Explicit list of pads.
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
    /// Number of pads.
    pub count: usize,
    /// Radius of the circle.
    pub radius_mm: f64,
    /// Angle of the first pad, counter-clockwise from +x.
    #[serde(default)]
    pub start_deg: f64,
}

/// One listed electrode on the rim.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RimElectrode {
    /// Angle of its middle, counter-clockwise from +x. On outlines other than discs: position along the rim, where
    /// 360 is the whole rim.
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
        centre_mm: Point,
        /// Diameter.
        diameter_mm: f64,
    },
    /// Rectangular pad.
    Rectangle {
        /// Centre.
        centre_mm: Point,
        /// Along x.
        width_mm: f64,
        /// Along y.
        height_mm: f64,
    },
    /// A single node.
    Point {
        /// Position of the node.
        at_mm: Point,
    },
}

impl Electrodes {
    /// Number of electrodes.
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
            Self::RimPlaces { places_mm, .. } => places_mm.len(),
            Self::Pads(pads) => pads.len(),
        }
    }

    /// Electrode shapes on an outline, metres, in order.
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
            Self::RimPlaces { places_mm, width_mm } => {
                let width_m = width_mm * MM;
                let shape = |place: &Point| {
                    let (centre_m, _) = outline.nearest_rim(place.map(|x| x * MM));
                    match outline {
                        Outline::Disc { radius_m } => {
                            ElectrodeShape::RimArc { centre_rad: centre_m / radius_m, width_m }
                        }
                        _ => ElectrodeShape::RimSegment { centre_m, width_m },
                    }
                };
                places_mm.iter().map(shape).collect()
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

    /// Distance that each electrode of [`Electrodes::RimPlaces`] was moved to reach the rim, millimetres; empty for
    /// other kinds.
    pub fn moved_mm(&self, outline: &Outline) -> Vec<f64> {
        let Self::RimPlaces { places_mm, .. } = self else { return Vec::new() };
        places_mm.iter().map(|place| outline.nearest_rim(place.map(|x| x * MM)).1 / MM).collect()
    }

    pub(super) fn check(&self, outline: &Outline, checker: &Checker<'_>) -> Result<(), Error> {
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
            Self::RimPlaces { places_mm, width_mm } => {
                checker.length_mm(&key("rim-places.width_mm"), *width_mm)?;
                places_mm.iter().try_for_each(|place| checker.place_mm(&key("rim-places.places_mm"), place))?;
                let (low, high) = outline.bounds_m();
                let size_mm = (high[0] - low[0]).max(high[1] - low[1]) / MM;
                let far = (1..).zip(self.moved_mm(outline)).find(|(_, moved)| *moved > FARTHEST * size_mm);
                if let Some((number, moved)) = far {
                    let value = format!("{:?}, electrode {number}", places_mm[number - 1]);
                    let expected =
                        format!("a place at the rim, got one {moved:.1} mm from it (lengths are millimetres)");
                    return Err(checker.refused(&key("rim-places.places_mm"), value, expected));
                }
                Ok(())
            }
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
        let metres = |p: &Point| [p[0] * MM, p[1] * MM];
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

/// Pad positions of [`Electrodes::PadGrid`], metres.
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
