//! `dermis evidence`: runs dermis on measurements published by others, and makes the tables of the book's page about
//! them.

mod page;
mod tables;

use std::io::{IsTerminal, Write};
use std::path::PathBuf;

use dermis_lab::evidence::{Extent, SETS, Set, SetReport};

use crate::exit::{Outcome, UsageError, report};
use page::OutFile;
use tables::Evidence;

const EXAMPLE: &str = "\
Examples:
  dermis evidence --list
  dermis evidence --data data --only golfball --quick
  dermis evidence --data data --only golfball,team7 --quick --out measured.html

DATA has one folder per set, as described in tests/data/README.md of the repository; the sets are not part of dermis. \
A set that is absent is reported as missing, with the expected path, and the others still run. In an existing \
Markdown page the text between the lines `<!-- evidence:begin -->` and `<!-- evidence:end -->` is replaced. A full \
run takes about ten minutes on two cores, --quick four. Random draws are seeded. Exit code 1: a set failed, or no set \
is present.";

/// Arguments of `dermis evidence`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Folder with the data sets.
    #[arg(long, value_name = "DATA", required_unless_present = "list")]
    data: Option<PathBuf>,
    /// Only these sets, separated by commas.
    #[arg(long, value_name = "SETS", value_delimiter = ',')]
    only: Vec<String>,
    /// Use one draw, fewer pokes, one level and a coarser mesh.
    #[arg(long)]
    quick: bool,
    /// Output file for the tables: .md (a page with the markers, or a new one), .html or .json.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// List the sets and exit.
    #[arg(long)]
    list: bool,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Runs the sets, prints the results and writes the page.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let sets = self.chosen()?;
        let data = match &self.data {
            Some(data) if !self.list => data,
            _ => return list(&sets, self.json, out),
        };
        if !data.is_dir() {
            return Err(UsageError(format!("--data {}: expected a folder", data.display())).into());
        }
        // Fail now if the file cannot be written, not after ten minutes of work.
        let file = self.out.as_deref().map(OutFile::checked).transpose()?;
        let extent = if self.quick { Extent::Quick } else { Extent::Full };
        let mut evidence = Evidence { data: data.clone(), extent, sets: Vec::with_capacity(sets.len()) };
        for set in sets {
            let report = measure(set, data, extent);
            if !self.json {
                tables::print(out, set, &report)?;
                out.flush()?;
            }
            evidence.sets.push((set, report));
        }
        if self.json {
            super::print_json(&evidence.as_json(), out)?;
        } else {
            writeln!(out, "{}", evidence.summary())?;
        }
        if let Some(file) = file {
            file.write(&evidence)?;
            eprintln!("written: {}", file.path().display());
        }
        Ok(evidence.outcome())
    }

    /// The selected sets in table order, each once.
    fn chosen(&self) -> Result<Vec<&'static Set>, UsageError> {
        if let Some(unknown) = self.only.iter().find(|name| Set::named(name).is_none()) {
            let names = SETS.iter().map(|set| set.name).collect::<Vec<_>>().join(", ");
            return Err(UsageError(format!("--only {unknown}: expected one or more of {names}")));
        }
        let is_chosen = |set: &&Set| self.only.is_empty() || self.only.iter().any(|name| name == set.name);
        Ok(SETS.iter().filter(is_chosen).collect())
    }
}

fn list(sets: &[&Set], json: bool, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    if json {
        let listed = |set: &&Set| serde_json::json!({ "set": set.name, "title": set.title, "source": set.source });
        super::print_json(&sets.iter().map(listed).collect::<Vec<_>>(), out)?;
    } else {
        sets.iter().try_for_each(|set| writeln!(out, "{:<16} {} ({})", set.name, set.title, set.source))?;
    }
    Ok(Outcome::Done)
}

/// Runs a set. On a terminal, stderr shows every step; otherwise one line per set.
fn measure(set: &Set, data: &std::path::Path, extent: Extent) -> SetReport {
    let spinner = super::spinner(set.name);
    if !std::io::stderr().is_terminal() {
        eprintln!("{} ...", set.name);
    }
    let found = set.measure(data, extent, &mut |step| spinner.set_message(format!("{}: {step}", set.name)));
    spinner.finish_and_clear();
    if let Some(error) = &found.failed {
        report(&anyhow::anyhow!("{}: {error}", set.name));
    }
    for path in &found.missing {
        eprintln!("missing: {}: {} does not exist", set.name, path.display());
    }
    found
}
