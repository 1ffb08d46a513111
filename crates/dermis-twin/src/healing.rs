//! What happens to a self-healing sheet in the course of its life: blades cut it, a heat pad closes cuts and raises the
//! conductivity about them, which falls back over two days, and the room warms it as a whole.
//!
//! A point at temperature `T` heals at the rate `r(T) = exp(-(E/R) (1/T - 1/363 K)) / 2 h`; its dose `q`, the integral of
//! `r` held at 1, is the share of the cut's faces that is joined again. A cut of width `w` conducts
//! `d = (1 - q) d_open + q d_healed` of the sheet, with `1/d_healed = 1 + l/w` and `l` the length of intact sheet that a
//! healed scar is worth. Heat raises the conductivity to `1 + q_h p` (`q_h`: dose of that heating); afterwards it is
//! `1 + q_h (k + (p - k) exp(-t / tau))`.
//!
//! From paper H (Chen, Wang et al., Fig. 5): 90 C for 2 h heal; the intact bar of 100 mm goes from 2.01 to 1.92 kohm, hence
//! `k`; the bar that was cut goes from 2.07 to 2.15 kohm, which with the same `k` makes `l` 8.7 mm; conductivity is
//! stable after 48 h. Assumed: the activation energy `E` (90 kJ/mol, usual for reversing Diels-Alder bonds), the rise `p`
//! at the end of the heating (the paper says only "significantly"), `tau` = 12 h, so that 2 % of it is left after 48 h,
//! and how far warmth reaches beyond the pad's rim.

use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};
use crate::physics::Cut;

/// Temperature and time that heal a cut entirely.
const HEALING_C: f64 = 90.0;
const HEALING_S: f64 = 7200.0;
/// Of the room.
const ROOM_C: f64 = 25.0;
const ZERO_C_IN_K: f64 = 273.15;
/// E/R in kelvin for E = 90 kJ/mol.
const ACTIVATION_K: f64 = 90e3 / 8.314;
/// p: rise of conductivity at the end of a full heating.
const PEAK_RISE: f64 = 0.3;
/// k: what stays of it, from the intact bar.
const LASTING_RISE: f64 = 2010.0 / 1920.0 - 1.0;
/// tau.
const RELAXATION_S: f64 = 12.0 * 3600.0;
/// l: the healed bar in excess of what heat alone would have made of it, as length of a bar of 100 mm.
const SCAR_M: f64 = 0.1 * (2150.0 * (1.0 + LASTING_RISE) / 2070.0 - 1.0);
/// Warmth falls from all to nothing over this distance across the pad's rim.
const RIM_M: f64 = 4e-3;
/// Cuts heal in pieces of this length at most, each by its own temperature.
const PIECE_M: f64 = 1e-3;

/// A heat pad laid on the skin for a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heating {
    /// Middle of the pad, metres.
    pub centre_m: [f64; 2],
    /// Its radius, metres.
    pub radius_m: f64,
    /// Its temperature, degrees Celsius.
    pub temperature_c: f64,
    /// How long it stays, seconds.
    pub duration_s: f64,
}

impl Heating {
    /// As published: 90 C for two hours.
    pub fn published(centre_m: [f64; 2], radius_m: f64) -> Self {
        Self { centre_m, radius_m, temperature_c: HEALING_C, duration_s: HEALING_S }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// A pad without place or size, a temperature outside 0 to 150 C, a time that is not positive and finite.
    pub fn check(&self) -> Result<(), TwinError> {
        for value in self.centre_m {
            check("heat pad's centre, m", value, -1e3, 1e3, "a position in metres")?;
        }
        check_positive("heat pad's radius_m", self.radius_m)?;
        check("heat pad's temperature_c", self.temperature_c, 0.0, 150.0, "0 to 150 degrees Celsius")?;
        check_positive("heat pad's duration_s", self.duration_s)
    }

    /// Rate of the dose at a point under or beside the pad, 1/s.
    fn rate_at(&self, point: [f64; 2]) -> f64 {
        let distance = (point[0] - self.centre_m[0]).hypot(point[1] - self.centre_m[1]);
        let x = (0.5 + (self.radius_m - distance) / RIM_M).clamp(0.0, 1.0);
        let kelvin = |celsius: f64| celsius + ZERO_C_IN_K;
        let temperature = kelvin(ROOM_C + (self.temperature_c - ROOM_C) * x * x * (3.0 - 2.0 * x));
        (-ACTIVATION_K * (1.0 / temperature - 1.0 / kelvin(HEALING_C))).exp() / HEALING_S
    }
}

/// Something done to a sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Treatment {
    /// A blade cuts it.
    Cut(Cut),
    /// A heat pad is laid on it.
    Heat(Heating),
    /// Cuts, heat and their aftermath go this many times as fast as the frames from now on; touches do not.
    TimeLapse(f64),
    /// Its conductivity as a whole rises by this share a second from now on (the room grows warmer); 0 holds it.
    Warm(f64),
    /// A new sheet is put in.
    Renew,
}

