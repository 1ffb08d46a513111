//! `dermis design`: predicts what skins will be able to do before they are built, compares them, and finds the best
//! protocol for one.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use dermis_device::instruments::npy;
use dermis_device::write_atomic;
use dermis_lab::design::{
    ForceMap, Freedom, Maps, Noise, Search, SharedInstrument, Summary, improve, smallest_force, spread_width, verdict,
};
use dermis_lab::tolerances::{Extent, Tolerances, run};
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;

use super::tolerance_page;
use crate::draw::{self, Heatmap, Panel};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis design healing-square ionic-disc
  dermis design ionic-disc --snr-db 59.7 --out design
  dermis design ionic-disc --force --map 6
  dermis design golfball-tank --map 12 --improve protocol --winner better.toml
  dermis design golfball-tank --map 8 --improve count,drive --winner better.toml
  dermis design healing-square --tolerances --samples 1 --pokes 0

Bounds are Cramer-Rao bounds: no unbiased method does better at this noise. \"Worst\" leaves out the outermost tenth \
of the area. By default the noise is the skin file's, the same for every channel; --noise-uv sets it in microvolts, \
--snr-db makes it proportional to the reading. Several skins, and the candidates of a search, are compared with the \
first skin's instrument and the same time per frame, so that more readings are noisier. --tolerances builds the skin \
many times with manufacturing errors and reports the cost of each error.";

/// Arguments of `dermis design`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Names of built-in skins, or skin files.
    #[arg(value_name = "SKIN", required = true)]
    skins: Vec<String>,
    /// Relative change of conductivity of the touch that the bounds are for.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    amplitude: f64,
    /// Noise of a reading of the first skin: signal-to-noise ratio of every channel, 20 log10(reading / deviation).
    #[arg(long, value_name = "DB")]
    snr_db: Option<f64>,
    /// Noise of a reading of the first skin: standard deviation, the same for every channel.
    #[arg(long, value_name = "MICROVOLTS", conflicts_with = "snr_db")]
    noise_uv: Option<f64>,
    /// Places along the longer side of the maps.
    #[arg(long, value_name = "PLACES", default_value_t = 32, value_parser = clap::value_parser!(u32).range(4..=128))]
    map: u32,
    /// Also compute the smallest detectable force, with the mechanics of the skin's twin.
    #[arg(long, conflicts_with = "improve")]
    force: bool,
    /// Output folder for the maps, PNG and NPY.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Search for a better skin by changing these, in this order.
    #[arg(long, value_enum, requires = "winner", value_delimiter = ',')]
    improve: Vec<Change>,
    /// Output file for the better skin.
    #[arg(long, value_name = "FILE.toml", requires = "improve")]
    winner: Option<PathBuf>,
    /// Try the skin with manufacturing errors; a TOML file gives their sizes.
    #[arg(
        long,
        value_name = "FILE.toml",
        num_args = 0..=1,
        conflicts_with_all = ["improve", "snr_db", "noise_uv", "force"]
    )]
    tolerances: Option<Option<PathBuf>>,
    /// Samples per row.
    #[arg(
        long,
        default_value_t = 200,
        requires = "tolerances",
        value_parser = clap::value_parser!(u32).range(1..=10_000)
    )]
    samples: u32,
    /// Presses per sample.
    #[arg(long, default_value_t = 5, requires = "tolerances", value_parser = clap::value_parser!(u32).range(1..=64))]
    presses: u32,
    /// Numbers of pokes to calibrate samples with; 0 for none.
    #[arg(long, value_delimiter = ',', default_values_t = [20, 50, 200], requires = "tolerances",
        value_parser = clap::value_parser!(u32).range(0..=1000))]
    pokes: Vec<u32>,
    /// Seed of the errors, the places and the noise.
    #[arg(long, default_value_t = 1, requires = "tolerances")]
    seed: u64,
    /// Print JSON instead of the table.
    #[arg(long, conflicts_with_all = ["improve", "tolerances"])]
    json: bool,
}

