//! A readout circuit is found in the middle of a stream, from the stream's own presses.

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

use dermis_device::{FileSpec, Frame, HostStamp, Layout};
use dermis_live::calibration::CircuitNews;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_record::{Entry, LiveRecording, Recording, RecordingHead, RerunOptions, rerun};
use dermis_skin::{CircuitChoice, Electronics, Preset, Skin, builtin_text};
use dermis_tomo::mesh::distance;
use dermis_touch::Observation;
use dermis_touch::damage::{Damage, DamageEvent};
use dermis_twin::AnyTwin;
use dermis_twin::physics::Cut;
use dermis_twin::{Frontend, Treatment};

/// The gel skin with a file that doesn't describe its board.
fn learner() -> Skin {
    let known = "circuit = { load = 0.47, idle = 0.15, reading = [-0.5, 1.0, -0.5] }";
    let text = builtin_text("hydrogel-disc").unwrap();
    assert!(text.contains(known));
    Skin::parse(&text.replace(known, "circuit = \"learn\""), "test").unwrap()
}

/// Positions all over a disc, metres: turned by the golden angle, with the radius growing as the square root.
fn places(count: usize, radius_m: f64, turn: f64) -> Vec<[f64; 2]> {
    let place = |n: usize| {
        let (r, angle) = (radius_m * ((n as f64 + 0.5) / count as f64).sqrt(), 2.399_963 * n as f64 + turn);
        [r * angle.cos(), r * angle.sin()]
    };
    // Neighbours in space are not neighbours in time.
    (0..count).map(|n| place(n * 7 % count)).collect()
}

/// The gel skin's twin behind its board, read without noise.
struct Gel {
    twin: AnyTwin,
    time_s: f64,
}

impl Gel {
    fn new() -> Self {
        let mut skin = Skin::open("hydrogel-disc").unwrap();
        skin.backend.electronics = Electronics { preset: Preset::Ideal, ..Electronics::default() };
        (skin.twin.element_mm, skin.twin.electrode_element_mm) = (Some(8.0), Some(4.0));
        Self { twin: AnyTwin::from_skin(&skin).unwrap(), time_s: 0.0 }
    }

    /// Readings after half a second.
    fn read(&mut self) -> Vec<f64> {
        self.time_s += 0.5;
        let mut frame = Vec::new();
        self.twin.step(self.time_s, &mut frame).unwrap();
        frame
    }

    fn press(&mut self, [x, y]: [f64; 2], radius_m: f64, pressure_pa: f64) -> Vec<f64> {
        self.twin.scene_mut().press(1, x, y, radius_m, pressure_pa).unwrap();
        self.read();
        self.read()
    }

    fn rest(&mut self) -> Vec<f64> {
        self.twin.scene_mut().release(1);
        self.read();
        self.read()
    }

    fn cut(&mut self, from_m: [f64; 2], to_m: [f64; 2]) {
        self.twin.frontend_mut().treat(&Treatment::Cut(Cut::open(from_m, to_m))).unwrap();
    }
}

/// The twin's readings at rest and under a press at each place.
fn twin_frames(places: &[[f64; 2]]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let mut gel = Gel::new();
    let rest = gel.read();
    let pressed = places.iter().map(|place| gel.press(*place, 9e-3, 30e3)).collect();
    (rest, pressed)
}

/// Frames at a fixed period, each with its own noise.
struct Stream {
    pipeline: Pipeline,
    recording: Option<LiveRecording>,
    period_ns: u64,
    noise: f64,
    number: u64,
    news: Vec<(u64, CircuitNews)>,
    /// Every touch of every frame, as exact bits.
    touches: Vec<(u64, [u64; 2])>,
    /// Every damage of every frame, as exact bits, and the damage events.
    damages: Vec<(u64, [u64; 5])>,
    events: Vec<(u64, DamageEvent)>,
}

