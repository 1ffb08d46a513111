//! Running a recording through the pipeline again gives the results of the live run bit for bit, including commands.
//! A recording started in the middle of a run continues from the baseline then in use.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use dermis_device::{Frame, Source, SourceEvent};
use dermis_lab::twin_source::TwinSource;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::sink::{JsonLines, LinesFor, Sink};
use dermis_record::{Entry, LiveRecording, Recording, RecordingHead, RerunOptions, RerunReport, rerun};
use dermis_skin::{Skin, builtin_text};

const SKIN: &str = "healing-square";
/// The demonstration presses from frame 61 on. The tare, forced under load, completes 32 frames after the request.
const TARE_AT: u64 = 70;
const LAMBDA_AT: u64 = 90;
const FRAMES: u64 = 110;

/// Result of a frame: its line, and its image bit for bit.
#[derive(Debug, PartialEq)]
struct Result {
    sequence: u64,
    line: String,
    image: Vec<u32>,
}

impl Result {
    fn of(output: &SkinFrame<'_>) -> Self {
        let mut lines = JsonLines::new(Vec::new(), "test", LinesFor::EveryFrame);
        lines.accept(output).unwrap();
        let line = String::from_utf8(lines.get_mut().clone()).unwrap();
        Self { sequence: output.sequence, line, image: output.image.iter().map(|value| value.to_bits()).collect() }
    }
}

/// Runs the twin's demonstration for `frames` frames with a forced tare and a change of lambda, recording from frame
/// `from` on and leaving out every frame in `lost`.
fn live(path: &Path, frames: u64, from: u64, lost: &[u64]) -> Vec<Result> {
    let (source, _commands) = TwinSource::new(&Skin::open(SKIN).unwrap()).unwrap();
    let mut source = source.unpaced();
    let prepared = dermis_live::prepare::Prepared::new(Skin::open(SKIN).unwrap()).unwrap();
    let head = RecordingHead::of(&prepared, source.layout().clone(), source.name());
    let layout = source.layout().clone();
    let mut pipeline = Pipeline::new(prepared, &layout, None).unwrap();
    let mut recording = None;
    let mut frame = Frame::default();
    let mut results = Vec::new();
    for number in 0..frames {
        assert_eq!(source.next_frame(&mut frame, Duration::ZERO).unwrap(), SourceEvent::Frame);
        if lost.contains(&number) {
            continue;
        }
        if number == from {
            recording = Some(LiveRecording::start(path, &head, &pipeline, 10.0).unwrap());
        }
        if number == TARE_AT {
            pipeline.tare(true, "test").unwrap();
            recording.iter().for_each(|recording| recording.tare(true, "test"));
        }
        if number == LAMBDA_AT {
            let lambda = 3.0 * pipeline.hyperparameter().unwrap();
            pipeline.set_hyperparameter(lambda).unwrap();
            recording.iter().for_each(|recording| recording.hyperparameter(lambda));
        }
        recording.iter_mut().for_each(|recording| recording.frame(&frame));
        let before = pipeline.baseline_records().len();
        let output = pipeline.process(&frame, 0).unwrap();
        recording.iter_mut().for_each(|recording| recording.results(&output));
        results.push(Result::of(&output));
        if pipeline.baseline_records().len() > before {
            recording.iter().for_each(|recording| recording.baseline(&pipeline, frame.host_wall_ns));
        }
    }
    let end = recording.unwrap().finish();
    assert_eq!((end.lost, end.error), (0, None));
    results
}

fn again(path: &Path, options: RerunOptions, change: impl FnOnce(&mut Skin)) -> (Vec<Result>, RerunReport) {
    let mut recording = Recording::open(path).unwrap();
    let mut skin = Skin::parse(recording.skin_toml(), "test").unwrap();
    change(&mut skin);
    let mut pipeline = recording.head().pipeline(skin, path).unwrap();
    let mut results = Vec::new();
    let report = rerun(&mut recording, &mut pipeline, options, &AtomicBool::new(false), |output| {
        results.push(Result::of(output));
        Ok(ControlFlow::Continue(()))
    });
    (results, report.unwrap())
}

#[test]
fn a_rerun_gives_the_live_result_to_the_bit_at_any_speed() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    let first = live(&path, FRAMES, 0, &[]);
    assert!(first.iter().filter(|result| result.line.contains("\"id\"")).count() > 20, "too few touches to say much");
    // A hundred times real time: the unpaced recording is short, and the test only needs some waiting.
    for speed in [0.0, 100.0] {
        let (second, report) = again(&path, RerunOptions { speed, ..RerunOptions::default() }, |_| {});
        for (second, first) in second.iter().zip(&first) {
            assert_eq!((second.sequence, &second.line), (first.sequence, &first.line));
            assert!(second.image == first.image, "image of frame {} at speed {speed}", first.sequence);
        }
        assert_eq!((report.frames, report.missing, report.refused, report.has_losses()), (FRAMES, 0, 0, false));
    }
}

