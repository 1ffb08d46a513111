//! What a skin file says of its twin: the seed of its noise, and what is broken in its instrument.

use dermis_twin::instrument::{Fault, TimedFault};
use dermis_twin::physics::Cut;
use dermis_twin::{Heating, TimedTreatment, Treatment};
use serde::{Deserialize, Serialize};

use super::refused;
use crate::Error;

/// The table `[twin]`. Hardware and recordings know nothing of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinSettings {
    /// Seed of the instrument's noise and of its faults; left out: the twin's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Angle by which the demodulator's reference leads, for `reads = "complex"` above all.
    #[serde(skip_serializing_if = "is_zero")]
    pub phase_error_deg: f64,
    /// What is broken, and when.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<TwinFaults>,
    /// What is done to a self-healing sheet, and when.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub treatments: Vec<TwinTreatment>,
}

/// Something done to a self-healing sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinTreatment {
    /// Seconds after the first frame.
    pub at_s: f64,
    /// What is done.
    pub action: TwinAction,
}

/// What can be done to a self-healing sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TwinAction {
    /// A blade cuts it.
    Cut {
        /// One end.
        from_mm: [f64; 2],
        /// The other end.
        to_mm: [f64; 2],
    },
    /// A heat pad is laid on it.
    Heal {
        /// Middle of the pad.
        at_mm: [f64; 2],
        /// Its radius.
        radius_mm: f64,
        /// Its temperature.
        temperature_c: f64,
        /// How long it stays.
        hours: f64,
    },
    /// Cuts, heat and their aftermath go this many times as fast from then on.
    TimeLapse(f64),
    /// Its conductivity rises as a whole, percent a minute, from then on.
    DriftPercentPerMin(f64),
    /// A new sheet is put in.
    Renew,
}

impl TwinAction {
    /// As the twin takes it.
    pub fn treatment(self) -> Treatment {
        let metres = |[x, y]: [f64; 2]| [x * 1e-3, y * 1e-3];
        match self {
            Self::Cut { from_mm, to_mm } => Treatment::Cut(Cut::open(metres(from_mm), metres(to_mm))),
            Self::Heal { at_mm, radius_mm, temperature_c, hours } => Treatment::Heat(Heating {
                centre_m: metres(at_mm),
                radius_m: radius_mm * 1e-3,
                temperature_c,
                duration_s: hours * 3600.0,
            }),
            Self::TimeLapse(factor) => Treatment::TimeLapse(factor),
            Self::DriftPercentPerMin(percent) => Treatment::Warm(percent * 0.01 / 60.0),
            Self::Renew => Treatment::Renew,
        }
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Faults that act at the same time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TwinFaults {
    /// Seconds after the first frame from which they act.
    pub from_s: f64,
    /// Seconds after the first frame until which they act; left out: for good.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until_s: Option<f64>,
    /// Electrodes without contact, counted from 1.
    pub open_electrodes: Vec<u32>,
    /// Pairs of electrodes connected by a wire, counted from 1.
    pub shorted_pairs: Vec<[u32; 2]>,
    /// Coils that neither make nor see a field, counted from 1; of skins with coils only.
    pub dead_coils: Vec<u32>,
    /// Channels that always read the same.
    pub stuck_channels: Vec<StuckChannel>,
    /// Channels with noise of their own.
    pub noisy_channels: Vec<NoisyChannel>,
    /// Probability of each frame to be lost on the way.
    pub dropped_share: f64,
    /// Probability of each frame to be a copy of the one before, number included.
    pub repeated_share: f64,
}

/// A channel that always reads the same.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StuckChannel {
    /// Which, counted from 1 as on the page.
    pub channel: usize,
    /// What it reads.
    pub value_mv: f64,
}

/// A channel with noise of its own besides that of all.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoisyChannel {
    /// Which, counted from 1 as on the page.
    pub channel: usize,
    /// Standard deviation of that noise.
    pub noise_mv: f64,
}

/// What there is that faults can name.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parts {
    pub electrodes: usize,
    pub coils: usize,
    /// `None` where a protocol cannot be made, which is refused elsewhere, by name.
    pub channels: Option<usize>,
}

impl TwinSettings {
    /// The faults as the twin takes them, electrodes counted from 0.
    pub fn timed_faults(&self) -> Vec<TimedFault> {
        self.faults.iter().flat_map(TwinFaults::timed).collect()
    }

    /// Whether any fault names a channel.
    pub(super) fn names_channels(&self) -> bool {
        self.faults.iter().any(|faults| !faults.stuck_channels.is_empty() || !faults.noisy_channels.is_empty())
    }

    /// The treatments as the twin takes them.
    pub fn timed_treatments(&self) -> Vec<TimedTreatment> {
        let timed = |t: &TwinTreatment| TimedTreatment { at_s: t.at_s, treatment: t.action.treatment() };
        self.treatments.iter().map(timed).collect()
    }

