//! What a command prints besides its own results.

use std::io::Write;

/// A hint on stderr, for people: what was meant was understood, and how it is said now.
pub(crate) fn hint(text: &str) {
    eprintln!("hint: {text}");
}

/// A report as JSON, on lines of its own.
pub(crate) fn print_json(report: &impl serde::Serialize, out: &mut dyn Write) -> anyhow::Result<()> {
    serde_json::to_writer_pretty(&mut *out, report).map_err(std::io::Error::from)?;
    writeln!(out)?;
    Ok(())
}
