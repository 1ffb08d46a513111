//! The contact between two conductive layers separated by an air gap. Conductance per area as a function of pressure:
//! `g(p) = 0` for `p <= p_t`, otherwise `g_max x / (1 + x)` with `x = ((p - p_t) / p_ref)^n`. Below `p_t` the gap is
//! open. Above it the real area of contact grows with load as a power law (n near 1 for elastic rough surfaces,
//! Greenwood and Williamson 1966; above 1 while the gap still closes from the middle outwards) until everything
//! touches.

use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};

/// Contact conductance per area as a function of pressure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContactLaw {
    /// p_t: pressure that closes the air gap, pascals.
    pub threshold_pa: f64,
    /// p_ref: pressure above the threshold at half the saturated conductance, pascals.
    pub reference_pa: f64,
    /// n: exponent of the power law.
    pub exponent: f64,
    /// g_max: conductance per area at saturation, S/m^2.
    pub saturation_s_per_m2: f64,
}

impl ContactLaw {
    /// g(p) in S/m^2 for a pressure in pascals.
    pub fn conductance_s_per_m2(&self, pressure_pa: f64) -> f64 {
        let above = pressure_pa - self.threshold_pa;
        if above <= 0.0 {
            return 0.0;
        }
        let ratio = (above / self.reference_pa).powf(self.exponent);
        // Equal to x/(1+x), but finite if x is not.
        self.saturation_s_per_m2 / (1.0 + 1.0 / ratio)
    }

    /// Checks the parameters.
    ///
    /// # Errors
    /// A negative threshold, or any other parameter that is not positive and finite.
    pub fn check(&self) -> Result<(), TwinError> {
        check("contact threshold_pa", self.threshold_pa, 0.0, f64::MAX, "zero or more, finite")?;
        check_positive("contact reference_pa", self.reference_pa)?;
        check_positive("contact exponent", self.exponent)?;
        check_positive("contact saturation_s_per_m2", self.saturation_s_per_m2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAW: ContactLaw =
        ContactLaw { threshold_pa: 3e3, reference_pa: 60e3, exponent: 1.5, saturation_s_per_m2: 1500.0 };

    #[test]
    fn gap_opens_then_grows_then_saturates() {
        let law = LAW;
        assert_eq!(law.conductance_s_per_m2(law.threshold_pa), 0.0);
        let half = law.conductance_s_per_m2(law.threshold_pa + law.reference_pa);
        assert!((half - 750.0).abs() < 1e-9, "{half}");
        let values: Vec<f64> = (0..200).map(|k| law.conductance_s_per_m2(1e3 * f64::from(k))).collect();
        assert!(values.windows(2).all(|pair| pair[1] >= pair[0]));
        assert!((law.conductance_s_per_m2(1e300) - 1500.0).abs() < 1e-9);
    }

    #[test]
    fn bad_input_is_refused_by_name() {
        let error = ContactLaw { exponent: f64::NAN, ..LAW }.check().unwrap_err();
        assert_eq!(error.to_string(), "contact exponent: NaN refused; expected positive and finite");
    }
}
