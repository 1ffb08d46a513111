//! A broken instrument or one that reverses signs, from the skin file to the pipeline: lost and repeated frames are
//! counted exactly, and an open electrode affects the channels that use it.

use std::time::Duration;

use dermis_device::Layout;
use dermis_device::acquire::{Acquisition, AcquisitionCounters, Next};
use dermis_lab::twin_source::TwinSource;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::{Skin, builtin_text};
use dermis_twin::TwinKit;
use dermis_twin::instrument::FrameFate;

/// Frames that may queue for the pipeline.
const QUEUE: usize = 4;

fn broken(faults: &str) -> Skin {
    let text = builtin_text("healing-square").unwrap();
    Skin::parse(&crate::with_twin(text, &format!("seed = 5\nfaults = [{faults}]")), "a test").unwrap()
}

/// Runs a skin's twin for `frames` frames through acquisition and pipeline; returns the frames' numbers and raw
/// channels.
fn run(skin: &Skin, frames: usize) -> (Vec<u64>, Vec<Vec<f64>>) {
    let (numbers, raw, _) = run_until(skin, frames, |_| true);
    (numbers, raw)
}

/// The same, and also returns the acquisition's counters, once its queue is full and the counters are as expected, or
/// after a minute.
fn run_until(
    skin: &Skin,
    frames: usize,
    is_expected: impl Fn(&AcquisitionCounters) -> bool,
) -> (Vec<u64>, Vec<Vec<f64>>, AcquisitionCounters) {
    let (source, _commands) = TwinSource::new(skin).unwrap();
    let layout = Layout::Channels { count: skin.protocol().unwrap().channel_count() };
    let mut pipeline = Pipeline::new(Prepared::new(skin.clone()).unwrap(), &layout, None).unwrap();
    let mut acquisition = Acquisition::spawn(Box::new(source.unpaced()), QUEUE, true);
    let (mut numbers, mut raw) = (Vec::new(), Vec::new());
    while numbers.len() < frames {
        match acquisition.next(Duration::from_secs(20)).unwrap() {
            Next::Frame(frame) => {
                let output = pipeline.process(&frame, frame.host_monotonic_ns).unwrap();
                numbers.push(output.sequence);
                raw.push(output.raw.to_vec());
                acquisition.recycle(frame);
            }
            other => panic!("{other:?} after {} frames", numbers.len()),
        }
    }
    // The thread runs ahead until its queue is full and one more frame waits for room; then its counters stop.
    for _ in 0..3000 {
        if acquisition.waiting() == QUEUE && is_expected(&acquisition.counters()) {
            break;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    // Counters that keep rising are thus noticed.
    std::thread::sleep(Duration::from_millis(20));
    (numbers, raw, acquisition.counters())
}

#[test]
fn dropped_and_repeated_frames_are_counted_exactly() {
    let skin = broken("{ dropped_share = 0.15, repeated_share = 0.1 }");
    let mut twin = TwinKit::of(&skin).unwrap().twin;
    let (mut delivered, mut frame) = (Vec::new(), Vec::new());
    let (mut lost_before, mut repeated_before) = (Vec::new(), Vec::new());
    let (mut lost, mut repeated) = (0, 0);
    for tick in 0..200 {
        let truth = twin.step(f64::from(tick) / 25.0, &mut frame).unwrap();
        match truth.fate {
            FrameFate::Delivered => {
                delivered.push(truth.sequence);
                lost_before.push(lost);
                repeated_before.push(repeated);
            }
            FrameFate::Dropped => lost += 1,
            FrameFate::Duplicated => repeated += 1,
        }
    }
    let count = 100;
    // The source runs ahead by the queue of four and the frame waiting for room, then stops.
    let expected = (lost_before[count + 4], repeated_before[count + 4]);
    let (numbers, _, counters) = run_until(&skin, count, |counters| (counters.lost, counters.repeated) == expected);
    assert_eq!(numbers, delivered[..count]);
    // The gaps in the numbers are the lost frames.
    let gaps = numbers.windows(2).map(|pair| pair[1] - pair[0] - 1).sum::<u64>() + numbers[0];
    assert_eq!(gaps, lost_before[count - 1]);
    assert!(gaps > 5 && repeated_before[count - 1] > 3, "{gaps} {}", repeated_before[count - 1]);
    assert_eq!((counters.lost, counters.repeated), expected);
    assert_eq!((counters.dropped, counters.bad), (0, 0));
}

#[test]
fn an_open_electrode_fails_and_recovers_on_schedule() {
    // At 25 frames/s: frames 35 and 36 only, before the first touch.
    let skin = broken("{ open_electrodes = [5], from_s = 1.39, until_s = 1.45 }");
    let sound = broken("");
    let protocol = skin.protocol().unwrap();
    let (numbers, raw) = run(&skin, 38);
    let (_, expected) = run(&sound, 38);
    assert_eq!(numbers, (0..38).collect::<Vec<u64>>());
    for frame in 0..38 {
        let changed: Vec<usize> = (0..208).filter(|&k| raw[frame][k] != expected[frame][k]).collect();
        if !(35..=36).contains(&frame) {
            assert_eq!(changed, [0; 0], "frame {frame}");
            continue;
        }
        let uses = |k: &usize| protocol.stimulation_of(*k).touches(4) || protocol.pattern_of(*k).touches(4);
        assert!(changed.iter().all(uses), "frame {frame}: {changed:?}");
        // 16 drives with 13 channels each: electrode 5 drives in two of them, and is read by two channels in each of
        // the others, except those that share its partners. All floating channels change, even dead ones unless they
        // read 0 before.
        let used = (0..208).filter(uses).count();
        assert!(changed.len() > used * 9 / 10, "frame {frame}: {} of {used}", changed.len());
    }
}

#[test]
fn complex_and_rectified_readings_give_the_same_channels() {
    let skin = |reads: &str, phase_deg: f64| {
        let text =
            builtin_text("healing-square").unwrap().replace("[backend]", &format!("[backend]\nreads = \"{reads}\""));
        Skin::parse(&crate::with_twin(&text, &format!("phase_error_deg = {phase_deg:.1}")), "a test").unwrap()
    };
    let (_, signed) = run(&skin("signed", 0.0), 33);
    let (_, complex) = run(&skin("complex", 30.0), 33);
    let (_, magnitude) = run(&skin("magnitude", 30.0), 33);
    let largest = signed[32].iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    for channel in 0..208 {
        // In phase with the baseline the complex reading has its full size; noise is 3e-4 of the largest channel.
        let size = signed[32][channel].abs();
        let apart = (complex[32][channel].abs() - size).abs().max((magnitude[32][channel].abs() - size).abs());
        assert!(apart < 5e-3 * largest, "channel {channel}: {apart} of {largest}");
    }
}
