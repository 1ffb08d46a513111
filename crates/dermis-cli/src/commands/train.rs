//! `dermis train`: trains a network on the CPU from a training set. To train on a GPU, use PyTorch: see
//! `dermis.torch` of the Python package.

use std::io::Write;
use std::path::{Path, PathBuf};

use dermis_learn::train::{EpochReport, Progress, TrainOptions, Training, train};
use dermis_learn::{Model, ModelCard, Tensors, TrainingSet};

use super::progress_bar;
use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis train --set set --out model.json --width 4 --levels 3 --epochs 2 \\
      --batch 10 --held-out 0.5

Losses are mean cross-entropies; IoU is the intersection over union of each class on the frames held out. Weights go \
to model.safetensors next to the card (PyTorch loads them as a state_dict). After every pass a checkpoint is written \
to model.checkpoint; the same command resumes from it, and removes it when done.";

/// Arguments of `dermis train`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Folder made by `dermis train-set`.
    #[arg(long, value_name = "FOLDER")]
    set: PathBuf,
    /// Output model card.
    #[arg(long, value_name = "MODEL.json")]
    out: PathBuf,
    /// Channels of the finest level.
    #[arg(long, default_value_t = TrainOptions::default().width)]
    width: usize,
    /// Number of levels, each with half the rows and columns of the one before.
    #[arg(long, default_value_t = TrainOptions::default().levels)]
    levels: usize,
    /// Maximum number of passes over the samples.
    #[arg(long, default_value_t = TrainOptions::default().epochs)]
    epochs: usize,
    /// Samples per step.
    #[arg(long, default_value_t = TrainOptions::default().batch)]
    batch: usize,
    /// Adam's initial step size; it falls to a fiftieth along a half cosine.
    #[arg(long, default_value_t = TrainOptions::default().learning_rate)]
    learning_rate: f64,
    /// Stop after this many passes without improvement.
    #[arg(long, default_value_t = TrainOptions::default().patience)]
    patience: usize,
    /// Share of the shards to hold out.
    #[arg(long, default_value_t = TrainOptions::default().held_out)]
    held_out: f64,
    /// Seed of the initial weights and of the order of samples.
    #[arg(long, default_value_t = TrainOptions::default().seed)]
    seed: u64,
    /// Weights of the classes in the loss, separated by commas; default: equal.
    #[arg(long, value_name = "WEIGHTS", value_delimiter = ',')]
    class_weights: Vec<f32>,
    /// Turn and mirror samples at random: for square skins whose electrodes and protocol have the square's
    /// symmetries.
    #[arg(long)]
    symmetries: bool,
    /// A model with the same architecture and inputs to start from; default: random weights.
    #[arg(long, value_name = "MODEL.json", conflicts_with = "weights")]
    start: Option<PathBuf>,
    /// Weights to start from that were trained elsewhere: a PyTorch state_dict with the same names, in safetensors.
    /// With --epochs 0 they are kept, evaluated and given a card.
    #[arg(long, value_name = "FILE.safetensors")]
    weights: Option<PathBuf>,
    /// The first-stage model, for a set whose inputs include its output; it becomes part of the model.
    #[arg(long, value_name = "MODEL.json")]
    first: Option<PathBuf>,
    /// Factors that the input images are multiplied by, separated by commas; default: those of the starting model, or
    /// those that bring each image to a root mean square of 1.
    #[arg(long, value_name = "FACTORS", value_delimiter = ',')]
    input_scale: Vec<f32>,
}

