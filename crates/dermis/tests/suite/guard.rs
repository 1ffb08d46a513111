//! The guard on skins with broken instruments: every fault leads to `stop` or `stale` within the time in which it is
//! recognised or the age limit passes, and none to `ok` while something presses.

use std::sync::Arc;

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::{GuardSettings, Skin};
use dermis_touch::guard::{GuardReason, GuardReport, GuardVerdict};
use dermis_touch::health::HEALTH_WINDOW;
use dermis_twin::{AnyTwin, TwinKit};

/// Turns readings into the values that are sent.
type Spoil = fn(&[f64], &mut [f64]);

/// Longest age of a frame in these tests, far above the processing time on a busy machine, milliseconds.
const STALE_AFTER_MS: f64 = 400.0;

/// Frames at rest after the baseline. The frame that completes it waits for the operator, and is held for that long.
const REST: usize = 100;

/// A twin and the guarded pipeline that follows it.
struct Line {
    twin: AnyTwin,
    pipeline: Pipeline,
    ticks: u64,
    frame_ns: u64,
    sent: Vec<f64>,
}

impl Line {
    fn new(prepared: &Arc<Prepared>) -> Self {
        let layout = Layout::Channels { count: prepared.channels() };
        let mut pipeline = Pipeline::new(prepared.clone(), &layout, None).unwrap();
        let settings = GuardSettings { stale_after_ms: Some(STALE_AFTER_MS), ..GuardSettings::default() };
        pipeline.set_guard(Some(settings)).unwrap();
        let frame_ns = (1e9 / prepared.skin.backend.frames_per_s.unwrap()) as u64;
        let twin = TwinKit::of(&prepared.skin).unwrap().twin;
        Self { twin, pipeline, ticks: 0, frame_ns, sent: Vec::new() }
    }

    fn step(&mut self, spoil: Option<Spoil>) -> GuardReport {
        let time_ns = self.ticks * self.frame_ns;
        let mut values = Vec::new();
        self.twin.step(1e-9 * time_ns as f64, &mut values).unwrap();
        if let Some(spoil) = spoil {
            spoil(&self.sent, &mut values);
        }
        self.sent.clone_from(&values);
        let mut frame = Frame::default();
        frame.refill(self.ticks, HostStamp { monotonic_ns: time_ns, wall_ns: 0 }, &values, &[]);
        self.ticks += 1;
        self.pipeline.process(&frame, time_ns).unwrap().guard.expect("a guard")
    }

    fn verdicts(&mut self, frames: usize, spoil: Option<Spoil>) -> Vec<GuardVerdict> {
        (0..frames).map(|_| self.step(spoil).verdict).collect()
    }

    fn press(&mut self) {
        let pressure_pa = if self.pipeline.prepared().skin.name == "ionic-disc" { 1.2e3 } else { 80e3 };
        self.twin.scene_mut().press(1, 0.01, -0.008, 0.01, pressure_pa).unwrap();
    }

    /// Frames after which a fault must be known.
    fn most_frames(&self) -> usize {
        HEALTH_WINDOW.max((1e6 * STALE_AFTER_MS) as usize / self.frame_ns as usize + 1)
    }
}

fn prepared(name: &str) -> Arc<Prepared> {
    Arc::new(Prepared::new(Skin::open(name).unwrap()).unwrap())
}

fn assert_never_ok(what: &str, verdicts: &[GuardVerdict]) {
    assert!(!verdicts.contains(&GuardVerdict::Ok), "{what}: {verdicts:?}");
}

const FAULTS: [(&str, Spoil); 6] = [
    ("frozen", |sent, values| values.copy_from_slice(sent)),
    ("out of range", |_, values| values.iter_mut().for_each(|v| *v *= 1e12)),
    ("saturated", |_, values| {
        let sign = |k: usize| if k.is_multiple_of(3) { -10.0 } else { 10.0 };
        values.iter_mut().enumerate().for_each(|(k, v)| *v = sign(k));
    }),
    ("flipped", |_, values| values.iter_mut().for_each(|v| *v = -*v)),
    ("blank", |_, values| values.iter_mut().enumerate().for_each(|(k, v)| *v *= 1e-6 * (1 + k % 3) as f64)),
    ("missing", |_, values| values.fill(f64::NAN)),
];

