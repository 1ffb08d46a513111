//! Life of a self-healing sheet: blades cut it, heat pads close cuts and raise the conductivity around them, which
//! partly decays later, and room temperature changes the whole sheet.
//!
//! A point at temperature `T` heals at the rate `r(T) = exp(-(E/R) (1/T - 1/T_h)) / t_h`: fully within `t_h` at
//! `T_h`. Its dose `q`, the integral of `r` limited to 1, is the share of the cut's faces that has rejoined. A cut of
//! width `w` has the relative conductance `d = (1 - q) d_open + q d_healed`, with `1/d_healed = 1 + l/w` and `l` the
//! length of intact sheet with the same resistance as a healed scar. Heat raises the conductivity to `1 + q_h p`
//! (`q_h`: dose of that heating); afterwards it is `1 + q_h (k + (p - k) exp(-t / tau))`.
//!
//! The constants of a material are in its [`HealingLaw`].

use dermis_tomo::mesh::{Point, distance};
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check, check_positive};
use crate::physics::Cut;

const ZERO_C_IN_K: f64 = 273.15;
/// Maximum length of the pieces of a cut, each of which heals at its own temperature.
const PIECE_M: f64 = 1e-3;

/// Maximum number of cuts in a sheet.
pub const MOST_CUTS: usize = 32;
/// Maximum number of heat pads whose effects a sheet keeps track of.
pub const MOST_PADS: usize = 24;

/// Healing of a material; see the module.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HealingLaw {
    /// T_h: temperature at which a cut heals fully, degrees Celsius.
    pub temperature_c: f64,
    /// t_h: time to heal fully at that temperature, seconds.
    pub duration_s: f64,
    /// Room temperature, degrees Celsius.
    pub room_c: f64,
    /// E/R: activation energy over the gas constant, kelvin.
    pub activation_k: f64,
    /// p: relative rise of the conductivity at the end of a full heating.
    pub peak_rise: f64,
    /// k: part of the rise that remains; at most `peak_rise`.
    pub lasting_rise: f64,
    /// tau: time constant with which the rest decays, seconds.
    pub relaxation_s: f64,
    /// l: length of intact sheet with the same resistance as a healed scar, metres.
    pub scar_m: f64,
    /// Distance across the rim of a heat pad over which the heating falls from full to none, metres.
    pub pad_rim_m: f64,
}

impl HealingLaw {
    /// Checks the numbers.
    ///
    /// # Errors
    /// Invalid temperatures, times or lengths that are not positive, or rises that are negative or out of order.
    pub fn check(&self) -> Result<(), TwinError> {
        check("healing room_c", self.room_c, -50.0, 100.0, "-50 to 100 degrees Celsius")?;
        check("healing temperature_c", self.temperature_c, self.room_c, 500.0, "room_c to 500 degrees Celsius")?;
        check_positive("healing duration_s", self.duration_s)?;
        check("healing activation_k", self.activation_k, 0.0, 1e6, "0 to 1e6 K")?;
        check("healing lasting_rise", self.lasting_rise, 0.0, 10.0, "0 to 10")?;
        check("healing peak_rise", self.peak_rise, self.lasting_rise, 10.0, "lasting_rise to 10")?;
        check_positive("healing relaxation_s", self.relaxation_s)?;
        check("healing scar_m", self.scar_m, 0.0, 1.0, "0 to 1 m")?;
        check_positive("healing pad_rim_m", self.pad_rim_m)
    }

    /// Relative heating of a point by a pad: 1 under it, 0 next to it, in between at its rim.
    fn nearness(&self, heating: &Heating, point: Point) -> f64 {
        (0.5 + (heating.radius_m - distance(point, heating.centre_m)) / self.pad_rim_m).clamp(0.0, 1.0)
    }

    /// Dose rate at a point with relative heating `x` by a pad, 1/s.
    fn rate_of(&self, heating: &Heating, x: f64) -> f64 {
        let kelvin = |celsius: f64| celsius + ZERO_C_IN_K;
        let temperature = kelvin(self.room_c + (heating.temperature_c - self.room_c) * x * x * (3.0 - 2.0 * x));
        (-self.activation_k * (1.0 / temperature - 1.0 / kelvin(self.temperature_c))).exp() / self.duration_s
    }
}

/// A heat pad laid on the skin for some time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heating {
    /// Centre of the pad, metres.
    pub centre_m: Point,
    /// Radius of the pad, metres.
    pub radius_m: f64,
    /// Temperature of the pad, degrees Celsius.
    pub temperature_c: f64,
    /// Duration of the heating, seconds.
    pub duration_s: f64,
}