impl Arguments {
    /// Trains, and prints the result of each pass.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let set = TrainingSet::open(&self.set)?;
        let first = self.first.as_deref().map(Model::load).transpose()?;
        check_first(&set, first.as_ref())?;
        let checkpoint = self.out.with_extension("checkpoint");
        let files = [self.out.clone(), self.out.with_extension("safetensors")];
        let stood = files.each_ref().map(|file| file.exists());
        let options = self.options();
        let (rows, columns) = (set.manifest().rows, set.manifest().columns);
        dermis_skin::budget::memory_limit();
        dermis_tomo::memory::check(options.bytes(set.manifest().inputs.len(), rows, columns), || {
            format!(
                "a training of width {}, {} levels and batches of {} images of {rows} x {columns} pixels",
                options.width, options.levels, options.batch
            )
        })?;
        let command = self.command();
        // Weights belong to the factors that their input images were multiplied by.
        let (start, mut input_scale) = match (&self.start, &self.weights) {
            (Some(model), _) => Model::load(model).map(|model| (Some(model.tensors), model.card.input_scale))?,
            (None, Some(file)) => (Some(weights_of(file)?), Vec::new()),
            (None, None) => (None, Vec::new()),
        };
        if !self.input_scale.is_empty() {
            input_scale.clone_from(&self.input_scale);
        }
        let training = Training {
            set: &set,
            options: &options,
            checkpoint: &checkpoint,
            command: &command,
            start: start.as_ref(),
            input_scale: (!input_scale.is_empty()).then_some(&input_scale),
        };
        let bar = progress_bar("samples");
        let mut failed = Ok(());
        let classes = set.manifest().classes.clone();
        let trained = train(&training, |progress| match progress {
            Progress::Step(done, all, loss) => {
                bar.set_length(*all as u64);
                bar.set_position(*done as u64);
                bar.set_message(format!("loss {loss:.4}"));
            }
            Progress::Epoch(report) => {
                let line = described(report, &classes);
                let written = bar.suspend(|| writeln!(out, "{line}").and_then(|()| out.flush()));
                if failed.is_ok() {
                    failed = written;
                }
            }
            _ => {}
        });
        bar.finish_and_clear();
        let mut model = trained?;
        failed?;
        if let Some(first) = &first {
            model.set_first(first)?;
        }
        // Training takes long. A file that has appeared under these names meanwhile belongs to someone else.
        let appeared = files.iter().zip(stood).find(|(file, stood)| !stood && file.exists()).map(|(file, _)| file);
        let kept = if appeared.is_some() { self.out.with_extension("finished.json") } else { self.out.clone() };
        model.save(&kept)?;
        remove_checkpoint(&checkpoint);
        if let Some(file) = appeared {
            let (file, kept) = (file.display(), kept.display());
            anyhow::bail!(
                "{file}: another file appeared there meanwhile and was not replaced; the finished model is in {kept}"
            );
        }
        summary(&model.card, out)?;
        Ok(Outcome::Done)
    }

    fn options(&self) -> TrainOptions {
        TrainOptions {
            width: self.width,
            levels: self.levels,
            epochs: self.epochs,
            batch: self.batch,
            learning_rate: self.learning_rate,
            patience: self.patience,
            held_out: self.held_out,
            seed: self.seed,
            class_weights: self.class_weights.clone(),
            symmetries: self.symmetries,
        }
    }

    /// The complete command, including defaults.
    fn command(&self) -> String {
        let weights: Vec<String> = self.class_weights.iter().map(ToString::to_string).collect();
        let weights =
            if weights.is_empty() { String::new() } else { format!(" --class-weights {}", weights.join(",")) };
        let mut start = self.start.as_deref().map_or(String::new(), |start| format!(" --start {}", name(start)));
        if let Some(first) = &self.first {
            start += &format!(" --first {}", name(first));
        }
        if let Some(file) = &self.weights {
            start += &format!(" --weights {}", name(file));
        }
        if !self.input_scale.is_empty() {
            let factors: Vec<String> = self.input_scale.iter().map(ToString::to_string).collect();
            start += &format!(" --input-scale {}", factors.join(","));
        }
        format!(
            "dermis train --set {} --out {} --width {} --levels {} --epochs {} --batch {} --learning-rate {} \
             --patience {} --held-out {} --seed {}{weights}{}{start}",
            name(&self.set),
            name(&self.out),
            self.width,
            self.levels,
            self.epochs,
            self.batch,
            self.learning_rate,
            self.patience,
            self.held_out,
            self.seed,
            if self.symmetries { " --symmetries" } else { "" }
        )
    }
}

/// A set that contains a first model's output needs that very model, and no other set accepts one.
fn check_first(set: &TrainingSet, first: Option<&Model>) -> anyhow::Result<()> {
    let shown = set.manifest().recipe.get("first_sha256").and_then(|hash| hash.as_str());
    let given = first.map(|model| model.card.weights_sha256.as_str());
    match (shown, given) {
        (Some(_), None) => {
            anyhow::bail!("the inputs include the output of a first model: expected that model with --first")
        }
        (None, Some(_)) => anyhow::bail!("--first: the set was made without a first model"),
        (Some(shown), Some(given)) if shown != given => {
            anyhow::bail!("--first: the set was made with a model of weights {shown}, not {given}")
        }
        _ => Ok(()),
    }
}

/// Reads weights from a separate file.
fn weights_of(file: &Path) -> anyhow::Result<Tensors> {
    let bytes = dermis_device::instruments::read_bytes(file).map_err(dermis_lab::Error::from)?;
    Ok(Tensors::from_bytes(&bytes, file)?)
}

/// The last part of a path, so that a card reveals nothing about the machine it was made on.
fn name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A leftover checkpoint does no harm if it cannot be removed.
fn remove_checkpoint(folder: &Path) {
    let _ = std::fs::remove_dir_all(folder);
}

fn described(report: &EpochReport, classes: &[String]) -> String {
    let mark = if report.best { ", best so far" } else { "" };
    format!(
        "epoch {}: loss {:.4}, held out {:.4}, IoU {}{mark}",
        report.epoch,
        report.loss,
        report.held_out_loss,
        overlaps(&report.held_out_iou, classes)
    )
}

fn overlaps(values: &[Option<f64>], classes: &[String]) -> String {
    let one = |(name, value): (&String, &Option<f64>)| match value {
        Some(value) => format!("{name} {value:.3}"),
        None => format!("{name} none"),
    };
    classes.iter().zip(values).map(one).collect::<Vec<_>>().join(", ")
}

fn summary(card: &ModelCard, out: &mut dyn Write) -> std::io::Result<()> {
    let record = &card.training;
    writeln!(out, "best pass: {} of {}", record.best_epoch, record.epochs)?;
    writeln!(out, "IoU: {}", overlaps(&record.held_out_iou, &card.classes))?;
    writeln!(out, "temperature: {:.3}", card.temperature)?;
    writeln!(out, "expected calibration error: {:.4}", record.calibration_error)?;
    writeln!(out, "weights: {} ({} bytes)", card.weights, card.weights_bytes)
}
