//! Settings in a skin file for its twin: noise seed and instrument faults.

use dermis_tomo::mesh::Point;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::{Checker, LEAST_MM, MOST_MM};
use crate::error::Error;
use crate::layer::Layer;

/// Maximum time of a fault or a treatment, seconds after the first frame: 30 years.
const MOST_S: f64 = 1e9;
/// Maximum reading of a stuck or noisy channel, millivolts: a megavolt.
const MOST_MV: f64 = 1e9;

/// The table `[twin]`. Only twins use it, not hardware or recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TwinSettings {
    /// Seed of the instrument's noise and faults. Default: the twin's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Phase lead of the demodulator's reference, mainly for `reads = "complex"`.
    #[serde(skip_serializing_if = "is_zero")]
    pub phase_error_deg: f64,
    /// Instrument faults and their times.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<TwinFaults>,
    /// Treatments of a self-healing sheet and their times.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub treatments: Vec<TwinTreatment>,
    /// Healing of a sandwich's sheet under heat. If left out, the sheet can be cut but does not heal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub healing: Option<Healing>,
    /// Edge length of the twin's elements. Default: derived from the skin's size, its layer and the size of a
    /// fingertip.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub element_mm: Option<f64>,
    /// Edge length of the twin's elements at electrodes. Default: derived from the electrode size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub electrode_element_mm: Option<f64>,
    /// Range of presses available to users. Default: derived from size and layer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub press: Option<PressSettings>,
    /// Demonstration that the twin plays by itself. Default: derived from size and layer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub demonstration: Option<Demonstration>,
}

/// Healing of a material: fully joined after `hours` at `temperature_c`, faster at higher temperatures (Arrhenius).
/// The defaults are from the published self-healing composite; the activation energy is assumed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Healing {
    /// Temperature at which a cut heals fully.
    pub temperature_c: f64,
    /// Time to heal fully at that temperature.
    pub hours: f64,
    /// Room temperature.
    pub room_c: f64,
    /// Activation energy.
    pub activation_kj_per_mol: f64,
    /// Relative rise of the conductivity at the end of a full heating.
    pub peak_rise: f64,
    /// Part of the rise that remains.
    pub lasting_rise: f64,
    /// Time constant with which the rest of the rise decays.
    pub relaxation_hours: f64,
    /// Length of intact sheet with the same resistance as a healed scar.
    pub scar_mm: f64,
    /// Distance across the rim of a heat pad over which the heating falls from full to none.
    pub pad_rim_mm: f64,
}

/// Lasting rise in conductivity: the intact bar went from 2.01 kohm to 1.92 kohm.
const LASTING_RISE: f64 = 2010.0 / 1920.0 - 1.0;

impl Default for Healing {
    fn default() -> Self {
        Self {
            temperature_c: 90.0,
            hours: 2.0,
            room_c: 25.0,
            activation_kj_per_mol: 90.0,
            peak_rise: 0.3,
            lasting_rise: LASTING_RISE,
            relaxation_hours: 12.0,
            // The bar of 100 mm: 2.07 kohm before it was cut, 2.15 kohm once healed.
            scar_mm: 100.0 * (2150.0 * (1.0 + LASTING_RISE) / 2070.0 - 1.0),
            pad_rim_mm: 4.0,
        }
    }
}

impl Healing {
    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("twin.healing.{name}");
        checker.within(&key("room_c"), self.room_c, -50.0, 100.0)?;
        checker.within(&key("temperature_c"), self.temperature_c, self.room_c + 1.0, 150.0)?;
        checker.within(&key("hours"), self.hours, 1e-6, 1e6)?;
        checker.within(&key("activation_kj_per_mol"), self.activation_kj_per_mol, 1.0, 1e3)?;
        checker.within(&key("lasting_rise"), self.lasting_rise, 0.0, 10.0)?;
        checker.within(&key("peak_rise"), self.peak_rise, self.lasting_rise, 10.0)?;
        checker.within(&key("relaxation_hours"), self.relaxation_hours, 1e-6, 1e6)?;
        checker.within(&key("scar_mm"), self.scar_mm, 1e-6, 1e4)?;
        checker.within(&key("pad_rim_mm"), self.pad_rim_mm, 1e-3, 1e3)
    }
}

