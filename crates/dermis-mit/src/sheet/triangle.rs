//! The potential of a uniformly charged triangle (Wilton, Rao, Glisson, Schaubert, Al-Bundak and Butler, IEEE Trans.
//! Antennas Propag. 32, 1984), and its integral over a second triangle.

use super::mesh::area;
use crate::vector::{Vector, add, cross, dot, norm, scaled, subtract};

/// Seven points, exact to degree 5 (Radon): barycentric coordinates, and weights that sum to 1.
pub(super) fn seven_points() -> [([f64; 3], f64); 7] {
    let root = 15.0_f64.sqrt();
    let (a, b) = ((6.0 - root) / 21.0, (6.0 + root) / 21.0);
    let (u, v) = ((155.0 - root) / 1200.0, (155.0 + root) / 1200.0);
    [
        ([1.0 / 3.0; 3], 0.225),
        ([1.0 - 2.0 * a, a, a], u),
        ([a, 1.0 - 2.0 * a, a], u),
        ([a, a, 1.0 - 2.0 * a], u),
        ([1.0 - 2.0 * b, b, b], v),
        ([b, 1.0 - 2.0 * b, b], v),
        ([b, b, 1.0 - 2.0 * b], v),
    ]
}

/// Three points with equal weights, exact to degree 2.
pub(super) const THREE_POINTS: [[f64; 3]; 3] =
    [[2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0], [1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0], [1.0 / 6.0, 1.0 / 6.0, 2.0 / 3.0]];

pub(super) fn place([a, b, c]: [Vector; 3], l: [f64; 3]) -> Vector {
    add(scaled(a, l[0]), add(scaled(b, l[1]), scaled(c, l[2])))
}

/// `int dS / sqrt(R^2 + blur^2)` over a triangle, where R is the distance to a point.
pub(super) fn potential(corners: [Vector; 3], point: Vector, blur: f64) -> f64 {
    let [a, b, c] = corners;
    let normal = cross(subtract(b, a), subtract(c, a));
    let normal = scaled(normal, 1.0 / norm(normal));
    let height = dot(subtract(point, a), normal);
    let below = subtract(point, scaled(normal, height));
    let h = height.hypot(blur);
    let of_edge = |from: Vector, to: Vector| {
        let along = subtract(to, from);
        let along = scaled(along, 1.0 / norm(along));
        let (from, to) = (subtract(from, below), subtract(to, below));
        let (low, high) = (dot(from, along), dot(to, along));
        let outward = dot(from, cross(along, normal));
        let nearest = outward * outward + h * h;
        let (r_low, r_high) = ((low * low + nearest).sqrt(), (high * high + nearest).sqrt());
        // Use the form that does not cancel.
        let log = if low + high > 0.0 {
            ((r_high + high) / (r_low + low)).ln()
        } else {
            ((r_low - low) / (r_high - high)).ln()
        };
        let angle = |l: f64, r: f64| (outward * l).atan2(nearest + h * r);
        let line = if outward == 0.0 { 0.0 } else { outward * log };
        line - h * (angle(high, r_high) - angle(low, r_low))
    };
    of_edge(a, b) + of_edge(b, c) + of_edge(c, a)
}

/// Minimum distance between the centres of two triangles, relative to the sum of their radii, for point quadrature.
const FAR: f64 = 2.5;

/// A triangle with precomputed data for its pairs.
pub(super) struct Panel {
    pub(super) corners: [Vector; 3],
    pub(super) area: f64,
    middle: Vector,
    reach: f64,
    points: [Vector; 3],
}

impl Panel {
    pub(super) fn new(corners: [Vector; 3]) -> Self {
        let middle = place(corners, [1.0 / 3.0; 3]);
        let reach = corners.iter().map(|p| norm(subtract(*p, middle))).fold(0.0, f64::max);
        Self { corners, area: area(corners), middle, reach, points: THREE_POINTS.map(|l| place(corners, l)) }
    }

    /// `int int 1/sqrt(R^2 + blur^2)` over this triangle and another: by quadrature points if they are far apart,
    /// otherwise by points here of the other's closed form.
    pub(super) fn product(&self, other: &Self, blur: f64) -> f64 {
        let apart = norm(subtract(self.middle, other.middle));
        if apart > FAR * (self.reach + other.reach) {
            let inverse = |p: Vector, q: Vector| {
                let r = subtract(p, q);
                (dot(r, r) + blur * blur).sqrt().recip()
            };
            let sum: f64 = self.points.iter().map(|p| other.points.iter().map(|q| inverse(*p, *q)).sum::<f64>()).sum();
            return self.area * other.area * sum / 9.0;
        }
        let value = |l: [f64; 3]| potential(other.corners, place(self.corners, l), blur);
        self.area * seven_points().into_iter().map(|(l, w)| w * value(l)).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closed_form_is_the_integral() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.2], [0.3, 0.8, -0.1]];
        // Points in and out of the plane, next to an edge, and on the line of an edge.
        for point in [[0.4, 0.3, 0.5], [-0.5, 0.2, 0.1], [1.5, 0.15, 0.3], [0.2, 0.3, -0.4]] {
            for blur in [0.0, 0.3] {
                let steps = 400;
                let mut sum = 0.0;
                for i in 0..steps {
                    for j in 0..steps - i {
                        // Centres of small triangles that point up and of those that point down.
                        for shift in [1.0 / 3.0, 2.0 / 3.0] {
                            if shift > 0.5 && i + j + 1 >= steps {
                                continue;
                            }
                            let (u, v) = ((i as f64 + shift) / steps as f64, (j as f64 + shift) / steps as f64);
                            let r = subtract(place(corners, [1.0 - u - v, u, v]), point);
                            sum += (dot(r, r) + blur * blur).sqrt().recip();
                        }
                    }
                }
                let expected = sum * area(corners) / (steps * steps) as f64;
                let found = potential(corners, point, blur);
                // Midpoints of 160,000 triangles, none closer than 0.1 to the point.
                assert!((found / expected - 1.0).abs() < 1e-5, "{point:?} {blur}: {found} {expected}");
            }
        }
    }

    #[test]
    fn seven_points_are_exact_to_degree_five() {
        // int x^a y^b over the unit triangle = a! b! / (a + b + 2)!.
        for (a, b, exact) in [(0, 0, 0.5), (1, 0, 1.0 / 6.0), (2, 3, 12.0 / 5040.0), (5, 0, 120.0 / 5040.0)] {
            let found: f64 = seven_points().iter().map(|(l, w)| 0.5 * w * l[1].powi(a) * l[2].powi(b)).sum();
            assert!((found - exact).abs() < 1e-14, "{a} {b}: {found}");
        }
    }
}
