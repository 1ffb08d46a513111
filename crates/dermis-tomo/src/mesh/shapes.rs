//! Geometry of a flat sheet before meshing: its outline, its electrodes, and generators for common electrode layouts.
//! Lengths in metres, angles in radians counter-clockwise from +x.
//!
//! Positions along the rim run counter-clockwise: on a disc from +x (so that position = angle x radius), on a
//! rectangle from its bottom-left corner, on a polygon from its first vertex (even if its vertices were listed
//! clockwise).

use std::f64::consts::TAU;

use super::core::MeshError;
use super::plane::{Point, sides, signed_area};

/// The shape of a sheet.
#[derive(Clone, Debug, PartialEq)]
pub enum Outline {
    /// Centred on the origin. Meshed as the polygon over its rim nodes, whose area is smaller than the circle's by a
    /// share `(2 pi^2 / 3) / n^2` for `n` rim edges, O(h^2) in the element size like the error of linear elements.
    Disc {
        /// Radius.
        radius_m: f64,
    },
    /// Centred on the origin; a square if both sides are equal.
    Rectangle {
        /// Along x.
        width_m: f64,
        /// Along y.
        height_m: f64,
    },
    /// Any simple polygon, in either orientation, with holes strictly inside it.
    Polygon {
        /// Vertices of the rim, without repeating the first.
        outer: Vec<Point>,
        /// Vertices of each hole.
        holes: Vec<Vec<Point>>,
    },
}

/// An electrode of a sheet.
#[derive(Clone, Debug, PartialEq)]
pub enum ElectrodeShape {
    /// A stretch of a disc's rim.
    RimArc {
        /// Angle of its middle, radians counter-clockwise from +x.
        centre_rad: f64,
        /// Length along the arc. The meshed length, measured along the chords, is shorter by `(w/r)^2 / (24 n^2)` for
        /// `n` edges.
        width_m: f64,
    },
    /// A stretch of any rim; may go around corners.
    RimSegment {
        /// Position of its middle along the rim.
        centre_m: f64,
        /// Length along the rim.
        width_m: f64,
    },
    /// One node on the rim.
    RimPoint {
        /// Position along the rim.
        position_m: f64,
    },
    /// A round pad under the sheet, meshed as a regular polygon with exactly the circle's area.
    PadCircle {
        /// Centre.
        centre_m: Point,
        /// Radius.
        radius_m: f64,
    },
    /// A rectangular pad under the sheet; may be flush with the rim.
    PadRectangle {
        /// Centre.
        centre_m: Point,
        /// Along its own x axis.
        width_m: f64,
        /// Along its own y axis.
        height_m: f64,
        /// Rotation of its axes, radians counter-clockwise.
        angle_rad: f64,
    },
    /// One node inside the sheet.
    Point {
        /// Position of the node.
        position_m: Point,
    },
}

/// Direction in which electrodes are numbered around the rim, seen from +z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Clockwise.
    Clockwise,
    /// Counter-clockwise.
    CounterClockwise,
}

impl Direction {
    fn sign(self) -> f64 {
        match self {
            Direction::Clockwise => -1.0,
            Direction::CounterClockwise => 1.0,
        }
    }
}

impl ElectrodeShape {
    /// Position along the rim and half the width of an electrode on it, metres; `None` for pads and inner points.
    pub fn on_rim(&self, outline: &Outline) -> Option<(f64, f64)> {
        match *self {
            Self::RimArc { centre_rad, width_m } => Some((centre_rad * outline.perimeter_m() / TAU, 0.5 * width_m)),
            Self::RimSegment { centre_m, width_m } => Some((centre_m, 0.5 * width_m)),
            Self::RimPoint { position_m } => Some((position_m, 0.0)),
            _ => None,
        }
    }

