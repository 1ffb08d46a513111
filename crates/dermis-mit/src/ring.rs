//! A circular filament: its vector potential, field and mutual inductances from complete elliptic integrals (Maxwell,
//! Treatise, 1873, art. 701; Smythe, Static and Dynamic Electricity, 3rd ed., 7.10).
//!
//! The combinations of K and E that cancel near the axis are summed from the arithmetic-geometric mean itself, whose
//! terms are all positive. Potential and field are accurate to about 1e-14 of their size everywhere, including the
//! axis.

use std::f64::consts::PI;

use crate::constants::MU0;
use crate::error::{MitError, positive};
use crate::vector::{Vector, add, cross, dot, norm, scaled, subtract};

/// Complete elliptic integrals K and E for a parameter `m = k^2`, given its complement `1 - m` in (0, 1].
pub fn complete_elliptic(complement: f64) -> (f64, f64) {
    let parts = Agm::new(complement);
    (parts.k, parts.k * (1.0 - 0.5 * (1.0 - complement) - 0.5 * (1.0 - complement).powi(2) * parts.rest))
}

/// `K`, and `sum_{n>=1} 2^n c_n^2 / m^2` over the differences c_n of the arithmetic-geometric mean, so that
/// `(2 - m) K - 2 E = K m^2 rest` and `E = K (1 - m/2 - m^2 rest / 2)`.
struct Agm {
    k: f64,
    rest: f64,
}

impl Agm {
    fn new(complement: f64) -> Self {
        let m = 1.0 - complement;
        let (mut a, mut b) = (1.0, complement.sqrt());
        // c_1 / m.
        let mut d = 0.5 / (1.0 + b);
        let (mut rest, mut power) = (0.0, 2.0);
        for _ in 0..40 {
            rest += power * d * d;
            (a, b) = (0.5 * (a + b), (a * b).sqrt());
            // c_{n+1} = c_n^2 / (4 a_{n+1}), with the next a.
            let next = 0.5 * (a + b);
            d = m * d * d / (4.0 * next);
            power *= 2.0;
            if power * d * d < 1e-18 * rest && (a - b).abs() < 1e-15 * a {
                break;
            }
        }
        Self { k: PI / (a + b), rest }
    }
}

/// A loop of thin wire carrying 1 A counter-clockwise around its axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Centre, metres.
    pub centre_m: Vector,
    /// Unit vector along the axis.
    pub axis: Vector,
    /// Radius, metres.
    pub radius_m: f64,
}

/// A point in a ring's own coordinates.
struct Local {
    /// Distance from the axis.
    rho: f64,
    /// Position along the axis.
    z: f64,
    /// Unit vector pointing away from the axis; zero on it.
    outward: Vector,
}

