//! A straight filament: potential, field and mutual inductance in closed form (Grover, Inductance Calculations, 1946,
//! ch. 7). Only closed chains of segments are physically meaningful.

use std::f64::consts::PI;

use crate::constants::MU0;
use crate::vector::{Vector, add, cross, dot, norm, scaled, subtract};

/// A straight wire carrying 1 A from one end to the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// End where the current enters, metres.
    pub from_m: Vector,
    /// End where the current leaves, metres.
    pub to_m: Vector,
}

impl Segment {
    /// Length, metres.
    pub fn length_m(&self) -> f64 {
        norm(subtract(self.to_m, self.from_m))
    }

    fn direction(&self) -> Vector {
        scaled(subtract(self.to_m, self.from_m), 1.0 / self.length_m())
    }

    /// Vector potential per ampere, V.s/(m.A): `mu0/(4 pi) ln((r1 + r2 + L)/(r1 + r2 - L))` along the wire.
    pub fn vector_potential(&self, point_m: Vector) -> Vector {
        let (r1, r2) = (norm(subtract(point_m, self.from_m)), norm(subtract(point_m, self.to_m)));
        let length = self.length_m();
        scaled(self.direction(), MU0 / (2.0 * PI) * (length / (r1 + r2)).atanh())
    }

    /// Flux density per ampere, T/A.
    pub fn flux_density(&self, point_m: Vector) -> Vector {
        let (a, b) = (subtract(point_m, self.from_m), subtract(point_m, self.to_m));
        let (r1, r2) = (norm(a), norm(b));
        // mu0/(4 pi) (a x b) (r1 + r2) / (r1 r2 (r1 r2 + a.b)): regular on the line beyond the ends.
        let denominator = r1 * r2 * (r1 * r2 + dot(a, b));
        scaled(cross(a, b), MU0 / (4.0 * PI) * (r1 + r2) / denominator)
    }

    /// Mutual inductance with a parallel or perpendicular segment, henries; other angles by Gauss quadrature of the
    /// potential. `least_m` is the distance assumed between coincident or collinear filaments (the wire's geometric
    /// mean distance).
    pub fn mutual_h(&self, other: &Segment, least_m: f64) -> f64 {
        let (t, u) = (self.direction(), other.direction());
        let cosine = dot(t, u);
        if cosine.abs() < 1e-14 {
            return 0.0;
        }
        if 1.0 - cosine.abs() < 1e-14 {
            let start = subtract(other.from_m, self.from_m);
            let along = dot(start, t);
            let distance = norm(subtract(start, scaled(t, along))).max(least_m);
            let ends = [along, along + cosine * other.length_m()];
            let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
            let g = |x: f64| x * (x / distance).asinh() - x.hypot(distance);
            let length = self.length_m();
            return cosine.signum() * MU0 / (4.0 * PI) * (g(high) - g(high - length) - g(low) + g(low - length));
        }
        let steps = 200;
        let step = other.length_m() / steps as f64;
        let at = |k: usize| add(other.from_m, scaled(u, step * (k as f64 + 0.5)));
        (0..steps).map(|k| dot(self.vector_potential(at(k)), u) * step).sum()
    }

    /// Minimum distance of the wire from a point.
    pub fn distance_m(&self, point_m: Vector) -> f64 {
        let (t, from) = (self.direction(), subtract(point_m, self.from_m));
        let along = dot(from, t).clamp(0.0, self.length_m());
        norm(subtract(from, scaled(t, along)))
    }
}
