//! `dermis reproduce`: the experiments of the published skins on their twins, as tables, figures and one report.

mod report;

use std::io::Write;
use std::path::PathBuf;

use dermis::lab::experiments::{Experiment, PAPERS, Report};

use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis reproduce --list
  dermis reproduce I I3 --out reproduce

Each experiment gets a folder with its table (CSV), figures (SVG and PNG) and their data (CSV, NPY); report.html shows
all. Noise and repeats are seeded: a replay gives the same numbers. Tables say of every figure whether it was fitted to
the paper, predicted by the twin's physics, or made by the image and touch algorithms.";

/// Arguments of `dermis reproduce`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Letter of a paper.
    #[arg(value_name = "PAPER", required_unless_present = "list")]
    paper: Option<String>,
    /// Experiments, as in `I2`; all of the paper when none is named.
    #[arg(value_name = "EXPERIMENT")]
    experiments: Vec<String>,
    /// Folder for what comes out.
    #[arg(long, value_name = "FOLDER", default_value = "reproduce")]
    out: PathBuf,
    /// Name the papers and experiments, and stop.
    #[arg(long)]
    list: bool,
    /// With --list: JSON instead of a table.
    #[arg(long, requires = "list")]
    json: bool,
}

impl Arguments {
    /// Replays what was asked for.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.list && self.json {
            let papers: Vec<serde_json::Value> = PAPERS
                .iter()
                .map(|(letter, title, experiments)| {
                    let listed = experiments.iter().map(|e| serde_json::json!({ "id": e.id, "title": e.title }));
                    serde_json::json!({ "paper": letter, "title": title, "experiments": listed.collect::<Vec<_>>() })
                })
                .collect();
            super::print_json(&papers, out)?;
            return Ok(Outcome::Done);
        }
        if self.list {
            for (letter, title, experiments) in PAPERS {
                writeln!(out, "{letter}  {title}")?;
                for experiment in experiments {
                    writeln!(out, "  {:4} {}", experiment.id, experiment.title)?;
                }
            }
            return Ok(Outcome::Done);
        }
        let chosen = self.chosen()?;
        let bar = super::progress_bar("experiments");
        bar.set_length(chosen.len() as u64);
        let mut reports: Vec<Report> = Vec::with_capacity(chosen.len());
        for experiment in chosen {
            let report = experiment.run()?;
            report::write(&self.out, &report)?;
            bar.suspend(|| report::print(out, &report))?;
            bar.inc(1);
            reports.push(report);
        }
        bar.finish_and_clear();
        let page = report::write_page(&self.out, &reports)?;
        writeln!(out, "report: {}", page.display())?;
        Ok(Outcome::Done)
    }

    fn chosen(&self) -> Result<Vec<&'static Experiment>, UsageError> {
        let letters = || PAPERS.iter().map(|paper| paper.0).collect::<Vec<_>>().join(", ");
        let asked = self.paper.as_deref().unwrap_or_default();
        let paper = PAPERS.iter().find(|paper| paper.0.eq_ignore_ascii_case(asked));
        let Some((_, _, experiments)) = paper else {
            return Err(UsageError(format!("paper {asked}: expected one of {}", letters())));
        };
        if self.experiments.is_empty() {
            return Ok(experiments.iter().collect());
        }
        let find = |name: &String| {
            experiments.iter().find(|experiment| experiment.id.eq_ignore_ascii_case(name)).ok_or_else(|| {
                let known = experiments.iter().map(|experiment| experiment.id).collect::<Vec<_>>().join(", ");
                UsageError(format!("experiment {name}: expected one of {known}"))
            })
        };
        self.experiments.iter().map(find).collect()
    }
}
