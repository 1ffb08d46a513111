//! Simulated, labelled data of a skin: its twin is pressed according to a table, and its frames are written, with the
//! instrument's noise, to files that `dermis reconstruct` and `dermis calibrate` read.
//!
//! Each press starts on a rested skin and is held for a second before its frames are taken. A viscoelastic layer thus
//! responds the same way whatever was pressed before.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use dermis_device::instruments::{csv, npy};
use dermis_device::{FrameTable, Layout};
use dermis_skin::Skin;
use dermis_tomo::mesh::Outline;
use dermis_twin::instrument::Instrument;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::{Frontend, PressRange, TwinKit};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use crate::Error;
use crate::tolerances::built_twin;

/// Frames of the untouched skin in the baseline.
pub const BASELINE_FRAMES: usize = 32;
/// Time that a press is held before its frames are taken, seconds.
const HELD_S: f64 = 1.0;
/// Rest before a press, seconds: far longer than any cover remembers.
const REST_S: f64 = 1e5;
/// Maximum number of presses in one request.
const MOST_PRESSES: usize = 1_000_000;
/// Maximum number of frames in one request.
const MOST_FRAMES: usize = 10_000_000;
/// Maximum number of readings in total; at 8 bytes each, 16 GiB.
const MOST_READINGS: usize = 2_000_000_000;
/// Random presses stay within this share of the outline about its centre.
const INSIDE_SHARE: f64 = 0.85;
/// Halve the required distance from the rim after this many misses in a row.
const MOST_MISSED: usize = 10_000;
/// Smallest distance from the rim, as a share of the shorter side.
const LEAST_MARGIN: f64 = 1e-6;

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
    /// Number of a skin that a workshop builds within the file's tolerances; as drawn where left out.
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

/// Reads a table of presses.
///
/// Columns are x_mm, y_mm (or x_m, y_m), either force_n or pressure_kpa, and optionally radius_mm (default: the
/// skin's usual one) and group: rows of the same group press together.
///
/// # Errors
/// The file is not such a table, or a value is missing or invalid; the message names the row.
pub fn read_presses(path: &Path, usual: &PressRange) -> Result<Vec<Vec<Indenter>>, Error> {
    let table = csv::read_numbers(path)?.in_millimetres();
    let content = |field: String, reason: String| {
        Error::Live(dermis_live::Error::Content { file: path.to_path_buf(), field, reason })
    };
    let expected =
        "expected a header with x_mm, y_mm, one of force_n and pressure_kpa, and optionally radius_mm and group";
    let Some(header) = &table.header else { return Err(content("columns".into(), expected.into())) };
    let known = ["x_mm", "y_mm", "force_n", "pressure_kpa", "radius_mm", "group"];
    if let Some(other) = header.iter().find(|name| !known.contains(&name.trim())) {
        return Err(content(format!("column {other:?}"), expected.into()));
    }
    let column = |name: &str| table.column_index(name);
    let (Some(x), Some(y)) = (column("x_mm"), column("y_mm")) else {
        return Err(content("columns".into(), expected.into()));
    };
    let load = match (column("force_n"), column("pressure_kpa")) {
        (Some(force), None) => (force, true),
        (None, Some(pressure)) => (pressure, false),
        _ => return Err(content("columns".into(), "expected one of force_n and pressure_kpa".into())),
    };
    if table.rows() > MOST_PRESSES {
        return Err(content("rows".into(), format!("{} rows; expected at most {MOST_PRESSES}", table.rows())));
    }
    let mut presses: Vec<Vec<Indenter>> = Vec::new();
    let mut groups: BTreeMap<u64, usize> = BTreeMap::new();
    for row in 0..table.rows() {
        let values = table.row(row).unwrap_or_default();
        let number = |index: usize, name: &str, low: f64, high: f64| {
            let value = values.get(index).copied().unwrap_or(f64::NAN);
            if value >= low && value <= high {
                return Ok(value);
            }
            // The header is line 1.
            let reason = format!("{value}; expected {low} to {high}");
            Err(content(format!("line {}, {name}", row + 2), reason))
        };
        let centre_m = [1e-3 * number(x, "x_mm", -1e4, 1e4)?, 1e-3 * number(y, "y_mm", -1e4, 1e4)?];
        let radius_m = match column("radius_mm") {
            Some(index) => 1e-3 * number(index, "radius_mm", 1e-2, 1e4)?,
            None => usual.initial_radius_m,
        };
        let load = match load {
            (index, true) => Load::ForceN(number(index, "force_n", 0.0, 1e6)?),
            (index, false) => Load::PressurePa(1e3 * number(index, "pressure_kpa", 0.0, 1e6)?),
        };
        let indenter = Indenter { centre_m, shape: Shape::Disc { radius_m }, load };
        match column("group") {
            Some(index) => {
                let group = number(index, "group", 0.0, 1e15)?;
                let next = presses.len();
                let place = *groups.entry(group as u64).or_insert(next);
                if place == next {
                    presses.push(Vec::new());
                }
                presses[place].push(indenter);
            }
            None => presses.push(vec![indenter]),
        }
    }
    if presses.is_empty() {
        return Err(content("rows".into(), "no press; expected at least one".into()));
    }
    Ok(presses)
}

