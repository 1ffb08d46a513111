//! One file per command. To add one: a file with `Arguments` and their `run`, and a variant below.

mod skins;
mod snr;
mod solve;

use std::io::Write;

use crate::exit::Outcome;

/// What can be asked for.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Solve a forward problem or make a difference image from a case file.
    Solve(solve::Arguments),
    /// List, show or draw skins.
    Skins(skins::Arguments),
    /// Signal-to-noise ratio of frames of an untouched skin.
    Snr(snr::Arguments),
}

impl Command {
    /// Runs it; results go to `out`.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        match self {
            Command::Solve(arguments) => arguments.run(out),
            Command::Skins(arguments) => arguments.run(out),
            Command::Snr(arguments) => arguments.run(out),
        }
    }
}
