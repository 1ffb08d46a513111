//! Random sequences of presses, cuts, faults, damaged frames, clock jumps, commands and recordings on the real twin and
//! the real pipeline in one process, with what must hold whatever happens. Sequences that fail shrink, and their seeds
//! are kept in `proptest-regressions` beside this file.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use dermis::lab::twin_commands::{MOST_TREATMENTS, MOST_WAITING, TwinCommand, TwinCommands};
use dermis::lab::twin_source::TwinSource;
use dermis::live::output::Output;
use dermis::live::pipeline::Pipeline;
use dermis::live::prepare::Prepared;
use dermis::record::{LiveRecording, Recording, RecordingHead, RerunOptions, rerun};
use dermis::skin::Skin;
use dermis::twin::instrument::Fault;
use dermis::twin::physics::Cut;
use dermis::twin::{Heating, Treatment};
use dermis_device::{Frame, Source, SourceEvent};
use dermis_touch::TouchEvent;
use proptest::prelude::*;
use proptest::test_runner::{Config, FileFailurePersistence, RngSeed};

/// One thing that happens.
#[derive(Debug, Clone)]
enum Step {
    /// Frames go by.
    Frames(u32),
    /// Someone commands the twin, so many times the same.
    Command(TwinCommand, u32),
    /// The next frame is spoilt on its way.
    Spoil(Spoilt),
    Tare {
        force: bool,
    },
    Hyperparameter(f64),
    RecordStart,
    RecordStop,
}

/// What becomes of a frame on its way.
#[derive(Debug, Clone, Copy)]
enum Spoilt {
    /// Every reading is this.
    All(f64),
    /// One in so many readings is this.
    Some(usize, f64),
    /// Readings are missing, or too many.
    Length(usize),
    /// It never comes.
    Lost,
    /// It comes twice.
    Twice,
    /// The device's clock is set by so many seconds.
    Clock(i64),
    /// The device counts anew.
    Reset,
}

fn place() -> impl Strategy<Value = [f64; 2]> {
    // On the skin, beside it, and nowhere.
    let near = (-0.06..0.06, -0.06..0.06).prop_map(|(x, y)| [x, y]);
    prop_oneof![8 => near, 1 => Just([50.0, 0.0]), 1 => Just([f64::NAN, 0.0])]
}

fn command() -> impl Strategy<Value = TwinCommand> {
    let press = (0..3_u64, place(), prop_oneof![0.003..0.02, Just(0.0), Just(1e9)], -1e3..2e5).prop_map(
        |(pointer, position_m, radius_m, pressure_pa)| TwinCommand::Press {
            pointer,
            position_m,
            radius_m,
            pressure_pa,
        },
    );
    // A few lines only, so that equal cuts, cuts that cross and cuts through pads all come.
    let line = prop_oneof![
        Just([[0.0, 0.0], [0.02, 0.0]]),
        Just([[0.02, 0.0], [0.0, 0.0]]),
        Just([[0.01, -0.01], [0.01, 0.01]]),
        Just([[0.0, 0.0], [0.020001, 0.0]]),
        (place(), place()).prop_map(|(from, to)| [from, to]),
    ];
    let cut = line.prop_map(|[from, to]| Treatment::Cut(Cut::open(from, to)));
    let heat = (place(), 0.001..0.05, 20.0..160.0, 1.0..10_000.0).prop_map(
        |(centre_m, radius_m, temperature_c, duration_s)| {
            Treatment::Heat(Heating { centre_m, radius_m, temperature_c, duration_s })
        },
    );
    let treatment = prop_oneof![
        4 => cut,
        2 => heat,
        1 => Just(Treatment::Renew),
        1 => prop_oneof![Just(0.0), Just(3600.0), Just(1e6), Just(f64::NAN)].prop_map(Treatment::TimeLapse),
        1 => prop_oneof![Just(0.0), Just(0.01), Just(-0.01)].prop_map(Treatment::Warm),
    ];
    let fault = prop_oneof![
        (0..20_u32).prop_map(|electrode| Fault::OpenElectrode { electrode }),
        (0..20_u32, 0..20_u32).prop_map(|(a, b)| Fault::ShortedPair { electrodes: [a, b] }),
        (0..300_usize, -1.0..1.0).prop_map(|(channel, value_v)| Fault::StuckChannel { channel, value_v }),
        (0..300_usize, 0.0..0.1).prop_map(|(channel, deviation_v)| Fault::NoisyChannel { channel, deviation_v }),
        (0.0..1.2).prop_map(|probability| Fault::DroppedFrames { probability }),
        (0.0..1.0).prop_map(|probability| Fault::DuplicatedFrames { probability }),
    ];
    prop_oneof![
        5 => press,
        2 => (0..3_u64).prop_map(|pointer| TwinCommand::Release { pointer }),
        3 => treatment.prop_map(TwinCommand::Treat),
        2 => fault.prop_map(TwinCommand::Break),
        1 => Just(TwinCommand::Repair),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    let number = prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(0.0), Just(1e300), Just(-1e300)];
    let spoilt = prop_oneof![
        number.clone().prop_map(Spoilt::All),
        (1..9_usize, number).prop_map(|(every, value)| Spoilt::Some(every, value)),
        (0..400_usize).prop_map(Spoilt::Length),
        Just(Spoilt::Lost),
        Just(Spoilt::Twice),
        (-100_000..100_000_i64).prop_map(Spoilt::Clock),
        Just(Spoilt::Reset),
    ];
    prop_oneof![
        6 => (1..12_u32).prop_map(Step::Frames),
        6 => (command(), prop_oneof![4 => Just(1_u32), 1 => Just(400_u32)]).prop_map(|(c, n)| Step::Command(c, n)),
        4 => spoilt.prop_map(Step::Spoil),
        1 => any::<bool>().prop_map(|force| Step::Tare { force }),
        1 => prop_oneof![1e-6..1e3, Just(f64::NAN), Just(0.0), Just(1e300), Just(1e-300)].prop_map(Step::Hyperparameter),
        1 => Just(Step::RecordStart),
        1 => Just(Step::RecordStop),
    ]
}

