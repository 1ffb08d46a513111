//! Constraints on a mesh, target sizes, and the rim on which positions are measured.

use super::super::plane::{Point, distance, lerp, sides, to_segment};
use super::super::shapes::Outline;

/// A stretch of the rim, in metres counter-clockwise along it; `end > start`, and `end` may exceed the perimeter.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    pub start: f64,
    pub end: f64,
}

impl Span {
    /// True if `position` lies between the ends, wrapping around the rim.
    pub fn holds(&self, position: f64, perimeter: f64) -> bool {
        (position - self.start).rem_euclid(perimeter) < self.end - self.start
    }
}

/// Constraints on a mesh. The `_owner` lists map these lists to the indices used in errors.
#[derive(Clone, Debug, Default)]
pub struct Features {
    pub spans: Vec<Span>,
    pub span_owner: Vec<usize>,
    pub rim_points: Vec<f64>,
    pub rim_point_owner: Vec<usize>,
    pub pads: Vec<Vec<Point>>,
    pub pad_owner: Vec<usize>,
    pub points: Vec<Point>,
    pub point_owner: Vec<usize>,
    /// Interior lines that edges must follow.
    pub lines: Vec<[Point; 2]>,
}

/// Target sizes.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    pub base: f64,
    pub electrode: f64,
    pub least_segments: usize,
}

/// The rim as a curve.
pub enum Border {
    Circle { radius: f64 },
    Polygon { vertices: Vec<Point>, starts: Vec<f64>, perimeter: f64 },
}

impl Border {
    pub fn new(outline: &Outline) -> Self {
        if let Outline::Disc { radius_m } = outline {
            return Border::Circle { radius: *radius_m };
        }
        let vertices = outline.rim_vertices();
        let mut perimeter = 0.0;
        let mut starts = Vec::with_capacity(vertices.len());
        for [a, b] in sides(&vertices) {
            starts.push(perimeter);
            perimeter += distance(a, b);
        }
        Border::Polygon { vertices, starts, perimeter }
    }

    pub fn perimeter(&self) -> f64 {
        match self {
            Border::Circle { radius } => std::f64::consts::TAU * radius,
            Border::Polygon { perimeter, .. } => *perimeter,
        }
    }

    pub fn at(&self, position: f64) -> Point {
        let position = position.rem_euclid(self.perimeter());
        match self {
            Border::Circle { radius } => {
                let (sine, cosine) = (position / radius).sin_cos();
                [radius * cosine, radius * sine]
            }
            Border::Polygon { vertices, starts, .. } => {
                let side = starts.partition_point(|&start| start <= position).max(1) - 1;
                let (a, b) = (vertices[side], vertices[(side + 1) % vertices.len()]);
                lerp(a, b, ((position - starts[side]) / distance(a, b)).min(1.0))
            }
        }
    }

    /// Distance to the rim, and the nearest position on it.
    pub fn project(&self, p: Point) -> (f64, f64) {
        match self {
            Border::Circle { radius } => {
                let position = radius * p[1].atan2(p[0]);
                ((radius - p[0].hypot(p[1])).abs(), position.rem_euclid(self.perimeter()))
            }
            Border::Polygon { vertices, starts, perimeter } => {
                let mut best = (f64::INFINITY, 0.0);
                for (side, [a, b]) in sides(vertices).enumerate() {
                    let (gap, t) = to_segment(p, a, b);
                    if gap < best.0 {
                        best = (gap, starts[side] + t * distance(a, b));
                    }
                }
                (best.0, best.1.rem_euclid(*perimeter))
            }
        }
    }

    pub fn corners(&self) -> &[f64] {
        match self {
            Border::Circle { .. } => &[],
            Border::Polygon { starts, .. } => starts,
        }
    }
}
