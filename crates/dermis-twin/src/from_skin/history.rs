//! Converts the faults and treatments of a skin file for the twin: electrodes, coils and channels counted from 0, SI
//! units.

use dermis_skin::{NoisyChannel, StuckChannel, TwinAction, TwinFaults, TwinSettings, TwinTreatment};
use dermis_tomo::mesh::Point;

use crate::healing::{Heating, TimedTreatment, Treatment};
use crate::instrument::{Fault, TimedFault};
use crate::physics::Cut;

/// The faults of a skin file, each with its times.
pub fn timed_faults(settings: &TwinSettings) -> Vec<TimedFault> {
    settings.faults.iter().flat_map(of_group).collect()
}

/// The treatments of a skin file, each with its time.
pub fn timed_treatments(settings: &TwinSettings) -> Vec<TimedTreatment> {
    let timed = |t: &TwinTreatment| TimedTreatment { at_s: t.at_s, treatment: treatment_of(t.action) };
    settings.treatments.iter().map(timed).collect()
}

/// Converts one treatment.
pub fn treatment_of(action: TwinAction) -> Treatment {
    let metres = |[x, y]: Point| [x * 1e-3, y * 1e-3];
    match action {
        TwinAction::Cut { from_mm, to_mm } => Treatment::Cut(Cut::open(metres(from_mm), metres(to_mm))),
        TwinAction::Heal { at_mm, radius_mm, temperature_c, hours } => Treatment::Heat(Heating {
            centre_m: metres(at_mm),
            radius_m: radius_mm * 1e-3,
            temperature_c,
            duration_s: hours * 3600.0,
        }),
        TwinAction::TimeLapse(factor) => Treatment::TimeLapse(factor),
        TwinAction::DriftPercentPerMin(percent) => Treatment::Warm(percent * 0.01 / 60.0),
        TwinAction::Renew => Treatment::Renew,
    }
}

fn of_group(group: &TwinFaults) -> impl Iterator<Item = TimedFault> + '_ {
    // Validated earlier: all are counted from 1.
    let open = group.open_electrodes.iter().map(|n| Fault::OpenElectrode { electrode: n.wrapping_sub(1) });
    let short = group.shorted_pairs.iter().map(|p| Fault::ShortedPair { electrodes: p.map(|n| n.wrapping_sub(1)) });
    let stuck =
        |s: &StuckChannel| Fault::StuckChannel { channel: s.channel.wrapping_sub(1), value_v: 1e-3 * s.value_mv };
    let noisy =
        |n: &NoisyChannel| Fault::NoisyChannel { channel: n.channel.wrapping_sub(1), deviation_v: 1e-3 * n.noise_mv };
    let coils = group.dead_coils.iter().map(|n| Fault::DeadCoil { coil: n.wrapping_sub(1) });
    let dropped = Fault::DroppedFrames { probability: group.dropped_share };
    let repeated = Fault::DuplicatedFrames { probability: group.repeated_share };
    let frames = [(group.dropped_share, dropped), (group.repeated_share, repeated)];
    let frames = frames.into_iter().filter(|(share, _)| *share > 0.0).map(|(_, fault)| fault);
    let channels = group.stuck_channels.iter().map(stuck).chain(group.noisy_channels.iter().map(noisy));
    let all = open.chain(short).chain(coils).chain(channels).chain(frames);
    all.map(|fault| TimedFault { fault, from_s: group.from_s, until_s: group.until_s })
}

#[cfg(test)]
mod tests {
    use dermis_skin::Skin;

    use super::*;

    fn settings(table: &str) -> TwinSettings {
        let text = dermis_skin::builtin_text("healing-square").unwrap();
        Skin::parse(&text.replace("[twin]", &format!("[twin]\n{table}")), "a page").unwrap().twin
    }

    #[test]
    fn electrodes_are_counted_from_one_and_times_go_with_all_of_a_group() {
        let timed = timed_faults(&settings(
            "faults = [{ open_electrodes = [1], shorted_pairs = [[15, 16]], from_s = 2.0, until_s = 3.0 }, { stuck_channels = [{ channel = 1, value_mv = 5.0 }], noisy_channels = [{ channel = 28, noise_mv = 2.0 }], dropped_share = 0.1 }]",
        ));
        let faults: Vec<Fault> = timed.iter().map(|timed| timed.fault).collect();
        let expected = [
            Fault::OpenElectrode { electrode: 0 },
            Fault::ShortedPair { electrodes: [14, 15] },
            Fault::StuckChannel { channel: 0, value_v: 5e-3 },
            Fault::NoisyChannel { channel: 27, deviation_v: 2e-3 },
            Fault::DroppedFrames { probability: 0.1 },
        ];
        assert_eq!(faults, expected);
        let times: Vec<_> = timed.iter().map(|timed| (timed.from_s, timed.until_s)).collect();
        assert_eq!(times, [(2.0, Some(3.0)), (2.0, Some(3.0)), (0.0, None), (0.0, None), (0.0, None)]);
    }

    #[test]
    fn treatments_are_read_in_millimetres() {
        let timed = timed_treatments(&settings(
            "treatments = [{ at_s = 2.0, action = { cut = { from_mm = [-10, 0], to_mm = [10, 5] } } }, { at_s = 3.0, action = { heal = { at_mm = [0, 0], radius_mm = 25, temperature_c = 90, hours = 2 } } }]",
        ));
        let Treatment::Cut(cut) = timed[0].treatment else { panic!("{timed:?}") };
        assert_eq!((cut.from_m, cut.to_m, timed[0].at_s), ([-0.01, 0.0], [0.01, 0.005], 2.0));
        let heating = Heating { centre_m: [0.0; 2], radius_m: 0.025, temperature_c: 90.0, duration_s: 7200.0 };
        assert_eq!(timed[1].treatment, Treatment::Heat(heating));
    }
}
