//! `dermis reconstruct`: turns recorded frames into images and touches.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use dermis_device::FileSpec;
use dermis_lab::channel_search::{FoundOrder, find_order};
use dermis_lab::reconstruct::{Report, Request, reconstruct};
use dermis_live::reference::NoiseSource;
use dermis_record::read_frames;

use super::order::print_order;
use super::printing::print_circuit;
use super::recorded::{RecordedFrames, baseline_or_differences};
use super::{listed, print_json, with_progress};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis reconstruct healing-square --baseline rest.csv --frames press.csv \\
      --touches t.csv --images i.npy
  dermis reconstruct healing-square --baseline 'press.csv#0' \\
      --frames 'press.csv#1..3' --touches t.csv

The frames of the baseline are averaged. If there are as many as frames to image, each frame gets its own baseline, \
and frames are independent of each other. Frames that are already differences (--differences) need none. t.csv has \
the columns frame, id, x_mm, y_mm, amplitude, area_mm2, sigma_x_mm, sigma_y_mm; depth_mm or poke_force_n with a sigma \
if the calibration's pokes had one; and, on a skin calibrated without labels, an alternative position: other_x_mm, \
other_y_mm and other_probability. A frame without touch has no row. i.npy is frames x rows x columns (f32), row 0 at \
the top, NaN outside. Missing channels are empty cells or NaN. Exit code 1: the files were written, but the baseline \
fits the skin better in another channel order, which is printed as lines for the skin file.";

/// Arguments of `dermis reconstruct`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    recorded: RecordedFrames,
    /// Frames of the untouched skin; not needed if the frames are already differences.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: Option<FileSpec>,
    /// The frames are already differences from the untouched skin.
    #[arg(long, conflicts_with = "baseline")]
    differences: bool,
    /// A calibration made by `dermis calibrate`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// A force calibration made by `dermis calibrate --forces`: the table then has force_n and force_range.
    #[arg(long, value_name = "FILE")]
    forces: Option<PathBuf>,
    /// lambda, overriding the skin file's rule.
    #[arg(long, value_name = "LAMBDA")]
    hyperparameter: Option<f64>,
    /// Output file for the table of touches.
    #[arg(long, value_name = "FILE.csv")]
    touches: Option<PathBuf>,
    /// Output file for the images.
    #[arg(long, value_name = "FILE.npy")]
    images: Option<PathBuf>,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Reconstructs all frames and prints a summary.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.touches.is_none() && self.images.is_none() {
            return Err(UsageError("nothing to write: give --touches, --images or both".into()).into());
        }
        let skin = self.recorded.skin.open()?;
        let differences = baseline_or_differences(self.baseline.as_ref(), self.differences, &skin)?;
        let request = Request {
            skin,
            baseline: self.baseline,
            frames: self.recorded.frames,
            read: self.recorded.read.options(),
            as_skin: self.recorded.as_skin,
            calibration: self.calibration,
            forces: self.forces,
            hyperparameter: self.hyperparameter,
            touches: self.touches,
            images: self.images,
        };
        let report = with_progress("frames", |progress| reconstruct(&request, progress))?;
        let found = match (&report.order.better, &request.baseline) {
            // With a readout circuit the readings are not the model's voltages in any order.
            (Some(_), Some(baseline)) if request.skin.backend.circuit.is_none() => {
                Some(find_order(&read_frames(baseline, request.read.clone())?, Some(&request.skin))?)
            }
            _ => None,
        };
        if self.json {
            print_json(&as_json(&report, differences, found.as_ref()), out)?;
        } else {
            print(&report, differences, out).context("writing the summary")?;
            found.as_ref().map_or(Ok(()), |found| print_order(found, out))?;
        }
        Ok(if found.is_some() { Outcome::ProblemsFound } else { Outcome::Done })
    }
}

fn as_json(report: &Report, differences: bool, found: Option<&FoundOrder>) -> serde_json::Value {
    let noise = match report.noise_source {
        NoiseSource::Baseline | NoiseSource::Pairs => "baseline",
        NoiseSource::Frames => "frames",
        NoiseSource::Assumed => "assumed",
    };
    let circuit = report.circuit.as_ref().map(|fit| {
        serde_json::json!({
            "found": fit.circuit,
            "score": fit.score,
            "score_before": fit.score_before,
            "trusted": fit.is_trusted(),
        })
    });
    serde_json::json!({
        "frames": report.frames,
        "mismatches": report.mismatches,
        "touch_rows": report.touch_rows,
        "hyperparameter": report.hyperparameter,
        "frames_with_missing": report.frames_with_missing,
        "left_out": report.left_out,
        "noise": noise,
        "differences": differences,
        "baseline_frames_averaged": report.averaged,
        "circuit": circuit,
        "baseline_correlation": (!differences).then_some(report.order.correlation),
        "other_order": found,
    })
}

fn print(report: &Report, differences: bool, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "frames: {}", report.frames)?;
    writeln!(out, "rows of touches: {}", report.touch_rows)?;
    writeln!(out, "hyperparameter: {:.6e}", report.hyperparameter)?;
    writeln!(out, "frames with missing channels: {}", report.frames_with_missing)?;
    if !report.left_out.is_empty() {
        let channels = listed(report.left_out.iter().map(|channel| *channel as usize));
        writeln!(out, "channels that jump while nothing touches the skin, left out: {channels}")?;
    }
    writeln!(out, "channel noise: {}", report.noise_source.describe())?;
    if differences {
        return Ok(());
    }
    match report.averaged {
        Some(1) => writeln!(out, "baseline: one frame")?,
        Some(frames) => writeln!(out, "baseline: the mean of {frames} frames")?,
        None => writeln!(out, "baseline: one for each frame")?,
    }
    if let Some(fit) = &report.circuit {
        print_circuit(fit, out)?;
    }
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