/// What all sequences of this process did together.
struct Figures {
    sequences: AtomicU64,
    commands: AtomicU64,
    frames: AtomicU64,
    replays: AtomicU64,
    states: Mutex<BTreeSet<State>>,
}

/// A state of the running system, as coarse as a test of it would name it.
type State = (&'static str, bool, bool, bool, &'static str, &'static str, bool);

static FIGURES: Figures = Figures {
    sequences: AtomicU64::new(0),
    commands: AtomicU64::new(0),
    frames: AtomicU64::new(0),
    replays: AtomicU64::new(0),
    states: Mutex::new(BTreeSet::new()),
};

impl Figures {
    fn tell(&self) {
        let states = self.states.lock().unwrap();
        let one = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let (sequences, commands, frames) = (one(&self.sequences), one(&self.commands), one(&self.frames));
        println!(
            "{sequences} sequences, {commands} commands, {frames} frames, {} states, {} replays to the bit",
            states.len(),
            one(&self.replays)
        );
    }
}

/// Few, some, many.
fn some(count: usize) -> &'static str {
    match count {
        0 => "none",
        1 => "one",
        _ => "several",
    }
}

/// What came of the frames, to be compared with a replay.
type Images = Vec<(u64, Vec<u32>, usize)>;

/// The running system and what is known of it.
struct System<'a> {
    source: TwinSource,
    commands: TwinCommands,
    pipeline: Pipeline,
    head: RecordingHead,
    folder: &'a Path,
    recording: Option<(LiveRecording, Images)>,
    recordings: u32,
    /// Added to the device's clock, nanoseconds, and taken from its numbers.
    clock_ns: i64,
    counted_from: u64,
    last_number: u64,
    begun: BTreeSet<u64>,
    ended: BTreeSet<u64>,
    given: u64,
    processed: u64,
    refused: u64,
    lost: u64,
}

impl<'a> System<'a> {
    fn new(folder: &'a Path) -> Self {
        let skin = Skin::open("healing-square").unwrap();
        let (source, commands) = TwinSource::new(&skin).unwrap();
        let source = source.unpaced();
        let prepared = Prepared::new(skin).unwrap();
        let head = RecordingHead::of(&prepared, source.layout().clone(), source.name());
        let layout = source.layout().clone();
        let pipeline = Pipeline::new(prepared, &layout, None).unwrap();
        Self {
            source,
            commands,
            pipeline,
            head,
            folder,
            recording: None,
            recordings: 0,
            clock_ns: 0,
            counted_from: 0,
            last_number: 0,
            begun: BTreeSet::new(),
            ended: BTreeSet::new(),
            given: 0,
            processed: 0,
            refused: 0,
            lost: 0,
        }
    }

