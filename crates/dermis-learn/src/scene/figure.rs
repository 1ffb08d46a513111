//! Closed shapes in the plane of a sheet, and their effect on its conductivity.

use std::f64::consts::TAU;

/// Background.
pub const BACKGROUND: u8 = 0;
/// Conductivity lowered: damaged, or a resistive inclusion.
pub const LOWERED: u8 = 1;
/// Conductivity raised: compressed, or a conductive inclusion.
pub const RAISED: u8 = 2;

/// A closed shape.
#[derive(Clone, Debug, PartialEq)]
pub enum Figure {
    /// A disc or ellipse: centre, half axes, rotation of the first half axis (radians).
    Ellipse([f64; 2], [f64; 2], f64),
    /// A polygon.
    Polygon(Vec<[f64; 2]>),
    /// All points within half the width of a polyline.
    Stroke(Vec<[f64; 2]>, f64),
}

/// A shape with its effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Inclusion {
    /// The shape.
    pub figure: Figure,
    /// Conductivity factor.
    pub factor: f64,
    /// [`LOWERED`] or [`RAISED`].
    pub class: u8,
}

/// A point in the axes of an ellipse, in half axes.
fn in_ellipse(p: [f64; 2], middle: [f64; 2], half: [f64; 2], turn: f64) -> (f64, f64) {
    let (sin, cos) = turn.sin_cos();
    let (x, y) = (p[0] - middle[0], p[1] - middle[1]);
    ((cos * x + sin * y) / half[0], (cos * y - sin * x) / half[1])
}

impl Figure {
    /// Minimum and maximum coordinates of a bounding box.
    pub fn bounds(&self) -> ([f64; 2], [f64; 2]) {
        let around = |points: &[[f64; 2]], margin: f64| {
            let fold = |axis: usize, start: f64, choose: fn(f64, f64) -> f64| {
                points.iter().map(|p| p[axis]).fold(start, choose)
            };
            let low = [0, 1].map(|axis| fold(axis, f64::INFINITY, f64::min) - margin);
            let high = [0, 1].map(|axis| fold(axis, f64::NEG_INFINITY, f64::max) + margin);
            (low, high)
        };
        match self {
            Figure::Ellipse(middle, half, _) => around(&[*middle], half[0].max(half[1])),
            Figure::Polygon(corners) => around(corners, 0.0),
            Figure::Stroke(chain, width) => around(chain, 0.5 * width),
        }
    }

    /// True if a point is inside.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        match self {
            Figure::Ellipse(middle, half, turn) => {
                let (u, v) = in_ellipse(p, *middle, *half, *turn);
                u * u + v * v <= 1.0
            }
            Figure::Polygon(corners) => {
                let mut inside = false;
                for (k, a) in corners.iter().enumerate() {
                    let b = corners[(k + 1) % corners.len()];
                    if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
                        inside = !inside;
                    }
                }
                inside
            }
            Figure::Stroke(chain, width) => {
                chain.windows(2).any(|ends| from_segment(p, ends[0], ends[1]) <= 0.5 * width)
            }
        }
    }

    /// Depth of a point inside the shape, metres; negative outside. First-order approximation at the rim of an
    /// ellipse.
    pub fn depth_m(&self, p: [f64; 2]) -> f64 {
        match self {
            Figure::Ellipse(middle, half, turn) => {
                let (u, v) = in_ellipse(p, *middle, *half, *turn);
                let level = u.hypot(v);
                // First-order distance: (1 - level) divided by the length of the gradient of level.
                let gradient = (u / half[0]).hypot(v / half[1]) / level.max(f64::MIN_POSITIVE);
                if level < 1e-9 { half[0].min(half[1]) } else { (1.0 - level) / gradient }
            }
            Figure::Polygon(corners) => {
                let sides = corners.iter().zip(corners.iter().cycle().skip(1));
                let nearest = sides.map(|(a, b)| from_segment(p, *a, *b)).fold(f64::INFINITY, f64::min);
                if self.contains(p) { nearest } else { -nearest }
            }
            Figure::Stroke(chain, width) => {
                let nearest = chain.windows(2).map(|ends| from_segment(p, ends[0], ends[1]));
                0.5 * width - nearest.fold(f64::INFINITY, f64::min)
            }
        }
    }
}

