//! `dermis calibrate`: pokes at known positions to a calibration that `run` and `reconstruct` use, and presses of known
//! force to a force calibration.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context;
use dermis::lab::forces::{PressPlan, fit_forces, force_samples, press_twin};
use dermis::live::calibration::{Calibration, read_pokes};
use dermis::live::channels::ChannelReader;
use dermis::live::forces::save_forces;
use dermis::live::prepare::Prepared;
use dermis::skin::Skin;
use dermis_device::{FileSpec, Format, FrameTable};
use dermis_touch::force::{CalibrationScope, CurveKind, ForceCalibration, ForceSample};

use super::{spinner, with_progress};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis calibrate --skin hydrogel-disc --baseline before.csv --frames pressed.csv --positions positions.csv --out c.json
  dermis calibrate --skin ionic-disc --twin --forces forces.json --curve quadratic

The baseline has one frame for all pokes, or one for each. The positions have the columns x_m, y_m and, if the load is
known, depth_m or force_n. Printed are the leave-one-out error and where more pokes would help most. A force calibration
(--forces) is made from pokes with force_n, or by pressing the skin's twin in nine places; `run` and `reconstruct` read it
with --forces.";

/// Arguments of `dermis calibrate`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Built-in skin or skin file.
    #[arg(long, value_name = "NAME|FILE")]
    skin: String,
    /// Frames of the untouched skin: one or more for all pokes, or one before each.
    #[arg(long, value_name = "FILE[#FRAMES]", required_unless_present = "twin")]
    baseline: Option<FileSpec>,
    /// Frames of the pressed skin, one a poke.
    #[arg(long, value_name = "FILE[#FRAMES]", required_unless_present = "twin")]
    frames: Option<FileSpec>,
    /// Where each poke was: x_m, y_m[, depth_m or force_n].
    #[arg(long, value_name = "FILE.csv", required_unless_present = "twin")]
    positions: Option<PathBuf>,
    /// Format of the frames (csv, columns, npy, sciospec, ...); recognised where left out.
    #[arg(long)]
    format: Option<Format>,
    /// Where the calibration goes.
    #[arg(long, value_name = "FILE.json", required_unless_present = "forces")]
    out: Option<PathBuf>,
    /// How many further pokes to suggest.
    #[arg(long, default_value_t = 5)]
    suggest: usize,
    /// Where the force calibration goes.
    #[arg(long, value_name = "FILE.json")]
    forces: Option<PathBuf>,
    /// Press the skin's twin in place of reading files.
    #[arg(long, requires = "forces", conflicts_with_all = ["baseline", "frames", "positions", "out"])]
    twin: bool,
    /// Force as a function of the signal.
    #[arg(long, value_enum, default_value_t = Shape::Linear)]
    curve: Shape,
    /// Diameter of the indenter; that of the twin's sliders where left out.
    #[arg(long, value_name = "MM")]
    indenter_mm: Option<f64>,
    /// Largest force that the twin is pressed with.
    #[arg(long, value_name = "N", requires = "twin")]
    most_n: Option<f64>,
}

/// Curves of a force calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Shape {
    /// A line.
    Linear,
    /// A parabola.
    Quadratic,
    /// Any curve that rises.
    Monotone,
}

impl Arguments {
    /// Fits what is asked for, writes it and says how good it is.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let skin = Skin::open(&self.skin)?;
        let (Some(baseline), Some(frames), Some(positions)) = (&self.baseline, &self.frames, &self.positions) else {
            self.calibrate_twin(&skin, out)?;
            return Ok(Outcome::Done);
        };
        let baselines = dermis_device::read(baseline, self.format).map_err(dermis::Error::from)?;
        let frames = dermis_device::read(frames, self.format).map_err(dermis::Error::from)?;
        let pokes = read_pokes(positions)?;
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
        if let Some(path) = &self.forces {
            let diameter_mm = self.indenter_mm.ok_or_else(|| {
                UsageError("--forces from files: --indenter-mm is needed, signals depend on the indenter".into())
            })?;
            let samples = force_samples(&prepared, &baselines, &frames, &pokes)?;
            self.write_forces(&prepared.skin.name, &samples, frames.len(), 1e-3 * diameter_mm, path, out)?;
        }
        let Some(path) = &self.out else { return Ok(Outcome::Done) };
        let spinner = spinner("fitting the calibration");
        let calibration = Calibration::fit(&prepared, &baselines, &frames, &pokes);
        spinner.finish_and_clear();
        let calibration = calibration?;
        calibration.save(path)?;
        self.print(&prepared, &calibration, out)?;
        writeln!(out, "written: {}", path.display())?;
        Ok(Outcome::Done)
    }

    fn calibrate_twin(&self, skin: &Skin, out: &mut dyn Write) -> anyhow::Result<()> {
        let mut plan = PressPlan::of(skin)?;
        plan.indenter_m = self.indenter_mm.map_or(plan.indenter_m, |mm| 1e-3 * mm);
        plan.most_n = self.most_n.unwrap_or(plan.most_n);
        let mut presses = 0;
        let samples = with_progress("presses", |progress| {
            press_twin(skin, &plan, |done, all| {
                presses = all;
                progress(done, all);
            })
        });
        let path = self.forces.as_ref().context("--forces is needed")?;
        self.write_forces(&skin.name, &samples?, presses, plan.indenter_m, path, out)
    }

    fn write_forces(
        &self,
        skin: &str,
        samples: &[ForceSample],
        presses: usize,
        indenter_m: f64,
        path: &Path,
        out: &mut dyn Write,
    ) -> anyhow::Result<()> {
        let kind = match self.curve {
            Shape::Linear => CurveKind::Linear,
            Shape::Quadratic => CurveKind::Quadratic,
            Shape::Monotone => CurveKind::Monotone,
        };
        let indenter_area_m2 = 0.25 * std::f64::consts::PI * indenter_m * indenter_m;
        let scope = CalibrationScope { skin: skin.to_string(), indenter_area_m2, date: today() };
        let calibration = fit_forces(samples, kind, scope)?;
        save_forces(&calibration, path)?;
        print_forces(&calibration, presses, out)?;
        writeln!(out, "written: {}", path.display())?;
        Ok(())
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
        Ok(())
    }
}

fn print_forces(calibration: &ForceCalibration, presses: usize, out: &mut dyn Write) -> std::io::Result<()> {
    let [least, most] = calibration.valid_force_n;
    let range = most - least;
    writeln!(out, "presses seen: {} of {presses}", calibration.samples)?;
    writeln!(out, "force: {least:.4} to {most:.4} N on {:.1} mm^2", 1e6 * calibration.scope.indenter_area_m2)?;
    let share = 100.0 * calibration.residual_n / range;
    writeln!(out, "residual: {:.4} N rms, {share:.1} % of the range", calibration.residual_n)?;
    match calibration.saturation_signal {
        Some(signal) => writeln!(out, "saturated from {:.4} N on", calibration.curve.force_n(signal)),
        None => writeln!(out, "no saturation within the range"),
    }
}

/// Today, UTC.
fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    date_of(seconds / 86_400)
}

/// Date of a day counted from 1970-01-01, by the calendar that begins its years in March (H. Hinnant, chrono-Compatible
/// Low-Level Date Algorithms, civil_from_days; for days from 1970 on).
fn date_of(days: u64) -> String {
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::date_of;

    #[test]
    fn days_are_dates() {
        let known = [(0, "1970-01-01"), (59, "1970-03-01"), (11_016, "2000-02-29"), (20_453, "2025-12-31")];
        known.iter().for_each(|(days, date)| assert_eq!(date_of(*days), *date));
    }
}
