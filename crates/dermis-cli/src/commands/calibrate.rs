//! `dermis calibrate`: turns pokes at known positions into a calibration for `run` and `reconstruct`, and presses of
//! known force into a force calibration.

mod report;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context;
use dermis_device::{FileSpec, FrameTable, ReadOptions};
use dermis_lab::forces::{PressPlan, fit_forces, force_samples, press_twin};
use dermis_lab::twin_sample::{random_presses, sample_tables};
use dermis_live::calibrate::calibrate;
use dermis_live::calibration::{
    Calibration, CalibrationOptions, PokeFrames, Pokes, find_circuit, read_pokes, relative_changes,
};
use dermis_live::channels::ChannelReader;
use dermis_live::forces::save_forces;
use dermis_live::label_checks::check_labels;
use dermis_live::prepare::Prepared;
use dermis_skin::{CircuitChoice, Skin, Wiring};
use dermis_touch::force::{CalibrationScope, CurveKind, ForceSample};
use dermis_twin::from_skin::press_range;
use report::{print_experts, print_forces, print_pokes};

use super::extent::Extent;
use super::printing::{date_of, print_circuit};
use super::reading::ReadArguments;
use super::recorded::baseline_or_differences;
use super::skin_word::SkinWord;
use super::{busy, hint, spinner, with_progress};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis calibrate hydrogel-disc --baseline before.csv --frames pressed.csv \\
      --positions positions.csv --out c.json
  dermis calibrate hydrogel-disc --differences --frames differences.csv \\
      --positions positions.csv --out d.json
  dermis calibrate --outline-mm 171 --channels 192 --write-skin gel.toml \\
      --differences --frames differences.csv --positions positions.csv \\
      --out gel.json
  dermis calibrate hydrogel-disc --baseline baselines.csv \\
      --frames touches.csv --write-skin mine.toml
  dermis calibrate ionic-disc --twin --forces forces.json --curve quadratic
  dermis calibrate healing-square --twin --pokes 12 --out c.json

The baseline has one frame for all pokes, or one per poke; with --differences the frames are already differences from \
the untouched skin. --start EARLIER.json uses an earlier calibration of this skin or of another of its family: the \
new pokes decide whether its pokes are pooled with them, or it becomes a prior, is kept unchanged or is ignored. The \
positions have the columns x_m, y_m (or x_mm, y_mm) and, if the load is known, depth_m, depth_mm or force_n. Rows \
with the same number in the column `group` are touches in one frame. Positions that look mirrored, rotated or shifted \
by a row are reported, and positions unrelated to the frames are refused. If only the outline of a skin is known, \
--outline-mm and --channels replace the skin file, and --write-skin writes one for `run` and `reconstruct`. Without \
positions, the readout's circuit is found from 20 or more frames of unknown touches.

The report gives the leave-one-out error, the benefit of physics and of each part of the locator, and the places \
where more pokes would help most. A force calibration (--forces) is made from pokes with force_n, or by pressing the \
skin's twin in nine places; `run` and `reconstruct` read it with --forces.";

