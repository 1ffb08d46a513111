//! Output that commands share.

use dermis_live::calibration::{CircuitFit, circuit_words};
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

/// Date of a day counted from 1970-01-01, using a calendar whose years begin in March (H. Hinnant, chrono-Compatible
/// Low-Level Date Algorithms, civil_from_days; for days from 1970 on).
pub(super) fn date_of(days: u64) -> String {
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

/// Prints the circuit found, and whether to trust it.
pub(super) fn print_circuit(fit: &CircuitFit, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "circuits tried: {} on {} frames", fit.tried, fit.frames)?;
    writeln!(out, "score (median correlation of a frame with its best touch) before: {:.3}", fit.score_before)?;
    writeln!(out, "score after: {:.3}; {:.3} nats per reading more likely", fit.score, fit.gain)?;
    writeln!(out, "circuit = {}", circuit_words(fit.circuit.as_ref()))?;
    if let Some(other) = &fit.runner_up {
        writeln!(
            out,
            "best circuit that reads other lines: {:.3}, {:.3} nats per reading less likely, with {}",
            other.score,
            other.behind,
            circuit_words(Some(&other.circuit))
        )?;
    }
    writeln!(out, "{}", fit.trust())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_have_their_dates() {
        let known = [(0, "1970-01-01"), (59, "1970-03-01"), (11_016, "2000-02-29"), (20_453, "2025-12-31")];
        known.iter().for_each(|(days, date)| assert_eq!(date_of(*days), *date));
    }
}