impl Heating {
    /// Checks the numbers.
    ///
    /// # Errors
    /// A pad without position or size, a temperature outside 0 to 150 C, or a time that is not positive and finite.
    pub fn check(&self) -> Result<(), TwinError> {
        for value in self.centre_m {
            check("heat pad's centre, m", value, -1e3, 1e3, "a position in metres")?;
        }
        check_positive("heat pad's radius_m", self.radius_m)?;
        check("heat pad's temperature_c", self.temperature_c, 0.0, 150.0, "0 to 150 degrees Celsius")?;
        check_positive("heat pad's duration_s", self.duration_s)
    }
}

/// A treatment of a sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Treatment {
    /// A cut with a blade.
    Cut(Cut),
    /// A heat pad laid on the sheet.
    Heat(Heating),
    /// Speeds up cuts, heat and their aftermath by this factor relative to the frames from now on; touches are
    /// unaffected.
    TimeLapse(f64),
    /// Relative rise of the whole sheet's conductivity per second from now on (the room warms up); 0 holds it.
    Warm(f64),
    /// Replaces the sheet with a new one.
    Renew,
}

impl Treatment {
    /// Checks the numbers.
    ///
    /// # Errors
    /// As [`Cut::check`] and [`Heating::check`]; also fails for factors and rates out of range.
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

/// A cut with its healing state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wound {
    /// The original cut.
    pub cut: Cut,
    /// Share of its faces that has rejoined, 0 to 1.
    pub healed: f64,
}

#[derive(Clone, Debug)]
struct Laceration {
    cut: Cut,
    /// One dose per piece.
    doses: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Pad {
    heating: Heating,
    age_s: f64,
}

/// Dose rates due to one pad, 1/s. Most points are either next to it or under it, where the rate is constant.
struct Rates<'a> {
    law: &'a HealingLaw,
    heating: &'a Heating,
    beside: f64,
    under: f64,
}

impl<'a> Rates<'a> {
    fn of(heating: &'a Heating, law: &'a HealingLaw) -> Self {
        Self { law, heating, beside: law.rate_of(heating, 0.0), under: law.rate_of(heating, 1.0) }
    }

    fn at(&self, point: Point) -> f64 {
        match self.law.nearness(self.heating, point) {
            0.0 => self.beside,
            1.0 => self.under,
            x => self.law.rate_of(self.heating, x),
        }
    }
}

/// Current effect of one pad on the conductivity.
struct Warmth<'a> {
    rates: Rates<'a>,
    /// Elapsed heating time, seconds.
    heated_s: f64,
    /// Remaining part of the decaying rise for a full dose.
    passing: f64,
}

impl<'a> Warmth<'a> {
    fn of(Pad { heating, age_s }: &'a Pad, law: &'a HealingLaw) -> Self {
        let since = age_s - heating.duration_s;
        let left = if since > 0.0 { (-since / law.relaxation_s).exp() } else { 1.0 };
        Self {
            rates: Rates::of(heating, law),
            heated_s: age_s.min(heating.duration_s),
            passing: (law.peak_rise - law.lasting_rise) * left,
        }
    }
}

/// State of one sheet.
#[derive(Clone, Debug)]
pub struct Wear {
    law: Option<HealingLaw>,
    cuts: Vec<Laceration>,
    pads: Vec<Pad>,
    time_lapse: f64,
    warming_per_s: f64,
    warmth: f64,
}

impl Wear {
    /// A new sheet that heals by this law. With `None` it can be cut, warmed and renewed, but does not heal.
    pub fn new(law: Option<HealingLaw>) -> Self {
        Self { law, cuts: Vec::new(), pads: Vec::new(), time_lapse: 1.0, warming_per_s: 0.0, warmth: 1.0 }
    }