/// Range of indenters and pressures offered to users, and the initial values of the sliders.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PressSettings {
    /// Minimum and maximum radius of the indenter.
    pub radius_mm: [f64; 2],
    /// Minimum and maximum pressure under it.
    pub pressure_kpa: [f64; 2],
    /// Initial radius.
    pub initial_radius_mm: f64,
    /// Initial pressure.
    pub initial_pressure_kpa: f64,
}

/// Demonstration of a twin: one touch wanders, others press and slide, in a loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Demonstration {
    /// No demonstration.
    None,
    /// Around the skin's middle, scaled by this factor from a 100 mm square.
    Scale(f64),
}

/// A treatment of a self-healing sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TwinTreatment {
    /// Seconds after the first frame.
    pub at_s: f64,
    /// The treatment.
    pub action: TwinAction,
}

/// Treatments of a self-healing sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TwinAction {
    /// A cut with a blade.
    Cut {
        /// One end.
        from_mm: Point,
        /// The other end.
        to_mm: Point,
    },
    /// A heat pad laid on the sheet.
    Heal {
        /// Centre of the pad.
        at_mm: Point,
        /// Radius of the pad.
        radius_mm: f64,
        /// Temperature of the pad.
        temperature_c: f64,
        /// Duration of the heating.
        hours: f64,
    },
    /// Speeds up cuts, heat and their aftermath by this factor from then on.
    TimeLapse(f64),
    /// Raises the conductivity of the whole sheet from then on, percent per minute.
    DriftPercentPerMin(f64),
    /// Replaces the sheet with a new one.
    Renew,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Faults that act at the same time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TwinFaults {
    /// Start of the faults, seconds after the first frame.
    pub from_s: f64,
    /// End of the faults, seconds after the first frame. Default: they last for good.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
    /// Electrodes without contact, counted from 1.
    pub open_electrodes: Vec<u32>,
    /// Pairs of electrodes shorted by a wire, counted from 1.
    pub shorted_pairs: Vec<[u32; 2]>,
    /// Coils that neither generate nor sense a field, counted from 1; only for skins with coils.
    pub dead_coils: Vec<u32>,
    /// Channels stuck at one value.
    pub stuck_channels: Vec<StuckChannel>,
    /// Channels with extra noise.
    pub noisy_channels: Vec<NoisyChannel>,
    /// Probability that a frame is lost in transit.
    pub dropped_share: f64,
    /// Probability that a frame repeats the one before, including its number.
    pub repeated_share: f64,
}

/// A channel stuck at one value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StuckChannel {
    /// Channel number, counted from 1 as on the page.
    pub channel: usize,
    /// Constant reading.
    pub value_mv: f64,
}

/// A channel with noise on top of the common noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoisyChannel {
    /// Channel number, counted from 1 as on the page.
    pub channel: usize,
    /// Standard deviation of the extra noise.
    pub noise_mv: f64,
}

/// Numbers of electrodes, channels and coils that faults can name.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parts {
    pub electrodes: usize,
    pub coils: usize,
    /// `None` if no protocol can be made; that error is reported elsewhere, by name.
    pub channels: Option<usize>,
}

impl TwinSettings {
    /// True if any fault refers to a channel.
    pub(crate) fn names_channels(&self) -> bool {
        self.faults.iter().any(|faults| !faults.stuck_channels.is_empty() || !faults.noisy_channels.is_empty())
    }

