//! Runs the system one step at a time, and checks the invariants after each.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use dermis_device::acquire::AcquisitionCounters;
use dermis_device::{Frame, Source, SourceEvent};
use dermis_lab::twin_commands::{CommandRefused, MOST_TREATMENTS, TwinCommand, TwinCommands};
use dermis_lab::twin_source::TwinSource;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::skin_frame::SkinFrame;
use dermis_page::feed::PageFeed;
use dermis_page::message::Notice;
use dermis_page::protocol::{Encoded, PageMessage, parse};
use dermis_page::{Announcer, Command, Scene, SourceState};
use dermis_record::{Entry, LiveRecording, Recording, RecordingHead, RerunOptions, rerun};
use dermis_skin::Skin;
use dermis_skin::budget::Budget;
use dermis_touch::TouchPhase;
use dermis_twin::from_skin::treatment_of;

use super::figures::{FIGURES, State, some};
use super::steps::{Spoilt, Step};

/// Maximum time for a recording to end once told to, even on a busy machine.
const ENDED_WITHIN: Duration = Duration::from_secs(60);
/// Memory allowed beyond the budget, which only covers the start, for queues, recording and page of a running system,
/// bytes.
const BESIDES: f64 = 100e6;
/// Factor on the budget: a second operator may be in preparation while one is in use, and an allocator with a heap
/// per thread may keep freed memory.
const KEPT: f64 = 2.0;
/// Header before the values of an image message, bytes.
const IMAGE_HEADER: usize = 32;

/// Results of the frames, for comparison with a replay.
pub type Images = Vec<(u64, Vec<u32>, usize)>;

/// The running system and the facts known about it.
pub struct System<'a> {
    skin: &'static str,
    source: TwinSource,
    commands: TwinCommands,
    pub pipeline: Pipeline,
    budget: f64,
    scene: Scene,
    feed: PageFeed,
    announcer: Announcer,
    head: RecordingHead,
    folder: &'a Path,
    pub recording: Option<(LiveRecording, Images)>,
    recordings: u32,
    /// If true, nothing ends the recording before the system ends.
    records_all: bool,
    /// The recording was told to end from elsewhere.
    is_told: bool,
    /// Offset of the device's clock, nanoseconds.
    clock_ns: i64,
    /// Offset of the host's wall clock, nanoseconds.
    wall_ns: i64,
    /// Offset of all clocks, from time without frames, nanoseconds.
    silence_ns: u64,
    now_ns: u64,
    follows_silence: bool,
    /// Memory in use before this system started, bytes; `None` if it cannot be measured.
    memory_before: Option<f64>,
    /// Offset subtracted from the device's frame numbers.
    counted_from: u64,
    begun: BTreeSet<u64>,
    ended: BTreeSet<u64>,
    /// Readings of the last frame.
    last_values: Vec<f64>,
    given: u64,
    pub processed: u64,
    refused: u64,
    lost: u64,
}

impl<'a> System<'a> {
    pub fn new(name: &'static str, folder: &'a Path) -> Self {
        let memory_before = forget_peak().and_then(|()| peak_bytes());
        let skin = Skin::open(name).unwrap();
        let budget = Budget::of_imaging(&skin).bytes + Budget::of_twin(&skin, skin.imaging.elements as f64).bytes;
        let (source, commands) = TwinSource::new(&skin).unwrap();
        let source = source.unpaced();
        let prepared = Prepared::new(skin).unwrap();
        let head = RecordingHead::of(&prepared, source.layout().clone(), source.name());
        let layout = source.layout().clone();
        let pipeline = Pipeline::new(prepared, &layout, None).unwrap();
        Self {
            skin: name,
            scene: dermis_page::scene(pipeline.prepared(), Some(source.press_range()), None),
            feed: PageFeed::new(&pipeline),
            announcer: Announcer::new(&pipeline.prepared().skin),
            source,
            commands,
            pipeline,
            budget,
            head,
            folder,
            recording: None,
            recordings: 0,
            records_all: false,
            is_told: false,
            clock_ns: 0,
            wall_ns: 0,
            silence_ns: 0,
            now_ns: 0,
            follows_silence: false,
            memory_before,
            counted_from: 0,
            begun: BTreeSet::new(),
            ended: BTreeSet::new(),
            last_values: Vec::new(),
            given: 0,
            processed: 0,
            refused: 0,
            lost: 0,
        }
    }

