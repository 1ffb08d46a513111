//! `dermis reconstruct`: recorded frames to images and touches.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use dermis::lab::reconstruct::{Report, Request, reconstruct};
use dermis::skin::Skin;
use dermis_device::FileSpec;

use super::recorded::RecordedFrames;
use super::with_progress;
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis reconstruct --skin healing-square --baseline rest.csv --frames press.csv --touches t.csv --images i.npy
  dermis reconstruct --skin healing-square --baseline 'press.csv#0' --frames 'press.csv#1..3' --touches t.csv

The baseline has one or more frames, which are averaged, or as many as there are frames: then each frame has its own, and
frames have nothing to do with each other. t.csv has the columns frame, id, x_mm, y_mm, amplitude, area_mm2, sigma_x_mm,
sigma_y_mm; a frame without touch has no row. i.npy is frames x rows x columns (f32), row 0 at the top, NaN outside.
Missing channels are empty cells or NaN.";

/// Arguments of `dermis reconstruct`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    recorded: RecordedFrames,
    /// Frames of the untouched skin.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: FileSpec,
    /// A calibration made by `dermis calibrate`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// A force calibration made by `dermis calibrate --forces`: the table then has force_n and force_range.
    #[arg(long, value_name = "FILE")]
    forces: Option<PathBuf>,
    /// lambda, in place of the skin file's rule.
    #[arg(long, value_name = "LAMBDA")]
    hyperparameter: Option<f64>,
    /// Where the table of touches goes.
    #[arg(long, value_name = "FILE.csv")]
    touches: Option<PathBuf>,
    /// Where the images go.
    #[arg(long, value_name = "FILE.npy")]
    images: Option<PathBuf>,
}

impl Arguments {
    /// Reconstructs all frames and says how it went.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.touches.is_none() && self.images.is_none() {
            return Err(UsageError("nothing asked for: give --touches, --images or both".into()).into());
        }
        let request = Request {
            skin: Skin::open(&self.recorded.skin)?,
            baseline: self.baseline,
            frames: self.recorded.frames,
            format: self.recorded.format,
            calibration: self.calibration,
            forces: self.forces,
            hyperparameter: self.hyperparameter,
            touches: self.touches,
            images: self.images,
        };
        let report = with_progress("frames", |progress| reconstruct(&request, progress))?;
        print(&report, out).context("writing the summary")?;
        Ok(Outcome::Done)
    }
}

fn print(report: &Report, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "frames: {}", report.frames)?;
    writeln!(out, "rows of touches: {}", report.touch_rows)?;
    writeln!(out, "hyperparameter: {:.6e}", report.hyperparameter)?;
    writeln!(out, "frames with missing channels: {}", report.frames_with_missing)?;
    writeln!(out, "channel noise: {}", if report.noise_measured { "measured" } else { "assumed" })?;
    writeln!(out, "correlation of the baseline with the homogeneous model: {:.4}", report.order.correlation)?;
    if let Some(better) = &report.order.better {
        writeln!(
            out,
            "the channels may be in another order: \"{}\" would give {:.4}",
            better.description, better.correlation
        )?;
    }
    Ok(())
}