/// Arguments of `dermis calibrate`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    skin: SkinWord,
    /// Outline of a skin without a skin file: width x height, or a diameter; the origin is its centre.
    #[arg(
        long,
        value_name = "WxH|D",
        conflicts_with_all = ["skin", "option", "twin"],
        requires_all = ["channels", "write_skin"]
    )]
    outline_mm: Option<Extent>,
    /// Number of channels of that skin.
    #[arg(long, value_name = "N", requires = "outline_mm")]
    channels: Option<usize>,
    /// Output skin file for --outline-mm, whose name becomes the skin's; without --positions, output skin file with the
    /// circuit found.
    #[arg(long, value_name = "FILE.toml")]
    write_skin: Option<PathBuf>,
    /// Frames of the untouched skin: one or more for all pokes, or one before each.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: Option<FileSpec>,
    /// The frames are already differences from the untouched skin.
    #[arg(long, conflicts_with_all = ["baseline", "twin"])]
    differences: bool,
    /// Frames of the pressed skin, one per poke.
    #[arg(long, value_name = "FILE[#FRAMES]", required_unless_present_any = ["twin", "baseline"])]
    frames: Option<FileSpec>,
    /// Position of each poke: x_m, y_m[, depth_m or force_n], or x_mm, y_mm[, depth_mm]. Without it, the readout's
    /// circuit is found from the frames alone.
    #[arg(long, value_name = "FILE.csv")]
    positions: Option<PathBuf>,
    #[command(flatten)]
    read: ReadArguments,
    /// Accept the positions even if they don't seem to belong to the frames.
    #[arg(long)]
    trust_labels: bool,
    /// Don't use the skin file's physics, even where it would help.
    #[arg(long)]
    no_physics: bool,
    /// Earlier calibration of this skin, or of another in its family. If several are given, the new pokes decide which
    /// is used.
    #[arg(long, value_name = "FILE.json")]
    start: Vec<PathBuf>,
    /// Output file for the calibration.
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,
    /// Number of further pokes to suggest.
    #[arg(long, default_value_t = 5)]
    suggest: usize,
    /// Output file for the force calibration.
    #[arg(long, value_name = "FILE.json")]
    forces: Option<PathBuf>,
    /// Press the skin's twin instead of reading files.
    #[arg(long, conflicts_with_all = ["baseline", "frames", "positions", "start"])]
    twin: bool,
    /// Number of presses on the twin, at random places, that --out is fitted to.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 40,
        requires = "twin",
        value_parser = clap::value_parser!(u32).range(4..=20_000)
    )]
    pokes: u32,
    /// Force as a function of the signal.
    #[arg(long, value_enum, default_value_t = Shape::Linear)]
    curve: Shape,
    /// Diameter of the indenter; default: that of the twin's sliders.
    #[arg(long, value_name = "MM")]
    indenter_mm: Option<f64>,
    /// Largest force pressed on the twin.
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
    /// Any rising curve.
    Monotone,
}

/// Frames measured with the pokes, in the protocol's order.
struct Measured {
    /// `None` if the frames are differences.
    baselines: Option<Vec<Vec<f64>>>,
    frames: Vec<Vec<f64>>,
}

impl Measured {
    fn read(
        prepared: &Prepared,
        baseline: Option<&FileSpec>,
        frames: &FileSpec,
        options: &ReadOptions,
    ) -> anyhow::Result<Self> {
        let reads = prepared.skin.backend.reads;
        let reader = |table: &FrameTable| {
            ChannelReader::new(table.layout(), &prepared.protocol, reads, &table.source().display().to_string())
        };
        let table = |file: &FileSpec| {
            if options.format.is_none() {
                dermis_record::check_skin(file, &prepared.skin)?;
            }
            dermis_record::read_frames_of(&prepared.skin, file, options.clone())
        };
        let frames = table(frames)?;
        let mut frame_reader = reader(&frames)?;
        let mut baselines = None;
        if let Some(baseline) = baseline {
            let baseline = table(baseline)?;
            let mut baseline_reader = reader(&baseline)?;
            baselines = Some(baseline_reader.read_table(&baseline)?);
            frame_reader.share_phase_of(&baseline_reader);
        }
        Ok(Self { baselines, frames: frame_reader.read_table(&frames)? })
    }

    fn as_pokes(&self) -> PokeFrames<'_> {
        match &self.baselines {
            Some(baselines) => PokeFrames::Readings { baselines, frames: &self.frames },
            None => PokeFrames::Differences(&self.frames),
        }
    }
}