impl Ring {
    /// A ring in a plane of constant z.
    pub fn flat(centre_m: Vector, radius_m: f64) -> Self {
        Self { centre_m, axis: [0.0, 0.0, 1.0], radius_m }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// A radius that is not positive, an axis that is not a unit vector, or a centre that is not finite.
    pub fn check(&self) -> Result<(), MitError> {
        positive("ring radius_m", self.radius_m)?;
        let length = norm(self.axis);
        if (length - 1.0).abs() > 1e-9 || !length.is_finite() {
            return Err(MitError::Value { field: "length of a ring's axis", value: length, expected: "1" });
        }
        let sum: f64 = self.centre_m.iter().sum();
        if sum.is_finite() {
            return Ok(());
        }
        Err(MitError::Value { field: "ring centre_m", value: sum, expected: "finite" })
    }

    fn local(&self, point_m: Vector) -> Local {
        let from = subtract(point_m, self.centre_m);
        let z = dot(from, self.axis);
        let flat = subtract(from, scaled(self.axis, z));
        let rho = norm(flat);
        let outward = if rho > 0.0 { scaled(flat, 1.0 / rho) } else { [0.0; 3] };
        Local { rho, z, outward }
    }

    /// Azimuthal vector potential per ampere, V.s/(m.A), at a distance from the axis and a position along it.
    /// Infinite on the wire.
    fn potential_around(&self, rho: f64, z: f64) -> f64 {
        let a = self.radius_m;
        let alpha_squared = (a + rho).powi(2) + z * z;
        let agm = Agm::new(((a - rho).powi(2) + z * z) / alpha_squared);
        // mu0/(4 pi rho) alpha [(2 - m) K - 2 E] with m = 4 a rho / alpha^2.
        let m = 4.0 * a * rho / alpha_squared;
        MU0 * a * m * agm.k * agm.rest / (PI * alpha_squared.sqrt())
    }

    /// Vector potential per ampere, V.s/(m.A).
    pub fn vector_potential(&self, point_m: Vector) -> Vector {
        let at = self.local(point_m);
        scaled(cross(self.axis, at.outward), self.potential_around(at.rho, at.z))
    }

    /// Flux density per ampere, T/A.
    pub fn flux_density(&self, point_m: Vector) -> Vector {
        let (at, a) = (self.local(point_m), self.radius_m);
        let (alpha_squared, beta_squared) = ((a + at.rho).powi(2) + at.z * at.z, (a - at.rho).powi(2) + at.z * at.z);
        let (alpha, complement, m) =
            (alpha_squared.sqrt(), beta_squared / alpha_squared, 4.0 * a * at.rho / alpha_squared);
        let Agm { k, rest } = Agm::new(complement);
        let e = k * (1.0 - 0.5 * m - 0.5 * m * m * rest);
        let along = MU0 / (2.0 * PI * alpha) * (k + (a * a - at.rho * at.rho - at.z * at.z) / beta_squared * e);
        // mu0 z/(2 pi rho alpha) [-K + (a^2 + rho^2 + z^2)/beta^2 E], where the bracket is
        // K m^2 [1/2 - (2 - m) rest/2] / (2 (1 - m)).
        let bracket = k * m * (1.0 - (2.0 - m) * rest) / complement;
        let away = MU0 * at.z * a * bracket / (2.0 * PI * alpha_squared * alpha);
        add(scaled(self.axis, along), scaled(at.outward, away))
    }

    /// Mutual inductance with another loop, henries. In closed form for a common axis; otherwise the integral of the
    /// potential along the other loop by the trapezoidal rule, which converges geometrically. The points are doubled
    /// until the result no longer changes.
    pub fn mutual_h(&self, other: &Ring) -> f64 {
        let between = subtract(other.centre_m, self.centre_m);
        let sine = norm(cross(self.axis, other.axis));
        let off = norm(cross(self.axis, between));
        if sine < 1e-14 && off < 1e-14 * (self.radius_m + other.radius_m) {
            let same = dot(self.axis, other.axis).signum();
            let along = dot(between, self.axis);
            return same * 2.0 * PI * other.radius_m * self.potential_around(other.radius_m, along);
        }
        let (u, v) = frame(other.axis);
        let mut points = 16;
        let mut sum = self.circulation(other, u, v, points, 0.0);
        let mut value = sum / points as f64;
        while points < 1 << 16 {
            sum += self.circulation(other, u, v, points, 0.5);
            points *= 2;
            let refined = sum / points as f64;
            let settled = (refined - value).abs() <= 1e-14 * refined.abs().max(1e-6 * MU0 * self.radius_m);
            value = refined;
            if settled {
                break;
            }
        }
        2.0 * PI * other.radius_m * value
    }

    /// Sum of the tangential potential over points of the other loop, shifted by a share of their spacing.
    fn circulation(&self, other: &Ring, u: Vector, v: Vector, points: usize, shift: f64) -> f64 {
        (0..points)
            .map(|k| {
                let (sine, cosine) = (2.0 * PI * (k as f64 + shift) / points as f64).sin_cos();
                let outward = add(scaled(u, cosine), scaled(v, sine));
                let along = add(scaled(u, -sine), scaled(v, cosine));
                dot(self.vector_potential(add(other.centre_m, scaled(outward, other.radius_m))), along)
            })
            .sum()
    }

    /// Self inductance of a wire ring with the given geometric mean distance from itself (`a e^{-1/4}` for round wire
    /// of radius a, 0.2235 w for a strip of width w), henries: `mu0 R (ln(8R/g) - 2)`, for g much smaller than R
    /// (Rosa and Grover, Bull. Bur. Stand. 8, 1912, eq. 58 ff.).
    pub fn self_inductance_h(&self, geometric_mean_distance_m: f64) -> f64 {
        MU0 * self.radius_m * ((8.0 * self.radius_m / geometric_mean_distance_m).ln() - 2.0)
    }

    /// Minimum distance of the wire from a point.
    pub fn distance_m(&self, point_m: Vector) -> f64 {
        let at = self.local(point_m);
        (at.rho - self.radius_m).hypot(at.z)
    }
}

/// Two unit vectors that form a right-handed frame with a third.
pub(crate) fn frame(axis: Vector) -> (Vector, Vector) {
    let start = if axis[0].abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    let u = subtract(start, scaled(axis, dot(start, axis)));
    let u = scaled(u, 1.0 / norm(u));
    (u, cross(axis, u))
}
