//! The contact under one press as a function of the distance from its centre.

use dermis_tomo::mesh::Point;

use super::law::{Conductance, cubic_at, hermite};
use super::pressure::{Field, OF_PRESS, Pressed};

/// Steps of the profile between the full pressure and the edge of the contact. Between them the conductance follows
/// Hermite's cubic, and its derivative by the pressure a straight line. With straight lines for the conductance,
/// the channels are so rough in the radius that fits end far from the best pressure.
const STEPS: usize = 128;

/// Conductance per area (S/m^2) under one press that overlaps no other, with its derivatives. It is tabulated
/// by the squared distance.
#[derive(Debug)]
pub(super) struct Profile {
    centre_m: Point,
    radius_m: f64,
    /// Squares of the distances between which the contact changes, and the number of steps per square metre.
    square_from: f64,
    square_to: f64,
    steps_per_m2: f64,
    steps: [Step; STEPS],
}

/// Contact between two distances from the centre.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Cubic of the conductance.
    conductance: [f64; 4],
    /// Derivative by the logarithm of the pressure at the inner distance, and its change over the step.
    by_log_pressure: [f64; 2],
}

impl Profile {
    /// The profile of a press that makes contact up to this distance from its centre, metres.
    pub fn new(press: &Pressed, field: &Field, contact_m: f64, conductance: &Conductance) -> Self {
        let (square_from, square_to) = (field.core_m().powi(2), contact_m.max(0.0).powi(2));
        let step_m2 = (square_to - square_from).max(0.0) / STEPS as f64;
        // Conductance, its change over one step outwards, and its derivative by the logarithm of the pressure.
        let knot = |k: usize| {
            let distance_m = (square_from + k as f64 * step_m2).sqrt();
            let (pressure_pa, outwards) = field.pressure_across(distance_m);
            let [conductance, by_pressure] = conductance.at(pressure_pa);
            ([conductance, by_pressure * outwards * step_m2 / (2.0 * distance_m)], by_pressure * pressure_pa)
        };
        let mut knots: [_; STEPS + 1] = std::array::from_fn(knot);
        if square_from == 0.0 {
            // A pressure with a tip in the middle has no slope by the squared distance there.
            knots[0].0[1] = knots[1].0[0] - knots[0].0[0];
        }
        let step = |k: usize| {
            let ((low, by_low), (high, by_high)) = (knots[k], knots[k + 1]);
            Step { conductance: hermite(low, high), by_log_pressure: [by_low, by_high - by_low] }
        };
        let steps = std::array::from_fn(step);
        let steps_per_m2 = step_m2.max(f64::MIN_POSITIVE).recip();
        Self {
            centre_m: press.position_m,
            radius_m: press.log_radius.exp(),
            square_from,
            square_to,
            steps_per_m2,
            steps,
        }
    }

    /// Conductance per area at a position, and its derivatives by the parameters of the press; `None` without contact.
    #[inline]
    pub fn at(&self, place_m: Point) -> Option<(f64, [f64; OF_PRESS])> {
        let off = [place_m[0] - self.centre_m[0], place_m[1] - self.centre_m[1]];
        let square = off[0] * off[0] + off[1] * off[1];
        if square <= self.square_from {
            let Step { conductance: [conductance, ..], by_log_pressure: [by_pressure, _] } = self.steps[0];
            return (conductance > 0.0).then_some((conductance, [0.0, 0.0, by_pressure, 0.0]));
        }
        if square >= self.square_to {
            return None;
        }
        let at = (square - self.square_from) * self.steps_per_m2;
        let k = (at as usize).min(STEPS - 1);
        let t = at - k as f64;
        let Step { conductance, by_log_pressure: [low, rise] } = &self.steps[k];
        let [conductance, slope] = cubic_at(conductance, t);
        let inwards = -2.0 * slope * self.steps_per_m2;
        let by_pressure = low + t * rise;
        // The pressure depends on the difference of radius and distance.
        let by_radius = inwards * square.sqrt() * self.radius_m;
        (conductance > 0.0).then_some((conductance, [inwards * off[0], inwards * off[1], by_pressure, by_radius]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plates::law::PlateLaw;

    #[test]
    fn the_contact_under_a_profile_is_that_of_its_pressure() {
        for (pressure_pa, exponent, radius_m) in
            [(4e3, 1.0, 8e-3), (1e5, 1.7, 8e-3), (1e6, 0.5, 12e-3), (3e4, 3.0, 1e-3)]
        {
            let law =
                PlateLaw { threshold_pa: 2e3, reference_pa: 9e3, exponent, saturation_s_per_m2: 50.0, spread_m: 1e-3 };
            let conductance = Conductance::new(law);
            let (log_pressure, log_radius) = (f64::ln(pressure_pa), f64::ln(radius_m));
            let press = Pressed { position_m: [1e-3, 0.0], log_pressure, log_radius, has_ended: false };
            let field = Field::new(&press, law.spread_m);
            let profile = Profile::new(&press, &field, field.reach_above_m(conductance.faint_pa()), &conductance);
            // x, y, pressure, radius, and the conductance itself.
            let (mut sums, mut exact_sums) = ([0.0; 1 + OF_PRESS], [0.0; 1 + OF_PRESS]);
            for k in (0..20_000).map(f64::from) {
                let place_m = [1e-3 + 6e-7 * k, 8e-7 * k];
                let [exact, slope] = conductance.at(field.pressure_at(place_m));
                let exact_by = field.derivatives_at(place_m).unwrap_or_default();
                let (near, by) = profile.at(place_m).unwrap_or_default();
                for j in 0..OF_PRESS {
                    sums[j] += k * by[j];
                    exact_sums[j] += k * slope * exact_by[j];
                }
                sums[OF_PRESS] += k * near;
                exact_sums[OF_PRESS] += k * exact;
            }
            for ((sum, exact), most) in sums.iter().zip(exact_sums).zip([0.01, 0.01, 0.1, 0.01, 0.01]) {
                assert!((sum / exact - 1.0).abs() < most, "{pressure_pa}: {sums:?} {exact_sums:?}");
            }
        }
    }
}
