//! A conducting, permeable sphere in an alternating field: its response to each degree, in closed form (Smythe,
//! Static and Dynamic Electricity, 3rd ed., 10.12; extended here to every degree).
//!
//! Outside, the toroidal potential of degree l is `r^l + T_l r^-(l+1)`. With `x = k a`, `k^2 = j w mu sigma` and
//! `L = 1 + x i_l'(x)/i_l(x)` (i_l is the modified spherical Bessel function), continuity of the tangential fields
//! gives `T_l = a^(2l+1) ((l + 1) - L/mu_r) / (l + L/mu_r)`; without permeability it is
//! `-a^(2l+1) i_(l+1)(x)/i_(l-1)(x)`.

use std::f64::consts::PI;

use crate::constants::MU0;
use crate::error::{MitError, frequency, positive};
use crate::vector::Complex;

/// A homogeneous sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Radius, metres.
    pub radius_m: f64,
    /// Conductivity, S/m.
    pub conductivity_s_per_m: f64,
    /// Relative permeability.
    pub relative_permeability: f64,
}

/// Depth at which a field in a good conductor has fallen to 1/e, metres: `sqrt(2 / (w mu sigma))`.
///
/// # Errors
/// A frequency outside 1 Hz to 1 MHz, or a conductivity or permeability that is not positive.
pub fn skin_depth_m(conductivity_s_per_m: f64, relative_permeability: f64, frequency_hz: f64) -> Result<f64, MitError> {
    frequency(frequency_hz)?;
    positive("conductivity_s_per_m", conductivity_s_per_m)?;
    positive("relative_permeability", relative_permeability)?;
    Ok((PI * frequency_hz * MU0 * relative_permeability * conductivity_s_per_m).powf(-0.5))
}

impl Sphere {
    /// `T_l` for degrees 1 to `degree`, m^(2l+1).
    ///
    /// # Errors
    /// A radius, conductivity or permeability that is not positive, or a frequency outside 1 Hz to 1 MHz.
    pub fn responses(&self, frequency_hz: f64, degree: usize) -> Result<Vec<Complex>, MitError> {
        positive("radius_m", self.radius_m)?;
        let depth = skin_depth_m(self.conductivity_s_per_m, self.relative_permeability, frequency_hz)?;
        // k = (1 + j) / depth.
        let x = Complex::new(1.0, 1.0) * (self.radius_m / depth);
        let ratios = bessel_ratios(x, degree + 1);
        let of_degree = |l: usize| {
            let scale = self.radius_m.powi(2 * l as i32 + 1);
            if self.relative_permeability == 1.0 {
                return -(ratios[l] * ratios[l + 1]) * scale;
            }
            let (over, l) = (x / ratios[l], l as f64);
            // x i_(l-1)/i_l - l.
            let derivative = (over - l) / self.relative_permeability;
            (-derivative + (l + 1.0)) / (derivative + l) * scale
        };
        Ok((1..=degree).map(of_degree).collect())
    }

    /// Magnetic polarizability alpha, m^3: `m = alpha H0`, `alpha = 2 pi T_1`.
    ///
    /// # Errors
    /// As [`Sphere::responses`].
    pub fn polarizability_m3(&self, frequency_hz: f64) -> Result<Complex, MitError> {
        Ok(self.responses(frequency_hz, 1)?[0] * (2.0 * PI))
    }
}

/// Real part of the argument above which `coth x` is 1 in double precision, by a wide margin.
const FAR: f64 = 200.0;

/// `i_l(x)/i_(l-1)(x)` for l = 1 to `most` (index 0 is unused), by the recurrence `i_(l-1) - i_(l+1) = (2l+1)/x i_l`
/// downward from far above, where the start value is forgotten.
fn bessel_ratios(x: Complex, most: usize) -> Vec<Complex> {
    if x.re > FAR {
        // For arguments far beyond the degrees, coth x is 1 and the recurrence is stable upward: the same work for
        // any size.
        let mut ratios = vec![Complex::new(0.0, 0.0); most + 1];
        for l in 1..=most {
            ratios[l] = if l == 1 {
                Complex::new(1.0, 0.0) - Complex::new(1.0, 0.0) / x
            } else {
                Complex::new(1.0, 0.0) / ratios[l - 1] - Complex::new(2.0 * l as f64 - 1.0, 0.0) / x
            };
        }
        return ratios;
    }
    let start = most + 30 + (2.0 * x.norm()) as usize;
    let mut ratios = vec![Complex::new(0.0, 0.0); most + 1];
    let mut ratio = x / (2.0 * start as f64 + 1.0);
    for l in (1..start).rev() {
        ratio = Complex::new(1.0, 0.0) / (Complex::new(2.0 * l as f64 + 1.0, 0.0) / x + ratio);
        if l <= most {
            ratios[l] = ratio;
        }
    }
    ratios
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_recurrences_agree_and_a_huge_sphere_takes_no_time() {
        let (near, far) = (Complex::new(0.999 * FAR, 0.999 * FAR), Complex::new(1.001 * FAR, 1.001 * FAR));
        let (below, above) = (bessel_ratios(near, 8), bessel_ratios(far, 8));
        // Between the two, the ratios change by less than 1e-5 of themselves.
        below[1..].iter().zip(&above[1..]).for_each(|(a, b)| assert!((a - b).norm() < 1e-3, "{a} {b}"));
        let recurred = |l: usize| {
            let l = l as f64;
            Complex::new(1.0, 0.0) / (Complex::new(2.0 * l + 1.0, 0.0) / far + above[l as usize + 1])
        };
        (1..8).for_each(|l| assert!((recurred(l) - above[l]).norm() < 1e-12, "{l}"));
        let sphere = Sphere { radius_m: 1e5, conductivity_s_per_m: 6e7, relative_permeability: 1.0 };
        let [response] = sphere.responses(1e6, 1).unwrap()[..] else { panic!("one degree") };
        // The response of a perfect conductor is minus its radius cubed.
        assert!((response / -1e15 - 1.0).norm() < 1e-6, "{response}");
    }
}
