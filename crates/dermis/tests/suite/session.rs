//! Sessions: every kind of source yields frames with touches, a baseline can be given, and errors explain why a
//! source cannot be opened.

use std::path::Path;
use std::time::Duration;

use dermis::{Error, Pipeline, Session, SessionOptions, Skin};
use dermis_device::{Counters, DeviceError, Frame, Layout, Source, SourceEvent};
use dermis_lab::serve::Background;
use dermis_lab::twin_sample::{SampleRequest, random_presses, sample};
use dermis_live::prepare::Prepared;

fn skin() -> Skin {
    Skin::open("healing-square").unwrap()
}

/// Frames of the untouched twin and of three presses, each three times, as `rest.csv` and `press.csv`.
fn files(folder: &Path) -> [String; 2] {
    let skin = skin();
    let [baseline, frames] = ["rest.csv", "press.csv"].map(|name| folder.join(name));
    let usual = dermis_twin::from_skin::press_range(&skin);
    let presses = random_presses(&skin.outline(), &usual, 3, 5).unwrap();
    let names = [&baseline, &frames].map(|path| path.display().to_string());
    sample(
        &SampleRequest { skin, presses, baseline, frames, truth: None, seed: None, built: None, repeats: 3 },
        |_, _| {},
    )
    .unwrap();
    names
}

#[test]
fn a_session_of_the_twin_is_repeatable_and_numbers_its_frames() {
    let places = || {
        let frames = Session::open("twin", skin()).unwrap().take(90).collect::<Result<Vec<_>, Error>>().unwrap();
        assert!(frames.iter().enumerate().all(|(k, frame)| frame.sequence == k as u64));
        assert!((frames[50].time_s - 50.0 * (frames[1].time_s - frames[0].time_s)).abs() < 1e-6);
        assert_eq!(frames.iter().position(|frame| frame.is_ready), Some(32), "32 frames make the baseline");
        frames.iter().flat_map(|frame| frame.touches.iter().map(|touch| touch.position_m)).collect::<Vec<_>>()
    };
    let first = places();
    // Positions depend on the host's clock only through drift and prediction: by less than a hundredth of a
    // millimetre here.
    assert!(first.len() > 20 && places().len() == first.len(), "{} touches", first.len());
}

#[test]
fn a_file_of_presses_with_a_baseline_keeps_its_touches() {
    let folder = tempfile::tempdir().unwrap();
    let [rest, press] = files(folder.path());
    let options = SessionOptions { baseline: Some(rest.parse().unwrap()), ..SessionOptions::default() };
    let frames: Vec<_> = Session::open_with(&press, skin(), &options).unwrap().map(Result::unwrap).collect();
    assert_eq!(frames.len(), 9);
    assert!(frames.iter().all(|frame| frame.is_ready && frame.image.iter().any(|value| value.is_finite())));
    assert!(frames[2].touches.len() == 1, "{:?}", frames[2].touches);
    // The same with a baseline from the file itself.
    let both = format!("{rest}#0..8");
    let options = SessionOptions { baseline: Some(both.parse().unwrap()), ..SessionOptions::default() };
    let again: Vec<_> = Session::open_with(&press, skin(), &options).unwrap().map(Result::unwrap).collect();
    assert!(again[2].touches.len() == 1);
}

#[test]
fn a_served_twin_is_read_over_its_socket() {
    let served = Background::start(&skin()).unwrap();
    let mut session = Session::open(&served.selector().to_string(), skin()).unwrap();
    let frames = session.by_ref().take(40).collect::<Result<Vec<_>, Error>>().unwrap();
    assert!(frames.last().is_some_and(|frame| frame.is_ready));
    assert!(session.counters().frames >= 40);
}

#[test]
fn invalid_sources_for_this_skin_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [rest, _] = files(folder.path());
    let refused = |source: &str, skin: Skin| Session::open(source, skin).unwrap_err().to_string();
    assert!(refused("twin:nobody", skin()).contains("nobody"));
    assert!(refused("udp:1.2.3.4:5", skin()).contains("expected file:PATH, twin[:NAME]"));
    assert!(refused("none.csv", skin()).contains("none.csv"));
    let other = refused(&rest, Skin::open("hydrogel-disc").unwrap());
    assert!(other.contains("expected") && other.contains("208 channels"), "{other}");
    let other = refused("twin:hydrogel-disc", skin());
    assert!(other.contains("expected 208 channels"), "{other}");
}

/// An instrument that is connected but silent.
struct Silent(Layout);

impl Source for Silent {
    fn layout(&self) -> &Layout {
        &self.0
    }

    fn name(&self) -> &str {
        "silent"
    }

    fn next_frame(&mut self, _frame: &mut Frame, _timeout: Duration) -> Result<SourceEvent, DeviceError> {
        Ok(SourceEvent::Idle)
    }

    fn counters(&self) -> Counters {
        Counters::default()
    }
}

#[test]
fn a_silent_instrument_is_an_error_and_not_a_hang() {
    let prepared = Prepared::new(skin()).unwrap();
    let layout = Layout::Channels { count: prepared.channels() };
    let pipeline = Pipeline::new(prepared, &layout, None).unwrap();
    let mut session = Session::of(Box::new(Silent(layout)), pipeline).with_patience(Duration::ZERO);
    for _ in 0..2 {
        let error = session.next().unwrap().unwrap_err().to_string();
        assert!(error.contains("silent") && error.contains("no frame"), "{error}");
    }
    // It can't be pressed by a command either.
    let error = session.press([0.0; 2], 0.008, 80e3).unwrap_err();
    assert!(matches!(&error, Error::NotATwin { name } if name == "silent"), "{error}");
    assert!(session.release().is_err());
}

#[test]
fn a_press_that_the_skin_cannot_carry_is_refused_with_the_reason() {
    let session = Session::open("twin", skin()).unwrap();
    let refused = |place, radius_m, pressure_pa| session.press(place, radius_m, pressure_pa).unwrap_err().to_string();
    assert!(refused([0.0, 1.0], 0.008, 80e3).contains("y of the indenter"));
    assert!(refused([0.0, 0.0], -0.008, 80e3).contains("radius"));
    assert!(refused([0.0, 0.0], 0.008, f64::NAN).contains("NaN"));
    session.press([0.01, 0.0], 0.008, 80e3).unwrap();
    session.release().unwrap();
}
