//! A press as reported: load, extent and force of its contact.

use std::f64::consts::PI;

use dermis_tomo::normal::{normal, normal_exactly};

use super::law::Conductance;
use super::pressure::{Field, Pressed};

/// Number of rings over which a contact is integrated where its pressure changes.
const RINGS: usize = 24;
/// Bisections for the radius of a contact: to a millionth of it.
const HALVINGS: usize = 20;

impl Conductance {
    /// Logarithms of the load and the radius of a press as reported: those of a Gaussian spot of the same conductance
    /// and second moment. Frames determine the conductance far better than pressure and size of the indenter. The
    /// derivatives have a row for each of them, and columns for the logarithms of pressure and radius.
    pub(super) fn reported(&self, log_pressure: f64, log_radius: f64) -> ([f64; 2], [[f64; 2]; 2]) {
        let (pressure_pa, disc_m, spread_m) = (log_pressure.exp(), log_radius.exp(), self.law().spread_m);
        let edge_m = Field::REACH * spread_m;
        let (core_m, reach_m) = ((disc_m - edge_m).max(0.0), disc_m + edge_m);
        // Rings move outwards with the edge of the disc, or widen if it has no core.
        let core_moved_m = if core_m > 0.0 { disc_m } else { 0.0 };
        let (width_m, widened_m) = ((reach_m - core_m) / RINGS as f64, (disc_m - core_moved_m) / RINGS as f64);
        // The conductance and its second moment over pi, each followed by its derivatives by both logarithms.
        let [g, slope] = self.at(pressure_pa);
        let core = [0.5 * core_m * g, 0.5 * core_m * slope * pressure_pa, core_moved_m * g].map(|value| core_m * value);
        let square = 0.5 * core_m * core_m;
        let mut total = [f64::MIN_POSITIVE + core[0], core[1], core[2]];
        let mut second = [square * core[0], square * core[1], 2.0 * square * core[2]];
        for k in 0..RINGS {
            let place = k as f64 + 0.5;
            let (at_m, moved_m) = (core_m + place * width_m, core_moved_m + place * widened_m);
            let [share, density] = normal((disc_m - at_m) / spread_m);
            let [g, slope] = self.at(pressure_pa * share);
            if g == 0.0 {
                continue;
            }
            let by_pressure = slope * pressure_pa * share;
            let by_radius = slope * pressure_pa * density * (disc_m - moved_m) / spread_m;
            let area = at_m * width_m;
            let area_moved = moved_m * width_m + at_m * widened_m;
            let ring = [area * g, area * by_pressure, area * by_radius + area_moved * g];
            let square = at_m * at_m;
            let ring_square = [square * ring[0], square * ring[1], square * ring[2] + 2.0 * at_m * moved_m * ring[0]];
            for j in 0..3 {
                total[j] += ring[j];
                second[j] += ring_square[j];
            }
        }
        // A spot exp(-d^2 / (2 r^2)) has the second moment 2 r^2 and the integral 2 pi r^2.
        let square = (0.5 * second[0] / total[0]).max(f64::MIN_POSITIVE);
        let load = total[0] / (square * self.law().saturation_s_per_m2);
        let relative = |sums: [f64; 3], j: usize| if sums[0] > 0.0 { sums[j] / sums[0] } else { 0.0 };
        let of_square = [1, 2].map(|j| relative(second, j) - relative(total, j));
        let of_load = [1, 2].map(|j| relative(total, j) - of_square[j - 1]);
        ([load.ln(), 0.5 * square.ln()], [of_load, of_square.map(|slope| 0.5 * slope)])
    }

    /// Force under a press, newtons: the integral of its pressure, `p pi ((R^2 + s^2) Phi(R/s) + R s phi(R/s))` with
    /// the normal distribution Phi and its density phi.
    pub(super) fn force_n(&self, press: &Pressed) -> f64 {
        let (radius_m, spread_m) = (press.log_radius.exp(), self.law().spread_m);
        let [below, density] = normal_exactly(radius_m / spread_m);
        let area_m2 = PI * ((radius_m * radius_m + spread_m * spread_m) * below + radius_m * spread_m * density);
        press.log_pressure.exp() * area_m2
    }

    /// Radius at which the contact under a press is half that in its middle, metres.
    pub(super) fn contact_radius_m(&self, press: &Pressed) -> f64 {
        let field = Field::new(press, self.law().spread_m);
        let middle_pa = field.pressure_at(press.position_m);
        let half = 0.5 * self.at(middle_pa)[0];
        let at = |distance_m: f64| field.pressure_at([press.position_m[0] + distance_m, press.position_m[1]]);
        let is_more = |distance_m: f64| self.at(at(distance_m))[0] > half;
        let (mut low, mut high) = (0.0, field.reach_m());
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if is_more(middle) { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plates::law::PlateLaw;

    /// A law that is saturated at the pressures of these tests.
    fn saturated(spread_m: f64) -> Conductance {
        let law =
            PlateLaw { threshold_pa: 10.0, reference_pa: 1.0, exponent: 3.0, saturation_s_per_m2: 50.0, spread_m };
        Conductance::new(law)
    }

    #[test]
    fn a_saturated_disc_is_reported_as_a_spot_of_its_conductance_and_extent() {
        // A disc of radius R has the second moment R^2 / 2, so r = R / 2, and the conductance pi R^2 = load 2 pi r^2.
        // The sharp edge is where the pressure closes the gap: for 1e6 Pa, 4.26 spreads beyond R.
        let (radius_m, spread_m) = (8e-3, 2e-5);
        let ([log_load, log_radius], _) = saturated(spread_m).reported(1e6_f64.ln(), f64::ln(radius_m));
        let edge_m = radius_m + 4.26 * spread_m;
        assert!((log_radius.exp() / (0.5 * edge_m) - 1.0).abs() < 1e-3, "{}", log_radius.exp());
        assert!((log_load.exp() - 2.0).abs() < 1e-3, "{}", log_load.exp());
    }

    #[test]
    fn derivatives_of_a_reported_press_are_those_of_differences() {
        let law = PlateLaw {
            threshold_pa: 3e3,
            reference_pa: 6e4,
            exponent: 1.5,
            saturation_s_per_m2: 1500.0,
            spread_m: 1e-3,
        };
        let conductance = Conductance::new(law);
        // With a disc of full pressure in the middle, and without.
        for (pressure_pa, radius_m) in [(8e4, 12e-3), (8e4, 4e-3), (1e6, 8e-3)] {
            let (log_pressure, log_radius) = (f64::ln(pressure_pa), f64::ln(radius_m));
            let (_, by) = conductance.reported(log_pressure, log_radius);
            for k in 0..2 {
                let h = 1e-3;
                let at = |sign: f64| {
                    let moved = [0, 1].map(|j| if j == k { sign * h } else { 0.0 });
                    conductance.reported(log_pressure + moved[0], log_radius + moved[1]).0
                };
                let (high, low) = (at(1.0), at(-1.0));
                for row in 0..2 {
                    let difference = (high[row] - low[row]) / (2.0 * h);
                    // Contact below 0.01 of the saturated one is left out, ring by ring.
                    assert!((difference - by[row][k]).abs() < 0.02, "{row} {k}: {difference} {}", by[row][k]);
                }
            }
        }
    }
}