/// A property that a search may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Change {
    /// Spacing of driving and measuring pairs.
    Protocol,
    /// Spacing of driving pairs.
    Drive,
    /// Number of electrodes.
    Count,
    /// Position of each electrode.
    Electrodes,
}

/// All results on one skin.
struct Sheet {
    prepared: Prepared,
    maps: Maps,
    spread_m: Vec<f64>,
    force: Option<ForceMap>,
}

impl Arguments {
    /// Computes maps, prints tables, and searches if asked to.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if let Some(winner) = &self.winner {
            return self.improve_skin(winner, out);
        }
        if let Some(file) = &self.tolerances {
            return self.try_tolerances(file.as_deref(), out);
        }
        let mut sheets: Vec<Sheet> = Vec::with_capacity(self.skins.len());
        let mut instrument = None;
        for name in &self.skins {
            let busy = super::busy(format!("designing {name}"));
            let prepared = Prepared::new(Skin::open(name)?)?;
            // A single skin keeps the noise that its file gives for each channel.
            let noise = match (&instrument, self.skins.len()) {
                (_, 1) => self.noise(),
                (None, _) => instrument.insert(SharedInstrument::of(&prepared, self.noise())?).noise,
                (Some(instrument), _) => instrument.noise_of(&prepared),
            };
            let sheet = self.sheet(prepared, noise)?;
            busy.finish();
            if let Some(folder) = &self.out {
                write_maps(folder, &sheet)?;
            }
            sheets.push(sheet);
        }
        let positions: Vec<(&str, Summary)> = sheets
            .iter()
            .map(|sheet| (sheet.prepared.skin.name.as_str(), Summary::of(&sheet.maps.position_m)))
            .collect();
        let verdict = verdict(&positions);
        if self.json {
            super::print_json(&report(&sheets, self.amplitude, verdict.as_deref()), out)?;
            return Ok(Outcome::Done);
        }
        writeln!(out, "touch with a peak change of {}; worst / median / best place", self.amplitude)?;
        if let Some(instrument) = instrument {
            let noise = in_words(instrument.noise);
            let (first, readings) = (positions[0].0, instrument.readings);
            writeln!(
                out,
                "one instrument for all: {noise} per reading of {first} ({readings} readings per frame); frames take equal \
                 time, so noise power grows with the number of readings"
            )?;
        }
        write_table(out, &sheets)?;
        if let Some(verdict) = verdict {
            writeln!(out, "{verdict}")?;
        }
        Ok(Outcome::Done)
    }

    /// Noise of a reading of the first skin.
    fn noise(&self) -> Noise {
        match (self.snr_db, self.noise_uv) {
            (Some(db), _) => Noise::Decibels(db),
            (None, Some(uv)) => Noise::Volts(1e-6 * uv),
            (None, None) => Noise::Assumed,
        }
    }

    fn sheet(&self, prepared: Prepared, noise: Noise) -> anyhow::Result<Sheet> {
        let maps = Maps::new(&prepared, noise, self.amplitude, self.map as usize)?;
        let spread_m = spread_width(&prepared, &maps)?;
        let mut force = None;
        if self.force {
            let press =
                |progress: &mut dyn FnMut(usize, usize)| smallest_force(&prepared, noise, self.map as usize, progress);
            force = Some(super::with_progress("places pressed", press)?);
        }
        Ok(Sheet { prepared, maps, spread_m, force })
    }

    fn try_tolerances(&self, file: Option<&Path>, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let given = file.map(Tolerances::read).transpose()?;
        let extent = Extent {
            samples: self.samples as usize,
            presses: self.presses as usize,
            pokes: self.pokes.iter().filter(|count| **count > 0).map(|count| *count as usize).collect(),
            seed: self.seed,
        };
        for name in &self.skins {
            let skin = Skin::open(name)?;
            let bar = super::progress_bar("samples");
            let tolerances = given.as_ref().unwrap_or(&skin.tolerances);
            let report = run(&skin, tolerances, &extent, &|done, all| {
                bar.set_length(all as u64);
                bar.set_position(done as u64);
                true
            });
            bar.finish_and_clear();
            let report = report?;
            tolerance_page::write_table(out, &report)?;
            if let Some(folder) = &self.out {
                tolerance_page::write_files(folder, &report, tolerances)?;
                writeln!(out, "{}", folder.display())?;
            }
        }
        Ok(Outcome::Done)
    }

    fn improve_skin(&self, winner: &Path, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let [name] = self.skins.as_slice() else {
            return Err(UsageError(format!("--improve: expected one skin, got {}", self.skins.len())).into());
        };
        let freed = self.improve.iter().map(|change| match change {
            Change::Protocol => Freedom::Protocol,
            Change::Drive => Freedom::Drive,
            Change::Count => Freedom::Count,
            Change::Electrodes => Freedom::Electrodes,
        });
        let (amplitude, along, noise) = (self.amplitude, self.map as usize, self.noise());
        let search = Search { freed: freed.collect(), amplitude, along, noise };
        let skin = Skin::open(name)?;
        let [own, best] = super::with_progress("skins", |progress| improve(&skin, &search, progress))?;
        let millimetres = |summary: Summary| three([summary.worst, summary.median, summary.best].map(|m| 1e3 * m));
        writeln!(out, "position bound, mm, worst / median / best place, at equal time per frame")?;
        for (label, candidate) in [("unchanged", &own), ("best", &best)] {
            let backend = &candidate.skin.backend;
            write!(out, "  {label:<9} {}  ", millimetres(candidate.position_m))?;
            write!(out, "{} electrodes, ", candidate.skin.electrode_shapes().len())?;
            match &backend.channels {
                Some(list) => writeln!(out, "{} listed channels", list.channels().len())?,
                None => {
                    let (drive, measure) = (inline(&backend.drive)?, inline(&backend.measure)?);
                    writeln!(out, "drive = {drive}, measure = {measure}")?;
                }
            }
        }
        let text = best.skin.to_toml();
        write_atomic(winner, |file| file.write_all(text.as_bytes()))?;
        writeln!(out, "{}", winner.display())?;
        Ok(Outcome::Done)
    }
}