    pub(crate) fn check(&self, parts: Parts, layer: &Layer, checker: &Checker<'_>) -> Result<(), Error> {
        let is_treatable = matches!(layer, Layer::Sandwich(_) | Layer::Sheet(_));
        if !is_treatable && !self.treatments.is_empty() {
            let expected = "none, except with frontend.layer.kind = \"sheet\" or \"sandwich\"";
            return Err(checker.refused("twin.treatments", layer.kind(), expected));
        }
        let heats = |treatment: &TwinTreatment| matches!(treatment.action, TwinAction::Heal { .. });
        if self.healing.is_none() && self.treatments.iter().any(heats) {
            let expected = "a layer that heals: frontend.layer.kind = \"sandwich\" with [twin] healing";
            return Err(checker.refused("twin.treatments.action.heal", "given", expected));
        }
        self.treatments.iter().try_for_each(|treatment| treatment.check(checker))?;
        checker.within("twin.phase_error_deg", self.phase_error_deg, -90.0, 90.0)?;
        for (field, value) in
            [("twin.element_mm", self.element_mm), ("twin.electrode_element_mm", self.electrode_element_mm)]
        {
            if let Some(value) = value {
                checker.within(field, value, LEAST_MM, 1e3)?;
            }
        }
        if let Some(press) = &self.press {
            press.check(checker)?;
        }
        if let Some(healing) = &self.healing {
            if !matches!(layer, Layer::Sandwich(_)) {
                let expected = "none, except with frontend.layer.kind = \"sandwich\"";
                return Err(checker.refused("twin.healing", layer.kind(), expected));
            }
            healing.check(checker)?;
        }
        if let Some(Demonstration::Scale(scale)) = self.demonstration {
            checker.within("twin.demonstration.scale", scale, 1e-3, 1e3)?;
        }
        self.faults.iter().try_for_each(|faults| faults.check(parts, checker))
    }
}

impl PressSettings {
    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let [least_mm, most_mm] = self.radius_mm;
        checker.length_mm("twin.press.radius_mm", least_mm)?;
        checker.within("twin.press.radius_mm", most_mm, least_mm, MOST_MM)?;
        checker.within("twin.press.initial_radius_mm", self.initial_radius_mm, least_mm, most_mm)?;
        let [least_kpa, most_kpa] = self.pressure_kpa;
        checker.within("twin.press.pressure_kpa", least_kpa, 0.0, 1e9)?;
        checker.within("twin.press.pressure_kpa", most_kpa, least_kpa, 1e9)?;
        checker.within("twin.press.initial_pressure_kpa", self.initial_pressure_kpa, least_kpa, most_kpa)
    }
}

impl TwinTreatment {
    fn check(&self, checker: &Checker<'_>) -> Result<(), Error> {
        let key = |name: &str| format!("twin.treatments.action.{name}");
        checker.within("twin.treatments.at_s", self.at_s, 0.0, MOST_S)?;
        match self.action {
            TwinAction::Cut { from_mm, to_mm } => {
                checker.place_mm(&key("cut.from_mm"), &from_mm)?;
                checker.place_mm(&key("cut.to_mm"), &to_mm)?;
                if from_mm == to_mm {
                    return Err(checker.refused(&key("cut.to_mm"), format!("{to_mm:?}"), "a place other than from_mm"));
                }
                Ok(())
            }
            TwinAction::Heal { at_mm, radius_mm, temperature_c, hours } => {
                checker.place_mm(&key("heal.at_mm"), &at_mm)?;
                checker.length_mm(&key("heal.radius_mm"), radius_mm)?;
                checker.within(&key("heal.temperature_c"), temperature_c, 0.0, 150.0)?;
                checker.within(&key("heal.hours"), hours, 1e-6, 1e5)
            }
            TwinAction::TimeLapse(factor) => checker.within(&key("time-lapse"), factor, 0.0, 1e6),
            TwinAction::DriftPercentPerMin(percent) => {
                checker.within(&key("drift-percent-per-min"), percent, -60.0, 60.0)
            }
            TwinAction::Renew => Ok(()),
        }
    }
}

