//! Faults of the instrument, through the twins of all skins: the channels they affect, and the numbering of frames.

mod published;

use dermis_tomo::eit::Protocol;
use dermis_twin::instrument::{Fault, FrameFate, InstrumentOptions, Reading, TimedFault};
use dermis_twin::{ElementSkin, Frontend, LiquidSkin, PatchedSkin, Sandwich, Twin, TwinOptions};
use published::{em_8, healing_square, healing_twin_options, ionic_disc, piezo_square};

type Any = Twin<Box<dyn Frontend>>;

/// The three kinds of skin with an ideal instrument, on small meshes, with their protocols.
fn skins() -> Vec<(&'static str, Any, Protocol)> {
    let ideal = TwinOptions::default();
    let square = healing_square().meshed(4e-3, 2e-3);
    let square = Twin::of(Sandwich::new(square).unwrap(), &ideal).unwrap();
    let ionic = ionic_disc().meshed(9e-3, 1.2e-3);
    let ionic = Twin::of(LiquidSkin::new(ionic).unwrap(), &ideal).unwrap();
    let piezo = piezo_square().meshed(6e-3, 2.5e-3);
    let piezo = Twin::of(PatchedSkin::new(piezo).unwrap(), &TwinOptions { seed: 2, ..ideal }).unwrap();
    let protocols = [
        square.frontend().stimulation().clone(),
        ionic.frontend().fields().protocol().clone(),
        piezo.frontend().stimulation().clone(),
    ];
    let twins = [square.boxed(), ionic.boxed(), piezo.boxed()];
    let names = ["healing-square", "ionic-disc", "piezo-square"];
    names.into_iter().zip(twins).zip(protocols).map(|((name, twin), protocol)| (name, twin, protocol)).collect()
}

fn step(twin: &mut Any, time_s: f64) -> Vec<f64> {
    let mut frame = Vec::new();
    twin.step(time_s, &mut frame).unwrap();
    frame
}

#[test]
fn an_open_electrode_changes_exactly_the_channels_that_use_it() {
    for (name, mut twin, protocol) in skins() {
        let sound = step(&mut twin, 0.0);
        let open = TimedFault { fault: Fault::OpenElectrode { electrode: 4 }, from_s: 1.0, until_s: Some(2.0) };
        twin.set_faults(vec![open]).unwrap();
        assert_eq!(step(&mut twin, 0.5), sound, "{name}: not yet");
        let broken = step(&mut twin, 1.5);
        let mut uses = 0;
        for (channel, measurement) in protocol.measurements().iter().enumerate() {
            let reads = protocol.patterns()[measurement.pattern as usize].touches(4);
            let drives = protocol.stimulations()[measurement.stimulation as usize].touches(4);
            uses += usize::from(reads || drives);
            match (reads, drives) {
                (false, false) => assert_eq!(broken[channel], sound[channel], "{name}: channel {channel}"),
                (false, true) => assert_eq!(broken[channel], 0.0, "{name}: channel {channel}"),
                (true, _) => assert_ne!(broken[channel], sound[channel], "{name}: channel {channel}"),
            }
        }
        assert!(uses > 0 && uses < sound.len() / 2, "{name}: {uses} of {}", sound.len());
        assert_eq!(step(&mut twin, 2.0), sound, "{name}: mended");
    }
}

#[test]
fn a_stuck_channel_and_a_short_show_in_every_twin() {
    for (name, mut twin, protocol) in skins() {
        let sound = step(&mut twin, 0.0);
        let stuck = Fault::StuckChannel { channel: 7, value_v: 0.25 };
        twin.set_faults(vec![stuck.into()]).unwrap();
        let read = step(&mut twin, 0.1);
        let changed: Vec<usize> = (0..sound.len()).filter(|&k| read[k] != sound[k]).collect();
        assert_eq!((changed, read[7]), (vec![7], 0.25), "{name}");
        twin.set_faults(vec![Fault::ShortedPair { electrodes: [2, 3] }.into()]).unwrap();
        let read = step(&mut twin, 0.2);
        for (channel, measurement) in protocol.measurements().iter().enumerate() {
            let drive = &protocol.stimulations()[measurement.stimulation as usize];
            if drive.touches(2) && drive.touches(3) {
                assert_eq!(read[channel], 0.0, "{name}: channel {channel} is driven into the short");
            }
        }
        let refused = twin.set_faults(vec![Fault::OpenElectrode { electrode: 64 }.into()]).unwrap_err().to_string();
        assert!(refused.starts_with("faulty electrode: 64 refused"), "{name}: {refused}");
        let late = TimedFault { from_s: 3.0, ..Fault::StuckChannel { channel: 5000, value_v: 0.0 }.into() };
        assert!(twin.set_faults(vec![late]).is_err(), "{name}: refused at once, not in three seconds");
    }
}

