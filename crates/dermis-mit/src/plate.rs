//! Round coils over a wide conducting plate or half space, in closed form except for one integral (Dodd and Deeds,
//! Journal of Applied Physics 39, 1968).
//!
//! A loop of radius a at height z above the face contains the harmonics `a J1(k a) e^(-k z)` around its axis. The
//! plate returns each of them multiplied by its reflection `G(k)`, so
//! `dM_mn = pi mu0 int F_m(k) F_n(k) J0(k p) G(k) dk`, with `F = sum a J1(k a) e^(-k z)` over the loops and p the
//! distance between the axes. With `k1^2 = k^2 + j w mu sigma`, `b = k1/mu_r` and thickness t,
//! `G = (k^2 - b^2)(1 - e^(-2 k1 t)) / ((k + b)^2 - (k - b)^2 e^(-2 k1 t))`; for a half space it is
//! `(k - b)/(k + b)`.

use std::f64::consts::{PI, TAU};

use dermis_tomo::mesh::{Point, distance};

use crate::coil::{Coil, Filament};
use crate::constants::MU0;
use crate::error::{MitError, frequency, positive};
use crate::quadrature::gauss_legendre;
use crate::vector::Complex;

/// A wide plate whose upper face is a plane of constant z, or the whole half space below that plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConductingPlate {
    /// Height of the upper face, metres.
    pub face_z_m: f64,
    /// Thickness, metres; `None` for a half space.
    pub thickness_m: Option<f64>,
    /// Conductivity, S/m.
    pub conductivity_s_per_m: f64,
    /// Relative permeability.
    pub relative_permeability: f64,
}

/// A loop of a [`RoundWinding`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Loop {
    radius_m: f64,
    z_m: f64,
    turns: f64,
}

/// Turns around one vertical axis.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundWinding {
    axis_m: Point,
    loops: Vec<Loop>,
}

/// Number of Gauss-Legendre points across a winding's cross-section.
const ACROSS: usize = 24;

impl RoundWinding {
    /// One loop around an axis at (x, y).
    ///
    /// # Errors
    /// A radius that is not positive.
    pub fn ring(centre_m: [f64; 3], radius_m: f64) -> Result<Self, MitError> {
        positive("radius_m", radius_m)?;
        Ok(Self { axis_m: [centre_m[0], centre_m[1]], loops: vec![Loop { radius_m, z_m: centre_m[2], turns: 1.0 }] })
    }

    /// Turns distributed evenly over an annulus.
    ///
    /// # Errors
    /// Diameters that are not positive or not in order, or a number of turns that is not positive.
    pub fn annulus(
        centre_m: [f64; 3],
        inner_diameter_m: f64,
        outer_diameter_m: f64,
        turns: f64,
    ) -> Result<Self, MitError> {
        Self::block(centre_m, inner_diameter_m, outer_diameter_m, 0.0, turns)
    }

    /// Turns distributed evenly over a block of this height around its centre.
    ///
    /// # Errors
    /// As [`RoundWinding::annulus`]; also fails if the height is negative.
    pub fn block(
        centre_m: [f64; 3],
        inner_diameter_m: f64,
        outer_diameter_m: f64,
        height_m: f64,
        turns: f64,
    ) -> Result<Self, MitError> {
        positive("inner_diameter_m", inner_diameter_m)?;
        positive("outer_diameter_m", outer_diameter_m)?;
        positive("turns", turns)?;
        positive("outer less inner diameter (m)", outer_diameter_m - inner_diameter_m)?;
        if !(height_m >= 0.0 && height_m.is_finite()) {
            return Err(MitError::Value { field: "height_m", value: height_m, expected: "0 or more, finite" });
        }
        let rule = gauss_legendre(ACROSS);
        let levels = if height_m > 0.0 { rule.clone() } else { vec![(0.0, 2.0)] };
        let mut loops = Vec::with_capacity(rule.len() * levels.len());
        for (u, share) in &rule {
            for (v, level) in &levels {
                let radius_m =
                    0.25 * (outer_diameter_m + inner_diameter_m) + 0.25 * u * (outer_diameter_m - inner_diameter_m);
                let z_m = centre_m[2] + 0.5 * v * height_m;
                loops.push(Loop { radius_m, z_m, turns: 0.25 * turns * share * level });
            }
        }
        Ok(Self { axis_m: [centre_m[0], centre_m[1]], loops })
    }