    /// Centre of a pad or an inner point, and half its extent along x and y, metres; `None` for electrodes on the rim.
    pub fn pad_box(&self) -> Option<([f64; 2], [f64; 2])> {
        match *self {
            Self::PadCircle { centre_m, radius_m } => Some((centre_m, [radius_m; 2])),
            Self::Point { position_m } => Some((position_m, [0.0; 2])),
            Self::PadRectangle { centre_m, width_m, height_m, angle_rad } => {
                let (sine, cosine) = (angle_rad.sin().abs(), angle_rad.cos().abs());
                let half = [0.5 * (width_m * cosine + height_m * sine), 0.5 * (width_m * sine + height_m * cosine)];
                Some((centre_m, half))
            }
            _ => None,
        }
    }
}

impl Outline {
    /// Length of the rim (of the true circle, for a disc).
    pub fn perimeter_m(&self) -> f64 {
        match self {
            Outline::Disc { radius_m } => TAU * radius_m,
            _ => sides(&self.rim_vertices()).map(|[a, b]| super::plane::distance(a, b)).sum(),
        }
    }

    /// Area (of the true circle, for a disc; without the holes).
    pub fn area_m2(&self) -> f64 {
        match self {
            Outline::Disc { radius_m } => TAU / 2.0 * radius_m * radius_m,
            Outline::Rectangle { width_m, height_m } => width_m * height_m,
            Outline::Polygon { outer, holes } => {
                signed_area(outer).abs() - holes.iter().map(|hole| signed_area(hole).abs()).sum::<f64>()
            }
        }
    }

    /// Minimum and maximum coordinates (of the true circle, for a disc).
    pub fn bounds_m(&self) -> (Point, Point) {
        match self {
            Outline::Disc { radius_m } => ([-radius_m, -radius_m], [*radius_m, *radius_m]),
            _ => super::plane::bounds(&self.rim_vertices()),
        }
    }

    /// True for points on the sheet, including its rim and the sides of its holes; false in its holes.
    pub fn contains(&self, point_m: Point) -> bool {
        let Outline::Polygon { outer, holes } = self else {
            let (low, high) = self.bounds_m();
            return match self {
                Outline::Disc { radius_m } => point_m[0].hypot(point_m[1]) <= *radius_m,
                _ => (0..2).all(|axis| (low[axis]..=high[axis]).contains(&point_m[axis])),
            };
        };
        // Check the sides first: for a point exactly on a side, the containment test is arbitrary.
        let slack = 1e-9 * self.perimeter_m();
        let loops = || std::iter::once(outer).chain(holes);
        loops().any(|polygon| super::plane::to_polygon(point_m, polygon) <= slack)
            || super::plane::contains(outer, point_m) && !holes.iter().any(|hole| super::plane::contains(hole, point_m))
    }

    /// Depth of a point inside the sheet: its distance from the rim or from the nearest hole; 0 off the sheet.
    pub fn inside_by_m(&self, point_m: Point) -> f64 {
        let [x, y] = point_m.map(f64::abs);
        match self {
            Outline::Disc { radius_m } => (radius_m - x.hypot(y)).max(0.0),
            Outline::Rectangle { width_m, height_m } => (0.5 * width_m - x).min(0.5 * height_m - y).max(0.0),
            Outline::Polygon { .. } if !self.contains(point_m) => 0.0,
            Outline::Polygon { outer, holes } => std::iter::once(outer)
                .chain(holes)
                .map(|polygon| super::plane::to_polygon(point_m, polygon))
                .fold(f64::INFINITY, f64::min),
        }
    }