/// A value in the syntax of skin files.
fn inline(pattern: &impl serde::Serialize) -> anyhow::Result<String> {
    Ok(dermis_lab::channel_search::toml_of(&serde_json::to_value(pattern)?))
}

fn in_words(noise: Noise) -> String {
    match noise {
        Noise::Volts(volts) => format!("{:.3} uV", 1e6 * volts),
        Noise::Decibels(db) => format!("{db} dB below"),
        Noise::Assumed => "the noise in the file".into(),
    }
}

/// The table as JSON: lengths in millimetres, shares in per cent.
fn report(sheets: &[Sheet], amplitude: f64, verdict: Option<&str>) -> serde_json::Value {
    let summary = |values: &[f64], scale: f64| {
        let Summary { worst, median, best } = Summary::of(values);
        serde_json::json!({ "worst": scale * worst, "median": scale * median, "best": scale * best })
    };
    let skin = |sheet: &Sheet| {
        serde_json::json!({
            "skin": sheet.prepared.skin.name,
            "channels": sheet.prepared.channels(),
            "frames_per_s": sheet.prepared.skin.backend.frames_per_s,
            "position_bound_mm": summary(&sheet.maps.position_m, 1e3),
            "amplitude_bound_percent": summary(&sheet.maps.amplitude_share, 1e2),
            "smallest_change_percent": summary(&sheet.maps.smallest, 1e2),
            "spread_mm": summary(&sheet.spread_m, 1e3),
            "smallest_force_mn": sheet.force.as_ref().map(|map| summary(&map.force_n, 1e3)),
        })
    };
    let skins: Vec<serde_json::Value> = sheets.iter().map(skin).collect();
    serde_json::json!({ "amplitude": amplitude, "skins": skins, "verdict": verdict })
}

fn three(values: [f64; 3]) -> String {
    values.map(|v| if v >= 100.0 { format!("{v:.0}") } else { format!("{v:.3}") }).join(" / ")
}