    /// The rings of a coil with a vertical axis, and their images if it has a shield.
    ///
    /// # Errors
    /// A coil that is not round.
    pub fn of_coil(coil: &Coil) -> Result<Self, MitError> {
        if !coil.is_axisymmetric() {
            return Err(MitError::NotRound { centre_m: coil.centre_m });
        }
        let of = |(filament, turns): (&Filament, f64)| match filament {
            // A loop whose axis points down carries its current in the opposite direction.
            Filament::Ring(ring) => Some(Loop {
                radius_m: ring.radius_m,
                z_m: ring.centre_m[2],
                turns: turns * coil.scale() * ring.axis[2].signum(),
            }),
            Filament::Segment(_) => None,
        };
        let wire = coil.filaments().iter().map(|filament| (filament, 1.0));
        let loops = wire.chain(coil.images().iter().map(|filament| (filament, -1.0))).filter_map(of).collect();
        Ok(Self { axis_m: [coil.centre_m[0], coil.centre_m[1]], loops })
    }

    fn lowest_m(&self) -> f64 {
        self.loops.iter().map(|l| l.z_m).fold(f64::INFINITY, f64::min)
    }

    fn widest_m(&self) -> f64 {
        self.loops.iter().map(|l| l.radius_m).fold(0.0, f64::max)
    }

    /// `sum turns a J1(k a) e^(-k (z - face))`.
    fn harmonic(&self, k: f64, face_z_m: f64) -> f64 {
        self.loops
            .iter()
            .map(|l| l.turns * l.radius_m * libm::j1(k * l.radius_m) * (-k * (l.z_m - face_z_m)).exp())
            .sum()
    }
}

impl ConductingPlate {
    /// Change of the mutual inductance of two windings above the plate, henries; for a winding with itself, of its
    /// self inductance. Accurate to about 1e-13 of the change due to a perfect conductor.
    ///
    /// # Errors
    /// A frequency outside 1 Hz to 1 MHz, a conductivity, permeability or thickness that is not positive, or a loop
    /// that is not above the face.
    pub fn change_h(&self, m: &RoundWinding, n: &RoundWinding, frequency_hz: f64) -> Result<Complex, MitError> {
        frequency(frequency_hz)?;
        positive("conductivity_s_per_m", self.conductivity_s_per_m)?;
        positive("relative_permeability", self.relative_permeability)?;
        if let Some(thickness_m) = self.thickness_m {
            positive("thickness_m", thickness_m)?;
        }
        for winding in [m, n] {
            positive("height of a loop over the plate (m)", winding.lowest_m() - self.face_z_m)?;
        }
        let apart = distance(m.axis_m, n.axis_m);
        let reach = m.widest_m() + n.widest_m() + apart;
        let heights = m.lowest_m() + n.lowest_m() - 2.0 * self.face_z_m;
        let rule = gauss_legendre(16);
        let mut sum = Complex::new(0.0, 0.0);
        // Start at 1e-6 of the wave number that the coils resolve (the integrand is proportional to k^2). Double each
        // panel until it is a full period of the fastest Bessel function. Stop when e^(-k z) is 1e-18.
        let (mut k, mut width, last) = (0.0, 1e-6 / reach, 41.0 / heights);
        while k < last {
            for (x, weight) in &rule {
                let at = k + 0.5 * width * (1.0 + x);
                let of_m = m.harmonic(at, self.face_z_m);
                let of_n = if m.loops == n.loops { of_m } else { n.harmonic(at, self.face_z_m) };
                let strength = of_m * of_n * libm::j0(at * apart);
                sum += self.reflection(at, frequency_hz) * (0.5 * width * weight * strength);
            }
            k += width;
            width = k.min(TAU / reach);
        }
        Ok(sum * (PI * MU0))
    }

    /// G(k): reflection of a harmonic with wave number k (1/m), relative to its value at the face.
    pub fn reflection(&self, k_per_m: f64, frequency_hz: f64) -> Complex {
        let mu_r = self.relative_permeability;
        let loss = TAU * frequency_hz * MU0 * self.conductivity_s_per_m;
        let k1 = Complex::new(k_per_m * k_per_m, loss * mu_r).sqrt();
        let b = k1 / mu_r;
        let (sum, difference) = (b + k_per_m, -b + k_per_m);
        // k^2 - b^2 without cancellation for a weak conductor.
        let squares = Complex::new(k_per_m * k_per_m * (1.0 - mu_r.powi(-2)), -loss / mu_r);
        let Some(thickness_m) = self.thickness_m else { return squares / (sum * sum) };
        let missing = one_less_exponential(k1 * (2.0 * thickness_m));
        squares * missing / (sum * sum - difference * difference * (-missing + 1.0))
    }
}

/// `1 - e^(-x)` without cancellation for small x.
fn one_less_exponential(x: Complex) -> Complex {
    let (sine, half) = (x.im.sin(), (0.5 * x.im).sin());
    let decay = (-x.re).exp();
    Complex::new(2.0 * half * half * decay - (-x.re).exp_m1(), decay * sine)
}