#[test]
fn faults_and_recoveries_are_events_of_the_recording_and_found_again_in_the_same_frames() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    // Between frames 49 and 50, and between 64 and 65; reversed 50 good frames later.
    let faults = "seed = 5\nfaults = [{ open_electrodes = [5], from_s = 1.98, until_s = 2.58 }]";
    let skin = Skin::parse(&crate::with_twin(builtin_text(SKIN).unwrap(), faults), "test").unwrap();
    let (source, _commands) = TwinSource::new(&skin).unwrap();
    let mut source = source.unpaced().undemonstrated();
    let prepared = dermis_live::prepare::Prepared::new(skin).unwrap();
    let (head, layout) =
        (RecordingHead::of(&prepared, source.layout().clone(), source.name()), source.layout().clone());
    let mut pipeline = Pipeline::new(prepared, &layout, None).unwrap();
    let mut recording = LiveRecording::start(&path, &head, &pipeline, 0.0).unwrap();
    let (mut frame, mut first) = (Frame::default(), Vec::new());
    for _ in 0..145 {
        assert_eq!(source.next_frame(&mut frame, Duration::ZERO).unwrap(), SourceEvent::Frame);
        recording.frame(&frame);
        let output = pipeline.process(&frame, 0).unwrap();
        recording.results(&output);
        first.push(Result::of(&output));
    }
    assert_eq!(recording.finish().error, None);
    let (mut number, mut electrodes) = (0, Vec::new());
    let mut recording = Recording::open(&path).unwrap();
    while let Some(entry) = recording.next_entry().unwrap() {
        match entry {
            Entry::Frame(frame) => number = frame.sequence,
            Entry::Event { entry, .. } if entry.event.starts_with("electrode") => {
                electrodes.push((number, entry.event.clone(), entry.detail.clone(), entry.values.clone()));
            }
            _ => {}
        }
    }
    let [lost, back] = &electrodes[..] else { panic!("{electrodes:?}") };
    assert_eq!((lost.1.as_str(), &lost.3[..]), ("electrode-fault", &[5.0][..]));
    assert!(lost.2.starts_with("electrode 5 is lost since frame ") && (50..62).contains(&lost.0), "{lost:?}");
    assert_eq!((back.1.as_str(), back.2.as_str()), ("electrode-recovered", "electrode 5 is sound again"));
    assert!((114..142).contains(&back.0), "{back:?}");
    let (second, _) = again(&path, RerunOptions::default(), |_| {});
    assert_eq!(second.len(), first.len());
    for (second, first) in second.iter().zip(&first) {
        assert_eq!((second.sequence, &second.line), (first.sequence, &first.line));
        assert!(second.image == first.image, "image of frame {}", first.sequence);
    }
}

#[test]
fn another_lambda_changes_the_images_of_the_same_frames() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    let first = live(&path, 80, 0, &[50, 51, 65]);
    let options = RerunOptions { follow_hyperparameter: false, ..RerunOptions::default() };
    let rule = "relative=0.5".parse().unwrap();
    let (second, report) = again(&path, options, |skin| skin.imaging.hyperparameter = rule);
    assert_eq!((report.frames, report.missing, report.has_losses()), (77, 3, true));
    let sequences = |results: &[Result]| results.iter().map(|result| result.sequence).collect::<Vec<_>>();
    assert_eq!(sequences(&second), sequences(&first));
    assert!(second.last().unwrap().image != first.last().unwrap().image, "the same image under another lambda");
}

#[test]
fn a_recording_started_mid_run_continues_from_the_current_baseline() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    // Before the demonstration presses, so that the recording doesn't start under a touch it knows nothing about.
    let first = live(&path, TARE_AT - 1, 34, &[]);
    let (second, report) = again(&path, RerunOptions::default(), |_| {});
    assert_eq!(report.frames, TARE_AT - 1 - 34);
    let values = |result: &Result| result.image.iter().map(|bits| f32::from_bits(*bits)).collect::<Vec<_>>();
    let largest = |image: &[f32]| image.iter().filter(|value| value.is_finite()).fold(0.0_f32, |a, b| a.max(b.abs()));
    let peak = first.iter().map(|result| largest(&values(result))).fold(0.0, f32::max);
    for (second, first) in second.iter().zip(&first[34..]) {
        assert_eq!(second.sequence, first.sequence);
        assert_eq!(second.line.matches("\"id\"").count(), first.line.matches("\"id\"").count(), "{}", first.line);
        let difference: Vec<f32> = values(second).iter().zip(values(first)).map(|(a, b)| a - b).collect();
        // The gain is matched to the baseline, which has drifted since, with the noise, by two frames' share of 60 s.
        assert!(largest(&difference) < 1e-3 * peak, "image of frame {}: {}", first.sequence, largest(&difference));
    }
    assert!(second.iter().any(|result| result.line.contains("\"id\"")), "no touch");
}