    /// Records from here to the end, whatever other steps request.
    pub fn record_all(&mut self) {
        self.take(&Step::RecordStart);
        self.records_all = true;
    }

    pub fn take(&mut self, step: &Step) {
        match step {
            Step::Frames(count) => (0..*count).for_each(|_| self.frame(None)),
            Step::Spoil(spoilt, times) => (0..*times).for_each(|_| self.frame(Some(*spoilt))),
            Step::Command(command, times) => self.command(*command, *times),
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
            Step::RecordStop if !self.records_all => self.stop(),
            Step::RecordStart | Step::RecordStop => {}
            Step::Page(text) => self.hear(text),
            Step::Silence(milliseconds, has_word) => self.silence(*milliseconds, *has_word),
            Step::Signal if self.records_all => {}
            Step::Signal => {
                if let Some((recording, _)) = &self.recording {
                    recording.stop().ask();
                    assert!(recording.stop().wait(ENDED_WITHIN), "a recording that was told to end goes on");
                    self.is_told = true;
                }
            }
        }
    }

    fn command(&mut self, command: TwinCommand, times: u32) {
        FIGURES.commands.fetch_add(u64::from(times), Ordering::Relaxed);
        for _ in 0..times {
            if let Err(refused) = self.commands.send(command) {
                assert!(
                    matches!(refused, CommandRefused::Full { waiting, .. } if waiting >= MOST_TREATMENTS),
                    "{refused}"
                );
            }
        }
    }

    /// Handles a message from a page.
    fn hear(&mut self, text: &str) {
        FIGURES.messages.fetch_add(1, Ordering::Relaxed);
        let command = match parse::<Command>(text) {
            Ok(PageMessage::Ask(_, command)) => command,
            Ok(PageMessage::Acknowledge(_)) => return,
            Err((_, reason)) => return assert!(!reason.is_empty(), "{text:?} was refused without a reason"),
        };
        if let Err(reason) = command.check(&self.scene) {
            return assert!(!reason.is_empty(), "{command:?} was refused without a reason");
        }
        match command {
            Command::Tare { force } => self.take(&Step::Tare { force }),
            Command::RecordStart => self.take(&Step::RecordStart),
            Command::RecordStop => self.take(&Step::RecordStop),
            Command::Hyperparameter(value) => self.take(&Step::Hyperparameter(value)),
            Command::Press(press) | Command::Move(press) => {
                let press = TwinCommand::Press {
                    pointer: press.pointer_id,
                    position_m: press.position_m(),
                    radius_m: press.radius_m(),
                    pressure_pa: press.pressure_pa(),
                };
                self.command(press, 1);
            }
            Command::Release { pointer_id } => self.command(TwinCommand::Release { pointer: pointer_id }, 1),
            Command::Treat(action) => self.command(TwinCommand::Treat(treatment_of(action)), 1),
            Command::Demonstrate(wanted) => self.command(TwinCommand::Demonstrate(wanted), 1),
            Command::ChooseChannels(_) => {}
        }
    }

    /// Time without frames: the page must not call the last frame fresh.
    fn silence(&mut self, milliseconds: u32, has_word: bool) {
        let problem = has_word.then(|| "no connection".to_owned());
        // The pipeline checks ten times a second.
        for _ in 0..=milliseconds / 100 {
            self.feed.wait(problem.clone(), self.now_ns);
            self.now_ns += 100_000_000;
            self.silence_ns += 100_000_000;
        }
        let update = self.feed.update();
        let state = &update.state.source;
        assert!(milliseconds < 1_100 || *state != SourceState::Running, "{state:?} after {milliseconds} ms of silence");
        assert!(!has_word || matches!(state, SourceState::Lost { .. }), "{state:?} with a word of the source");
        assert!(*state == SourceState::Running || update.fps == 0.0, "{} frames a second of none", update.fps);
        self.follows_silence = true;
    }

