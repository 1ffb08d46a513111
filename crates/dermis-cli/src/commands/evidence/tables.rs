//! Results of all sets: as text, as JSON, and as the tables of a page.

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use dermis_lab::evidence::{Extent, Finding, Set, SetReport};

use crate::commands::escaped;
use crate::exit::Outcome;

/// The selected sets and their results.
pub(super) struct Evidence {
    pub(super) data: PathBuf,
    pub(super) extent: Extent,
    pub(super) sets: Vec<(&'static Set, SetReport)>,
}

/// Columns of a set's table.
const COLUMNS: [&str; 5] = ["measured", "known or assumed", "dermis", "plain method", "best published"];

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
        format!(
            "Written by `dermis evidence --data DIR{quick}` of dermis {version}: {}. `--only SET` repeats one set.",
            self.summary()
        )
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
        let mut text = format!("{}\n", self.lead());
        for (set, report) in &self.sets {
            let _ = write!(text, "\n### `{}`: {}\n\n{}.\n\n", set.name, set.title, set.source);
            for path in &report.missing {
                let _ = write!(text, "Missing: `{}` does not exist.\n\n", self.named(path));
            }
            if let Some(error) = &report.failed {
                let _ = write!(text, "Failed: {}\n\n", cell(&error.to_string()));
            }
            if report.findings.is_empty() {
                continue;
            }
            let Layout { columns, rows, shared } = Layout::of(report);
            if !columns.is_empty() {
                let _ = write!(text, "| {} |\n|{}\n", columns.join(" | "), "---|".repeat(columns.len()));
                for row in rows {
                    let _ = writeln!(text, "| {} |", row.iter().map(|text| cell(text)).collect::<Vec<_>>().join(" | "));
                }
                text.push('\n');
            }
            for (name, value) in shared {
                let _ = writeln!(text, "- **{name}**: {}", cell(&value));
            }
            let _ = write!(text, "- **tuned on this set**: {}\n- **not tuned**: {}\n", set.tuned, set.not_tuned);
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
                let _ = writeln!(text, "<p>Missing: <code>{}</code> does not exist.</p>", escaped(&self.named(path)));
            }
            if let Some(error) = &report.failed {
                let _ = writeln!(text, "<p>Failed: {}</p>", escaped(&error.to_string()));
            }
            if report.findings.is_empty() {
                continue;
            }
            let Layout { columns, rows, shared } = Layout::of(report);
            if !columns.is_empty() {
                let head = columns.iter().map(|column| format!("<th>{column}</th>")).collect::<String>();
                let _ = writeln!(text, "<div class=\"wide\"><table><tr>{head}</tr>");
                for row in rows {
                    let row = row.iter().map(|text| format!("<td>{}</td>", escaped(text))).collect::<String>();
                    let _ = writeln!(text, "<tr>{row}</tr>");
                }
                text.push_str("</table></div>\n");
            }
            text.push_str("<ul>");
            for (name, value) in shared {
                let _ = write!(text, "<li><b>{name}</b>: {}</li>", escaped(&value));
            }
            let _ = writeln!(text, "<li>tuned on this set: {tuned}</li><li>not tuned: {not_tuned}</li></ul>");
        }
        text
    }
}

/// A set's findings as a table without repetitions. Columns whose cells are all the same are listed separately.
struct Layout {
    columns: Vec<&'static str>,
    rows: Vec<Vec<String>>,
    shared: Vec<(&'static str, String)>,
}

impl Layout {
    fn of(report: &SetReport) -> Self {
        let cells: Vec<[String; COLUMNS.len()]> = report.findings.iter().map(cells).collect();
        let (mut shared, mut varying) = (Vec::new(), Vec::new());
        for (index, name) in COLUMNS.into_iter().enumerate() {
            if cells.iter().all(|row| row[index] == cells[0][index]) {
                shared.push((name, cells[0][index].clone()));
            } else {
                varying.push(index);
            }
        }
        let cell = |row: usize, index: usize| {
            let repeats = row > 0 && cells[row][index] == cells[row - 1][index];
            if repeats { "as above".to_owned() } else { cells[row][index].clone() }
        };
        let rows = (0..cells.len()).map(|row| varying.iter().map(|&index| cell(row, index)).collect()).collect();
        Self { columns: varying.into_iter().map(|index| COLUMNS[index]).collect(), rows, shared }
    }
}

/// The cells of a row, in the order of [`COLUMNS`].
fn cells(finding: &Finding) -> [String; COLUMNS.len()] {
    let Finding { measured, known, plain, published, .. } = finding;
    [measured.clone(), known.clone(), finding.here_text(), plain.text(), published.text()]
}

/// Text escaped for a cell of a Markdown table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_lab::evidence::{Comparison, Figure};

    fn evidence() -> Evidence {
        let finding = Finding {
            measured: "place | of presses".into(),
            known: "the <outline>".into(),
            here: vec![Figure::over("median", &[1.0, 2.0], "mm")],
            plain: Comparison::computed("ridge", vec![Figure::new("median", 3.0, "mm")]),
            published: Comparison::said("none"),
            seconds: 150.0,
        };
        let other = Finding { measured: "place of others".into(), here: vec![], ..finding.clone() };
        let findings = vec![finding, other];
        let measured = SetReport { findings, missing: vec!["data/x/b.csv".into()], failed: None, seconds: 151.0 };
        let missing =
            SetReport { findings: vec![], missing: vec!["data/ktc/a.csv".into()], failed: None, seconds: 0.0 };
        let sets = ["hydrogel", "ktc"].map(|name| Set::named(name).expect("a set"));
        let sets = sets.into_iter().zip([measured, missing]).collect();
        Evidence { data: "data".into(), extent: Extent::Full, sets }
    }

    #[test]
    fn identical_cells_are_listed_once_and_missing_files_named() {
        let text = evidence().markdown();
        assert!(text.contains("1 of 2 sets in 2.5 min; missing: ktc; incomplete: hydrogel"), "{text}");
        let row = "| place \\| of presses | median 1.50 mm (1.00 to 2.00) |";
        assert!(text.contains(row) && text.contains("| measured | dermis |"), "{text}");
        assert!(
            text.contains("- **known or assumed**: the <outline>\n- **plain method**: ridge: median 3.00 mm\n"),
            "{text}"
        );
        assert!(text.contains("Missing: `DIR/ktc/a.csv` does not exist."), "{text}");
        let html = evidence().html();
        assert!(
            html.contains("<li><b>known or assumed</b>: the &lt;outline&gt;</li>") && html.contains("<h2 id=\"ktc\">"),
            "{html}"
        );
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