impl Treatment {
    /// Checks the numbers.
    ///
    /// # Errors
    /// As [`Cut::check`] and [`Heating::check`]; factors and rates out of range.
    pub fn check(&self) -> Result<(), TwinError> {
        match self {
            Self::Cut(cut) => cut.check(),
            Self::Heat(heating) => heating.check(),
            Self::TimeLapse(factor) => check("time-lapse", *factor, 0.0, 1e6, "0 to 1e6 times as fast"),
            Self::Warm(rate) => check("warming, share/s", *rate, -0.01, 0.01, "-0.01 to 0.01 a second"),
            Self::Renew => Ok(()),
        }
    }
}

/// A cut with what has become of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wound {
    /// As it was cut.
    pub cut: Cut,
    /// Share of its faces that is joined again, 0 to 1.
    pub healed: f64,
}

#[derive(Clone, Debug)]
struct Laceration {
    cut: Cut,
    /// One value for each of its pieces.
    doses: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Pad {
    heating: Heating,
    age_s: f64,
}

/// The state of one sheet.
#[derive(Clone, Debug)]
pub struct Wear {
    cuts: Vec<Laceration>,
    pads: Vec<Pad>,
    time_lapse: f64,
    warming_per_s: f64,
    warmth: f64,
}

impl Default for Wear {
    fn default() -> Self {
        Self { cuts: Vec::new(), pads: Vec::new(), time_lapse: 1.0, warming_per_s: 0.0, warmth: 1.0 }
    }
}

impl Wear {
    /// Does something to the sheet.
    ///
    /// # Errors
    /// Numbers that make no sense.
    pub fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        treatment.check()?;
        match *treatment {
            Treatment::Cut(cut) => {
                let pieces = ((cut.length_m() / PIECE_M).ceil() as usize).clamp(1, 1000);
                self.cuts.push(Laceration { cut, doses: vec![0.0; pieces] });
            }
            Treatment::Heat(heating) => self.pads.push(Pad { heating, age_s: 0.0 }),
            Treatment::TimeLapse(factor) => self.time_lapse = factor,
            Treatment::Warm(share_per_s) => self.warming_per_s = share_per_s,
            Treatment::Renew => *self = Self { time_lapse: self.time_lapse, ..Self::default() },
        }
        Ok(())
    }

    /// Lets `dt_s` of the frames' time pass; true where the sheet has changed.
    pub fn advance(&mut self, dt_s: f64) -> bool {
        let before = self.warmth;
        // Nothing grows without end.
        self.warmth = (self.warmth * (1.0 + self.warming_per_s * dt_s)).clamp(0.1, 10.0);
        let passed = dt_s * self.time_lapse;
        let mut changed = self.warmth != before;
        if passed <= 0.0 {
            return changed;
        }
        for pad in &mut self.pads {
            let heated = (pad.heating.duration_s - pad.age_s).clamp(0.0, passed);
            pad.age_s += passed;
            changed |= heated > 0.0 || pad.age_s < pad.heating.duration_s + 20.0 * RELAXATION_S;
            for wound in &mut self.cuts {
                let Laceration { cut, doses } = wound;
                let count = doses.len();
                for (index, dose) in doses.iter_mut().enumerate() {
                    let middle = cut.at((index as f64 + 0.5) / count as f64);
                    *dose = (*dose + heated * pad.heating.rate_at(middle)).min(1.0);
                }
            }
        }
        changed
    }

    /// Conductivity at a point as a share of the new sheet's, cuts left aside.
    pub fn share_at(&self, point: [f64; 2]) -> f64 {
        let (mut passing, mut lasting) = (0.0, 0.0_f64);
        for Pad { heating, age_s } in &self.pads {
            let dose = (heating.rate_at(point) * age_s.min(heating.duration_s)).min(1.0);
            let since = age_s - heating.duration_s;
            let left = if since > 0.0 { (-since / RELAXATION_S).exp() } else { 1.0 };
            passing += dose * (PEAK_RISE - LASTING_RISE) * left;
            // What is healed through cannot gain the same again.
            lasting = lasting.max(dose * LASTING_RISE);
        }
        self.warmth * (1.0 + passing + lasting)
    }

    /// The cuts as they conduct now, each in equal pieces from end to end.
    pub fn cuts(&self) -> impl Iterator<Item = Vec<Cut>> + '_ {
        self.cuts.iter().map(|Laceration { cut, doses }| {
            let count = doses.len() as f64;
            let healed = cut.width_m / (cut.width_m + SCAR_M);
            let piece = |(index, dose): (usize, &f64)| Cut {
                from_m: cut.at(index as f64 / count),
                to_m: cut.at((index + 1) as f64 / count),
                residual: cut.residual + dose * (healed - cut.residual).max(0.0),
                ..*cut
            };
            doses.iter().enumerate().map(piece).collect()
        })
    }

    /// The cuts as they were made, and how far they have healed.
    pub fn wounds(&self) -> impl Iterator<Item = Wound> + '_ {
        self.cuts.iter().map(|Laceration { cut, doses }| {
            let healed = doses.iter().sum::<f64>() / doses.len() as f64;
            Wound { cut: *cut, healed }
        })
    }
}

