//! The contact under one press as a function of the distance from its centre.

use dermis_tomo::mesh::Point;

use super::law::Conductance;
use super::pressure::{Field, OF_PRESS, Pressed};

/// Steps of the profile between the full pressure and the edge of the contact. With straight lines between them, the
/// sums of the conductance and of its derivatives under a press are off by at most 0.01 of themselves, those of the
/// derivative by the pressure by 0.1.
const STEPS: usize = 128;

/// Conductance per area (S/m^2) under one press that overlaps no other, with its derivative by the logarithm of the
/// pressure.
#[derive(Debug)]
pub(super) struct Profile {
    centre_m: Point,
    radius_m: f64,
    /// Distances from the centre between which the contact changes, and the number of steps per metre.
    from_m: f64,
    square_from: f64,
    square_to: f64,
    steps_per_m: f64,
    values: [[f64; 2]; STEPS + 1],
}

impl Profile {
    /// The profile of a press that makes contact up to this distance from its centre, metres.
    pub fn new(press: &Pressed, field: &Field, contact_m: f64, conductance: &Conductance) -> Self {
        let from_m = field.core_m();
        let step_m = (contact_m - from_m).max(0.0) / STEPS as f64;
        let value = |k: usize| {
            let pressure_pa = field.pressure_across(from_m + k as f64 * step_m);
            let [conductance, slope] = conductance.at(pressure_pa);
            [conductance, slope * pressure_pa]
        };
        Self {
            centre_m: press.position_m,
            radius_m: press.log_radius.exp(),
            from_m,
            square_from: from_m * from_m,
            square_to: contact_m.max(0.0).powi(2),
            steps_per_m: step_m.max(f64::MIN_POSITIVE).recip(),
            values: std::array::from_fn(value),
        }
    }

    /// Conductance per area at a position, and its derivatives by the parameters of the press; `None` without contact.
    #[inline]
    pub fn at(&self, place_m: Point) -> Option<(f64, [f64; OF_PRESS])> {
        let off = [place_m[0] - self.centre_m[0], place_m[1] - self.centre_m[1]];
        let square = off[0] * off[0] + off[1] * off[1];
        if square <= self.square_from {
            let [conductance, by_pressure] = self.values[0];
            return (conductance > 0.0).then_some((conductance, [0.0, 0.0, by_pressure, 0.0]));
        }
        if square >= self.square_to {
            return None;
        }
        let distance_m = square.sqrt();
        let at = (distance_m - self.from_m) * self.steps_per_m;
        let k = (at as usize).min(STEPS - 1);
        let share = at - k as f64;
        let ([low, low_by_pressure], [high, high_by_pressure]) = (self.values[k], self.values[k + 1]);
        let conductance = low + share * (high - low);
        let by_pressure = low_by_pressure + share * (high_by_pressure - low_by_pressure);
        // The pressure depends on the difference of radius and distance.
        let outwards = (high - low) * self.steps_per_m;
        let along = -outwards / distance_m.max(1e-9);
        let by = [along * off[0], along * off[1], by_pressure, -outwards * self.radius_m];
        (conductance > 0.0).then_some((conductance, by))
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
