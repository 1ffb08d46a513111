//! The force of a press from the change it causes, by the law of a sheet or a liquid in the skin's file. Contacts with
//! plates have their force from their own fit.
//!
//! Under a spot ([`SpotShape`]), the conductance changes by `u Phi((R - d) / s)` at distance d. Channels respond to a
//! large change like a dipole `2 u / (2 + u)` (Jackson, Classical Electrodynamics, 1999, section 4.4, in the plane),
//! which gives u from the fitted amplitude. On a sheet, `ln (1 + du) = k p` with `k = c - G / E`; integrated over the
//! spot, the force is `F = 2 pi / k int ln (1 + u Phi((R - d) / s)) d dd`. Under a membrane, the dent is proportional
//! to the pressure, and u is its depth where it is deepest: `F = 2 pi r^2 p`, where p is the pressure of a Gaussian
//! load that makes a dent of that depth.
//!
//! A sheet that hardly conducts under the press, and a liquid pressed to its bottom, hardly respond to more force. The
//! law then gives the force at which that begins.

use std::f64::consts::PI;

use dermis_estimate::{BuiltVariance, Press};
use dermis_skin::{Layer, SheetLayer};
use dermis_tomo::inverse::SpotShape;
use dermis_touch::force::ForceReading;

use crate::prepare::Prepared;

/// Error of the law as a share of the response, on twins pressed by discs with 0.3 to 3 times the usual force: twelve
/// gels and foams, and six liquids.
const SHEET_SHARE: f64 = 0.013;
const MEMBRANE_SHARE: f64 = 0.01;
/// Number of steps of the integral across the edge of a spot. Simpson's rule is then accurate to 1e-5 for changes of up
/// to 95 %.
const STEPS: usize = 64;
/// The law holds for responses of the channels in this range: of relative changes u from -0.95 to 3.7.
const RESPONSES: [f64; 2] = [-1.81, 1.3];
/// The steepness of the law is the difference quotient over this share of the response.
const STEP: f64 = 0.01;

/// Converts presses to forces on one skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ForceLaw {
    /// Change of the logarithm of the conductance per pressure, 1/Pa, and the smoothing of edges, metres.
    Sheet { per_pa: f64, smoothing_m: f64 },
    /// Pressure of a load of amplitude 1, pascal.
    Membrane { pressure_pa: f64 },
}

/// Change of the logarithm of a sheet's conductance per pressure, 1/Pa.
fn sheet_per_pa(layer: &SheetLayer) -> f64 {
    1e-5 * layer.pressure_percent_per_kpa - 1e-3 * layer.gauge_factor / layer.modulus_kpa
}

impl ForceLaw {
    /// The law of a skin whose layer states one. `membrane_pa` is the pressure of a load of amplitude 1 on a
    /// membrane.
    pub fn of(prepared: &Prepared, membrane_pa: Option<f64>) -> Option<Self> {
        match &prepared.skin.frontend.layer {
            Layer::Sheet(layer) => {
                let per_pa = sheet_per_pa(layer);
                (per_pa != 0.0).then_some(Self::Sheet { per_pa, smoothing_m: 1e-3 * layer.spread_mm() })
            }
            Layer::Liquid(_) => membrane_pa.map(|pressure_pa| Self::Membrane { pressure_pa }),
            Layer::Sandwich(_) | Layer::Patches(_) | Layer::Elements(_) => None,
        }
    }

    /// The force; `None` if the press changes the skin in a way that the law excludes. `largest` is the depth of the
    /// dent that such a press makes in a liquid per unit of load. `built` are the errors of a skin that is not as drawn.
    pub fn read(&self, press: &Press, largest: f64, polarity: f64, built: &BuiltVariance) -> Option<ForceReading> {
        let largest = match self {
            Self::Membrane { .. } => largest,
            Self::Sheet { smoothing_m, .. } => disc(press.radius_m, *smoothing_m).height(),
        };
        let response = polarity * press.load * largest;
        let bounded = response.clamp(RESPONSES[0], RESPONSES[1]);
        let force_n = self.force_n(press.radius_m, bounded, largest);
        if !(force_n > 0.0 && force_n.is_finite()) {
            return None;
        }
        if bounded != response {
            return Some(ForceReading::Saturated { from_n: force_n });
        }
        // The nearer the press is to saturation, the more an error of the response changes the force.
        let less_n = self.force_n(press.radius_m, (1.0 - STEP) * bounded, largest);
        let steepness = ((1.0 - less_n / force_n) / STEP).max(1.0);
        let of_response = press.significance().recip().hypot(self.share()).hypot(built.gain.sqrt());
        let share = (steepness * of_response).hypot(built.law.sqrt());
        Some(ForceReading::FromLaw { force_n, sigma_n: share * force_n })
    }

