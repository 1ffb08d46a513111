//! Random sequences of presses, cuts, faults, damaged frames, silences, clock jumps, page messages, signals and
//! recordings, on real twins and the real pipeline in one process, with invariants that must hold whatever happens.
//! Failing sequences are shrunk, and their seeds are kept in `proptest-regressions` next to this file.

mod figures;
mod steps;
mod system;

use std::sync::atomic::Ordering;

use dermis_lab::twin_commands::TwinCommand;
use dermis_twin::Treatment;
use dermis_twin::instrument::Fault;
use dermis_twin::physics::Cut;
use proptest::prelude::*;
use proptest::test_runner::{Config, FileFailurePersistence, RngSeed};

use figures::FIGURES;
use steps::{Spoilt, Step, step};
use system::{System, peak_bytes, replayed};

/// Number of sequences requested with `DERMIS_FUZZ`.
fn asked() -> Option<u32> {
    std::env::var("DERMIS_FUZZ").ok().and_then(|text| text.parse().ok())
}

proptest! {
    #![proptest_config(Config {
        cases: asked().unwrap_or(12),
        // The same sequences in every test run, but random ones if a number is requested.
        rng_seed: if asked().is_some() { RngSeed::Random } else { RngSeed::Fixed(1) },
        max_shrink_iters: 200,
        failure_persistence: Some(Box::new(FileFailurePersistence::WithSource("proptest-regressions"))),
        ..Config::default()
    })]

    #[test]
    fn random_sequences_never_stop_the_system_and_its_counts_add_up(
        skin in prop_oneof![
            4 => Just("healing-square"),
            2 => Just("ionic-disc"),
            1 => Just("hydrogel-disc"),
            1 => Just("piezo-disc"),
            1 => Just("em-8"),
        ],
        before in prop::collection::vec(step(), 0..4),
        steps in prop::collection::vec(step(), 1..40),
        whole in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut system = System::new(skin, folder.path());
        if whole {
            // Recorded from the first frame on, and no command can end it: the replay is compared bit for bit.
            system.record_all();
        }
        before.iter().for_each(|step| system.take(step));
        // Past the baseline.
        system.take(&Step::Frames(40));
        steps.iter().for_each(|step| system.take(step));
        let images = system.recording.as_ref().filter(|_| whole).map(|(_, images)| images.clone());
        system.end();
        if let Some(images) = images {
            replayed(&folder.path().join("0.mcap"), &images);
        }
        let sequences = FIGURES.sequences.fetch_add(1, Ordering::Relaxed) + 1;
        if asked().is_some_and(|asked| sequences.is_multiple_of(100) || sequences == u64::from(asked)) {
            FIGURES.tell();
        }
    }
}

#[test]
fn three_equal_cuts_are_one_and_the_stream_continues() {
    let folder = tempfile::tempdir().unwrap();
    let mut system = System::new("healing-square", folder.path());
    system.take(&Step::Frames(40));
    for _ in 0..4 {
        let cut = TwinCommand::Treat(Treatment::Cut(Cut::open([0.0, 0.0], [0.02, 0.0])));
        system.take(&Step::Command(cut, 3));
        system.take(&Step::Frames(2));
    }
    system.end();
    assert_eq!(system.processed, 48);
}

#[test]
fn first_frames_without_readings_delay_the_baseline_and_end_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut system = System::new("healing-square", folder.path());
    for _ in 0..50 {
        system.take(&Step::Spoil(Spoilt::All(f64::NAN), 1));
    }
    assert!(system.pipeline.hyperparameter().is_none());
    system.take(&Step::Frames(40));
    assert!(system.pipeline.hyperparameter().is_some(), "no baseline although readings come");
    system.end();
}

#[test]
fn silence_is_reported_and_ended_by_the_next_frame() {
    let folder = tempfile::tempdir().unwrap();
    let mut system = System::new("ionic-disc", folder.path());
    system.take(&Step::Frames(40));
    for (milliseconds, has_word) in [(500, false), (5_000, false), (200, true), (90_000, true)] {
        system.take(&Step::Silence(milliseconds, has_word));
        system.take(&Step::Frames(2));
    }
    system.end();
}

#[test]
fn a_stopped_recording_has_every_earlier_frame() {
    let folder = tempfile::tempdir().unwrap();
    let mut system = System::new("ionic-disc", folder.path());
    system.take(&Step::RecordStart);
    system.take(&Step::Frames(20));
    system.take(&Step::Signal);
    system.take(&Step::Frames(20));
    system.end();
    assert_eq!(system.processed, 40);
}

#[test]
fn first_frames_of_zeros_delay_the_baseline_and_end_nothing() {
    for skin in ["healing-square", "ionic-disc", "em-8"] {
        let folder = tempfile::tempdir().unwrap();
        let mut system = System::new(skin, folder.path());
        system.take(&Step::Spoil(Spoilt::All(0.0), 1));
        (0..150).for_each(|_| system.take(&Step::Spoil(Spoilt::All(0.0), 1)));
        assert!(system.pipeline.hyperparameter().is_none(), "{skin}: a baseline of zeros");
        system.take(&Step::Frames(120));
        assert!(system.pipeline.hyperparameter().is_some(), "{skin}: no baseline although readings come");
        assert!(system.pipeline.health().is_sound(), "{skin}: what was wrong before the start is held against it");
        system.end();
    }
}

#[test]
fn hyperparameters_that_cannot_be_used_are_refused_and_channels_may_fail_meanwhile() {
    for skin in ["healing-square", "ionic-disc", "piezo-disc", "em-8"] {
        let folder = tempfile::tempdir().unwrap();
        let mut system = System::new(skin, folder.path());
        system.take(&Step::Frames(40));
        let usual = system.pipeline.hyperparameter().unwrap();
        for lambda in [1e-300, 1e300, 1e-150, 1e150] {
            system.take(&Step::Hyperparameter(lambda));
            system.take(&Step::Frames(40));
            assert_eq!(system.pipeline.hyperparameter(), Some(usual), "{skin} went on with {lambda:e}");
        }
        // One hardly regularises, the other ignores almost all of the data.
        for lambda in [1e-6 * usual, 1e6 * usual] {
            system.take(&Step::Hyperparameter(lambda));
            system.take(&Step::Frames(40));
            for channel in [0, 7, 13] {
                let stuck = TwinCommand::Break(Fault::StuckChannel { channel, value_v: 0.0 });
                system.take(&Step::Command(stuck, 1));
                system.take(&Step::Frames(30));
            }
            system.take(&Step::Command(TwinCommand::Repair, 1));
        }
        system.end();
    }
}
