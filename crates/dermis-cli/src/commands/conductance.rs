//! `dermis conductance`: a sheet's conductance in siemens from frames of a single state, without a baseline.

use std::io::Write;
use std::path::PathBuf;

use dermis_device::instruments::npy;
use dermis_device::{FileSpec, Format};
use dermis_lab::conductance::{Conductance, conductance};
use dermis_record::read_frames;

use super::skin_word::SkinWord;
use super::{print_json, spinner};
use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis conductance healing-square --frames rest.csv
  dermis conductance healing-square --frames 'rest.csv#0..1' --out sheet.npy \\
      --json

Averages the frames and fits the conductance of the sheet to them, with its standard deviation: one number for the \
sheet, and the places that differ from it. Current, electrodes and contact impedance are taken from the skin file, \
whose conductivity is only the starting value. sheet.npy is 2 x rows x columns (f64, siemens): the image and its \
standard deviation, row 0 at the top, NaN outside.";

/// Arguments of `dermis conductance`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    skin: SkinWord,
    /// Frames of a single state.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    frames: FileSpec,
    /// Format of the file (csv, columns, npy, sciospec, ktc, golfball, pyeidors); default: recognised from the file.
    #[arg(long)]
    format: Option<Format>,
    /// Output file for the image and its standard deviation.
    #[arg(long, value_name = "FILE.npy")]
    out: Option<PathBuf>,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Estimates the conductance and prints the result.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let skin = self.skin.open()?;
        let table = read_frames(&self.frames, self.format)?;
        let spinner = spinner("estimating");
        let found = conductance(&skin, &table);
        spinner.finish_and_clear();
        let found = found?;
        if let Some(path) = &self.out {
            let both = [found.image_s.as_slice(), &found.sigma_s].concat();
            npy::write_f64(path, &[2, found.grid.rows, found.grid.columns], &both)?;
        }
        if self.json {
            print_json(&found, out)?;
        } else {
            let thickness_m = skin.frontend.layer.thickness_m();
            print(&found, thickness_m, out)?;
        }
        Ok(Outcome::Done)
    }
}

fn print(found: &Conductance, thickness_m: Option<f64>, out: &mut dyn Write) -> std::io::Result<()> {
    let Conductance { frames, channels, sheet_s, sheet_sigma_s, .. } = found;
    writeln!(out, "{channels} channels, mean of {frames} frames")?;
    writeln!(
        out,
        "sheet: {:.4e} S, standard deviation {:.1e} S ({:.4} ohm per square)",
        sheet_s,
        sheet_sigma_s,
        1.0 / sheet_s
    )?;
    if let Some(thickness_m) = thickness_m {
        writeln!(out, "conductivity: {:.4} S/m at {:.3} mm", sheet_s / thickness_m, 1e3 * thickness_m)?;
    }
    writeln!(out, "misfit: {:.2} standard deviations of the readings", found.misfit)?;
    if found.regions.is_empty() {
        return writeln!(out, "no place differs significantly");
    }
    writeln!(out, "{:>8} {:>8} {:>10} {:>11} {:>9}", "x mm", "y mm", "radius mm", "S", "+- S")?;
    for region in &found.regions {
        let [x, y, radius] = [region.x_m, region.y_m, region.radius_m].map(|metres| 1e3 * metres);
        writeln!(out, "{x:>8.1} {y:>8.1} {radius:>10.1} {:>11.4e} {:>9.1e}", region.conductance_s, region.sigma_s)?;
    }
    Ok(())
}