    fn take(&mut self, step: &Step) {
        match step {
            Step::Frames(count) => (0..*count).for_each(|_| self.frame(None)),
            Step::Spoil(spoilt) => self.frame(Some(*spoilt)),
            Step::Command(command, times) => {
                FIGURES.commands.fetch_add(u64::from(*times), Ordering::Relaxed);
                let taken = (0..*times).filter(|_| self.commands.send(*command).is_ok()).count();
                assert!(taken <= *times as usize, "{MOST_WAITING} {MOST_TREATMENTS}");
            }
            Step::Tare { force } => {
                if self.pipeline.tare(*force, "fuzz").is_ok() {
                    self.recording.iter().for_each(|(recording, _)| recording.tare(*force, "fuzz"));
                }
            }
            Step::Hyperparameter(value) => {
                if self.pipeline.set_hyperparameter(*value).is_ok() {
                    self.recording.iter().for_each(|(recording, _)| recording.hyperparameter(*value));
                }
            }
            Step::RecordStart if self.recording.is_none() => {
                let path = self.folder.join(format!("{}.mcap", self.recordings));
                self.recordings += 1;
                let recording = LiveRecording::start(&path, &self.head, &self.pipeline, 0.0).unwrap();
                self.recording = Some((recording, Images::new()));
            }
            Step::RecordStart => {}
            Step::RecordStop => self.stop(),
        }
    }

    /// The next frame of the twin, and what becomes of it.
    fn frame(&mut self, spoilt: Option<Spoilt>) {
        let mut frame = Frame::default();
        match self.source.next_frame(&mut frame, Duration::ZERO).expect("the twin goes on") {
            SourceEvent::Frame => {}
            SourceEvent::Idle => return,
            SourceEvent::End => panic!("the twin has ended"),
        }
        assert!(frame.values.iter().all(|value| value.is_finite()), "the twin gave {:?}", frame.values);
        self.given += 1;
        self.last_number = frame.sequence;
        let mut times = 1;
        match spoilt {
            None => {}
            Some(Spoilt::All(value)) => frame.values.fill(value),
            Some(Spoilt::Some(every, value)) => frame.values.iter_mut().step_by(every).for_each(|v| *v = value),
            Some(Spoilt::Length(length)) => frame.values.resize(length, 0.0),
            Some(Spoilt::Lost) => {
                self.lost += 1;
                return;
            }
            Some(Spoilt::Twice) => times = 2,
            Some(Spoilt::Clock(seconds)) => self.clock_ns += seconds * 1_000_000_000,
            Some(Spoilt::Reset) => self.counted_from = frame.sequence,
        }
        frame.sequence = frame.sequence.saturating_sub(self.counted_from);
        let device_ns = frame.device_time_ns.expect("a twin has a clock");
        frame.device_time_ns = Some(device_ns.saturating_add_signed(self.clock_ns));
        self.given += times - 1;
        for _ in 0..times {
            self.process(&frame);
        }
    }

    fn process(&mut self, frame: &Frame) {
        let channels = self.source.layout().channels();
        let whole = frame.values.len() == channels;
        if let Some((recording, _)) = self.recording.as_mut().filter(|_| whole) {
            recording.frame(frame);
        }
        let baselines = self.pipeline.baseline_records().len();
        let inside = self.pipeline.prepared().map.inside_mask().to_vec();
        let is_started = self.pipeline.hyperparameter().is_some();
        let output = match self.pipeline.process(frame, frame.host_monotonic_ns) {
            Ok(output) => output,
            Err(error) => {
                // Nothing but its length makes a frame unfit.
                assert!(!whole, "a frame of the right length was refused: {error}");
                self.refused += 1;
                return;
            }
        };
        assert!(whole, "a frame of {} readings was taken", frame.values.len());
        self.processed += 1;
        FIGURES.frames.fetch_add(1, Ordering::Relaxed);
        let state = (
            if !is_started {
                "no baseline"
            } else if output.image.iter().any(|v| v.is_finite()) {
                "images"
            } else {
                "held"
            },
            self.recording.is_some(),
            output.touches.is_empty(),
            output.anomalies.clock_jump_ns != 0 || output.anomalies.renumbered || output.anomalies.lost_before > 0,
            some(output.damage.damages.len()),
            some(self.source.acting_faults().len()),
            !output.health.is_sound(),
        );
        FIGURES.states.lock().unwrap().insert(state);
        let finite = output.image.iter().zip(&inside).filter(|(value, inside)| **inside && value.is_finite()).count();
        let all = inside.iter().filter(|inside| **inside).count();
        assert!(finite == all || finite == 0, "{finite} of {all} pixels have a value");
        assert!(is_started || finite == 0, "an image before there is a baseline");
        identities(&output, &mut self.begun, &mut self.ended);
        if let Some((recording, images)) = &mut self.recording {
            recording.results(&output);
            let bits = output.image.iter().map(|value| value.to_bits()).collect();
            images.push((output.sequence, bits, output.touches.len()));
        }
        if self.pipeline.baseline_records().len() > baselines
            && let Some((recording, _)) = &self.recording
        {
            recording.baseline(&self.pipeline, frame.host_wall_ns);
        }
    }