/// Distance between two points, in their unit.
pub(super) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn from_segment(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let square = ab[0] * ab[0] + ab[1] * ab[1];
    let along = if square > 0.0 { ((ab[0] * ap[0] + ab[1] * ap[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (ap[0] - along * ab[0]).hypot(ap[1] - along * ab[1])
}

/// Points around a middle, at even angles.
pub(super) fn ring(middle: [f64; 2], count: usize, turn: f64, radius: impl Fn(usize) -> f64) -> Vec<[f64; 2]> {
    (0..count)
        .map(|k| {
            let angle = turn + TAU * k as f64 / count as f64;
            [middle[0] + radius(k) * angle.cos(), middle[1] + radius(k) * angle.sin()]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// Area of a shape within a square of side 2.
    fn area(figure: &Figure) -> f64 {
        let side = 400;
        let at = |k: usize| (2.0 * k as f64 + 1.0) / side as f64 - 1.0;
        let (low, high) = figure.bounds();
        let boxed = |p: [f64; 2]| (0..2).all(|axis| p[axis] >= low[axis] && p[axis] <= high[axis]);
        let inside = |k: &usize| {
            let p = [at(k % side), at(k / side)];
            assert!(boxed(p) || !figure.contains(p), "{p:?} is outside the box of {figure:?}");
            figure.contains(p)
        };
        let inside = (0..side * side).filter(inside).count();
        4.0 * inside as f64 / (side * side) as f64
    }

    #[test]
    fn areas_agree_with_the_formulas() {
        let ellipse = Figure::Ellipse([0.1, -0.1], [0.6, 0.3], 0.7);
        // A grid of 160,000 points; the error of an area comes from its rim and is about a thousandth.
        assert!((area(&ellipse) - PI * 0.18).abs() < 4e-3);
        let square = Figure::Polygon(ring([0.0, 0.0], 4, 0.3, |_| 0.8));
        assert!((area(&square) - 2.0 * 0.64).abs() < 4e-3);
        let stroke = Figure::Stroke(vec![[-0.5, 0.0], [0.5, 0.2]], 0.2);
        assert!((area(&stroke) - (1.04_f64.sqrt() * 0.2 + PI * 0.01)).abs() < 4e-3);
    }

    #[test]
    fn depths_are_distances_from_the_rim() {
        let disc = Figure::Ellipse([1.0, 0.0], [0.5, 0.5], 0.3);
        assert!((disc.depth_m([1.0, 0.2]) - 0.3).abs() < 1e-12 && (disc.depth_m([2.0, 0.0]) + 0.5).abs() < 1e-12);
        assert!((disc.depth_m([1.0, 0.0]) - 0.5).abs() < 1e-12);
        let ellipse = Figure::Ellipse([0.0, 0.0], [2.0, 1.0], 0.0);
        assert!(
            (ellipse.depth_m([1.99, 0.0]) - 0.01).abs() < 1e-4 && (ellipse.depth_m([0.0, 1.01]) + 0.01).abs() < 1e-4
        );
        let square = Figure::Polygon(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        assert!((square.depth_m([0.5, 0.2]) - 0.2).abs() < 1e-12 && (square.depth_m([2.0, 0.5]) + 1.0).abs() < 1e-12);
        let stroke = Figure::Stroke(vec![[0.0, 0.0], [1.0, 0.0]], 0.4);
        assert!((stroke.depth_m([0.5, 0.1]) - 0.1).abs() < 1e-12 && (stroke.depth_m([1.3, 0.0]) + 0.1).abs() < 1e-12);
    }
}
