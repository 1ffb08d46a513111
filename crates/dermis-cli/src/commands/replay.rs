//! `dermis replay`: runs a recording through the live pipeline again, with its original times, commands and
//! calibrations, or with other imaging settings.

use std::io::Write;
use std::ops::ControlFlow;
use std::path::PathBuf;

use dermis_live::skin_frame::SkinFrame;
use dermis_live::stages::health::HealthWatch;
use dermis_record::sink::{ImageStack, JsonLines, LinesFor, Sink, TouchColumns, TouchTable};
use dermis_record::{LostFrames, Recording, RerunOptions, RerunReport, rerun};
use dermis_skin::{HyperparameterChoice, PriorChoice, Skin};

use crate::exit::{Outcome, UsageError};
use crate::interrupt;

const EXAMPLE: &str = "\
Examples:
  dermis replay press.mcap --only-touches
  dermis replay press.mcap --prior laplace --hyperparameter 1e-3 \\
      --images laplace.npy --touches laplace.csv

Prints the same JSON lines, one per frame, as `dermis run --headless` while recording; with --images or --touches it \
writes files instead. Electrodes and channels that fail or recover are named on stderr. `dermis run --source \
press.mcap` shows a recording in the page. Exit code 3: the recording lacks frames; their number is printed.";

/// Arguments of `dermis replay`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// The recording, complete or not.
    #[arg(value_name = "FILE.mcap")]
    file: PathBuf,
    /// 0 as fast as possible, 1 as recorded, 2 twice as fast.
    #[arg(long, default_value_t = 0.0)]
    speed: f64,
    /// Another skin, or another file of the same one, instead of the recorded one.
    #[arg(long, value_name = "NAME|FILE")]
    skin: Option<String>,
    /// Another prior: identity, laplace, noser=EXPONENT, gaussian-mm=LENGTH, or a value as in a skin file.
    #[arg(long, value_name = "PRIOR")]
    prior: Option<PriorChoice>,
    /// lambda, or relative=FACTOR, noise-figure=TARGET, overriding the recorded skin's rule.
    #[arg(long, value_name = "LAMBDA")]
    hyperparameter: Option<HyperparameterChoice>,
    /// Print lines only for frames with touches or events.
    #[arg(long)]
    only_touches: bool,
    /// Output file for a table of touches.
    #[arg(long, value_name = "FILE.csv")]
    touches: Option<PathBuf>,
    /// Output file for the images.
    #[arg(long, value_name = "FILE.npy")]
    images: Option<PathBuf>,
}

impl Arguments {
    /// Replays until the recording ends or the user interrupts.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if !(self.speed.is_finite() && self.speed >= 0.0) {
            let text = format!("--speed {}: expected 0 (as fast as possible) or a positive number", self.speed);
            return Err(UsageError(text).into());
        }
        let mut recording = Recording::open(&self.file)?;
        let head = recording.head().clone();
        let mut skin = match &self.skin {
            Some(name) => Skin::open(name)?,
            None => Skin::parse(&head.skin_toml, &self.file.display().to_string())?,
        };
        if let Some(prior) = &self.prior {
            skin.imaging.prior = prior.clone();
        }
        if let Some(rule) = &self.hyperparameter {
            skin.imaging.hyperparameter = rule.clone();
        }
        let mut pipeline = head.pipeline(skin, &self.file)?;
        let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
        if let Some(path) = &self.touches {
            let columns = TouchColumns {
                forces: head.forces.is_some() || pipeline.prepared().skin.states_force_law(),
                load: pipeline.load_quantity(),
                other_places: pipeline.may_tell_other_places(),
            };
            sinks.push(Box::new(TouchTable::create(path, columns)?));
        }
        if let Some(path) = &self.images {
            let grid = pipeline.prepared().map.grid();
            sinks.push(Box::new(ImageStack::create(path, grid.rows, grid.columns)?));
        }
        let lines_for = if self.only_touches { LinesFor::Touches } else { LinesFor::EveryFrame };
        let mut lines =
            sinks.is_empty().then(|| JsonLines::new(Vec::new(), "standard output", lines_for).of_recording());
        let options = RerunOptions { speed: self.speed, follow_hyperparameter: self.hyperparameter.is_none() };
        let stop = interrupt::begin();
        let mut health = HealthWatch::new(&pipeline.prepared().skin);
        // A closed pipe on stdout is not an error of the replay.
        let mut failed: Option<std::io::Error> = None;
        let report = rerun(&mut recording, &mut pipeline, options, stop, |output: &SkinFrame<'_>| {
            sinks.iter_mut().try_for_each(|sink| sink.accept(output))?;
            for change in health.changes(&output.health) {
                tracing::warn!(frame = output.sequence, "{}", change.detail);
            }
            if let Some(news) = output.circuit {
                tracing::warn!(frame = output.sequence, "{}", news.describe());
            }
            if let Some(lines) = &mut lines {
                lines.accept(output)?;
                if let Err(error) = out.write_all(lines.get_mut()).and_then(|()| out.flush()) {
                    failed = Some(error);
                    return Ok(ControlFlow::Break(()));
                }
                lines.get_mut().clear();
            }
            Ok(ControlFlow::Continue(()))
        })?;
        failed.map_or(Ok(()), Err)?;
        for sink in &mut sinks {
            sink.finish()?;
        }
        Ok(outcome(&report))
    }
}

/// Logs what is missing; returns [`Outcome::DataLost`] if anything is.
fn outcome(report: &RerunReport) -> Outcome {
    if report.refused > 0 {
        tracing::warn!(refused = report.refused, "recorded commands were refused this time");
    }
    if !report.has_losses() {
        return Outcome::Done;
    }
    let damage = &report.damage;
    let unreadable = match damage.frames {
        LostFrames::Exactly(count) => count.to_string(),
        LostFrames::Unknown { in_damaged_chunks } => format!("at most {in_damaged_chunks}"),
    };
    tracing::error!(lost = report.missing, unreadable, cut_off = damage.cut_off, "frames were lost");
    Outcome::DataLost
}