#[test]
fn faults_of_whole_frames_are_never_ok_for_longer_than_they_take_to_recognise() {
    for name in ["healing-square", "ionic-disc"] {
        let prepared = prepared(name);
        for (fault, spoil) in FAULTS {
            let what = format!("{name}, {fault}");
            let mut line = Line::new(&prepared);
            assert_never_ok("before the baseline", &line.verdicts(31, None));
            let quiet = line.verdicts(REST, None);
            assert_eq!(quiet.last(), Some(&GuardVerdict::Ok), "{what}: {quiet:?}");
            let begun = line.most_frames();
            line.verdicts(begun, Some(spoil));
            assert_never_ok(&what, &line.verdicts(30, Some(spoil)));
            let after = line.verdicts(80, None);
            assert_eq!(after.last(), Some(&GuardVerdict::Ok), "{what}: {after:?}");
            // While something presses, the fault is never taken for the end of the press.
            line.press();
            let pressed = line.verdicts(15, None);
            assert_eq!(pressed.last(), Some(&GuardVerdict::Stop), "{what}: {pressed:?}");
            assert_never_ok(&what, &line.verdicts(30, Some(spoil)));
        }
    }
}

#[test]
fn a_lost_electrode_is_never_ok() {
    for name in ["healing-square", "ionic-disc"] {
        let text = dermis_skin::builtin_text(name).unwrap();
        let from_s = (40 + REST) as f64 / Skin::open(name).unwrap().backend.frames_per_s.unwrap();
        let faults = format!("faults = [{{ open_electrodes = [5], from_s = {from_s:.4} }}]");
        let skin = Skin::parse(&crate::with_twin(text, &faults), "a test").unwrap();
        let mut line = Line::new(&Arc::new(Prepared::new(skin).unwrap()));
        let before: Vec<GuardReport> = (0..38 + REST).map(|_| line.step(None)).skip(30 + REST).collect();
        assert!(before.iter().all(|report| report.verdict == GuardVerdict::Ok), "{name}: {before:?}");
        let begun = line.most_frames() + 3;
        line.verdicts(begun, None);
        assert_never_ok(name, &line.verdicts(40, None));
        assert!(line.step(None).reasons.contains(GuardReason::ChannelsLeftOut));
    }
}

#[test]
fn a_tare_forced_under_a_press_is_not_trusted_until_the_next_one() {
    let mut line = Line::new(&prepared("healing-square"));
    line.verdicts(45, None);
    line.press();
    assert_eq!(line.verdicts(15, None).last(), Some(&GuardVerdict::Stop));
    line.pipeline.tare(true, "a test").unwrap();
    line.verdicts(45, None);
    // The press is in the baseline and cannot be seen.
    let report = line.step(None);
    assert!(
        report.verdict != GuardVerdict::Ok && report.reasons.contains(GuardReason::BaselineUntrusted),
        "{report:?}"
    );
    line.twin.scene_mut().release(1);
    assert_never_ok("released", &line.verdicts(20, None));
    line.pipeline.tare(true, "let the skin rest").unwrap();
    line.verdicts(60, None);
    line.pipeline.tare(false, "a test").unwrap();
    let after = line.verdicts(60, None);
    assert_eq!(after.last(), Some(&GuardVerdict::Ok), "{after:?}");
}

#[test]
fn a_guard_without_watched_health_is_refused() {
    let mut skin = Skin::open("healing-square").unwrap();
    skin.health.watch = false;
    let prepared = Prepared::new(skin).unwrap();
    let layout = Layout::Channels { count: prepared.channels() };
    let mut pipeline = Pipeline::new(prepared, &layout, None).unwrap();
    let refused = pipeline.set_guard(Some(GuardSettings::default())).unwrap_err().to_string();
    assert!(refused.contains("health.watch = false: expected true"), "{refused}");
}