#[test]
fn dropped_frames_leave_gaps_and_copies_repeat_numbers() {
    let options = healing_square().meshed(6e-3, 3e-3);
    let mut twin = Twin::of(Sandwich::new(options).unwrap(), &healing_twin_options()).unwrap();
    let faults = [Fault::DroppedFrames { probability: 0.1 }, Fault::DuplicatedFrames { probability: 0.1 }];
    twin.set_faults(faults.map(TimedFault::from).to_vec()).unwrap();
    let (mut frame, mut last, mut next) = (Vec::new(), None::<(u64, Vec<f64>)>, 0);
    let mut fates = [0; 3];
    for tick in 0..500 {
        let truth = twin.step(0.04 * f64::from(tick), &mut frame).unwrap();
        let (sequence, fate) = (truth.sequence, truth.fate);
        fates[fate as usize] += 1;
        match fate {
            FrameFate::Delivered | FrameFate::Dropped => {
                assert_eq!(sequence, next);
                next += 1;
            }
            FrameFate::Duplicated => assert_eq!(Some(&(sequence, frame.clone())), last.as_ref()),
        }
        if fate == FrameFate::Delivered {
            // Noise makes every frame different.
            assert!(last.as_ref().is_none_or(|(_, before)| *before != frame));
            last = Some((sequence, frame.clone()));
        }
    }
    // Binomial: 50 +- 7 and 45 +- 7, four standard deviations.
    assert!((23..78).contains(&fates[1]) && (18..73).contains(&fates[2]), "{fates:?}");
}

#[test]
fn a_dead_coil_silences_exactly_its_channels() {
    let instrument = InstrumentOptions { reading: Reading::Magnitude, ..InstrumentOptions::ideal() };
    let around = TwinOptions { instrument, ..TwinOptions::default() };
    let twin = Twin::of(ElementSkin::new(em_8()).unwrap(), &around).unwrap();
    let pairs = twin.frontend().pairs().to_vec();
    let mut twin = twin.boxed();
    let sound = step(&mut twin, 0.0);
    twin.set_faults(vec![Fault::DeadCoil { coil: 2 }.into()]).unwrap();
    let broken = step(&mut twin, 0.1);
    for (channel, pair) in pairs.iter().enumerate() {
        let expected = if pair.contains(&2) { 0.0 } else { sound[channel] };
        assert_eq!(broken[channel], expected, "{pair:?}");
    }
    assert!(twin.set_faults(vec![Fault::DeadCoil { coil: 8 }.into()]).is_err());
    assert!(twin.set_faults(vec![Fault::OpenElectrode { electrode: 0 }.into()]).is_err(), "coils are not electrodes");
}

#[test]
fn a_noisy_channel_has_the_noise_asked_for_and_no_other_changes() {
    let (_, mut twin, _) = skins().swap_remove(0);
    let sound = step(&mut twin, 0.0);
    twin.set_faults(vec![Fault::NoisyChannel { channel: 9, deviation_v: 2e-3 }.into()]).unwrap();
    let (mut sum, count) = (0.0, 400);
    for tick in 1..=count {
        let read = step(&mut twin, 0.01 * f64::from(tick));
        assert!((0..sound.len()).all(|c| c == 9 || read[c] == sound[c]));
        sum += (read[9] - sound[9]).powi(2);
    }
    // With 400 values the standard deviation is known to 3.5 % (one standard error).
    let deviation_v = (sum / f64::from(count)).sqrt();
    assert!((deviation_v / 2e-3 - 1.0).abs() < 0.15, "{deviation_v}");
    assert!(twin.set_faults(vec![Fault::DeadCoil { coil: 0 }.into()]).is_err(), "electrodes are not coils");
    assert!(twin.set_faults(vec![Fault::NoisyChannel { channel: 0, deviation_v: -1.0 }.into()]).is_err());
}