impl TwinFaults {
    fn check(&self, parts: Parts, checker: &Checker<'_>) -> Result<(), Error> {
        let Parts { electrodes, coils, .. } = parts;
        self.check_channels(parts.channels.unwrap_or(usize::MAX), checker)?;
        let exists = |number: u32| number >= 1 && number as usize <= electrodes;
        let expected = format!("electrodes 1 to {electrodes}");
        if let Some(number) = self.open_electrodes.iter().find(|&&number| !exists(number)) {
            return Err(checker.refused("twin.faults.open_electrodes", number, expected));
        }
        if let Some([a, b]) = self.shorted_pairs.iter().find(|[a, b]| !exists(*a) || !exists(*b) || a == b) {
            let expected = format!("two different {expected}");
            return Err(checker.refused("twin.faults.shorted_pairs", format!("[{a}, {b}]"), expected));
        }
        if let Some(number) = self.dead_coils.iter().find(|&&number| !(1..=coils).contains(&(number as usize))) {
            let expected =
                if coils == 0 { "coils, which this skin does not have".into() } else { format!("coils 1 to {coils}") };
            return Err(checker.refused("twin.faults.dead_coils", number, expected));
        }
        for (field, share) in
            [("twin.faults.dropped_share", self.dropped_share), ("twin.faults.repeated_share", self.repeated_share)]
        {
            if !(0.0..=1.0).contains(&share) {
                return Err(checker.refused(field, share, "0 to 1"));
            }
        }
        checker.within("twin.faults.from_s", self.from_s, 0.0, MOST_S)?;
        match self.until_s {
            Some(until) if !(until > self.from_s && until <= MOST_S) => {
                let expected = format!("a number above from_s, at most {MOST_S:e}");
                Err(checker.refused("twin.faults.until_s", until, expected))
            }
            _ => Ok(()),
        }
    }

