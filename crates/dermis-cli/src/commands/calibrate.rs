//! `dermis calibrate`: pokes at known positions to a calibration that `run` and `reconstruct` use.

use std::io::Write;
use std::path::PathBuf;

use dermis::calibrate::{Calibration, read_pokes};
use dermis::channels::ChannelReader;
use dermis::prepare::Prepared;
use dermis::skin::Skin;
use dermis_device::{FileSpec, Format, FrameTable};

use super::spinner;
use crate::exit::Outcome;

const EXAMPLE: &str = "\
Example:
  dermis calibrate --skin hydrogel-disc --baseline before.csv --frames pressed.csv --positions positions.csv --out c.json

The baseline has one frame for all pokes, or one for each. The positions have the columns x_m, y_m and, if the load is
known, depth_m or force_n. Printed are the leave-one-out error and where more pokes would help most.";

/// Arguments of `dermis calibrate`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Built-in skin or skin file.
    #[arg(long, value_name = "NAME|FILE")]
    skin: String,
    /// Frames of the untouched skin: one or more for all pokes, or one before each.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: FileSpec,
    /// Frames of the pressed skin, one a poke.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    frames: FileSpec,
    /// Where each poke was: x_m, y_m[, depth_m or force_n].
    #[arg(long, value_name = "FILE.csv")]
    positions: PathBuf,
    /// Format of the frames (csv, columns, npy, sciospec, ...); recognised where left out.
    #[arg(long)]
    format: Option<Format>,
    /// Where the calibration goes.
    #[arg(long, value_name = "FILE.json")]
    out: PathBuf,
    /// How many further pokes to suggest.
    #[arg(long, default_value_t = 5)]
    suggest: usize,
}

impl Arguments {
    /// Fits the calibration, writes it and says how good it is.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let skin = Skin::open(&self.skin)?;
        let baselines = dermis_device::read(&self.baseline, self.format).map_err(dermis::Error::from)?;
        let frames = dermis_device::read(&self.frames, self.format).map_err(dermis::Error::from)?;
        let pokes = read_pokes(&self.positions)?;
        let prepared = Prepared::new(skin)?;
        let reads = prepared.skin.backend.reads;
        let reader = |table: &FrameTable| {
            ChannelReader::new(table.layout(), &prepared.protocol, reads, &table.source().display().to_string())
        };
        let mut baseline_reader = reader(&baselines)?;
        let baselines = baseline_reader.read_table(&baselines)?;
        let mut frame_reader = reader(&frames)?;
        frame_reader.share_phase_of(&baseline_reader);
        let frames = frame_reader.read_table(&frames)?;
        let spinner = spinner("fitting the calibration");
        let calibration = prepared.calibrate(&baselines, &frames, &pokes);
        spinner.finish_and_clear();
        let calibration = calibration?;
        calibration.save(&self.out)?;
        self.print(&prepared, &calibration, out)?;
        Ok(Outcome::Done)
    }

    fn print(&self, prepared: &Prepared, calibration: &Calibration, out: &mut dyn Write) -> anyhow::Result<()> {
        let report = calibration.leave_one_out();
        let measured = calibration.measured_jacobian(prepared)?;
        writeln!(out, "pokes: {}", calibration.pokes())?;
        writeln!(
            out,
            "leave-one-out error: median {:.2} mm, 90th percentile {:.2} mm",
            report.median_error_m * 1e3,
            report.p90_error_m * 1e3
        )?;
        writeln!(
            out,
            "within one predicted sigma: {:.0} % in x, {:.0} % in y",
            100.0 * report.coverage[0],
            100.0 * report.coverage[1]
        )?;
        writeln!(
            out,
            "measured Jacobian: correlation length {:.1} mm, left-out frames predicted within {:.0} % (rms)",
            measured.length_m * 1e3,
            100.0 * measured.leave_one_out
        )?;
        if self.suggest > 0 {
            writeln!(out, "more pokes would help most at:")?;
            for poke in calibration.suggest_pokes(self.suggest)? {
                writeln!(
                    out,
                    "  ({:.1}, {:.1}) mm, expected sigma {:.2} mm",
                    poke.position_m[0] * 1e3,
                    poke.position_m[1] * 1e3,
                    poke.sigma_m * 1e3
                )?;
            }
        }
        writeln!(out, "written: {}", self.out.display())?;
        Ok(())
    }
}
