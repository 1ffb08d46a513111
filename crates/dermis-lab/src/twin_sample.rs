//! Simulated, labelled data of a skin: its twin is pressed according to a table, and its frames are written, with the
//! instrument's noise, to files that `dermis reconstruct` and `dermis calibrate` read.
//!
//! Each press starts on a rested skin and is held for a second before its frames are taken. A viscoelastic layer thus
//! responds the same way whatever was pressed before.

mod files;
mod presses;

use std::path::PathBuf;

use dermis_device::{FrameTable, Layout};
use dermis_skin::Skin;
use dermis_twin::instrument::Instrument;
use dermis_twin::mechanics::Indenter;
use dermis_twin::{Frontend, TwinKit};

use files::{Format, Rows, write_truth};
pub use presses::{random_presses, read_presses};

use crate::Error;
use crate::tolerances::built_twin;

/// Frames of the untouched skin in the baseline.
pub const BASELINE_FRAMES: usize = 32;
/// Time that a press is held before its frames are taken, seconds.
const HELD_S: f64 = 1.0;
/// Rest before a press, seconds: far longer than any cover remembers.
const REST_S: f64 = 1e5;
/// Maximum number of frames in one request.
const MOST_FRAMES: usize = 10_000_000;
/// Maximum number of readings in total; at 8 bytes each, 16 GiB.
const MOST_READINGS: usize = 2_000_000_000;
/// Content and destination of a data set.
#[derive(Clone, Debug)]
pub struct SampleRequest {
    /// The skin.
    pub skin: Skin,
    /// Presses in order; all indenters of one entry press together.
    pub presses: Vec<Vec<Indenter>>,
    /// File of the untouched skin's frames.
    pub baseline: PathBuf,
    /// File of the presses' frames.
    pub frames: PathBuf,
    /// Output table with the true presses in each frame.
    pub truth: Option<PathBuf>,
    /// Seed of the noise; the skin file's if `None`.
    pub seed: Option<u64>,
    /// Number of a random skin within the file's tolerances; without it, the skin is exactly as in its file.
    pub built: Option<u64>,
    /// Frames per press.
    pub repeats: usize,
}

/// Counts of the data made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampled {
    /// Frames of presses.
    pub frames: usize,
    /// Presses, counting simultaneous ones once.
    pub presses: usize,
    /// Readings in a frame.
    pub channels: usize,
    /// Presses that took the model out of its range of validity, for example when a membrane touches the bottom.
    pub outside_validity: usize,
}

/// Presses the twin and writes the files, each complete or not at all. `progress` gets the number of presses done and
/// the total.
///
/// # Errors
/// The twin cannot be built, a press is off the skin (named by its number), or a file cannot be written.
pub fn sample(request: &SampleRequest, progress: impl FnMut(usize, usize)) -> Result<Sampled, Error> {
    let formats = [&request.baseline, &request.frames].map(|path| Format::of(path));
    let [baseline_format, frames_format] = [formats[0].clone()?, formats[1].clone()?];
    let Pressed { baseline, rows, reader, outside_validity } =
        press(&request.skin, &request.presses, request.repeats, [request.seed, request.built], progress)?;
    let channels = reader.channels;
    baseline_format.write(&request.baseline, channels, &baseline, reader.complex)?;
    frames_format.write(&request.frames, channels, &rows, reader.complex)?;
    if let Some(path) = &request.truth {
        write_truth(path, &request.presses, request.repeats)?;
    }
    let frames = request.presses.len() * request.repeats;
    Ok(Sampled { frames, presses: request.presses.len(), channels, outside_validity })
}

/// Like `sample`, in memory: returns the frames of the untouched skin and one frame per press.
///
/// # Errors
/// The twin cannot be built, or a press is off the skin (named by its number).
pub fn sample_tables(
    skin: &Skin,
    presses: &[Vec<Indenter>],
    seed: Option<u64>,
    progress: impl FnMut(usize, usize),
) -> Result<[FrameTable; 2], Error> {
    let Pressed { baseline, rows, reader, .. } = press(skin, presses, 1, [seed, None], progress)?;
    let table = |rows: Rows, name: &str| -> Result<FrameTable, Error> {
        let name = format!("twin:{}, {name}", skin.name);
        let table = FrameTable::new(Layout::Channels { count: reader.channels }, rows.values, name)?;
        Ok(if reader.complex { table.with_imaginary(rows.imaginary)? } else { table })
    };
    Ok([table(baseline, "untouched")?, table(rows, "pressed")?])
}

/// Frames of a twin.
struct Pressed {
    baseline: Rows,
    rows: Rows,
    reader: Reader,
    outside_validity: usize,
}

