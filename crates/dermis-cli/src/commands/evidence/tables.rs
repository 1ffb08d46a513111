//! Results of all sets: as text, as JSON, and as the tables of a page.

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use dermis_lab::evidence::{Extent, Set, SetReport};

use crate::commands::escaped;
use crate::exit::Outcome;

/// The selected sets and their results.
pub(super) struct Evidence {
    pub(super) data: PathBuf,
    pub(super) extent: Extent,
    pub(super) sets: Vec<(&'static Set, SetReport)>,
}

/// Columns of a set's table.
const COLUMNS: [&str; 6] = ["measured", "known or assumed", "dermis", "plain method", "best published", "time"];

/// Prints a set on the terminal.
pub(super) fn print(out: &mut dyn Write, set: &Set, report: &SetReport) -> std::io::Result<()> {
    writeln!(out, "{}  {} ({:.1} s)", set.name, set.title, report.seconds)?;
    for finding in &report.findings {
        writeln!(out, "  {}", finding.measured)?;
        for (name, text) in [
            ("dermis", finding.here_text()),
            ("plain", finding.plain.text()),
            ("published", finding.published.text()),
            ("known", finding.known.clone()),
        ] {
            writeln!(out, "    {name:<10} {text}")?;
        }
    }
    if !report.findings.is_empty() {
        writeln!(out, "  tuned on it: {}", set.tuned)?;
        writeln!(out, "  not tuned: {}", set.not_tuned)?;
    }
    report.missing.iter().try_for_each(|path| writeln!(out, "  missing: {}", path.display()))?;
    report.failed.iter().try_for_each(|error| writeln!(out, "  failed: {error}"))
}

fn state(report: &SetReport) -> &'static str {
    match report {
        _ if report.failed.is_some() => "failed",
        _ if report.is_missing() => "missing",
        _ if report.missing.is_empty() => "measured",
        _ => "incomplete",
    }
}

/// Seconds up to two minutes, then minutes.
fn duration(seconds: f64) -> String {
    if seconds < 120.0 { format!("{seconds:.0} s") } else { format!("{:.1} min", seconds / 60.0) }
}

impl Evidence {
    /// Outcome of the command: failure if a set failed or none is present.
    pub(super) fn outcome(&self) -> Outcome {
        let failed = self.sets.iter().any(|(_, report)| report.failed.is_some());
        let none = self.sets.iter().all(|(_, report)| report.is_missing());
        if failed || none { Outcome::ProblemsFound } else { Outcome::Done }
    }

    /// A sentence that says how many sets are present.
    pub(super) fn summary(&self) -> String {
        let names = |wanted: &str| -> Vec<&str> {
            self.sets.iter().filter(|(_, report)| state(report) == wanted).map(|(set, _)| set.name).collect()
        };
        let seconds: f64 = self.sets.iter().map(|(_, report)| report.seconds).sum();
        let (missing, incomplete, failed) = (names("missing"), names("incomplete"), names("failed"));
        let done = self.sets.len() - missing.len() - failed.len();
        let mut text = format!("{done} of {} sets in {}", self.sets.len(), duration(seconds));
        for (what, names) in [("missing", missing), ("incomplete", incomplete), ("failed", failed)] {
            if !names.is_empty() {
                let _ = write!(text, "; {what}: {}", names.join(", "));
            }
        }
        text
    }

    /// All results for programs.
    pub(super) fn as_json(&self) -> serde_json::Value {
        let set = |(set, report): &(&Set, SetReport)| {
            serde_json::json!({
                "set": set.name,
                "title": set.title,
                "source": set.source,
                "tuned": set.tuned,
                "not_tuned": set.not_tuned,
                "command": self.command(set),
                "state": state(report),
                "looked_at": report.missing.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
                "error": report.failed.as_ref().map(ToString::to_string),
                "seconds": report.seconds,
                "findings": report.findings,
            })
        };
        serde_json::json!({
            "dermis": env!("CARGO_PKG_VERSION"),
            "quick": self.extent == Extent::Quick,
            "sets": self.sets.iter().map(set).collect::<Vec<_>>(),
        })
    }

    /// The command that repeats a set.
    fn command(&self, set: &Set) -> String {
        let quick = if self.extent == Extent::Quick { " --quick" } else { "" };
        format!("dermis evidence --data DIR --only {}{quick}", set.name)
    }

    /// Introduction of a page.
    fn lead(&self) -> String {
        let quick = if self.extent == Extent::Quick { " --quick" } else { "" };
        let version = env!("CARGO_PKG_VERSION");
        format!("Written by `dermis evidence --data DIR{quick}` of dermis {version}: {}.", self.summary())
    }

    /// A missing file as named on a page. The folder of the data is private and left out.
    fn named(&self, path: &Path) -> String {
        path.strip_prefix(&self.data).map_or_else(
            |_| path.display().to_string(),
            |path| Path::new("DIR").join(path).components().collect::<PathBuf>().display().to_string(),
        )
    }

