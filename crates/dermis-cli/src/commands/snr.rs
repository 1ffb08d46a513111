//! `dermis snr`: the signal-to-noise ratio of every channel and their average, under each definition used by the
//! published skins, since the same frames give three different numbers.

use std::io::{self, Write};

use dermis_device::{FileSpec, FrameTable};
use dermis_touch::{RunningStats, SnrDefinition, SnrSummary, average_snr_db, snr_db};
use serde::Serialize;

use super::reading::ReadArguments;
use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis snr --frames frames.csv
  dermis snr --frames 'frames.csv#0..4' --json

V are the values of one channel over the frames, which must show an untouched skin. Averages are means of the \
channels' decibels, as in the papers.";

const DEFINITIONS: [(SnrDefinition, &str); 3] = [
    (SnrDefinition::IonicAsPrinted, "as the ionic-liquid skin's paper prints it"),
    (SnrDefinition::HealingEnergy, "equation 5 of the self-healing skin's paper"),
    (SnrDefinition::Amplitude, "the amplitude ratio in decibels"),
];

/// Arguments of `dermis snr`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Frames of an untouched skin, one per row; #0..60 after the name selects some of them.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    frames: FileSpec,
    #[command(flatten)]
    read: ReadArguments,
    /// Print JSON instead of a table; ratios that are not finite are null.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    frames: usize,
    /// Averaged quantity: `value`, or `magnitude` for complex readings.
    reading: &'static str,
    definitions: Vec<Average>,
    channels: Vec<Channel>,
}

#[derive(Serialize)]
struct Average {
    formula: &'static str,
    source: &'static str,
    #[serde(flatten)]
    summary: SnrSummary,
}

#[derive(Serialize)]
struct Channel {
    /// Counted from 1, as on paper.
    channel: usize,
    mean: f64,
    std: f64,
    ionic_as_printed_db: f64,
    healing_energy_db: f64,
    amplitude_db: f64,
}

impl Arguments {
    /// Reads the frames and prints the ratios.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let table = dermis_record::read_frames(&self.frames, self.read.options())?;
        let report = Report::of(&table)?;
        if self.json {
            serde_json::to_writer_pretty(&mut *out, &report).map_err(io::Error::from)?;
            writeln!(out)?;
        } else {
            report.print(out)?;
        }
        Ok(Outcome::Done)
    }
}

impl Report {
    fn of(table: &FrameTable) -> Result<Self, dermis_live::Error> {
        if table.frames() < 2 {
            return Err(dermis_live::Error::Frames {
                what: format!("{}: frames to take noise from", table.source().display()),
                expected: "at least 2".to_string(),
                got: table.frames().to_string(),
            });
        }
        let mut stats = RunningStats::new(table.channels());
        let mut magnitude = Vec::new();
        for (index, row) in table.rows().enumerate() {
            match table.imaginary_row(index) {
                Some(imaginary) => {
                    magnitude.clear();
                    magnitude.extend(row.iter().zip(imaginary).map(|(re, im)| re.hypot(*im)));
                    stats.push(&magnitude)?;
                }
                None => stats.push(row)?,
            }
        }
        let average = |(definition, source): (SnrDefinition, _)| Average {
            formula: definition.formula(),
            source,
            summary: average_snr_db(definition, &stats),
        };
        let channel = |channel: usize| Channel {
            channel: channel + 1,
            mean: stats.mean(channel),
            std: stats.std(channel),
            ionic_as_printed_db: snr_db(SnrDefinition::IonicAsPrinted, &stats, channel),
            healing_energy_db: snr_db(SnrDefinition::HealingEnergy, &stats, channel),
            amplitude_db: snr_db(SnrDefinition::Amplitude, &stats, channel),
        };
        Ok(Self {
            frames: table.frames(),
            reading: if table.imaginary().is_some() { "magnitude" } else { "value" },
            definitions: DEFINITIONS.into_iter().map(average).collect(),
            channels: (0..stats.channels()).map(channel).collect(),
        })
    }

    fn print(&self, out: &mut dyn Write) -> io::Result<()> {
        let head = ["channel", "mean", "std", "ionic dB", "energy dB", "amplitude dB"];
        writeln!(
            out,
            "{:>7} {:>14} {:>14} {:>10} {:>10} {:>13}",
            head[0], head[1], head[2], head[3], head[4], head[5]
        )?;
        for row in &self.channels {
            writeln!(
                out,
                "{:>7} {:>14.6e} {:>14.6e} {:>10.2} {:>10.2} {:>13.2}",
                row.channel, row.mean, row.std, row.ionic_as_printed_db, row.healing_energy_db, row.amplitude_db
            )?;
        }
        writeln!(
            out,
            "\naverage over {} channels, {} frames ({} of each reading):",
            self.channels.len(),
            self.frames,
            self.reading
        )?;
        for (name, average) in ["ionic", "energy", "amplitude"].into_iter().zip(&self.definitions) {
            let summary = &average.summary;
            write!(out, "{name:>10} {:>8.2} dB = {} ({})", summary.mean_db, average.formula, average.source)?;
            match summary.left_out {
                0 => writeln!(out)?,
                some => writeln!(out, "; {some} channels without a finite ratio left out")?,
            }
        }
        Ok(())
    }
}