    fn check_treatments(&self, kind: &str, file: &str) -> Result<(), Error> {
        if kind != "sandwich" && !self.treatments.is_empty() {
            return Err(refused(file, "twin.treatments", kind, "none, except with frontend.layer.kind = \"sandwich\""));
        }
        for TwinTreatment { at_s, action } in &self.treatments {
            if !(*at_s >= 0.0 && at_s.is_finite()) {
                return Err(refused(file, "twin.treatments.at_s", at_s, "0 or more"));
            }
            if let Err(error) = action.treatment().check() {
                return Err(refused(file, "twin.treatments.action", error, "numbers that make sense"));
            }
        }
        Ok(())
    }

    pub(super) fn check(&self, parts: Parts, kind: &str, file: &str) -> Result<(), Error> {
        self.check_treatments(kind, file)?;
        if !(-90.0..=90.0).contains(&self.phase_error_deg) {
            return Err(refused(file, "twin.phase_error_deg", self.phase_error_deg, "-90 to 90"));
        }
        self.faults.iter().try_for_each(|faults| faults.check(parts, file))
    }
}

impl TwinFaults {
    fn timed(&self) -> impl Iterator<Item = TimedFault> + '_ {
        // Checked: electrodes are counted from 1.
        let open = self.open_electrodes.iter().map(|n| Fault::OpenElectrode { electrode: n.wrapping_sub(1) });
        let short = self.shorted_pairs.iter().map(|p| Fault::ShortedPair { electrodes: p.map(|n| n.wrapping_sub(1)) });
        let stuck =
            |s: &StuckChannel| Fault::StuckChannel { channel: s.channel.wrapping_sub(1), value_v: 1e-3 * s.value_mv };
        let noisy = |n: &NoisyChannel| Fault::NoisyChannel {
            channel: n.channel.wrapping_sub(1),
            deviation_v: 1e-3 * n.noise_mv,
        };
        let coils = self.dead_coils.iter().map(|n| Fault::DeadCoil { coil: n.wrapping_sub(1) });
        let dropped = Fault::DroppedFrames { probability: self.dropped_share };
        let repeated = Fault::DuplicatedFrames { probability: self.repeated_share };
        let frames = [(self.dropped_share, dropped), (self.repeated_share, repeated)];
        let frames = frames.into_iter().filter(|(share, _)| *share > 0.0).map(|(_, fault)| fault);
        let channels = self.stuck_channels.iter().map(stuck).chain(self.noisy_channels.iter().map(noisy));
        let all = open.chain(short).chain(coils).chain(channels).chain(frames);
        all.map(|fault| TimedFault { fault, from_s: self.from_s, until_s: self.until_s })
    }

    fn check(&self, parts: Parts, file: &str) -> Result<(), Error> {
        let Parts { electrodes, coils, .. } = parts;
        self.check_channels(parts.channels.unwrap_or(usize::MAX), file)?;
        let exists = |number: u32| number >= 1 && number as usize <= electrodes;
        let expected = format!("electrodes 1 to {electrodes}");
        if let Some(number) = self.open_electrodes.iter().find(|&&number| !exists(number)) {
            return Err(refused(file, "twin.faults.open_electrodes", number, &expected));
        }
        if let Some([a, b]) = self.shorted_pairs.iter().find(|[a, b]| !exists(*a) || !exists(*b) || a == b) {
            let expected = format!("two different {expected}");
            return Err(refused(file, "twin.faults.shorted_pairs", format!("[{a}, {b}]"), &expected));
        }
        if let Some(number) = self.dead_coils.iter().find(|&&number| !(1..=coils).contains(&(number as usize))) {
            let expected =
                if coils == 0 { "coils, which this skin has none of".into() } else { format!("coils 1 to {coils}") };
            return Err(refused(file, "twin.faults.dead_coils", number, &expected));
        }
        for (field, share) in
            [("twin.faults.dropped_share", self.dropped_share), ("twin.faults.repeated_share", self.repeated_share)]
        {
            if !(0.0..=1.0).contains(&share) {
                return Err(refused(file, field, share, "0 to 1"));
            }
        }
        if !(self.from_s >= 0.0 && self.from_s.is_finite()) {
            return Err(refused(file, "twin.faults.from_s", self.from_s, "0 or more"));
        }
        match self.until_s {
            Some(until) if !(until > self.from_s && until.is_finite()) => {
                Err(refused(file, "twin.faults.until_s", until, "a number above from_s"))
            }
            _ => Ok(()),
        }
    }

    /// Channels 1 to `most`, and what they read.
    fn check_channels(&self, most: usize, file: &str) -> Result<(), Error> {
        let expected = format!("channels 1 to {most}");
        let stuck = self.stuck_channels.iter().map(|s| ("twin.faults.stuck_channels.channel", s.channel));
        let noisy = self.noisy_channels.iter().map(|n| ("twin.faults.noisy_channels.channel", n.channel));
        if let Some((field, channel)) = stuck.chain(noisy).find(|(_, channel)| !(1..=most).contains(channel)) {
            return Err(refused(file, field, channel, &expected));
        }
        if let Some(stuck) = self.stuck_channels.iter().find(|stuck| !stuck.value_mv.is_finite()) {
            return Err(refused(file, "twin.faults.stuck_channels.value_mv", stuck.value_mv, "a finite number"));
        }
        let good = |noise_mv: f64| noise_mv >= 0.0 && noise_mv.is_finite();
        match self.noisy_channels.iter().find(|noisy| !good(noisy.noise_mv)) {
            Some(noisy) => {
                Err(refused(file, "twin.faults.noisy_channels.noise_mv", noisy.noise_mv, "zero or more, finite"))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Skin, builtin_text};
    use super::*;

    fn with(faults: &str) -> Result<Skin, Error> {
        let text = builtin_text("healing-square").unwrap();
        Skin::parse(&format!("{text}\n[twin]\nfaults = [{faults}]\n"), "a page")
    }

    #[test]
    fn electrodes_are_counted_from_one_and_times_go_with_all_of_a_group() {
        let skin = with("{ open_electrodes = [1], shorted_pairs = [[15, 16]], from_s = 2.0, until_s = 3.0 }, { stuck_channels = [{ channel = 1, value_mv = 5.0 }], dropped_share = 0.1 }").unwrap();
        let timed = skin.twin.timed_faults();
        let faults: Vec<Fault> = timed.iter().map(|timed| timed.fault).collect();
        let expected = [
            Fault::OpenElectrode { electrode: 0 },
            Fault::ShortedPair { electrodes: [14, 15] },
            Fault::StuckChannel { channel: 0, value_v: 5e-3 },
            Fault::DroppedFrames { probability: 0.1 },
        ];
        assert_eq!(faults, expected);
        let times: Vec<_> = timed.iter().map(|timed| (timed.from_s, timed.until_s)).collect();
        assert_eq!(times, [(2.0, Some(3.0)), (2.0, Some(3.0)), (0.0, None), (0.0, None)]);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        assert!(!Skin::open("healing-square").unwrap().to_toml().contains("twin"), "a sound twin needs no table");
    }

    #[test]
    fn treatments_are_read_in_millimetres_and_checked() {
        let text = builtin_text("healing-square").unwrap();
        let with = |list: &str| Skin::parse(&format!("{text}\n[twin]\ntreatments = [{list}]\n"), "a page");
        let list = r#"{ at_s = 2.0, action = { cut = { from_mm = [-10, 0], to_mm = [10, 5] } } },
            { at_s = 3.0, action = { heal = { at_mm = [0, 0], radius_mm = 25, temperature_c = 90, hours = 2 } } },
            { at_s = 3.0, action = { time-lapse = 3600.0 } }, { at_s = 9.0, action = "renew" }"#;
        let skin = with(&list.replace('\n', " ")).unwrap();
        let timed = skin.twin.timed_treatments();
        let Treatment::Cut(cut) = timed[0].treatment else { panic!("{timed:?}") };
        assert_eq!((cut.from_m, cut.to_m, timed[0].at_s), ([-0.01, 0.0], [0.01, 0.005], 2.0));
        assert_eq!(timed[1].treatment, Treatment::Heat(Heating::published([0.0; 2], 0.025)));
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
        let error = |list: &str| with(list).unwrap_err().to_string();
        assert!(error("{ at_s = -1.0, action = \"renew\" }").contains("twin.treatments.at_s = -1"));
        let hot =
            "{ at_s = 1.0, action = { heal = { at_mm = [0, 0], radius_mm = 25, temperature_c = 900, hours = 2 } } }";
        assert!(error(hot).contains("temperature_c: 900"), "{}", error(hot));
        let other = builtin_text("ionic-disc").unwrap();
        let other = Skin::parse(&format!("{other}\n[twin]\ntreatments = [{list}]\n"), "a page").unwrap_err();
        assert!(other.to_string().contains("twin.treatments = liquid"), "{other}");
    }

    #[test]
    fn faults_that_cannot_be_are_refused_with_value_and_field() {
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
        assert!(error("{ dead_coils = [1] }").contains("which this skin has none of"));
        assert!(error("{ open = [1] }").contains("unknown field"));
    }

    #[test]
    fn coils_break_where_there_are_coils() {
        let text = builtin_text("em-8").unwrap();
        let with = |faults: &str| Skin::parse(&format!("{text}\n[twin]\nfaults = [{faults}]\n"), "a page");
        let skin = with("{ dead_coils = [3], noisy_channels = [{ channel = 28, noise_mv = 2.0 }] }").unwrap();
        let faults: Vec<Fault> = skin.twin.timed_faults().iter().map(|timed| timed.fault).collect();
        assert_eq!(faults, [Fault::DeadCoil { coil: 2 }, Fault::NoisyChannel { channel: 27, deviation_v: 2e-3 }]);
        assert!(
            with("{ dead_coils = [9] }").unwrap_err().to_string().contains("dead_coils = 9: expected coils 1 to 8")
        );
        assert!(with("{ open_electrodes = [1] }").is_err());
    }
}
