//! Output that commands share.

use std::io::Write;

/// Prints a hint on stderr: the current form of an old or unusual spelling that the user typed.
pub(crate) fn hint(text: &str) {
    eprintln!("hint: {text}");
}

/// Prints a report as JSON, on lines of its own.
pub(crate) fn print_json(report: &impl serde::Serialize, out: &mut dyn Write) -> anyhow::Result<()> {
    serde_json::to_writer_pretty(&mut *out, report).map_err(std::io::Error::from)?;
    writeln!(out)?;
    Ok(())
}

/// Text escaped for HTML, for use between tags and in attributes.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The first few of some indices, which count from 0, in words.
pub(crate) fn listed(numbers: impl ExactSizeIterator<Item = usize>) -> String {
    const MOST: usize = 12;
    let count = numbers.len();
    let mut text = numbers.take(MOST).map(|n| n.to_string()).collect::<Vec<_>>().join(", ");
    if count > MOST {
        text.push_str(&format!(" and {} more", count - MOST));
    }
    text
}