    /// Ends the recording, and compares its replay.
    fn stop(&mut self) {
        let Some((recording, images)) = self.recording.take() else { return };
        let path = recording.path().to_owned();
        let end = recording.finish();
        assert_eq!((end.frames, end.lost, end.error), (images.len() as u64, 0, None));
        let mut recorded = Recording::open(&path).unwrap();
        let mut numbers = Vec::new();
        while let Some(entry) = recorded.next_entry().unwrap() {
            if let dermis::record::Entry::Frame(frame) = entry {
                numbers.push(frame.sequence);
            }
        }
        assert!(recorded.damage().is_none(), "{:?}", recorded.damage());
        assert_eq!(numbers, images.iter().map(|image| image.0).collect::<Vec<_>>());
    }

    /// What must hold at the end of it all.
    fn end(&mut self) {
        self.stop();
        assert_eq!(self.given, self.processed + self.refused + self.lost);
        assert!(self.ended.is_subset(&self.begun), "a touch ended that never began");
        assert!(self.source.notices().len() <= 64);
    }
}

/// Every touch begins once and ends once, and is only seen between the two.
fn identities(output: &Output<'_>, begun: &mut BTreeSet<u64>, ended: &mut BTreeSet<u64>) {
    for event in output.events {
        match event {
            TouchEvent::Begin(touch) => assert!(begun.insert(touch.id), "touch {} began twice", touch.id),
            TouchEvent::End(touch) => {
                assert!(begun.contains(&touch.id), "touch {} ended before it began", touch.id);
                assert!(ended.insert(touch.id), "touch {} ended twice", touch.id);
            }
            _ => {}
        }
    }
    for touch in output.touches {
        assert!(begun.contains(&touch.id) && !ended.contains(&touch.id), "touch {} is there without being", touch.id);
        assert!(touch.position_m.iter().all(|v| v.is_finite()), "{touch:?}");
    }
}

/// A recording from the first frame on, replayed: the same bits.
fn replayed(path: &Path, images: &Images) {
    let mut recording = Recording::open(path).unwrap();
    let skin = Skin::parse(recording.skin_toml(), "replay").unwrap();
    let mut pipeline = recording.head().pipeline(skin, path).unwrap();
    let mut again = Images::new();
    rerun(&mut recording, &mut pipeline, RerunOptions::default(), &AtomicBool::new(false), |output| {
        let bits = output.image.iter().map(|value| value.to_bits()).collect();
        again.push((output.sequence, bits, output.touches.len()));
        Ok(ControlFlow::Continue(()))
    })
    .unwrap();
    assert_eq!(again.len(), images.len());
    for (again, first) in again.iter().zip(images) {
        assert_eq!((again.0, again.2), (first.0, first.2));
        assert!(again.1 == first.1, "another image of frame {} in the replay", first.0);
    }
    FIGURES.replays.fetch_add(1, Ordering::Relaxed);
}

/// Sequences that `DERMIS_FUZZ` asks for.
fn asked() -> Option<u32> {
    std::env::var("DERMIS_FUZZ").ok().and_then(|text| text.parse().ok())
}

proptest! {
    #![proptest_config(Config {
        cases: asked().unwrap_or(12),
        // The same sequences in every run of the tests; others where a number is asked for.
        rng_seed: if asked().is_some() { RngSeed::Random } else { RngSeed::Fixed(1) },
        max_shrink_iters: 200,
        failure_persistence: Some(Box::new(FileFailurePersistence::WithSource("proptest-regressions"))),
        ..Config::default()
    })]

    #[test]
    fn whatever_happens_the_system_goes_on_and_its_counts_add_up(
        before in prop::collection::vec(step(), 0..4),
        steps in prop::collection::vec(step(), 1..40),
        whole in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut system = System::new(folder.path());
        if whole {
            // Recorded from the first frame on, without commands to end it: the replay is compared to the bit.
            system.take(&Step::RecordStart);
        }
        before.iter().filter(|step| !(whole && matches!(step, Step::RecordStop))).for_each(|step| system.take(step));
        // Past the baseline.
        system.take(&Step::Frames(40));
        steps.iter().filter(|step| !(whole && matches!(step, Step::RecordStop))).for_each(|step| system.take(step));
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
fn three_equal_cuts_are_one_and_the_stream_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut system = System::new(folder.path());
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
    let mut system = System::new(folder.path());
    for _ in 0..50 {
        system.take(&Step::Spoil(Spoilt::All(f64::NAN)));
    }
    assert!(system.pipeline.hyperparameter().is_none());
    system.take(&Step::Frames(40));
    assert!(system.pipeline.hyperparameter().is_some(), "no baseline although readings come");
    system.end();
}