impl Stream {
    fn new(skin: Skin, period_ns: u64, noise: f64) -> Self {
        let prepared = Prepared::new(skin).unwrap();
        let layout = Layout::Channels { count: prepared.channels() };
        let pipeline = Pipeline::new(prepared, &layout, None).unwrap();
        let (news, touches, damages, events) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { pipeline, recording: None, period_ns, noise, number: 0, news, touches, damages, events }
    }

    /// Processes the same readings `count` times and returns the position of the strongest touch.
    fn run(&mut self, readings: &[f64], count: u64) -> Option<[f64; 2]> {
        let mut place = None;
        for _ in 0..count {
            let time_ns = self.number * self.period_ns;
            let noise = |channel: usize| {
                // A hash of frame and channel, scaled to -1 to 1.
                let hash = (self.number << 16 | channel as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                ((hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64 / f64::from(1 << 23) - 1.0
            };
            let values: Vec<f64> =
                readings.iter().enumerate().map(|(channel, v)| v + self.noise * noise(channel)).collect();
            let mut frame = Frame::default();
            frame.refill(self.number, HostStamp { monotonic_ns: time_ns, wall_ns: time_ns }, &values, &[]);
            self.recording.iter_mut().for_each(|recording| recording.frame(&frame));
            let output = self.pipeline.process(&frame, time_ns).unwrap();
            self.recording.iter_mut().for_each(|recording| recording.results(&output));
            self.news.extend(output.circuit.map(|news| (self.number, news)));
            let seen = output.touches.iter().filter(|touch| touch.observation != Observation::Missed);
            place = seen.max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).map(|touch| touch.position_m);
            self.touches.extend(output.touches.iter().map(|t| (self.number, t.position_m.map(f64::to_bits))));
            self.damages.extend(output.damage.damages.iter().map(|damage| (self.number, bits(damage))));
            self.events.extend(output.damage.events.iter().map(|event| (self.number, *event)));
            self.number += 1;
        }
        place
    }
}

fn bits(damage: &Damage) -> [u64; 5] {
    let [x, y] = damage.shape.centre_m;
    [damage.id, x.to_bits(), y.to_bits(), damage.depth.to_bits(), damage.share.to_bits()]
}

/// Errors of the touches found, millimetres: number, median, 90th percentile.
fn errors_mm(found: &[Option<[f64; 2]>], places: &[[f64; 2]]) -> (usize, f64, f64) {
    let off = |(found, place): (&Option<[f64; 2]>, &[f64; 2])| found.map(|found| 1e3 * distance(found, *place));
    let mut errors: Vec<f64> = found.iter().zip(places).filter_map(off).collect();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors.get((errors.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN);
    (errors.len(), at(0.5), at(0.9))
}

#[test]
fn finding_the_circuit_improves_positions_and_reruns_are_bit_identical() {
    let (taught, tested) = (places(24, 0.065, 0.0), places(20, 0.06, 1.0));
    let (rest, taught_frames) = twin_frames(&taught);
    let (_, tested_frames) = twin_frames(&tested);
    let largest = rest.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut stream = Stream::new(learner(), 50_000_000, 1e-5 * largest);
    let head = RecordingHead::of(stream.pipeline.prepared(), Layout::Channels { count: rest.len() }, "test");
    stream.recording = Some(LiveRecording::start(&path, &head, &stream.pipeline, 0.0).unwrap());
    stream.run(&rest, 40);
    // Use smoother images than the skin file's. They must stay so once the circuit is found.
    let by_file = stream.pipeline.hyperparameter().unwrap();
    stream.recording.as_ref().unwrap().hyperparameter(1.5 * by_file);
    stream.pipeline.set_hyperparameter(1.5 * by_file).unwrap();
    let press = |stream: &mut Stream, frames: &[Vec<f64>]| -> Vec<Option<[f64; 2]>> {
        let of_one = |frame: &Vec<f64>| {
            let place = stream.run(frame, 5);
            stream.run(&rest, 5);
            place
        };
        frames.iter().map(of_one).collect()
    };
    let before = press(&mut stream, &taught_frames);
    stream.run(&rest, 640);
    let after = press(&mut stream, &tested_frames);
    let (before, after) = (errors_mm(&before, &taught), errors_mm(&after, &tested));
    println!("found, median and 90th percentile before {before:.2?}, after {after:.2?}");
    let [(at, news)] = stream.news[..] else { panic!("{:?}", stream.news) };
    println!("frame {at}: {}", news.describe());
    assert!(news.is_new && news.fit.score > news.fit.score_before + 0.05 && news.fit.is_trusted(), "{news:?}");
    assert!(matches!(stream.pipeline.prepared().skin.backend.circuit, Some(CircuitChoice::Known(_))));
    assert!(after.0 == tested.len() && after.1 < 0.6 * before.1 && after.1 < 5.0 && after.2 < 10.0);
    let (lambda, by_rule) = (stream.pipeline.hyperparameter().unwrap(), stream.pipeline.rule_hyperparameter().unwrap());
    assert!(
        (lambda / by_rule - 1.5).abs() < 1e-9 && (by_rule / by_file - 1.0).abs() > 0.01,
        "{lambda} {by_rule} {by_file}"
    );

    let end = stream.recording.take().unwrap().finish();
    assert_eq!((end.lost, end.error), (0, None));
    let mut recording = Recording::open(&path).unwrap();
    let mut said = 0;
    while let Some(entry) = recording.next_entry().unwrap() {
        said += usize::from(matches!(entry, Entry::Event { entry, .. } if entry.event == "circuit"));
    }
    assert_eq!(said, 1);
    let mut recording = Recording::open(&path).unwrap();
    let skin = Skin::parse(recording.skin_toml(), "test").unwrap();
    let mut pipeline = recording.head().pipeline(skin, &path).unwrap();
    let mut again = Vec::new();
    rerun(&mut recording, &mut pipeline, RerunOptions::default(), &AtomicBool::new(false), |output| {
        again.extend(output.touches.iter().map(|t| (output.sequence, t.position_m.map(f64::to_bits))));
        Ok(ControlFlow::Continue(()))
    })
    .unwrap();
    assert!(again == stream.touches, "{} touches, {} in the rerun", stream.touches.len(), again.len());
}

/// A gel is cut before its circuit is found: the damage keeps its identity, is placed by the new model, and heals.
#[test]
fn damage_stays_known_when_a_circuit_is_found() {
    let (from_m, to_m) = ([0.014, 0.018], [0.041, 0.03]);
    let mut gel = Gel::new();
    let rest = gel.rest();
    let before: Vec<Vec<f64>> = places(8, 0.06, 0.5).iter().map(|place| gel.press(*place, 9e-3, 30e3)).collect();
    // A blade, with the weight of a hand next to it.
    gel.cut(from_m, to_m);
    let blade = gel.press([-0.01, -0.01], 0.025, 200e3);
    let cut = gel.rest();
    let after: Vec<Vec<f64>> = places(16, 0.06, 1.7).iter().map(|place| gel.press(*place, 9e-3, 30e3)).collect();
    let largest = rest.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let mut skin = learner();
    skin.damage.watch = true;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut stream = Stream::new(skin, 50_000_000, 1e-5 * largest);
    let head = RecordingHead::of(stream.pipeline.prepared(), Layout::Channels { count: rest.len() }, "test");
    stream.recording = Some(LiveRecording::start(&path, &head, &stream.pipeline, 0.0).unwrap());
    stream.run(&rest, 60);
    for frame in &before {
        stream.run(frame, 5);
        stream.run(&rest, 20);
    }
    stream.run(&blade, 2);
    stream.run(&cut, 60);
    let [(_, DamageEvent::Begin(first))] = stream.events[..] else { panic!("{:?}", stream.events) };
    for frame in &after {
        stream.run(frame, 5);
        stream.run(&cut, 25);
    }
    stream.run(&cut, 640);
    let [(at, news)] = stream.news[..] else { panic!("{:?}", stream.news) };
    assert!(news.is_new && news.fit.is_trusted(), "frame {at}: {news:?}");
    let known = stream.pipeline.damage();
    let [damage] = known.damages[..] else { panic!("{:?}", known.damages) };
    let middle_m = [0, 1].map(|axis| 0.5 * (from_m[axis] + to_m[axis]));
    let off_mm = |damage: &Damage| 1e3 * distance(damage.shape.centre_m, middle_m);
    println!("frame {at}: {:.1} mm off, then {:.1} mm; {damage:?}", off_mm(&first), off_mm(&damage));
    assert_eq!((damage.id, known.intact), (first.id, Some(0)));
    assert!(damage.is_open() && damage.share > 0.8 && off_mm(&damage) < 12.0, "{damage:?}");
    assert_eq!(stream.events.len(), 1, "{:?}", stream.events);
    stream.run(&rest, 200);
    let healed = stream.events.iter().any(|(_, event)| matches!(event, DamageEvent::Healed(d) if d.id == first.id));
    assert!(healed, "{:?}", stream.events);
    let end = stream.recording.take().unwrap().finish();
    assert_eq!((end.lost, end.error), (0, None));
    let mut recording = Recording::open(&path).unwrap();
    let skin = Skin::parse(recording.skin_toml(), "test").unwrap();
    let mut pipeline = recording.head().pipeline(skin, &path).unwrap();
    let (mut touches, mut damages) = (Vec::new(), Vec::new());
    rerun(&mut recording, &mut pipeline, RerunOptions::default(), &AtomicBool::new(false), |output| {
        touches.extend(output.touches.iter().map(|t| (output.sequence, t.position_m.map(f64::to_bits))));
        damages.extend(output.damage.damages.iter().map(|damage| (output.sequence, bits(damage))));
        Ok(ControlFlow::Continue(()))
    })
    .unwrap();
    assert!(touches == stream.touches && damages == stream.damages, "another rerun");
}

/// The published presses as a stream: for each, its untouched frame for a while, then the press.
#[test]
fn the_circuit_of_the_measured_gel_skin_is_found_while_it_is_pressed() {
    let Some(folder) = dermis_testdata::set("hydrogel") else { return };
    let read = |name: &str| dermis_device::read(&FileSpec::all(folder.join(name)), None).unwrap();
    let (before, pressed) = (read("ohmc16_before.csv"), read("ohmc16_pressed.csv"));
    let pokes = dermis_live::calibration::read_pokes(&folder.join("ohmc16_positions.csv")).unwrap();
    let mut skin = learner();
    // The gel creeps from press to press.
    skin.touch.drift_time_constant_s = 1.0;
    // Readings are in the thousands; bit-identical frames would count as frozen.
    let mut stream = Stream::new(skin, 500_000_000, 1e-3);
    for n in 0..32 {
        stream.run(before.row(n).unwrap(), 1);
    }
    let mut found: Vec<(u64, Option<[f64; 2]>)> = Vec::new();
    for n in 32..500 {
        stream.run(before.row(n).unwrap(), 12);
        found.push((stream.number, stream.run(pressed.row(n).unwrap(), 3)));
    }
    let mut ends: Vec<u64> = stream.news.iter().map(|(at, _)| *at).collect();
    stream.news.iter().for_each(|(at, news)| println!("frame {at}: {}", news.describe()));
    ends.push(u64::MAX);
    let mut from = 0;
    let mut outcomes = Vec::new();
    for to in ends {
        let (places, positions): (Vec<_>, Vec<_>) = found
            .iter()
            .zip(&pokes.positions_m[32..])
            .filter(|((at, _), _)| (from..to).contains(at))
            .map(|((_, place), position)| (*place, *position))
            .unzip();
        let outcome = errors_mm(&places, &positions);
        println!("frames {from} to {to}, {} presses: found, median, 90th percentile {outcome:.2?}", places.len());
        outcomes.push(outcome);
        from = to;
    }
    let last = outcomes[outcomes.len() - 1];
    assert!(
        stream.news.len() >= 2 && stream.news[0].1.is_new && stream.news[0].1.fit.is_trusted(),
        "{:?}",
        stream.news
    );
    assert!(last.0 > 180 && last.1 < 6.0 && last.2 < 12.0, "{outcomes:?}");
}