    /// Applies a treatment. A blade that follows an existing cut reopens it instead of adding a second one.
    ///
    /// # Errors
    /// Invalid numbers, heat on a sheet that does not heal, or more than [`MOST_CUTS`] cuts or [`MOST_PADS`] pads.
    pub fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        treatment.check()?;
        let most = |field, most: usize, got: usize| {
            let expected = format!("at most {most} on one sheet; a new sheet has none (renew)");
            if got < most { Ok(()) } else { Err(TwinError::Count { field, got: got + 1, expected }) }
        };
        match *treatment {
            Treatment::Cut(cut) => {
                if let Some(same) = self.cuts.iter_mut().find(|other| other.cut.is_along(&cut)) {
                    same.doses.fill(0.0);
                    return Ok(());
                }
                most("cuts", MOST_CUTS, self.cuts.len())?;
                let pieces = ((cut.length_m() / PIECE_M).ceil() as usize).clamp(1, 1000);
                self.cuts.push(Laceration { cut, doses: vec![0.0; pieces] });
            }
            Treatment::Heat(_) if self.law.is_none() => return Err(TwinError::NotTreatable),
            Treatment::Heat(heating) => {
                // A pad laid twice at the same moment counts once. A pad whose decaying part is gone leaves the same
                // effect as the next one in its place.
                let relaxation_s = self.law.map_or(0.0, |law| law.relaxation_s);
                let is_over = |pad: &Pad| pad.age_s > pad.heating.duration_s + 20.0 * relaxation_s;
                self.pads.retain(|pad| pad.heating != heating || !(pad.age_s == 0.0 || is_over(pad)));
                most("heat pads", MOST_PADS, self.pads.len())?;
                self.pads.push(Pad { heating, age_s: 0.0 });
            }
            Treatment::TimeLapse(factor) => self.time_lapse = factor,
            Treatment::Warm(share_per_s) => self.warming_per_s = share_per_s,
            Treatment::Renew => *self = Self { time_lapse: self.time_lapse, ..Self::new(self.law) },
        }
        Ok(())
    }

    /// Advances the frames' time by `dt_s`; returns true if the sheet has changed.
    pub fn advance(&mut self, dt_s: f64) -> bool {
        let before = self.warmth;
        // Limits the drift.
        self.warmth = (self.warmth * (1.0 + self.warming_per_s * dt_s)).clamp(0.1, 10.0);
        let passed = dt_s * self.time_lapse;
        let mut changed = self.warmth != before;
        if passed <= 0.0 {
            return changed;
        }
        let Some(law) = self.law else { return changed };
        for pad in &mut self.pads {
            let heated = (pad.heating.duration_s - pad.age_s).clamp(0.0, passed);
            pad.age_s += passed;
            let rates = Rates::of(&pad.heating, &law);
            changed |= heated > 0.0 || pad.age_s < pad.heating.duration_s + 20.0 * law.relaxation_s;
            // Nothing heals under a pad that has been removed.
            let wounds = if heated > 0.0 { self.cuts.as_mut_slice() } else { &mut [] };
            for Laceration { cut, doses } in wounds {
                let count = doses.len();
                for (index, dose) in doses.iter_mut().enumerate().filter(|(_, dose)| **dose < 1.0) {
                    let middle = cut.at((index as f64 + 0.5) / count as f64);
                    *dose = (*dose + heated * rates.at(middle)).min(1.0);
                }
            }
        }
        changed
    }

    /// Conductivity at a point relative to a new sheet, ignoring cuts.
    pub fn share_at(&self, point: Point) -> f64 {
        self.share()(point)
    }

    /// The same for many points; common terms are computed once.
    pub fn share(&self) -> impl Fn(Point) -> f64 + '_ {
        let warmths: Vec<Warmth> =
            self.law.iter().flat_map(|law| self.pads.iter().map(|pad| Warmth::of(pad, law))).collect();
        move |point| {
            let (mut passing, mut lasting) = (0.0, 0.0_f64);
            for warmth in &warmths {
                let dose = (warmth.rates.at(point) * warmth.heated_s).min(1.0);
                passing += dose * warmth.passing;
                // The lasting rise does not add up over several heatings.
                lasting = lasting.max(dose * warmth.rates.law.lasting_rise);
            }
            self.warmth * (1.0 + passing + lasting)
        }
    }

    /// The cuts with their current conductance, each in equal pieces from end to end.
    pub fn cuts(&self) -> impl Iterator<Item = Vec<Cut>> + '_ {
        self.cuts.iter().map(|Laceration { cut, doses }| {
            let count = doses.len() as f64;
            let healed = self.law.map_or(0.0, |law| cut.width_m / (cut.width_m + law.scar_m));
            let piece = |(index, dose): (usize, &f64)| Cut {
                from_m: cut.at(index as f64 / count),
                to_m: cut.at((index + 1) as f64 / count),
                residual: cut.residual + dose * (healed - cut.residual).max(0.0),
                ..*cut
            };
            doses.iter().enumerate().map(piece).collect()
        })
    }

    /// The original cuts and their healing state.
    pub fn wounds(&self) -> impl Iterator<Item = Wound> + '_ {
        self.cuts.iter().map(|Laceration { cut, doses }| {
            let healed = doses.iter().sum::<f64>() / doses.len() as f64;
            Wound { cut: *cut, healed }
        })
    }
}

/// A treatment and its time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedTreatment {
    /// Seconds after the first frame.
    pub at_s: f64,
    /// The treatment.
    pub treatment: Treatment,
}