    /// The tables in Markdown.
    pub(super) fn markdown(&self) -> String {
        let mut text = format!("{}\n\n| set | what it is | state | time |\n|---|---|---|---|\n", self.lead());
        for (set, report) in &self.sets {
            let (state, took) = (state(report), duration(report.seconds));
            let _ = writeln!(text, "| `{}` | {} | {state} | {took} |", set.name, cell(set.title));
        }
        for (set, report) in &self.sets {
            let _ = write!(text, "\n### `{}`: {}\n\n{}.\n\n", set.name, set.title, set.source);
            let _ = write!(text, "```sh\n{}\n```\n\n", self.command(set));
            for path in &report.missing {
                let _ = write!(text, "Missing: `{}` is not there.\n\n", self.named(path));
            }
            if let Some(error) = &report.failed {
                let _ = write!(text, "Failed: {}\n\n", cell(&error.to_string()));
            }
            if report.findings.is_empty() {
                continue;
            }
            let _ = write!(text, "| {} |\n|{}\n", COLUMNS.join(" | "), "---|".repeat(COLUMNS.len()));
            for row in cells(report) {
                let _ = writeln!(text, "| {} |", row.map(|text| cell(&text)).join(" | "));
            }
            let _ = write!(text, "\n- Tuned on this set: {}.\n- Not tuned: {}.\n", set.tuned, set.not_tuned);
        }
        text
    }

    /// The tables in HTML.
    pub(super) fn html(&self) -> String {
        let mut text = format!("<p>{}</p>\n", escaped(&self.lead()));
        for (set, report) in &self.sets {
            let [name, title, source, tuned, not_tuned] =
                [set.name, set.title, set.source, set.tuned, set.not_tuned].map(escaped);
            let _ = write!(text, "<h2 id=\"{name}\">{name}: {title}</h2>\n<p>{source}</p>\n<pre>{}</pre>\n", {
                escaped(&self.command(set))
            });
            for path in &report.missing {
                let _ = writeln!(text, "<p>Missing: <code>{}</code> is not there.</p>", escaped(&self.named(path)));
            }
            if let Some(error) = &report.failed {
                let _ = writeln!(text, "<p>Failed: {}</p>", escaped(&error.to_string()));
            }
            if report.findings.is_empty() {
                continue;
            }
            let head = COLUMNS.map(|column| format!("<th>{column}</th>")).concat();
            let rows: String = cells(report)
                .map(|row| format!("<tr>{}</tr>\n", row.map(|text| format!("<td>{}</td>", escaped(&text))).concat()))
                .collect();
            let _ = write!(
                text,
                "<div class=\"wide\"><table><tr>{head}</tr>\n{rows}</table></div>\n<ul><li>Tuned on this set: {tuned}.</li>\
                 <li>Not tuned: {not_tuned}.</li></ul>\n"
            );
        }
        text
    }
}

/// The cells of a set's rows, in the order of [`COLUMNS`].
fn cells(report: &SetReport) -> impl Iterator<Item = [String; 6]> {
    report.findings.iter().map(|finding| {
        [
            finding.measured.clone(),
            finding.known.clone(),
            finding.here_text(),
            finding.plain.text(),
            finding.published.text(),
            duration(finding.seconds),
        ]
    })
}

/// Text escaped for a cell of a Markdown table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_lab::evidence::{Comparison, Figure, Finding};

    fn evidence() -> Evidence {
        let finding = Finding {
            measured: "place | of presses".into(),
            known: "the <outline>".into(),
            here: vec![Figure::over("median", &[1.0, 2.0], "mm")],
            plain: Comparison::computed("ridge", vec![Figure::new("median", 3.0, "mm")]),
            published: Comparison::said("none"),
            seconds: 150.0,
        };
        let measured =
            SetReport { findings: vec![finding], missing: vec!["data/x/b.csv".into()], failed: None, seconds: 151.0 };
        let missing =
            SetReport { findings: vec![], missing: vec!["data/ktc/a.csv".into()], failed: None, seconds: 0.0 };
        let sets = ["hydrogel", "ktc"].map(|name| Set::named(name).expect("a set"));
        let sets = sets.into_iter().zip([measured, missing]).collect();
        Evidence { data: "data".into(), extent: Extent::Full, sets }
    }

    #[test]
    fn tables_hold_every_column_and_say_what_is_missing() {
        let text = evidence().markdown();
        assert!(text.contains("1 of 2 sets in 2.5 min; missing: ktc; incomplete: hydrogel"), "{text}");
        let row = "| place \\| of presses | the <outline> | median 1.50 mm (1.00 to 2.00) | ridge: median 3.00 mm | none | \
                   2.5 min |";
        assert!(text.contains(row), "{text}");
        assert!(text.contains("Missing: `DIR/ktc/a.csv` is not there."), "{text}");
        assert!(text.contains("dermis evidence --data DIR --only hydrogel\n"), "{text}");
        let html = evidence().html();
        assert!(html.contains("<td>the &lt;outline&gt;</td>") && html.contains("<h2 id=\"ktc\">"), "{html}");
        let json = evidence().as_json();
        assert_eq!((&json["sets"][0]["state"], &json["sets"][1]["state"]), (&"incomplete".into(), &"missing".into()));
        assert_eq!(json["sets"][0]["findings"][0]["here"][0]["range"][1], 2.0);
    }

    #[test]
    fn the_code_tells_failures_and_empty_folders() {
        let mut evidence = evidence();
        assert_eq!(evidence.outcome(), Outcome::Done);
        evidence.sets.remove(0);
        assert_eq!(evidence.outcome(), Outcome::ProblemsFound);
    }
}
