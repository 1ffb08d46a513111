//! Decides which fitted patches are touches, and how strong they are.

use dermis_tomo::eit::contacts::{ContactFit, ContactPatch};
use dermis_tomo::mesh::PixelGrid;

use crate::prepare::Prepared;

/// A touch has at least this share of the strongest one's effect, and a position uncertainty of at most this share of
/// half the shorter side.
const LEAST_SHARE: f64 = 0.05;
const LEAST_CERTAIN: f64 = 0.1;

/// Distinguishes touches from other patches on one skin.
#[derive(Debug)]
pub(super) struct TouchRule {
    sheet_s: f64,
    grid: PixelGrid,
    inside: Vec<bool>,
    pub half_width_m: f64,
    pub smallest_amplitude: f64,
}

impl TouchRule {
    pub fn new(prepared: &Prepared) -> Self {
        Self {
            sheet_s: prepared.skin.sheet_conductance_s(),
            grid: *prepared.map.grid(),
            inside: prepared.map.inside_mask(),
            half_width_m: prepared.half_width_m(),
            smallest_amplitude: prepared.skin.touch.smallest_amplitude,
        }
    }

    /// The largest effect of these patches.
    pub fn strongest(&self, fits: &[ContactFit]) -> f64 {
        fits.iter().map(|fit| self.effect_m2(&fit.patch)).fold(f64::MIN_POSITIVE, f64::max)
    }

    /// Effect of a patch on a uniform current, expressed as the squared radius of a short circuit with the same
    /// effect: `r^2 I2(kr) / I0(kr)` with `k^2 = g / sheet conductance`. This follows from `lap v = k^2 v` within the
    /// patch; by symmetry, the layer above is at the mean potential of the patch's rim.
    pub fn effect_m2(&self, patch: &ContactPatch) -> f64 {
        let x = (patch.conductance_s_per_m2 / self.sheet_s).sqrt() * patch.radius_m;
        let [zeroth, second] = bessel_i0_i2(x);
        patch.radius_m * patch.radius_m * second / zeroth
    }

    /// True if a patch is a touch, given the strongest effect in the frame.
    pub fn is_touch(&self, fit: &ContactFit, strongest: f64) -> bool {
        let variance = fit.covariance[0][0] + fit.covariance[1][1];
        self.effect_m2(&fit.patch) >= LEAST_SHARE * strongest
            && variance.sqrt() <= LEAST_CERTAIN * self.half_width_m
            && self.grid.pixel_at(fit.patch.position_m).is_some_and(|pixel| self.inside[pixel])
    }
}

/// Modified Bessel functions I0 and I2, both divided by the leading growth of I0 for large arguments: only their
/// ratio matters.
fn bessel_i0_i2(x: f64) -> [f64; 2] {
    if x > 50.0 {
        // Hankel's expansion (Abramowitz and Stegun 9.7.1), to the second order.
        let by = |mu: f64| 1.0 - (mu - 1.0) / (8.0 * x) + (mu - 1.0) * (mu - 9.0) / (128.0 * x * x);
        return [by(0.0), by(16.0)];
    }
    // Power series (9.6.10).
    let quarter = 0.25 * x * x;
    let series = |first: f64, order: f64| {
        let (mut term, mut sum, mut k) = (first, first, 0.0);
        while term > 1e-17 * sum {
            k += 1.0;
            term *= quarter / (k * (k + order));
            sum += term;
        }
        sum
    };
    [series(1.0, 0.0), series(0.5 * quarter, 2.0)]
}

#[cfg(test)]
mod tests {
    use super::bessel_i0_i2;

    #[test]
    fn bessel_functions_are_those_of_the_tables() {
        // Abramowitz and Stegun, table 9.8: exp(-x) I0 and x^-2 I2 at 2 and 5.
        let [zeroth, second] = bessel_i0_i2(2.0);
        assert!((zeroth - 2.279_585_302_336_067).abs() < 1e-12 && (second - 0.688_948_447_698_738_2).abs() < 1e-12);
        let [zeroth, second] = bessel_i0_i2(5.0);
        assert!((zeroth - 27.239_871_823_604_44).abs() < 1e-10 && (second - 17.505_614_966_624_236).abs() < 1e-10);
        // Series and expansion agree where they meet.
        let ratio = |x: f64| bessel_i0_i2(x)[1] / bessel_i0_i2(x)[0];
        assert!((ratio(49.999) - ratio(50.001)).abs() < 1e-5, "{} {}", ratio(49.999), ratio(50.001));
        assert!(bessel_i0_i2(0.0)[1] == 0.0);
    }
}