    /// Checks that channels are between 1 and `most`, and checks their readings.
    fn check_channels(&self, most: usize, checker: &Checker<'_>) -> Result<(), Error> {
        let expected = format!("channels 1 to {most}");
        let stuck = self.stuck_channels.iter().map(|s| ("twin.faults.stuck_channels.channel", s.channel));
        let noisy = self.noisy_channels.iter().map(|n| ("twin.faults.noisy_channels.channel", n.channel));
        if let Some((field, channel)) = stuck.chain(noisy).find(|(_, channel)| !(1..=most).contains(channel)) {
            return Err(checker.refused(field, channel, expected));
        }
        for stuck in &self.stuck_channels {
            checker.within("twin.faults.stuck_channels.value_mv", stuck.value_mv, -MOST_MV, MOST_MV)?;
        }
        for noisy in &self.noisy_channels {
            checker.within("twin.faults.noisy_channels.noise_mv", noisy.noise_mv, 0.0, MOST_MV)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Skin, builtin_text};

    fn with(faults: &str) -> Result<Skin, Error> {
        let text = builtin_text("healing-square").unwrap();
        Skin::parse(&text.replace("[twin]", &format!("[twin]\nfaults = [{faults}]")), "a page")
    }

    #[test]
    fn the_table_survives_writing_and_a_faultless_twin_needs_less() {
        let skin = with("{ open_electrodes = [1], shorted_pairs = [[15, 16]], from_s = 2.0, until_s = 3.0 }, { stuck_channels = [{ channel = 1, value_mv = 5.0 }], dropped_share = 0.1 }").unwrap();
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        assert!(!Skin::open("golfball-tank").unwrap().to_toml().contains("[twin"), "nothing said, nothing written");
    }

    #[test]
    fn treatments_are_checked() {
        let text = builtin_text("healing-square").unwrap();
        let with =
            |list: &str| Skin::parse(&text.replace("[twin]", &format!("[twin]\ntreatments = [{list}]")), "a page");
        let list = r#"{ at_s = 2.0, action = { cut = { from_mm = [-10, 0], to_mm = [10, 5] } } },
            { at_s = 3.0, action = { heal = { at_mm = [0, 0], radius_mm = 25, temperature_c = 90, hours = 2 } } },
            { at_s = 3.0, action = { time-lapse = 3600.0 } }, { at_s = 9.0, action = "renew" }"#;
        let skin = with(&list.replace('\n', " ")).unwrap();
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        let error = |list: &str| with(list).unwrap_err().to_string();
        assert!(error("{ at_s = -1.0, action = \"renew\" }").contains("twin.treatments.at_s = -1"));
        let hot =
            "{ at_s = 1.0, action = { heal = { at_mm = [0, 0], radius_mm = 25, temperature_c = 900, hours = 2 } } }";
        assert!(error(hot).contains("temperature_c = 900"), "{}", error(hot));
        let other = builtin_text("ionic-disc")
            .unwrap()
            .replace("[twin]", &format!("[twin]\ntreatments = [{}]", list.replace('\n', " ")));
        let other = Skin::parse(&other, "a page").unwrap_err();
        assert!(other.to_string().contains("twin.treatments = liquid"), "{other}");
    }

    #[test]
    fn sheets_are_cut_and_warmed_but_not_healed() {
        let mut skin = Skin::rectangle("gel", 120.0, 80.0, Layer::Sheet(crate::SheetLayer::gel(5.0, 0.2)));
        let cut = TwinAction::Cut { from_mm: [-10.0, 0.0], to_mm: [10.0, 5.0] };
        skin.twin.treatments = vec![TwinTreatment { at_s: 2.0, action: cut }];
        let skin = skin.checked().unwrap();
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        let mut heated = skin;
        let heal = TwinAction::Heal { at_mm: [0.0; 2], radius_mm: 25.0, temperature_c: 90.0, hours: 2.0 };
        heated.twin.treatments.push(TwinTreatment { at_s: 3.0, action: heal });
        let message = heated.checked().unwrap_err().to_string();
        assert!(message.contains("twin.treatments.action.heal") && message.contains("a layer that heals"), "{message}");
    }

    #[test]
    fn impossible_faults_are_refused_with_value_and_field() {
        let error = |faults: &str| with(faults).unwrap_err().to_string();
        let open = error("{ open_electrodes = [3, 17] }");
        assert_eq!(open, "a page: twin.faults.open_electrodes = 17: expected electrodes 1 to 16");
        assert!(error("{ open_electrodes = [0] }").contains("open_electrodes = 0"));
        assert!(error("{ shorted_pairs = [[2, 2]] }").contains("shorted_pairs = [2, 2]: expected two different"));
        assert!(error("{ dropped_share = 1.5 }").contains("dropped_share = 1.5: expected 0 to 1"));
        assert!(error("{ repeated_share = nan }").contains("repeated_share = NaN"));
        assert!(error("{ from_s = 2.0, until_s = 1.0 }").contains("until_s = 1: expected a number above from_s"));
        assert!(error("{ from_s = -1.0 }").contains("from_s = -1"));
        assert!(error("{ stuck_channels = [{ channel = 1, value_mv = inf }] }").contains("value_mv = inf"));
        let stuck = error("{ stuck_channels = [{ channel = 209, value_mv = 0.0 }] }");
        assert_eq!(stuck, "a page: twin.faults.stuck_channels.channel = 209: expected channels 1 to 208");
        assert!(error("{ stuck_channels = [{ channel = 0, value_mv = 0.0 }] }").contains("channel = 0"));
        let noisy = error("{ noisy_channels = [{ channel = 209, noise_mv = 1.0 }] }");
        assert_eq!(noisy, "a page: twin.faults.noisy_channels.channel = 209: expected channels 1 to 208");
        assert!(error("{ noisy_channels = [{ channel = 9, noise_mv = -1.0 }] }").contains("noise_mv = -1"));
        assert!(error("{ dead_coils = [1] }").contains("which this skin does not have"));
        assert!(error("{ open = [1] }").contains("unknown field"));
    }

    #[test]
    fn only_skins_with_coils_have_coil_faults() {
        let text = builtin_text("em-8").unwrap();
        let with =
            |faults: &str| Skin::parse(&text.replace("[twin]", &format!("[twin]\nfaults = [{faults}]")), "a page");
        let skin = with("{ dead_coils = [3], noisy_channels = [{ channel = 28, noise_mv = 2.0 }] }").unwrap();
        assert_eq!(skin.twin.faults[0].dead_coils, [3]);
        assert!(
            with("{ dead_coils = [9] }").unwrap_err().to_string().contains("dead_coils = 9: expected coils 1 to 8")
        );
        assert!(with("{ open_electrodes = [1] }").is_err());
    }
}
