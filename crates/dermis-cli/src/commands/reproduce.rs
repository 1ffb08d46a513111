//! `dermis reproduce`: replays the experiments of the published skins on their twins, with tables, figures and one
//! report.

mod figures;
mod page;
mod report;

use std::io::Write;
use std::path::PathBuf;

use dermis_lab::experiments::{Experiment, PAPERS, Report};

use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis reproduce --list
  dermis reproduce I I3 --out reproduce
  dermis reproduce I3 H2 --out both

Letters and experiments can be mixed: `dermis reproduce I P H1` replays two papers and one experiment of a third.

Each experiment gets a folder with its table (CSV), figures (SVG, PDF, PNG) and their data (CSV, NPY); report.html \
combines them: contents, methods, tables, figures with captions, readable on a phone and in print. Noise and repeats \
are seeded, so a replay gives the same numbers. Tables state for every number whether it was fitted to the paper, \
predicted by the twin's physics, or computed by the image and touch algorithms.";

/// Arguments of `dermis reproduce`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Letters of papers, and experiments such as `I2`. A letter stands for its whole paper, unless experiments of
    /// that paper are named as well.
    #[arg(value_name = "PAPER|EXPERIMENT", required_unless_present = "list")]
    which: Vec<String>,
    /// Output folder.
    #[arg(long, value_name = "FOLDER", default_value = "reproduce")]
    out: PathBuf,
    /// List the papers and experiments, and exit.
    #[arg(long)]
    list: bool,
    /// With --list: JSON instead of a table.
    #[arg(long, requires = "list")]
    json: bool,
}

impl Arguments {
    /// Replays the selected experiments.
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
        let page = page::write_page(&self.out, &reports)?;
        writeln!(out, "report: {}", page.display())?;
        Ok(Outcome::Done)
    }

    /// The selected experiments in the order of papers and experiments, each once.
    fn chosen(&self) -> Result<Vec<&'static Experiment>, UsageError> {
        let is_letter = |word: &String, letter: &str| word.eq_ignore_ascii_case(letter);
        for word in &self.which {
            known(word)?;
        }
        let mut chosen = Vec::new();
        for (letter, _, experiments) in &PAPERS {
            let is_named = |e: &Experiment| self.which.iter().any(|word| word.eq_ignore_ascii_case(e.id));
            let named: Vec<&Experiment> = experiments.iter().filter(|experiment| is_named(experiment)).collect();
            if named.is_empty() && self.which.iter().any(|word| is_letter(word, letter)) {
                chosen.extend(experiments.iter());
            }
            chosen.extend(named);
        }
        Ok(chosen)
    }
}

/// Refuses words that are neither a paper's letter nor one of its experiments.
fn known(word: &str) -> Result<(), UsageError> {
    let begins = |letter: &str| word.get(..letter.len()).is_some_and(|start| start.eq_ignore_ascii_case(letter));
    let Some((letter, _, experiments)) = PAPERS.iter().find(|(letter, ..)| begins(letter)) else {
        let letters = PAPERS.iter().map(|paper| paper.0).collect::<Vec<_>>().join(", ");
        return Err(UsageError(format!("paper {word}: expected one of {letters}")));
    };
    if word.len() == letter.len() || experiments.iter().any(|experiment| experiment.id.eq_ignore_ascii_case(word)) {
        return Ok(());
    }
    let names = experiments.iter().map(|experiment| experiment.id).collect::<Vec<_>>().join(", ");
    Err(UsageError(format!("experiment {word}: expected one of {names}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(words: &[&str]) -> Vec<&'static str> {
        let which = words.iter().map(|word| word.to_string()).collect();
        let arguments = Arguments { which, out: PathBuf::new(), list: false, json: false };
        arguments.chosen().unwrap().iter().map(|experiment| experiment.id).collect()
    }

    #[test]
    fn papers_and_experiments_mix_and_run_once_in_order() {
        assert_eq!(ids(&["P", "i3", "I", "I1", "h1"]), ["H1", "I1", "I3", "P1", "P2", "P3"]);
        assert_eq!(ids(&["p", "P"]), ["P1", "P2", "P3"]);
        assert_eq!(ids(&["E10", "I-SNR"]), ["E10", "I-SNR"]);
    }
}