    /// Position along the rim of the point nearest to a place, and its distance from the place, metres.
    pub fn nearest_rim(&self, place_m: Point) -> (f64, f64) {
        if let Outline::Disc { radius_m } = self {
            let angle = place_m[1].atan2(place_m[0]).rem_euclid(TAU);
            return (angle * radius_m, (place_m[0].hypot(place_m[1]) - radius_m).abs());
        }
        let (mut begin, mut nearest) = (0.0, (0.0, f64::INFINITY));
        for [a, b] in sides(&self.rim_vertices()) {
            let length = super::plane::distance(a, b);
            let along = (0..2).map(|k| (place_m[k] - a[k]) * (b[k] - a[k])).sum::<f64>() / (length * length);
            let along = along.clamp(0.0, 1.0);
            let point = [0, 1].map(|k| a[k] + along * (b[k] - a[k]));
            let distance = super::plane::distance(point, place_m);
            if distance < nearest.1 {
                nearest = (begin + along * length, distance);
            }
            begin += length;
        }
        nearest
    }

    /// The point at a position along the rim; positions go round.
    pub fn rim_at(&self, position_m: f64) -> Point {
        let mut left = position_m.rem_euclid(self.perimeter_m());
        if let Outline::Disc { radius_m } = self {
            let (sine, cosine) = (left / radius_m).sin_cos();
            return [radius_m * cosine, radius_m * sine];
        }
        let vertices = self.rim_vertices();
        for [a, b] in sides(&vertices) {
            let length = super::plane::distance(a, b);
            if left <= length {
                return [0, 1].map(|k| a[k] + left / length * (b[k] - a[k]));
            }
            left -= length;
        }
        vertices[0]
    }

    /// Positions of the corners along the rim, the first at the perimeter; none for a disc.
    pub fn rim_corners_m(&self) -> Vec<f64> {
        let vertices = self.rim_vertices();
        let ends = sides(&vertices).scan(0.0, |end, [a, b]| {
            *end += super::plane::distance(a, b);
            Some(*end)
        });
        ends.collect()
    }

    /// Corners counter-clockwise, starting where rim positions start; empty for a disc.
    pub(super) fn rim_vertices(&self) -> Vec<Point> {
        match self {
            Outline::Disc { .. } => Vec::new(),
            Outline::Rectangle { width_m, height_m } => {
                let (x, y) = (width_m / 2.0, height_m / 2.0);
                vec![[-x, -y], [x, -y], [x, y], [-x, y]]
            }
            Outline::Polygon { outer, .. } => {
                let mut vertices = outer.clone();
                if signed_area(&vertices) < 0.0 {
                    vertices[1..].reverse();
                }
                vertices
            }
        }
    }

    /// `count` electrodes of equal width (arc length), evenly spaced around the rim of a disc, the first centred at
    /// `start_rad`.
    pub fn rim_arcs(count: usize, width_m: f64, start_rad: f64, direction: Direction) -> Vec<ElectrodeShape> {
        let step = direction.sign() * TAU / count.max(1) as f64;
        (0..count).map(|k| ElectrodeShape::RimArc { centre_rad: start_rad + step * k as f64, width_m }).collect()
    }

    /// `count` electrodes of equal width, evenly spaced along any rim, the first centred at position `start_m`.
    pub fn rim_segments(&self, count: usize, width_m: f64, start_m: f64, direction: Direction) -> Vec<ElectrodeShape> {
        self.rim_positions(count, start_m, direction)
            .map(|centre_m| ElectrodeShape::RimSegment { centre_m, width_m })
            .collect()
    }

    /// `count` point electrodes, evenly spaced along any rim, the first at position `start_m`.
    pub fn rim_points(&self, count: usize, start_m: f64, direction: Direction) -> Vec<ElectrodeShape> {
        self.rim_positions(count, start_m, direction)
            .map(|position_m| ElectrodeShape::RimPoint { position_m })
            .collect()
    }