/// A treatment and when it is given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedTreatment {
    /// Seconds after the first frame.
    pub at_s: f64,
    /// What is done.
    pub treatment: Treatment,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Resistance of a bar of 100 x 10 mm that had `new_ohm`, with a cut across its middle or not, after what was done.
    fn bar_ohm(wear: &Wear, new_ohm: f64) -> f64 {
        let per_m = new_ohm / 0.1 / wear.share_at([0.0; 2]);
        let scars: f64 = wear.cuts().flatten().take(1).map(|cut| cut.width_m * (1.0 / cut.residual - 1.0)).sum();
        per_m * (0.1 + scars)
    }

    fn healed_for(hours: f64, cut: bool) -> Wear {
        let mut wear = Wear::default();
        if cut {
            wear.treat(&Treatment::Cut(Cut::open([0.0, -0.005], [0.0, 0.005]))).unwrap();
        }
        wear.treat(&Treatment::Heat(Heating::published([0.0; 2], 0.03))).unwrap();
        (0..100).for_each(|_| {
            wear.advance(hours * 36.0);
        });
        wear
    }

    #[test]
    fn bars_end_at_the_published_resistances() {
        // 48 h after the heating the relaxation has 1.8 % of its way to go: 0.26 x 0.018 = 0.5 % of the resistance.
        let (intact, cut) = (healed_for(50.0, false), healed_for(50.0, true));
        assert!((bar_ohm(&intact, 2010.0) - 1920.0).abs() < 0.006 * 1920.0, "{}", bar_ohm(&intact, 2010.0));
        assert!((bar_ohm(&cut, 2070.0) - 2150.0).abs() < 0.006 * 2150.0, "{}", bar_ohm(&cut, 2070.0));
        let (intact, cut) = (healed_for(500.0, false), healed_for(500.0, true));
        assert!((bar_ohm(&intact, 2010.0) - 1920.0).abs() < 1e-6 && (bar_ohm(&cut, 2070.0) - 2150.0).abs() < 0.05);
    }

    #[test]
    fn conductivity_rises_while_heated_and_falls_after() {
        let share = |hours: f64| healed_for(hours, false).share_at([0.0; 2]);
        assert!((share(2.0) - 1.3).abs() < 1e-9);
        let course = [1.0, 2.0, 6.0, 24.0, 50.0].map(share);
        assert!(course[0] < course[1] && course[1..].windows(2).all(|pair| pair[1] < pair[0]), "{course:?}");
        assert!(course[4] > 1.0 + LASTING_RISE);
    }

    #[test]
    fn what_lies_outside_the_pad_or_stays_cool_does_not_heal() {
        let mut wear = Wear::default();
        wear.treat(&Treatment::Cut(Cut::open([-0.01, 0.0], [0.01, 0.0]))).unwrap();
        // The right half is under the pad.
        wear.treat(&Treatment::Heat(Heating::published([0.02, 0.0], 0.02))).unwrap();
        wear.advance(7200.0);
        let healed = wear.wounds().next().unwrap().healed;
        assert!((healed - 0.5).abs() < 0.1, "{healed}");
        assert!(wear.share_at([-0.02, 0.0]) < 1.001);
        let mut cool = Wear::default();
        cool.treat(&Treatment::Cut(Cut::open([-0.01, 0.0], [0.01, 0.0]))).unwrap();
        let warm = Heating { temperature_c: 40.0, ..Heating::published([0.0; 2], 0.03) };
        cool.treat(&Treatment::Heat(warm)).unwrap();
        cool.advance(7200.0);
        assert!(cool.wounds().next().unwrap().healed < 0.02);
    }

    #[test]
    fn time_lapse_hurries_healing_and_nothing_else() {
        let mut wear = Wear::default();
        for treatment in [Treatment::TimeLapse(3600.0), Treatment::Warm(1e-3)] {
            wear.treat(&treatment).unwrap();
        }
        wear.treat(&Treatment::Heat(Heating::published([0.0; 2], 0.03))).unwrap();
        assert!(wear.advance(1.0));
        // Half of the heating in a second; the room warms at its own pace.
        assert!((wear.share_at([0.0; 2]) - 1.001 * (1.0 + 0.5 * PEAK_RISE)).abs() < 1e-9);
        wear.treat(&Treatment::Renew).unwrap();
        assert!(!wear.advance(1.0) && wear.share_at([0.0; 2]) == 1.0);
    }

    #[test]
    fn nonsense_is_refused() {
        let mut wear = Wear::default();
        let pad = Heating::published([0.0; 2], 0.02);
        for treatment in [
            Treatment::Heat(Heating { temperature_c: 400.0, ..pad }),
            Treatment::Heat(Heating { radius_m: 0.0, ..pad }),
            Treatment::Heat(Heating { duration_s: f64::NAN, ..pad }),
            Treatment::TimeLapse(-1.0),
            Treatment::Warm(1.0),
            Treatment::Cut(Cut::open([0.0; 2], [0.0; 2])),
        ] {
            assert!(wear.treat(&treatment).is_err(), "{treatment:?}");
        }
    }
}
