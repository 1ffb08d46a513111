//! The multipole polarizability of a small body at one frequency: its response to the surrounding field as a complex
//! symmetric matrix tau over solid harmonics.

use crate::array::CoilArray;
use crate::constants::FOUR_PI_MU0;
use crate::error::{MitError, positive};
use crate::harmonics::{DEGREES, HARMONICS, MOST_DEGREE};
use crate::sphere::Sphere;
use crate::vector::Complex;

/// Multipole polarizability of a body: the tensor tau that maps the surrounding field to the body's response,
/// `dM_mn = c_m' tau c_n`.
#[derive(Clone, Debug, PartialEq)]
pub struct Polarizability {
    /// Description, for display.
    pub label: String,
    /// Radius of the bounding sphere, metres.
    pub radius_m: f64,
    /// Radius of an inscribed sphere, metres; 0 if unknown.
    pub(crate) inner_m: f64,
    /// tau, row by row, [`HARMONICS`] squared.
    tau: Vec<Complex>,
    /// Row, column and value of the nonzero entries: a tenth of all for a body of revolution, the diagonal for a
    /// sphere.
    pub(crate) entries: Vec<(usize, usize, Complex)>,
}

/// Nonzero entries, row by row.
fn entries(tau: &[Complex]) -> Vec<(usize, usize, Complex)> {
    let of = |(k, value): (usize, &Complex)| (k / HARMONICS, k % HARMONICS, *value);
    tau.iter().enumerate().map(of).filter(|(_, _, value)| value.re != 0.0 || value.im != 0.0).collect()
}

impl Polarizability {
    /// Builds a body from a matrix computed elsewhere, row by row, for one frequency.
    ///
    /// # Errors
    /// The wrong number of entries, non-finite entries, a matrix whose asymmetry exceeds 1e-3 of its largest entry of
    /// these degrees, or a radius that is not positive.
    pub fn from_tau(label: impl Into<String>, radius_m: f64, tau: Vec<Complex>) -> Result<Self, MitError> {
        positive("radius_m", radius_m)?;
        if tau.len() != HARMONICS * HARMONICS {
            let (expected, got) = (HARMONICS * HARMONICS, tau.len());
            return Err(MitError::Count { what: "entries of tau", expected, got });
        }
        // Scaled to the harmonics of the bounding sphere, so that degrees are comparable.
        let size =
            |i: usize, j: usize| (tau[i * HARMONICS + j] / radius_m.powi((DEGREES[i] + DEGREES[j] + 1) as i32)).norm();
        let largest = (0..HARMONICS).flat_map(|i| (0..HARMONICS).map(move |j| (i, j))).map(|(i, j)| size(i, j));
        let largest = largest.fold(0.0, f64::max);
        for i in 0..HARMONICS {
            for j in 0..i {
                let scale = radius_m.powi((DEGREES[i] + DEGREES[j] + 1) as i32);
                let off = ((tau[i * HARMONICS + j] - tau[j * HARMONICS + i]) / scale).norm();
                if off > 1e-3 * largest || !off.is_finite() {
                    let expected = "tau to be symmetric";
                    return Err(MitError::Value {
                        field: "tau_ij - tau_ji over its largest",
                        value: off / largest,
                        expected,
                    });
                }
            }
        }
        Ok(Self { label: label.into(), radius_m, inner_m: 0.0, entries: entries(&tau), tau })
    }

    /// A sphere at a frequency.
    ///
    /// # Errors
    /// See [`Sphere::responses`].
    pub fn sphere(sphere: &Sphere, frequency_hz: f64) -> Result<Self, MitError> {
        let responses = sphere.responses(frequency_hz, MOST_DEGREE)?;
        let mut tau = vec![Complex::new(0.0, 0.0); HARMONICS * HARMONICS];
        for (i, &l) in DEGREES.iter().enumerate() {
            tau[i * HARMONICS + i] = responses[l - 1] * (FOUR_PI_MU0 * l as f64 / (l as f64 + 1.0));
        }
        Ok(Self {
            label: "sphere".into(),
            radius_m: sphere.radius_m,
            inner_m: sphere.radius_m,
            entries: entries(&tau),
            tau,
        })
    }

    /// The same body, with the radius of a sphere inscribed around its centre, metres. Bodies whose inscribed spheres
    /// overlap are refused even if they do not excite each other.
    pub fn with_inner_radius(mut self, inner_m: f64) -> Self {
        self.inner_m = inner_m.clamp(0.0, self.radius_m);
        self
    }

    /// tau, row by row.
    pub fn tau(&self) -> &[Complex] {
        &self.tau
    }

    /// The same body without all responses of higher degrees.
    pub fn truncated(&self, degree: usize) -> Self {
        let mut body = self.clone();
        for i in 0..HARMONICS {
            for j in 0..HARMONICS {
                if DEGREES[i].max(DEGREES[j]) > degree {
                    body.tau[i * HARMONICS + j] = Complex::new(0.0, 0.0);
                }
            }
        }
        body.entries = entries(&body.tau);
        body
    }

    /// Change of the mutual inductance of two coils with these expansions (see [`crate::expansion`]) due to the body
    /// alone, henries: `c_m' tau c_n`.
    pub fn change_h(&self, c_m: &[f64; HARMONICS], c_n: &[f64; HARMONICS]) -> Complex {
        let mut answer = [Complex::new(0.0, 0.0); HARMONICS];
        self.answer(c_n, &mut answer);
        answer.iter().zip(c_m).map(|(a, c)| *a * *c).sum()
    }

    /// The same for all pairs of an array, for the body centred at a place. All wire must be outside its bounding
    /// sphere.
    pub fn changes_h(&self, array: &CoilArray, centre_m: [f64; 3]) -> Vec<Complex> {
        let fields: Vec<_> = array.coils().iter().map(|coil| coil.expansion(centre_m)).collect();
        array.pairs().iter().map(|&[m, n]| self.change_h(&fields[m], &fields[n])).collect()
    }

    /// `tau c` for a real c.
    pub(crate) fn answer(&self, c: &[f64], out: &mut [Complex]) {
        out.fill(Complex::new(0.0, 0.0));
        for (row, column, value) in &self.entries {
            out[*row] += *value * c[*column];
        }
    }
}
