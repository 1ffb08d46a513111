//! Points and vectors in the plane.

/// A point in the plane, in metres in the frame of the skin unless the name says otherwise: x right, y up.
pub(crate) type Point = [f64; 2];

/// An offset or a velocity in the plane.
pub(crate) type Vec2 = [f64; 2];

pub(crate) fn add(a: Point, b: Vec2) -> Point {
    [a[0] + b[0], a[1] + b[1]]
}

pub(crate) fn sub(a: Point, b: Point) -> Vec2 {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn scale(a: Vec2, factor: f64) -> Vec2 {
    [a[0] * factor, a[1] * factor]
}

pub(crate) fn norm(a: Vec2) -> f64 {
    a[0].hypot(a[1])
}

/// Distance between two points, in their unit.
pub(crate) fn distance(a: Point, b: Point) -> f64 {
    norm(sub(a, b))
}

/// The square of the distance between two points.
pub(crate) fn squared_distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}
