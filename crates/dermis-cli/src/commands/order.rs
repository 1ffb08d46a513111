//! `dermis order`: finds the channel order of an unknown file, as lines for a skin file.

use std::io::Write;

use dermis_device::FileSpec;
use dermis_lab::channel_search::{FoundOrder, OrderCandidate, find_order};
use dermis_live::channels::readings_of;
use dermis_record::read_frames;
use dermis_skin::Skin;

use super::reading::ReadArguments;
use super::skin_word::SkinWord;
use super::{print_json, spinner};
use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis order healing-square --baseline rest.csv
  dermis order healing-square --baseline 'rest.csv#0..1' --json

Compares frames of the untouched skin with the model's readings under every protocol with the same number of \
readings: drives and measurements at every spacing, with and without driven electrodes, pairs that measure \
themselves, and the skin file's own list of channels; either sign; lists that begin elsewhere, run backwards or \
rotate with the drive; tables stored by columns; electrodes counted from another one or in the other direction. The \
best order is printed as lines for [backend] in the skin file, or as a list of channels if no pattern describes it. \
Without a SKIN, discs with evenly spaced electrodes are tried. Exit code 1: nothing fits, or no candidate stands out.";

/// Arguments of `dermis order`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    skin: SkinWord,
    /// Frames of the untouched skin.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    baseline: FileSpec,
    #[command(flatten)]
    read: ReadArguments,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Searches and prints the matches.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let skin = self.skin.given()?.map(|name| Skin::open(&name)).transpose()?;
        let channels = skin.as_ref().map(readings_of).unwrap_or_default();
        let options = self.read.options().with_channels(channels);
        let table = read_frames(&self.baseline, options)?;
        let spinner = spinner("comparing orders");
        let found = find_order(&table, skin.as_ref());
        spinner.finish_and_clear();
        let found = found?;
        if self.json {
            print_json(&found, out)?;
        } else {
            print(&found, out)?;
        }
        Ok(if found.is_clear { Outcome::Done } else { Outcome::ProblemsFound })
    }
}

fn print(found: &FoundOrder, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "{} readings, mean of {} frames", found.readings, found.frames)?;
    writeln!(out, "{}", found.verdict())?;
    // Don't print lines for a poor match, since users would copy them.
    if let Some(best) = found.fitting() {
        print_lines(best, out)?;
    }
    if found.candidates.is_empty() {
        return Ok(());
    }
    writeln!(out, "{:>11} {:>7}  order", "correlation", "score")?;
    for candidate in &found.candidates {
        writeln!(out, "{:>11.4} {:>7.4}  {}", candidate.correlation, candidate.score, candidate.description)?;
    }
    Ok(())
}

/// Reported by other commands if a file's order differs from the skin's: a sentence, and lines for the skin file.
pub(super) fn print_order(found: &FoundOrder, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "order of the channels: {}", found.verdict())?;
    found.fitting().map_or(Ok(()), |best| print_lines(best, out))
}

fn print_lines(best: &OrderCandidate, out: &mut dyn Write) -> std::io::Result<()> {
    if best.same > 0 {
        let same = best.same;
        writeln!(
            out,
            "{same} other numberings of electrodes and lists give the same readings; a press tells them apart"
        )?;
    }
    writeln!(out, "\n# for [backend] of the skin file, {} electrodes", best.electrodes)?;
    writeln!(out, "{}", best.lines())
}