    /// Error of the law as a share of the response.
    fn share(&self) -> f64 {
        if matches!(self, Self::Sheet { .. }) { SHEET_SHARE } else { MEMBRANE_SHARE }
    }

    /// Force from the response of the channels to the largest change, newtons.
    fn force_n(&self, radius_m: f64, response: f64, largest: f64) -> f64 {
        let change = response / (1.0 - 0.5 * response);
        match self {
            Self::Sheet { per_pa, smoothing_m } => logarithms(change, &disc(radius_m, *smoothing_m)) / per_pa,
            // The channels respond to the dent. A narrow load dents a membrane less than its amplitude suggests.
            Self::Membrane { pressure_pa } => -2.0 * PI * radius_m * radius_m * change / largest * pressure_pa,
        }
    }
}

fn disc(radius_m: f64, smoothing_m: f64) -> SpotShape {
    SpotShape::new(radius_m, Some(smoothing_m))
}

/// Integral of `ln (1 + u t)` over a spot, m^2, where t is its shape, 1 in the middle.
fn logarithms(u: f64, shape: &SpotShape) -> f64 {
    let [core_m, reach_m] = shape.edges_m();
    let at = |d: f64| d * (u * shape.at(d * d) / shape.height()).ln_1p();
    let step = (reach_m - core_m) / STEPS as f64;
    let inner = |k: usize| at(core_m + k as f64 * step) * if k.is_multiple_of(2) { 2.0 } else { 4.0 };
    let edge = (at(core_m) + (1..STEPS).map(inner).sum::<f64>() + at(reach_m)) * step / 3.0;
    2.0 * PI * (0.5 * core_m * core_m * u.ln_1p() + edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    const AS_DRAWN: BuiltVariance = BuiltVariance { gain: 0.0, law: 0.0 };

    #[test]
    fn logarithms_are_integrated_over_the_spot() {
        // By SciPy: 4,000 steps of the trapezoidal rule.
        let shape = disc(4.317_294_761e-3, 2.5e-3);
        for (u, integral_m2) in [(38.0, 1.046_38e-3), (2.0, 2.142_985e-4)] {
            let found_m2 = logarithms(u, &shape);
            assert!((found_m2 / integral_m2 - 1.0).abs() < 1e-3, "{found_m2}");
        }
    }

    #[test]
    fn the_integral_over_a_gaussian_is_the_dilogarithm() {
        // Abramowitz and Stegun 27.7: Li2(1/2) = pi^2 / 12 - ln^2 2 / 2, and Li2(-1) = -pi^2 / 12. The Gaussian ends
        // where it is 6e-6.
        let half = PI * PI / 12.0 - 0.5 * 2.0_f64.ln().powi(2);
        let of = |u: f64| logarithms(u, &SpotShape::new(5e-3, None)) / (2.0 * PI * 25e-6);
        assert!((of(-0.5) + half).abs() < 1e-5 && (of(1.0) - PI * PI / 12.0).abs() < 1e-5);
    }

    #[test]
    fn a_weak_press_has_the_force_that_its_change_integrates_to() {
        let press = Press { radius_m: 5e-3, load: 1e-4, ..Press::default() };
        // A gel of 60 kPa: du = -p / E over the spot.
        let gel = ForceLaw::Sheet { per_pa: -1.0 / 60e3, smoothing_m: 2e-3 };
        let force_n = gel.read(&press, 1.0, -1.0, &AS_DRAWN).and_then(ForceReading::nearest_n).unwrap();
        assert!((force_n / (2.0 * PI * 25e-6 * 1e-4 * 60e3) - 1.0).abs() < 2e-3, "{force_n}");
        assert!(gel.read(&press, 1.0, 1.0, &AS_DRAWN).is_none());
    }

    #[test]
    fn a_press_that_saturates_the_skin_has_the_least_force_that_does() {
        let gel = ForceLaw::Sheet { per_pa: -1.0 / 60e3, smoothing_m: 2e-3 };
        let read =
            |load: f64| gel.read(&Press { radius_m: 5e-3, load, ..Press::default() }, 1.0, -1.0, &AS_DRAWN).unwrap();
        let ForceReading::Saturated { from_n } = read(4.0) else { panic!("saturated") };
        assert_eq!(read(40.0), ForceReading::Saturated { from_n });
        let ForceReading::FromLaw { force_n, sigma_n } = read(1.8) else { panic!("by the law") };
        assert!(force_n < from_n && sigma_n > SHEET_SHARE * force_n);
    }
}