    /// Takes the next frame of the twin, possibly corrupted.
    fn frame(&mut self, spoilt: Option<Spoilt>) {
        let mut frame = Frame::default();
        match self.source.next_frame(&mut frame, Duration::ZERO).expect("the twin goes on") {
            SourceEvent::Frame => {}
            SourceEvent::Idle => return,
            SourceEvent::End => panic!("the twin has ended"),
        }
        assert!(frame.values.iter().all(|value| value.is_finite()), "the twin gave {:?}", frame.values);
        self.given += 1;
        let mut times = 1;
        match spoilt {
            None => {}
            Some(Spoilt::All(value)) => frame.values.fill(value),
            Some(Spoilt::Some(every, value)) => frame.values.iter_mut().step_by(every).for_each(|v| *v = value),
            Some(Spoilt::Scaled(factor)) => frame.values.iter_mut().for_each(|v| *v *= factor),
            Some(Spoilt::Frozen) if self.last_values.len() == frame.values.len() => {
                frame.values.copy_from_slice(&self.last_values);
            }
            Some(Spoilt::Frozen) => {}
            Some(Spoilt::Length(length)) => frame.values.resize(length, 0.0),
            Some(Spoilt::Lost) => {
                self.lost += 1;
                return;
            }
            Some(Spoilt::Twice) => times = 2,
            Some(Spoilt::Clock(seconds)) => self.clock_ns += seconds * 1_000_000_000,
            Some(Spoilt::WallClock(seconds)) => self.wall_ns += seconds * 1_000_000_000,
            Some(Spoilt::Reset) => self.counted_from = frame.sequence,
        }
        self.last_values.clone_from(&frame.values);
        frame.sequence = frame.sequence.saturating_sub(self.counted_from);
        let device_ns = frame.device_time_ns.expect("a twin has a clock") + self.silence_ns;
        frame.device_time_ns = Some(device_ns.saturating_add_signed(self.clock_ns));
        frame.host_monotonic_ns += self.silence_ns;
        frame.host_wall_ns = (frame.host_wall_ns + self.silence_ns).saturating_add_signed(self.wall_ns);
        self.now_ns = self.now_ns.max(frame.host_monotonic_ns);
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
                // Only a wrong length makes a frame unfit.
                assert!(!whole, "a frame of the right length was refused: {error}");
                self.refused += 1;
                return;
            }
        };
        assert!(whole, "a frame of {} readings was taken", frame.values.len());
        self.processed += 1;
        FIGURES.frames.fetch_add(1, Ordering::Relaxed);
        let state = State {
            skin: self.skin,
            image: if !is_started {
                "no baseline"
            } else if output.image.iter().any(|v| v.is_finite()) {
                "images"
            } else {
                "held"
            },
            is_recording: self.recording.is_some(),
            is_touched: !output.touches.is_empty(),
            is_anomalous: output.anomalies.clock_jump_ns != 0
                || output.anomalies.renumbered
                || output.anomalies.lost_before > 0,
            follows_silence: std::mem::take(&mut self.follows_silence),
            damages: some(output.damage.damages.len()),
            faults: some(self.source.acting_faults().len()),
            is_sound: output.health.is_sound(),
        };
        FIGURES.states.lock().unwrap().insert(state);
        let finite = output.image.iter().zip(&inside).filter(|(value, inside)| **inside && value.is_finite()).count();
        let all = inside.iter().filter(|inside| **inside).count();
        assert!(finite == all || finite == 0, "{finite} of {all} pixels have a value");
        assert!(is_started || finite == 0, "an image before there is a baseline");
        identities(&output, &mut self.begun, &mut self.ended);
        if let Some((recording, images)) = self.recording.as_mut().filter(|_| !self.is_told) {
            recording.results(&output);
            let bits = output.image.iter().map(|value| value.to_bits()).collect();
            images.push((output.sequence, bits, output.touches.len()));
        }
        self.feed.show(&output, self.now_ns);
        for Notice { text, .. } in self.announcer.notices(&output) {
            assert!(!text.is_empty(), "an empty notice");
        }
        self.feed
            .count(AcquisitionCounters { lost: self.lost, bad: self.refused, ..AcquisitionCounters::default() }, None);
        self.feed.describe(&self.pipeline, self.now_ns);
        self.shown();
        if self.pipeline.baseline_records().len() > baselines
            && let Some((recording, _)) = &self.recording
        {
            recording.baseline(&self.pipeline, frame.host_wall_ns);
        }
    }

    /// Checks what the page is told after a frame.
    fn shown(&self) {
        let update = self.feed.update();
        assert_eq!(update.state.source, SourceState::Running);
        assert_eq!(update.counters[0].value, self.processed);
        let losses: u64 = update.counters.iter().filter(|counter| counter.is_loss).map(|counter| counter.value).sum();
        assert_eq!(losses, self.lost + self.refused);
        let Encoded { image, state, .. } = Encoded::new(self.processed, update);
        assert_eq!(image.len(), IMAGE_HEADER + 4 * update.image.values.len());
        let state: serde_json::Value = serde_json::from_str(&state).expect("a state that is JSON");
        let touches = state["touches"].as_array().expect("a list of touches");
        for touch in touches {
            for field in ["x_mm", "y_mm", "amplitude", "sigma_x_mm", "sigma_y_mm"] {
                assert!(touch[field].is_f64(), "{field} of {touch} is no number");
            }
        }
    }

    /// Ends the recording and reads it.
    pub fn stop(&mut self) {
        let Some((recording, images)) = self.recording.take() else { return };
        let is_told = std::mem::take(&mut self.is_told);
        let path = recording.path().to_owned();
        let end = recording.finish();
        assert_eq!((end.frames, end.error), (images.len() as u64, None));
        assert!(end.lost == 0 || is_told, "{} frames are not in the recording", end.lost);
        let mut recorded = Recording::open(&path).unwrap();
        let mut numbers = Vec::new();
        while let Some(entry) = recorded.next_entry().unwrap() {
            if let Entry::Frame(frame) = entry {
                numbers.push(frame.sequence);
            }
        }
        assert!(recorded.damage().is_none(), "{:?}", recorded.damage());
        assert_eq!(numbers, images.iter().map(|image| image.0).collect::<Vec<_>>());
    }

    /// Checks the invariants at the end.
    pub fn end(&mut self) {
        self.stop();
        assert_eq!(self.given, self.processed + self.refused + self.lost);
        assert!(self.ended.is_subset(&self.begun), "a touch ended that never began");
        assert!(self.source.notices().len() <= 64);
        if let (Some(before), Some(peak)) = (self.memory_before, peak_bytes()) {
            let (taken, most) = (1e-6 * (peak - before), 1e-6 * KEPT * (self.budget + BESIDES));
            assert!(taken < most, "{}: {taken:.0} MB in memory, where at most {most:.0} were expected", self.skin);
        }
    }
}