/// Prints the table, with a column per skin and a line per figure.
fn write_table(out: &mut dyn Write, sheets: &[Sheet]) -> std::io::Result<()> {
    let line = |out: &mut dyn Write, label: &str, cell: &dyn Fn(&Sheet) -> String| {
        write!(out, "{label:<24}")?;
        sheets.iter().try_for_each(|sheet| write!(out, " {:>24}", cell(sheet)))?;
        writeln!(out)
    };
    let rate = |sheet: &Sheet| sheet.prepared.skin.backend.frames_per_s;
    let text = |value: Option<f64>| value.map_or("-".to_string(), |v| format!("{v:.1}"));
    let column = |values: &[f64], scale: f64| {
        let summary = Summary::of(values);
        three([summary.worst, summary.median, summary.best].map(|v| scale * v))
    };
    line(out, "", &|sheet| sheet.prepared.skin.name.clone())?;
    line(out, "channels", &|sheet| sheet.prepared.channels().to_string())?;
    line(out, "frames/s", &|sheet| text(rate(sheet)))?;
    // Two bytes per reading, as from a 16-bit converter.
    line(out, "data, kB/s", &|sheet| text(rate(sheet).map(|rate| rate * sheet.prepared.channels() as f64 * 2e-3)))?;
    line(out, "position bound, mm", &|sheet| column(&sheet.maps.position_m, 1e3))?;
    line(out, "amplitude bound, %", &|sheet| column(&sheet.maps.amplitude_share, 1e2))?;
    line(out, "smallest change, %", &|sheet| column(&sheet.maps.smallest, 1e2))?;
    line(out, "point-spread width, mm", &|sheet| column(&sheet.spread_m, 1e3))?;
    if sheets.iter().any(|sheet| sheet.force.is_some()) {
        let force = |sheet: &Sheet| sheet.force.as_ref().map_or("-".to_string(), |map| column(&map.force_n, 1e3));
        line(out, "smallest force, mN", &force)?;
        let diameter = |sheet: &Sheet| sheet.force.as_ref().map(|map| 2e3 * map.radius_m);
        line(out, "  on a disc of, mm", &|sheet| text(diameter(sheet)))?;
    }
    Ok(())
}

fn write_maps(folder: &Path, sheet: &Sheet) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    let (maps, name) = (&sheet.maps, &sheet.prepared.skin.name);
    let figures = [
        ("sensitivity", "sensitivity", &maps.sensitivity),
        ("smallest", "smallest change", &maps.smallest),
        ("position", "position bound", &maps.position_m),
        ("amplitude", "amplitude bound", &maps.amplitude_share),
        ("spread", "point-spread width", &sheet.spread_m),
    ];
    let mut images: Vec<(&str, &str, Vec<f32>, [usize; 2])> = figures
        .into_iter()
        .map(|(key, title, values)| (key, title, maps.image(values), [maps.grid.rows, maps.grid.columns]))
        .collect();
    if let Some(map) = &sheet.force {
        let title = "smallest force";
        images.push(("force", title, map.image(), [map.grid.rows, map.grid.columns]));
    }
    let mut panels = Vec::with_capacity(images.len());
    for (key, title, image, shape) in images {
        npy::write_f32(&folder.join(format!("{name}-{key}.npy")), &shape, &image)?;
        let least = image.iter().copied().filter(|v| v.is_finite()).fold(f32::INFINITY, f32::min);
        let values = image.iter().map(|value| (value / least).log10()).collect();
        panels.push(Panel {
            name: title.to_string(),
            quantity: format!("log₁₀ of {title} / minimum"),
            columns: shape[1],
            values,
            marks: Vec::new(),
            bend: None,
            width_mm: Some(1e3 * maps.grid.pixel_m * shape[1] as f64),
        });
    }
    let picture = Heatmap { title: format!("{name}: predicted performance"), panels }.picture();
    let content = draw::png(&picture, 2)?;
    write_atomic(&folder.join(format!("{name}.png")), |file| file.write_all(&content))?;
    Ok(())
}