impl Arguments {
    /// Fits the requested calibrations, writes them and reports their quality.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let skin = self.skin()?;
        if self.twin {
            if self.out.is_none() && self.forces.is_none() {
                return Err(
                    UsageError("--out, --forces or both are needed: where to write the calibration".into()).into()
                );
            }
            if let Some(path) = &self.out {
                self.locate_twin(&skin, path, out)?;
            }
            if self.forces.is_some() {
                self.calibrate_twin(&skin, out)?;
            }
            return Ok(Outcome::Done);
        }
        let Some(positions) = &self.positions else {
            self.learn_circuit(skin, out)?;
            return Ok(Outcome::Done);
        };
        let frames = self.frames.as_ref().ok_or_else(|| UsageError("--frames is needed: one frame per poke".into()))?;
        if self.out.is_none() && self.forces.is_none() {
            return Err(UsageError("--out is needed: where to write the calibration".into()).into());
        }
        let differences = baseline_or_differences(self.baseline.as_ref(), self.differences, &skin)?;
        let pokes = read_pokes(positions)?;
        let sisters = self.start.iter().map(|path| Calibration::load(path)).collect::<Result<Vec<_>, _>>()?;
        let prepared = Prepared::new(skin)?;
        let measured = Measured::read(&prepared, self.baseline.as_ref(), frames, &self.read.options())?;
        self.check_labels(&prepared, &measured, &pokes)?;
        if let Some(path) = &self.forces {
            let diameter_mm = self.indenter_mm.ok_or_else(|| {
                UsageError("--forces from files: --indenter-mm is needed, since signals depend on the indenter".into())
            })?;
            let baselines = measured.baselines.as_ref().ok_or_else(|| {
                UsageError("--forces: expected frames with a baseline, got differences, which have no scale".into())
            })?;
            let indenter_m = 1e-3 * diameter_mm;
            let samples = force_samples(&prepared, baselines, &measured.frames, &pokes, indenter_m)?;
            self.write_forces(&prepared.skin, &samples, measured.frames.len(), indenter_m, path, out)?;
        }
        let Some(path) = &self.out else { return Ok(Outcome::Done) };
        let spinner = spinner("fitting the calibration");
        let options = CalibrationOptions { physics: !self.no_physics, start: &sisters };
        let calibration = calibrate(&prepared, measured.as_pokes(), &pokes, &options);
        spinner.finish_and_clear();
        let calibration = calibration?;
        calibration.save(path)?;
        if let (Some(file), Some(_)) = (&self.write_skin, &self.outline_mm) {
            write_skin(STAND_INS, &prepared.skin, file)?;
            writeln!(out, "skin file: {}", file.display())?;
        }
        print_pokes(&calibration, out)?;
        print_experts(&prepared.skin, &calibration, differences, self.no_physics, out)?;
        self.print(&prepared, &calibration, out)?;
        writeln!(out, "written: {}", path.display())?;
        Ok(Outcome::Done)
    }

    /// Warns about suspicious labels, and refuses labels unrelated to the frames.
    fn check_labels(&self, prepared: &Prepared, measured: &Measured, pokes: &Pokes) -> anyhow::Result<()> {
        if self.trust_labels {
            return Ok(());
        }
        let found = check_labels(prepared, measured.as_pokes(), pokes)?;
        if let Some(rows) = found.lag_rows {
            let (rows, way) = (rows.unsigned_abs(), if rows > 0 { "lag behind" } else { "lead" });
            let unit = if rows == 1 { "row" } else { "rows" };
            hint(&format!("--positions {way} the frames by {rows} {unit}: they fit far better when shifted"));
        }
        if let Some(turn) = found.turned {
            hint(&format!("--positions: {}: this fits the model far better", turn.words));
        }
        if found.is_unrelated() {
            let text = format!(
                "positions and frames do not belong together: {:.0} % of shuffled tables fit equally well \
                 (--trust-labels accepts them anyway)",
                100.0 * found.p_value.unwrap_or(1.0)
            );
            return Err(UsageError(text).into());
        }
        Ok(())
    }

    /// The named skin, or one made from outline and channels only.
    fn skin(&self) -> anyhow::Result<Skin> {
        let mut skin = match (self.outline_mm, self.channels, &self.write_skin) {
            (Some(extent), Some(channels), Some(file)) => {
                let name = file.file_stem().unwrap_or_default().to_string_lossy();
                Skin::of_channels(&name, extent.shape(), channels)?
            }
            _ => self.skin.open()?,
        };
        if skin.backend.wiring == Wiring::Unknown {
            skin.backend.differences |= self.differences;
        }
        Ok(skin)
    }

    /// Finds the readout's circuit from frames whose touches are unknown.
    fn learn_circuit(&self, skin: Skin, out: &mut dyn Write) -> anyhow::Result<()> {
        if self.out.is_some() || self.forces.is_some() || self.outline_mm.is_some() || !self.start.is_empty() {
            let text = "--positions is needed: the position of every poke (without it, only a readout circuit can be found, \
                        with SKIN, --frames, --baseline and --write-skin)";
            return Err(UsageError(text.into()).into());
        }
        let Some(baseline) = &self.baseline else {
            return Err(UsageError("--baseline is needed: changes are relative to it".into()).into());
        };
        let prepared = Prepared::new(skin)?;
        let read =
            Measured::read(&prepared, Some(baseline), self.frames.as_ref().unwrap_or(baseline), &self.read.options())?;
        let baselines = read.baselines.unwrap_or_default();
        let frames = if self.frames.is_some() { read.frames } else { Vec::new() };
        let changes = relative_changes(&prepared, &baselines, &frames)?;
        let spinner = spinner("trying circuits");
        let fit = find_circuit(&prepared, &changes, |_| spinner.tick());
        spinner.finish_and_clear();
        let fit = fit?;
        print_circuit(&fit, out)?;
        if let Some(file) = &self.write_skin {
            let mut skin = prepared.skin.clone();
            skin.backend.circuit = fit.circuit.map(CircuitChoice::Known);
            let head = "# With the circuit that dermis calibrate found from frames of unknown touches.\n";
            write_skin(head, &skin, file)?;
            writeln!(out, "written: {}", file.display())?;
        }
        Ok(())
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
        self.write_forces(skin, &samples?, presses, plan.indenter_m, path, out)
    }

    /// Makes a calibration from the twin's pokes at random places, to predict its benefit on the real skin.
    fn locate_twin(&self, skin: &Skin, path: &Path, out: &mut dyn Write) -> anyhow::Result<()> {
        let presses = random_presses(&skin.outline(), &press_range(skin), self.pokes as usize, 1)?;
        let tables = with_progress("presses", |progress| sample_tables(skin, &presses, None, progress))?;
        let prepared = Prepared::new(skin.clone())?;
        let reads = prepared.skin.backend.reads;
        let mut reader = ChannelReader::new(tables[0].layout(), &prepared.protocol, reads, "the twin")?;
        let [baselines, frames] = tables.each_ref().map(|table| reader.read_table(table));
        let positions_m = presses.iter().map(|press| press[0].centre_m).collect();
        let pokes = Pokes { positions_m, further_m: Vec::new(), loads: None };
        let busy = busy("fitting the calibration".into());
        let (baselines, frames) = (baselines?, frames?);
        let measured = PokeFrames::Readings { baselines: &baselines, frames: &frames };
        let calibration = calibrate(&prepared, measured, &pokes, &CalibrationOptions::default())?;
        calibration.save(path)?;
        busy.finish();
        print_pokes(&calibration, out)?;
        print_experts(skin, &calibration, false, false, out)?;
        self.print(&prepared, &calibration, out)?;
        writeln!(out, "written: {}{OF_TWIN}", path.display())?;
        Ok(())
    }

    fn write_forces(
        &self,
        skin: &Skin,
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
        let scope = CalibrationScope { skin: skin.name.clone(), indenter_area_m2, date: today() };
        let fitted = fit_forces(samples, kind, scope)?;
        let (calibration, remark) = match self.twin {
            true => (fitted.of_twin(), OF_TWIN),
            false => (fitted, ""),
        };
        save_forces(&calibration, skin, path)?;
        print_forces(&calibration, presses, out)?;
        writeln!(out, "written: {}{remark}", path.display())?;
        Ok(())
    }

    fn print(&self, prepared: &Prepared, calibration: &Calibration, out: &mut dyn Write) -> anyhow::Result<()> {
        let measured = calibration.measured_jacobian(prepared)?;
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

/// Remark on calibrations made from a twin.
const OF_TWIN: &str = "; made from the twin, not from a measured skin";

/// Comment at the top of the file of a skin known only by its outline and channels.
const STAND_INS: &str = "\
# Only the outline and the number of channels of this skin are known. Its electrodes and pairs are placeholders, and its
# response is learnt from pokes (dermis calibrate).
";

fn write_skin(head: &str, skin: &Skin, file: &Path) -> anyhow::Result<()> {
    dermis_device::write_atomic(file, |out| {
        out.write_all(head.as_bytes())?;
        out.write_all(skin.to_toml().as_bytes())?;
        Ok(())
    })
    .map_err(dermis_lab::Error::from)?;
    Ok(())
}

/// Today's date, UTC.
fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    date_of(seconds / 86_400)
}