/// Resets the peak memory counter, if the operating system supports it.
fn forget_peak() -> Option<()> {
    std::fs::write("/proc/self/clear_refs", "5").ok()
}

/// Peak memory of this process since then, bytes, if it runs a single test.
pub fn peak_bytes() -> Option<f64> {
    std::env::var_os("NEXTEST")?;
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024.0)
}

/// Every touch begins once and ends once, and is seen only in between.
fn identities(output: &SkinFrame<'_>, begun: &mut BTreeSet<u64>, ended: &mut BTreeSet<u64>) {
    for touch in output.ended.iter() {
        assert!(begun.contains(&touch.id), "touch {} ended before it began", touch.id);
        assert!(ended.insert(touch.id), "touch {} ended twice", touch.id);
    }
    for touch in output.touches.iter().filter(|touch| touch.phase == TouchPhase::Begin) {
        assert!(begun.insert(touch.id), "touch {} began twice", touch.id);
    }
    for touch in output.touches.iter() {
        assert!(
            begun.contains(&touch.id) && !ended.contains(&touch.id),
            "touch {} is reported but not active",
            touch.id
        );
        assert!(touch.position_m.iter().all(|v| v.is_finite()), "{touch:?}");
    }
}

/// Replays a recording made from the first frame on and compares it bit for bit.
pub fn replayed(path: &Path, images: &Images) {
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
