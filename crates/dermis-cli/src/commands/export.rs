//! `dermis export`: exports parts of a recording as tables for spreadsheets, data frames and NumPy.

use std::io::Write;
use std::path::PathBuf;

use dermis::record::{Recording, Table, TableFormat, export};

use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis export press.mcap --out readings.csv
  dermis export press.mcap --format npy --out readings.npy
  dermis export press.mcap --table touches --format parquet --out touches.parquet

Tables: frames (number, times in nanoseconds, a column for each channel), touches, baselines, events. NPY holds the readings
of frames alone: frames x channels. Exit code 3: the recording could not be read whole.";

/// Arguments of `dermis export`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// The recording, complete or not.
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// Part to export: frames, touches, baselines or events.
    #[arg(long, default_value = "frames")]
    table: Table,
    /// csv, npy or parquet.
    #[arg(long, default_value = "csv")]
    format: TableFormat,
    /// Output file.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

impl Arguments {
    /// Exports the table and prints its size.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let mut recording = Recording::open(&self.file)?;
        let exported = export(&mut recording, self.table, self.format, &self.out)?;
        writeln!(out, "{}: {} rows of {} columns", self.out.display(), exported.rows, exported.columns)?;
        if exported.damage.is_none() {
            return Ok(Outcome::Done);
        }
        tracing::error!("{} could not be read whole: {}", self.file.display(), exported.damage);
        Ok(Outcome::DataLost)
    }
}
