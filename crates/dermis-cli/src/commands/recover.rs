//! `dermis recover`: rebuilds a complete recording from one damaged by a crash, a full disk or a bad sector.

use std::io::Write;
use std::path::PathBuf;

use dermis_record::{LostFrames, recover};

use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis recover broken.partial.mcap --out recovered.mcap

Copies every chunk with a valid checksum, and skips and reports the rest. Exit code 0: everything in the file was \
readable (a killed recording lacks at most its last second, which was never written); 3: something was not.";

/// Arguments of `dermis recover`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// The damaged recording; it is not changed.
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// The new recording; an existing one is not overwritten.
    #[arg(long, value_name = "FILE.mcap")]
    out: PathBuf,
}

impl Arguments {
    /// Recovers the recording and prints how much.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let recovered = recover(&self.file, &self.out)?;
        let damage = recovered.damage;
        writeln!(out, "{}: {} frames, {} messages", self.out.display(), recovered.frames, recovered.messages)?;
        if let Some(reason) = &recovered.stopped {
            writeln!(out, "the recording stopped early: {reason}")?;
        } else if damage.cut_off {
            writeln!(out, "the end was missing: a killed recording lacks at most its last second")?;
        }
        if damage.bytes == 0 && damage.chunks == 0 && damage.messages == 0 {
            return Ok(Outcome::Done);
        }
        let frames = match damage.frames {
            LostFrames::Exactly(count) => count.to_string(),
            LostFrames::Unknown { in_damaged_chunks } => format!("at most {in_damaged_chunks}"),
        };
        tracing::error!(
            frames,
            bytes = damage.bytes,
            chunks = damage.chunks,
            messages = damage.messages,
            "could not be read"
        );
        Ok(Outcome::DataLost)
    }
}
