//! `dermis design`: what skins will be able to do before they are built, side by side, and which protocol suits one best.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use dermis::design::{Maps, Noise, Summary, improve_protocol};
use dermis::prepare::Prepared;
use dermis::skin::Skin;
use dermis_device::instruments::npy;
use dermis_device::write_atomic;

use crate::draw::{self, Heatmap, Panel};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis design healing-square ionic-disc
  dermis design ionic-disc --snr-db 59.7 --out design
  dermis design golfball-tank --map 12 --improve protocol --winner better.toml

Bounds are Cramer-Rao bounds: no unbiased method does better at this noise. \"Worst\" leaves out the outermost tenth of the
area. Noise is what the skin file assumes, the same for every channel; --snr-db makes it proportional to the reading.";

/// Arguments of `dermis design`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Names of built-in skins, or skin files.
    #[arg(value_name = "SKIN", required = true)]
    skins: Vec<String>,
    /// Relative change of conductivity of the touch that bounds are for.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    amplitude: f64,
    /// Signal-to-noise ratio of every channel, 20 log10(reading / deviation).
    #[arg(long, value_name = "DB", conflicts_with = "improve")]
    snr_db: Option<f64>,
    /// Places along the longer side of the maps.
    #[arg(long, value_name = "PLACES", default_value_t = 32, value_parser = clap::value_parser!(u32).range(4..=128))]
    map: u32,
    /// Folder for the maps, PNG and NPY.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Search for a better skin; what may change.
    #[arg(long, value_enum, requires = "winner")]
    improve: Option<Freedom>,
    /// Where the better skin file goes.
    #[arg(long, value_name = "FILE.toml", requires = "improve")]
    winner: Option<PathBuf>,
}

/// What a search may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Freedom {
    /// Distances of driving and measuring pairs.
    Protocol,
}

impl Arguments {
    /// Maps, tables, and the search where asked for.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if let (Some(Freedom::Protocol), Some(winner)) = (self.improve, &self.winner) {
            return self.improve_each(winner, out);
        }
        let noise = self.snr_db.map_or(Noise::Assumed, Noise::Decibels);
        let columns = ["channels", "frames/s", "kB/s", "position mm", "amplitude %", "smallest %"];
        writeln!(out, "touch of {} at its middle; worst / median / best place", self.amplitude)?;
        write!(out, "{:<16} {:>8} {:>8} {:>8}", "", columns[0], columns[1], columns[2])?;
        writeln!(out, " {:>24} {:>24} {:>24}", columns[3], columns[4], columns[5])?;
        for name in &self.skins {
            let prepared = Prepared::new(Skin::open(name)?)?;
            let maps = Maps::new(&prepared, noise, self.amplitude, self.map as usize)?;
            table_row(out, &prepared, &maps)?;
            if let Some(folder) = &self.out {
                write_maps(folder, &prepared.skin.name, &maps)?;
            }
        }
        Ok(Outcome::Done)
    }

    fn improve_each(&self, winner: &Path, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let [name] = self.skins.as_slice() else {
            return Err(UsageError(format!("--improve: expected one skin, got {}", self.skins.len())).into());
        };
        let bar = super::progress_bar("protocols");
        let [own, best] = improve_protocol(&Skin::open(name)?, self.amplitude, self.map as usize, |done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        let millimetres = |summary: Summary| three([summary.worst, summary.median, summary.best].map(|m| 1e3 * m));
        writeln!(out, "position bound, mm, worst / median / best place, at the same noise in volts")?;
        writeln!(out, "  as it is  {}", millimetres(own.position_m))?;
        writeln!(
            out,
            "  best      {}  drive {:?}, measure {:?}",
            millimetres(best.position_m),
            best.skin.backend.drive,
            best.skin.backend.measure
        )?;
        let text = best.skin.to_toml();
        write_atomic(winner, |file| file.write_all(text.as_bytes()))?;
        writeln!(out, "{}", winner.display())?;
        Ok(Outcome::Done)
    }
}

fn three(values: [f64; 3]) -> String {
    values.map(|v| if v >= 100.0 { format!("{v:.0}") } else { format!("{v:.3}") }).join(" / ")
}

fn table_row(out: &mut dyn Write, prepared: &Prepared, maps: &Maps) -> std::io::Result<()> {
    let (name, channels) = (&prepared.skin.name, prepared.channels());
    let rate = prepared.skin.backend.frames_per_s;
    let text = |value: Option<f64>| value.map_or("-".to_string(), |v| format!("{v:.1}"));
    // Two bytes a reading, as converters of 16 bits give.
    let kilobytes = rate.map(|rate| rate * channels as f64 * 2e-3);
    let column = |values: &[f64], scale: f64| {
        let summary = Summary::of(values);
        three([summary.worst, summary.median, summary.best].map(|v| scale * v))
    };
    write!(out, "{name:<16} {channels:>8} {:>8} {:>8}", text(rate), text(kilobytes))?;
    let (position, share) = (column(&maps.position_m, 1e3), column(&maps.amplitude_share, 1e2));
    writeln!(out, " {position:>24} {share:>24} {:>24}", column(&maps.smallest, 1e2))
}

fn write_maps(folder: &Path, name: &str, maps: &Maps) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    let figures = [
        ("sensitivity", "sensitivity: log10 over the weakest", &maps.sensitivity),
        ("smallest", "smallest amplitude: log10 over the best", &maps.smallest),
        ("position", "position bound: log10 over the best", &maps.position_m),
        ("amplitude", "amplitude bound: log10 over the best", &maps.amplitude_share),
    ];
    let mut panels = Vec::with_capacity(figures.len());
    for (key, title, values) in figures {
        let shape = [maps.grid.rows, maps.grid.columns];
        npy::write_f32(&folder.join(format!("{name}-{key}.npy")), &shape, &maps.image(values))?;
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let logs: Vec<f64> = values.iter().map(|value| (value / least).log10()).collect();
        let values = maps.image(&logs);
        panels.push(Panel {
            name: title.to_string(),
            columns: maps.grid.columns,
            values,
            marks: Vec::new(),
            bend: None,
        });
    }
    let picture = Heatmap { title: format!("{name}: before it is built"), panels, own_scales: true }.picture();
    let content = draw::png(&picture)?;
    write_atomic(&folder.join(format!("{name}.png")), |file| file.write_all(&content))?;
    Ok(())
}
