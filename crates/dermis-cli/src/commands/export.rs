//! `dermis export`: exports parts of a recording, or the frames of any file, as tables for spreadsheets, data frames
//! and NumPy.

use std::io::Write;
use std::path::PathBuf;

use dermis_device::{FileSpec, FrameSelect};
use dermis_record::{Exported, Recording, Table, TableFormat, export, export_frames, is_recording, read_frames};

use super::reading::TableArguments;
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis export press.mcap --out readings.csv
  dermis export press.mcap --out readings.npy
  dermis export press.mcap --table touches --out touches.parquet
  dermis export press.mcap#0..60 --out baseline.csv

Tables: frames (number, times in nanoseconds, one column per channel), touches, baselines, events. NPY holds only the \
frames' readings: frames x channels. Any other file (CSV, MATLAB, Excel, a ROS bag, ...) has frames only, and is \
converted to the new format. Exit code 3: part of the recording could not be read.";

/// Arguments of `dermis export`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// A recording, complete or not, or a file of frames; #0..60 after the name selects some frames.
    #[arg(value_name = "FILE[#FRAMES]")]
    file: FileSpec,
    /// Part to export: frames, touches, baselines or events.
    #[arg(long, default_value = "frames")]
    table: Table,
    /// csv, npy or parquet; default: by the ending of the output file, otherwise csv.
    #[arg(long)]
    format: Option<TableFormat>,
    /// Output file.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    read: TableArguments,
}

impl Arguments {
    /// Exports the table and prints its size.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let exported = self.export()?;
        writeln!(out, "{}: {} rows of {} columns", self.out.display(), exported.rows, exported.columns)?;
        if exported.damage.is_none() {
            return Ok(Outcome::Done);
        }
        tracing::error!("{}: parts could not be read: {}", self.file.path.display(), exported.damage);
        Ok(Outcome::DataLost)
    }

    fn export(&self) -> anyhow::Result<Exported> {
        let format = self.format.unwrap_or_else(|| TableFormat::of_name(&self.out));
        let is_recording = is_recording(&self.file.path);
        if is_recording && self.file.select == FrameSelect::All {
            return Ok(export(&mut Recording::open(&self.file.path)?, self.table, format, &self.out)?);
        }
        if self.table != Table::Frames {
            let which = if is_recording { "of a selection of frames" } else { "of a file that is not a recording" };
            return Err(UsageError(format!("--table: expected frames, the only table {which}")).into());
        }
        Ok(export_frames(&read_frames(&self.file, self.read.options())?, format, &self.out)?)
    }
}