fn press(
    skin: &Skin,
    presses: &[Vec<Indenter>],
    repeats: usize,
    [seed, built]: [Option<u64>; 2],
    mut progress: impl FnMut(usize, usize),
) -> Result<Pressed, Error> {
    let mut skin = skin.clone();
    skin.twin.seed = seed.or(skin.twin.seed);
    let channels = skin.protocol()?.channel_count();
    let frames = presses.len().saturating_mul(repeats);
    let refuse = |what: &str, expected: String, got: String| {
        Err(Error::Live(dermis_live::Error::Frames { what: what.into(), expected, got }))
    };
    if repeats == 0 || frames == 0 || frames > MOST_FRAMES {
        return refuse("frames to make", format!("1 to {MOST_FRAMES}"), frames.to_string());
    }
    if frames.saturating_mul(channels) > MOST_READINGS {
        let got = format!("{frames} frames of {channels} channels");
        return refuse("readings to make", format!("at most {MOST_READINGS}; fewer presses or repeats"), got);
    }
    let rate_hz = skin.backend.frame_rate_hz();
    let (mut frontend, mut instrument, gains) = match built {
        Some(number) => built_twin(&skin, number)?,
        None => {
            let (frontend, instrument, _) = TwinKit::of(&skin)?.twin.into_parts();
            (frontend, instrument, vec![1.0; channels])
        }
    };
    for (k, group) in presses.iter().enumerate() {
        for indenter in group {
            let refused = |error: dermis_twin::TwinError| {
                Error::Live(dermis_live::Error::Frames {
                    what: format!("press {}", k + 1),
                    expected: "one that the skin can carry".into(),
                    got: error.to_string(),
                })
            };
            frontend.check_indenter(indenter).map_err(refused)?;
        }
    }
    let mut reader = Reader { channels, gains, rate_hz, values: vec![0.0; channels], complex: false };
    let mut baseline = Rows::default();
    reader.hold(&mut *frontend, &[], REST_S)?;
    for _ in 0..BASELINE_FRAMES {
        reader.read(&mut instrument, &mut baseline);
    }
    let mut rows = Rows::default();
    let mut outside_validity = 0;
    for (k, group) in presses.iter().enumerate() {
        reader.hold(&mut *frontend, &[], REST_S)?;
        reader.hold(&mut *frontend, group, HELD_S)?;
        outside_validity += usize::from(frontend.outside_validity().is_some());
        for _ in 0..repeats {
            reader.read(&mut instrument, &mut rows);
        }
        progress(k + 1, presses.len());
    }
    Ok(Pressed { baseline, rows, reader, outside_validity })
}

struct Reader {
    channels: usize,
    gains: Vec<f64>,
    rate_hz: f64,
    /// True voltages.
    values: Vec<f64>,
    complex: bool,
}

impl Reader {
    fn hold(&mut self, frontend: &mut dyn Frontend, indenters: &[Indenter], held_s: f64) -> Result<(), Error> {
        self.values.resize(self.channels, 0.0);
        Ok(frontend.voltages(indenters, held_s, &mut self.values)?)
    }

    fn read(&mut self, instrument: &mut Instrument, rows: &mut Rows) {
        let mut frame: Vec<f64> = self.values.iter().zip(&self.gains).map(|(value, gain)| value * gain).collect();
        instrument.read(1.0 / self.rate_hz, &mut frame);
        rows.values.extend_from_slice(&frame);
        rows.imaginary.extend_from_slice(instrument.imaginary_v());
        self.complex |= !instrument.imaginary_v().is_empty();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_data_set_is_made_and_places_are_found_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mut skin = Skin::open("ionic-disc").unwrap();
        skin.twin.element_mm = Some(8.0);
        let usual = dermis_twin::from_skin::press_range(&skin);
        let presses = random_presses(&skin.outline(), &usual, 5, 3).unwrap();
        let request = SampleRequest {
            skin: skin.clone(),
            presses,
            baseline: at("b.npy"),
            frames: at("f.csv"),
            truth: Some(at("t.csv")),
            seed: Some(4),
            built: None,
            repeats: 2,
        };
        let made = sample(&request, |_, _| {}).unwrap();
        assert_eq!(made, Sampled { frames: 10, presses: 5, channels: 208, outside_validity: 0 });
        let text = std::fs::read_to_string(at("t.csv")).unwrap();
        assert_eq!(text.lines().count(), 11);
        assert_eq!(std::fs::read_to_string(at("f.csv")).unwrap().lines().count(), 10);
        // The same seed gives identical bytes.
        let first = std::fs::read(at("f.csv")).unwrap();
        sample(&request, |_, _| {}).unwrap();
        assert_eq!(std::fs::read(at("f.csv")).unwrap(), first);
        let pokes = dermis_live::calibration::read_pokes(&at("t.csv")).unwrap();
        assert_eq!(pokes.positions_m.len(), 10);
        let off = SampleRequest { presses: vec![vec![Indenter::disc([1.0, 0.0], 0.01, 1e3)]], ..request };
        let error = sample(&off, |_, _| {}).unwrap_err().to_string();
        assert!(error.contains("press 1"), "{error}");
    }
}
