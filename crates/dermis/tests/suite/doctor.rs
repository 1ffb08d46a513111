//! The examination finds each fault of a twin and names it, and finds none on a sound twin.

use std::collections::VecDeque;
use std::time::Duration;

use dermis_device::{Counters, DeviceError, Frame, Layout, Source, SourceEvent};
use dermis_lab::doctor::{Answer, Check, examine};
use dermis_lab::twin_source::TwinSource;
use dermis_live::prepare::Prepared;
use dermis_skin::{Skin, builtin_text};

fn skin(name: &str, faults: &str) -> Skin {
    let text = builtin_text(name).unwrap();
    Skin::parse(&crate::with_twin(text, &format!("seed = 5\nfaults = [{faults}]")), "a test").unwrap()
}

/// Examines a twin that nobody presses; the demonstration starts later than the frames used here.
fn examined(skin: Skin, frames: u64) -> Vec<Check> {
    let (source, _commands) = TwinSource::new(&skin).unwrap();
    examine(skin, &mut source.unpaced(), frames, Duration::from_secs(5), None).unwrap()
}

fn bad(checks: &[Check]) -> Vec<String> {
    checks
        .iter()
        .filter(|c| c.answer == Answer::Bad)
        .map(|c| format!("{}: {}; {}", c.name, c.found, c.advice))
        .collect()
}

#[test]
fn a_sound_twin_is_in_good_health() {
    for name in ["healing-square", "em-8"] {
        let checks = examined(skin(name, ""), 64);
        assert_eq!(bad(&checks), [""; 0], "{name}");
        for asked in ["rate", "noise", "saturation", "electrodes", "reciprocity", "channel order", "contact impedance"]
        {
            assert!(checks.iter().any(|check| check.name == asked), "{name}: {asked} in {checks:?}");
        }
    }
}

#[test]
fn each_fault_gives_its_sentence() {
    let sentences = |faults: &str| bad(&examined(skin("healing-square", faults), 64)).join("\n");
    let open = sentences("{ open_electrodes = [5] }");
    assert!(open.contains("electrode 5 is lost") && open.contains("fasten electrode 5"), "{open}");
    let several = "{ shorted_pairs = [[5, 12]], dropped_share = 0.2, from_s = 1.5 }, \
                   { stuck_channels = [{ channel = 31, value_mv = 4.0 }] }";
    let several = sentences(several);
    assert!(several.contains("electrodes 5 and 12 are shorted"), "{several}");
    assert!(several.contains("channel 31 ") && several.contains("read the same"), "{several}");
    assert!(several.contains("rate: ") && several.contains(" frames lost"), "{several}");
    let ends = "{ stuck_channels = [{ channel = 30, value_mv = 125.0 }, { channel = 40, value_mv = 125.0 }] }";
    let saturated = sentences(ends);
    assert!(saturated.contains("channels 30 ") && saturated.contains("lower the gain"), "{saturated}");
}

/// A source of prepared frames.
struct Given {
    layout: Layout,
    frames: VecDeque<Vec<f64>>,
    count: u64,
}

impl Source for Given {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn name(&self) -> &str {
        "given"
    }

    fn next_frame(&mut self, frame: &mut Frame, _: Duration) -> Result<SourceEvent, DeviceError> {
        let Some(values) = self.frames.pop_front() else { return Ok(SourceEvent::Idle) };
        frame.refill(self.count, dermis_device::HostStamp::now(), &values, &[]);
        frame.device_time_ns = Some(self.count * 40_000_000);
        self.count += 1;
        Ok(SourceEvent::Frame)
    }

    fn counters(&self) -> Counters {
        Counters { frames: self.count, ..Counters::default() }
    }

    fn problem(&self) -> Option<String> {
        Some("the cable is out".into())
    }
}

/// Frames of the model at rest, with a little independent noise per channel and frame.
fn given(skin: &Skin, frames: usize, change: impl Fn(&mut Vec<f64>)) -> Given {
    let prepared = Prepared::new(skin.clone()).unwrap();
    let noise =
        |frame: usize, channel: usize| 1e-5 * (((frame * 7919 + channel * 104_729) % 1013) as f64 / 506.5 - 1.0);
    let frames = (0..frames).map(|k| {
        let mut values: Vec<f64> = prepared.voltages.iter().enumerate().map(|(c, v)| v + noise(k, c) * 0.1).collect();
        change(&mut values);
        values
    });
    Given { layout: Layout::Channels { count: prepared.channels() }, frames: frames.collect(), count: 0 }
}

#[test]
fn swapped_electrodes_reversed_signs_and_silence_are_reported() {
    let skin = skin("healing-square", "");
    // The instrument's readings with the wires of electrodes 3 and 7 exchanged, on a mesh other than the doctor's.
    let mut finer = skin.clone();
    finer.imaging.elements = 3000;
    let body = finer.body().unwrap();
    let protocol = finer.protocol().unwrap();
    let model = dermis_tomo::eit::ForwardModel::new(body.mesh.clone(), protocol.clone()).unwrap();
    let sigma = vec![finer.sheet_conductance_s(); body.mesh.mesh.element_count()];
    let solution = model.solve(&sigma).unwrap();
    let impedance = solution.transfer_impedance();
    let exchanged = |e: u32| {
        if e == 2 {
            6
        } else if e == 6 {
            2
        } else {
            e as usize
        }
    };
    let voltage = |c: usize| -> f64 {
        let (drive, read) = (protocol.stimulation_of(c).entries(), protocol.pattern_of(c).entries());
        let by =
            |m: &(u32, f64)| drive.iter().map(|s| m.1 * s.1 * impedance[(exchanged(m.0), exchanged(s.0))]).sum::<f64>();
        read.iter().map(by).sum()
    };
    let swapped: Vec<f64> = (0..protocol.channel_count()).map(voltage).collect();
    let rest = Prepared::new(skin.clone()).unwrap().voltages;
    let exchange = |values: &mut Vec<f64>| {
        values.iter_mut().zip(&rest).zip(&swapped).for_each(|((v, rest), swapped)| *v += swapped - rest);
    };
    let say = |source: &mut Given, frames: u64| {
        bad(&examine(skin.clone(), source, frames, Duration::from_millis(300), None).unwrap()).join("\n")
    };
    let said = say(&mut given(&skin, 64, exchange), 64);
    assert!(said.contains("swap the wires of electrodes 3 and 7"), "{said}");
    let said = say(&mut given(&skin, 64, |values| values.iter_mut().for_each(|v| *v = -*v)), 64);
    assert!(said.contains("sign reversed"), "{said}");
    let said = say(&mut given(&skin, 10, |_| {}), 64);
    assert!(said.contains("the cable is out (10 frames in all)"), "{said}");
}