/// Single presses at random places within 85 % of the outline, with the skin's usual radius and pressure. If the
/// outline is so thin that hardly any place is that far from its rim, places nearer to the rim are accepted.
///
/// # Errors
/// The outline has hardly any interior.
pub fn random_presses(
    outline: &Outline,
    usual: &PressRange,
    count: usize,
    seed: u64,
) -> Result<Vec<Vec<Indenter>>, Error> {
    let mut random = StdRng::seed_from_u64(seed);
    let (low, high) = outline.bounds_m();
    let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
    let load = Load::PressurePa(usual.initial_pressure_pa);
    let shape = Shape::Disc { radius_m: usual.initial_radius_m };
    let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
    let mut margin = 0.5 * (1.0 - INSIDE_SHARE) * shorter_m;
    let mut presses = Vec::with_capacity(count);
    let mut missed = 0;
    while presses.len() < count {
        let place = [0, 1].map(|axis| random.random_range(low[axis]..=high[axis]));
        let is_in = match outline {
            // Stay away from every rim.
            Outline::Polygon { .. } => {
                let clear = |k: u32| {
                    let angle = f64::from(k) * std::f64::consts::TAU / 16.0;
                    outline.contains([place[0] + margin * angle.cos(), place[1] + margin * angle.sin()])
                };
                outline.contains(place) && (0..16).all(clear)
            }
            // Shrink the outline about its centre.
            _ => outline.contains([0, 1].map(|axis| middle[axis] + (place[axis] - middle[axis]) / INSIDE_SHARE)),
        };
        if is_in {
            presses.push(vec![Indenter { centre_m: place, shape, load }]);
            missed = 0;
            continue;
        }
        missed += 1;
        if missed == MOST_MISSED {
            (margin, missed) = (0.5 * margin, 0);
            if margin < LEAST_MARGIN * shorter_m {
                return Err(Error::Live(dermis_live::Error::Frames {
                    what: "places to press".into(),
                    expected: format!("{count} inside the outline"),
                    got: presses.len().to_string(),
                }));
            }
        }
    }
    Ok(presses)
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
                    expected: "one that the skin can bear".into(),
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

/// Consecutive frames, with their imaginary parts if they have any.
#[derive(Default)]
struct Rows {
    values: Vec<f64>,
    imaginary: Vec<f64>,
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

#[derive(Clone, Copy)]
enum Format {
    Csv,
    Npy,
}

impl Format {
    fn of(path: &Path) -> Result<Self, UnknownFormat> {
        match path.extension().and_then(|extension| extension.to_str()).map(str::to_lowercase).as_deref() {
            Some("csv") => Ok(Self::Csv),
            Some("npy") => Ok(Self::Npy),
            _ => Err(UnknownFormat(path.to_path_buf())),
        }
    }

    fn write(self, path: &Path, channels: usize, rows: &Rows, complex: bool) -> Result<(), Error> {
        match (self, complex) {
            (Self::Npy, false) => npy::write_f64(path, &[rows.values.len() / channels, channels], &rows.values)?,
            (Self::Npy, true) => {
                return Err(Error::Live(dermis_live::Error::Frames {
                    what: path.display().to_string(),
                    expected: "a name that ends in .csv: readings of this skin are complex".into(),
                    got: ".npy".into(),
                }));
            }
            (Self::Csv, _) => dermis_device::write_atomic(path, |out| write_csv(out, channels, rows, complex))?,
        }
        Ok(())
    }
}

/// A file whose name doesn't tell its format.
#[derive(Clone, Debug)]
struct UnknownFormat(PathBuf);

impl From<UnknownFormat> for Error {
    fn from(UnknownFormat(path): UnknownFormat) -> Self {
        let expected = "a name that ends in .csv or .npy".to_string();
        Error::Live(dermis_live::Error::Frames {
            what: "file of frames".into(),
            expected,
            got: path.display().to_string(),
        })
    }
}

/// Writes one row per frame, without header. Complex readings are written as real and imaginary part.
fn write_csv(out: &mut dyn Write, channels: usize, rows: &Rows, complex: bool) -> std::io::Result<()> {
    for (k, frame) in rows.values.chunks_exact(channels).enumerate() {
        for (channel, value) in frame.iter().enumerate() {
            let comma = if channel == 0 { "" } else { "," };
            if complex {
                let imaginary = rows.imaginary[k * channels + channel];
                let sign = if imaginary.is_sign_negative() { '-' } else { '+' };
                write!(out, "{comma}{value:e}{sign}{:e}j", imaginary.abs())?;
            } else {
                write!(out, "{comma}{value:e}")?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Writes one row per touch with its frame number from 0. If all presses are single, the file also serves as a
/// table of poke positions.
fn write_truth(path: &Path, presses: &[Vec<Indenter>], repeats: usize) -> Result<(), Error> {
    dermis_device::write_atomic(path, |out| {
        writeln!(out, "frame,x_m,y_m,force_n,radius_m,pressure_pa")?;
        for (k, group) in presses.iter().enumerate() {
            for repeat in 0..repeats {
                for indenter in group {
                    let ([x, y], pressure_pa) = (indenter.centre_m, indenter.pressure_pa());
                    let (area, radius) = (indenter.shape.area_m2(), indenter.shape.equal_area_radius_m());
                    let frame = k * repeats + repeat;
                    writeln!(out, "{frame},{x},{y},{},{radius},{pressure_pa}", pressure_pa * area)?;
                }
            }
        }
        Ok(())
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn usual() -> PressRange {
        let skin = Skin::open("ionic-disc").unwrap();
        dermis_twin::from_skin::press_range(&skin)
    }

    fn table(text: &str) -> Result<Vec<Vec<Indenter>>, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.csv");
        std::fs::write(&path, text).unwrap();
        read_presses(&path, &usual())
    }

    #[test]
    fn rows_of_a_group_press_together() {
        let presses = table("x_mm,y_mm,force_n,group\n1,2,0.1,7\n3,4,0.2,8\n5,6,0.3,7\n").unwrap();
        assert_eq!(presses.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1]);
        assert_eq!(presses[0][1].centre_m, [5e-3, 6e-3]);
        assert_eq!(table("x_mm,y_mm,pressure_kpa\n1,2,3\n1,2,3\n").unwrap().len(), 2);
    }

    #[test]
    fn bad_tables_are_refused_with_line_and_column() {
        for (text, says) in [
            ("x_mm,y_mm\n1,2\n", "one of force_n and pressure_kpa"),
            ("x_mm,y_mm,force_n,pressure_kpa\n1,2,3,4\n", "one of force_n and pressure_kpa"),
            ("x,y,force_n\n1,2,3\n", "column \"x\""),
            ("x_mm,y_mm,force_n\n1,2,-3\n", "line 2, force_n: -3"),
            ("x_mm,y_mm,force_n,radius_mm\n1,2,3,0\n", "line 2, radius_mm: 0"),
        ] {
            let error = table(text).unwrap_err().to_string();
            assert!(error.contains(says), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_data_set_is_made_and_places_are_found_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mut skin = Skin::open("ionic-disc").unwrap();
        skin.twin.element_mm = Some(8.0);
        let presses = random_presses(&skin.outline(), &usual(), 5, 3).unwrap();
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

    #[test]
    fn thin_outlines_are_pressed_nearer_to_their_rim() {
        // A strip across the square: 0.5 % of its area, and nowhere further than 0.25 mm from a rim.
        let outer = vec![[-0.05, -0.05], [-0.0493, -0.05], [0.05, 0.05], [0.0493, 0.05]];
        let strip = Outline::Polygon { outer, holes: Vec::new() };
        let presses = random_presses(&strip, &usual(), 5, 1).unwrap();
        assert!(presses.len() == 5 && presses.iter().all(|press| strip.contains(press[0].centre_m)));
        let none = Outline::Polygon { outer: vec![[0.0, 0.0], [0.1, 0.1], [0.1, 0.1 + 1e-12]], holes: Vec::new() };
        let refused = random_presses(&none, &usual(), 5, 1).unwrap_err().to_string();
        assert!(refused.contains("places to press: expected 5 inside the outline, got"), "{refused}");
    }
}