    /// `per_side` electrodes on every side of a rectangle or polygon, each in the middle of an equal share of its
    /// side. Starts with the first electrode of the first side (bottom, from the left, on a rectangle); clockwise
    /// numbering keeps that one first and goes the other way.
    pub fn rim_per_side(&self, per_side: usize, width_m: f64, direction: Direction) -> Vec<ElectrodeShape> {
        let mut centres = Vec::new();
        let mut begin = 0.0;
        for [a, b] in sides(&self.rim_vertices()) {
            let length = super::plane::distance(a, b);
            centres.extend((0..per_side).map(|k| begin + (k as f64 + 0.5) * length / per_side as f64));
            begin += length;
        }
        if direction == Direction::Clockwise && !centres.is_empty() {
            centres[1..].reverse();
        }
        centres.into_iter().map(|centre_m| ElectrodeShape::RimSegment { centre_m, width_m }).collect()
    }

    fn rim_positions(&self, count: usize, start_m: f64, direction: Direction) -> impl Iterator<Item = f64> {
        let perimeter = self.perimeter_m();
        let step = direction.sign() * perimeter / count.max(1) as f64;
        (0..count).map(move |k| (start_m + step * k as f64).rem_euclid(perimeter))
    }
}

impl ElectrodeShape {
    /// Copies of this pad on a `columns` x `rows` grid with the given pitch, centred on the origin, row by row from
    /// the top left. Empty for shapes on the rim.
    pub fn grid(&self, columns: usize, rows: usize, pitch_m: [f64; 2]) -> Vec<ElectrodeShape> {
        let place = |column: usize, row: usize| {
            let x = (column as f64 - (columns as f64 - 1.0) / 2.0) * pitch_m[0];
            let y = ((rows as f64 - 1.0) / 2.0 - row as f64) * pitch_m[1];
            self.moved_to([x, y])
        };
        let places = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        places.map_while(|(column, row)| place(column, row)).collect()
    }

    /// The outer ring of [`ElectrodeShape::grid`]: `2 (columns + rows) - 4` pads along the edge of a rectangle,
    /// starting at the bottom-left corner in the given direction.
    pub fn ring(&self, columns: usize, rows: usize, pitch_m: [f64; 2], direction: Direction) -> Vec<ElectrodeShape> {
        if columns < 2 || rows < 2 {
            return self.grid(columns, rows, pitch_m);
        }
        let (right, top) = (columns - 1, rows - 1);
        let mut places: Vec<[usize; 2]> = (0..right).map(|x| [x, 0]).collect();
        places.extend((0..top).map(|y| [right, y]));
        places.extend((1..=right).rev().map(|x| [x, top]));
        places.extend((1..=top).rev().map(|y| [0, y]));
        if direction == Direction::Clockwise {
            places[1..].reverse();
        }
        let at = |place: [usize; 2]| {
            let x = (place[0] as f64 - right as f64 / 2.0) * pitch_m[0];
            self.moved_to([x, (place[1] as f64 - top as f64 / 2.0) * pitch_m[1]])
        };
        places.into_iter().map_while(at).collect()
    }

    fn moved_to(&self, place: Point) -> Option<ElectrodeShape> {
        let mut moved = self.clone();
        match &mut moved {
            ElectrodeShape::PadCircle { centre_m, .. } | ElectrodeShape::PadRectangle { centre_m, .. } => {
                *centre_m = place;
            }
            ElectrodeShape::Point { position_m } => *position_m = place,
            _ => return None,
        }
        Some(moved)
    }
}

/// Refuses a length that is not between a nanometre and 1,000 km. Beyond that range neither the physics nor the
/// arithmetic of refinement is valid.
pub(super) fn check_length(field: &'static str, value: f64) -> Result<(), MeshError> {
    if (1e-9..=1e6).contains(&value) {
        return Ok(());
    }
    Err(MeshError::Shape { field, value: value.to_string(), expected: "a length in metres, 1e-9 to 1e6".into() })
}

/// Refuses a coordinate or angle that is not finite or absurdly large.
pub(super) fn check_coordinate(field: &'static str, value: f64) -> Result<(), MeshError> {
    if value.abs() <= 1e6 {
        return Ok(());
    }
    Err(MeshError::Shape { field, value: value.to_string(), expected: "a finite number below 1e6".into() })
}
