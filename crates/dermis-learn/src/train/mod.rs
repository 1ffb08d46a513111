//! Training: Adam on the cross-entropy of a training set's shards, with frames held out for early stopping, for the
//! temperature and for the figures on the model card. Every pass over the samples ends in a checkpoint, from which an
//! interrupted training goes on as if it had not been.

mod checkpoint;
mod finish;
mod initial;
mod native;

use std::path::Path;
use std::time::Instant;

use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use crate::LearnError;
use crate::metrics::{Confusion, most_likely};
use crate::model::Model;
use crate::network::{Network, softmax};
use crate::shape::UNetShape;
use crate::shards::{Manifest, Shard, TrainingSet};
use crate::weights::Tensors;
use checkpoint::{Checkpoint, State};
use initial::initial;
use native::NativeUNet;

/// Shards whose samples are mixed: their number bounds the memory.
const SHARDS_AT_ONCE: usize = 8;
/// Share of the first step that the last one has; between them a half cosine.
const LAST_RATE: f64 = 0.02;

/// Share by which a batch moves the running mean and variance; PyTorch's default.
const MOMENTUM: f32 = 0.1;

/// Samples of one step: images are batch x inputs x rows x columns, labels batch x rows x columns.
struct Batch<'a> {
    count: usize,
    rows: usize,
    columns: usize,
    inputs: &'a [f32],
    labels: &'a [u8],
}

/// How to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainOptions {
    /// Channels of the finest level.
    pub width: usize,
    /// Levels.
    pub levels: usize,
    /// Most passes over the samples; with none, the weights to begin with are judged and given a card.
    pub epochs: usize,
    /// Samples a step.
    pub batch: usize,
    /// Adam's first step; it falls to a fiftieth along a half cosine.
    pub learning_rate: f64,
    /// Passes without improvement on the frames held out after which training stops.
    pub patience: usize,
    /// Share of the shards that are held out, the last ones.
    pub held_out: f64,
    /// Seed of the initial weights and of the order of samples.
    pub seed: u64,
    /// Weights of the classes in the loss; none for equal ones.
    pub class_weights: Vec<f32>,
    /// Turn and mirror samples at random, by the eight symmetries of the square: for skins that have them in outline,
    /// electrodes and protocol, whose images of a turned scene are turned images.
    pub symmetries: bool,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            width: 8,
            levels: 4,
            epochs: 40,
            batch: 64,
            learning_rate: 1e-3,
            patience: 8,
            held_out: 0.1,
            seed: 1,
            class_weights: Vec::new(),
            symmetries: false,
        }
    }
}

/// What training tells while it runs.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Progress {
    /// A step was made: samples done in this pass, samples in a pass, mean loss so far in the pass.
    Step(usize, usize, f64),
    /// A pass was made.
    Epoch(EpochReport),
}

/// One pass over the samples.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochReport {
    /// Counted from 1.
    pub epoch: usize,
    /// Mean cross-entropy of the batches.
    pub loss: f64,
    /// Mean cross-entropy of the frames held out.
    pub held_out_loss: f64,
    /// Intersection over union of each class on frames held out; `None` where it does not occur.
    pub held_out_iou: Vec<Option<f64>>,
    /// True where this is the best pass so far.
    pub best: bool,
}

/// What is trained, and where it is kept meanwhile.
pub struct Training<'a> {
    /// The samples.
    pub set: &'a TrainingSet,
    /// How.
    pub options: &'a TrainOptions,
    /// Folder of the checkpoint; training goes on from what is there.
    pub checkpoint: &'a Path,
    /// The command, for the card.
    pub command: &'a str,
    /// Weights to begin with; random ones where `None`.
    pub start: Option<&'a Tensors>,
    /// Factors that the input images are multiplied by; where `None`, those that bring each to a root mean square of 1.
    pub input_scale: Option<&'a [f32]>,
}

impl Training<'_> {
    fn input_scale(&self, split: &Split) -> Result<Vec<f32>, LearnError> {
        let Some(scale) = self.input_scale else { return input_scale(self.set, split) };
        let (expected, got) = (self.set.manifest().inputs.len(), scale.len());
        if got != expected {
            return Err(LearnError::Size { what: "factors of the input images", expected, got });
        }
        if let Some(factor) = scale.iter().find(|factor| !(factor.is_finite() && **factor > 0.0)) {
            let (what, value) = ("factor of an input image", factor.to_string());
            return Err(LearnError::Value { what, value, expected: "a positive and finite one".into() });
        }
        Ok(scale.to_vec())
    }

    fn first_weights(&self, shape: &UNetShape) -> Result<Tensors, LearnError> {
        let Some(start) = self.start else {
            return initial(shape, &mut StdRng::seed_from_u64(self.options.seed));
        };
        start.check(shape, Path::new("weights to begin with"))?;
        // What is beside them, a novelty score, is of another training.
        let mut tensors = Tensors::default();
        for spec in shape.tensors() {
            let values = start.get(&spec.name).map(|(_, values)| values.to_vec()).unwrap_or_default();
            tensors.insert(spec.name, spec.dims, values)?;
        }
        Ok(tensors)
    }
}

impl TrainOptions {
    fn check(&self) -> Result<(), LearnError> {
        let refuse = |what: &'static str, value: String, expected: &str| {
            Err(LearnError::Value { what, value, expected: expected.into() })
        };
        if self.batch == 0 || self.patience == 0 {
            let value = format!("{}, {}", self.batch, self.patience);
            return refuse("batch and patience", value, "at least 1 each");
        }
        if !(self.learning_rate > 0.0 && self.learning_rate < 1.0) {
            return refuse("learning rate", self.learning_rate.to_string(), "between 0 and 1");
        }
        if !(self.held_out > 0.0 && self.held_out < 1.0) {
            return refuse("share held out", self.held_out.to_string(), "between 0 and 1");
        }
        Ok(())
    }

    /// Weights of so many classes.
    fn weights_of(&self, classes: usize) -> Result<Vec<f32>, LearnError> {
        let weights = if self.class_weights.is_empty() { vec![1.0; classes] } else { self.class_weights.clone() };
        if weights.len() != classes {
            let (what, got) = ("weights of the classes", weights.len());
            return Err(LearnError::Size { what, expected: classes, got });
        }
        if let Some(weight) = weights.iter().find(|weight| !(weight.is_finite() && **weight > 0.0)) {
            let (what, value) = ("weight of a class", weight.to_string());
            return Err(LearnError::Value { what, value, expected: "a positive and finite one".into() });
        }
        Ok(weights)
    }

    /// Adam's step in a pass counted from 0.
    fn rate(&self, epoch: usize) -> f64 {
        let along = epoch as f64 / self.epochs as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * along).cos());
        self.learning_rate * (LAST_RATE + (1.0 - LAST_RATE) * cosine)
    }
}

/// Trains, or goes on training, and returns the finished model (not yet saved).
///
/// # Errors
/// Options or a training set that make no sense, shards that are missing or damaged, a checkpoint of another training, a
/// checkpoint that cannot be written, a loss that is no longer finite.
pub fn train(training: &Training<'_>, mut progress: impl FnMut(&Progress)) -> Result<Model, LearnError> {
    let (set, options) = (training.set, training.options);
    options.check()?;
    if options.epochs == 0 && training.start.is_none() {
        let (what, expected) = ("epochs", "at least 1 where there are no weights to begin with".into());
        return Err(LearnError::Value { what, value: "0".into(), expected });
    }
    let manifest = set.manifest();
    let shape = UNetShape {
        inputs: manifest.inputs.len(),
        classes: manifest.classes.len(),
        width: options.width,
        levels: options.levels,
    };
    shape.check()?;
    shape.check_image(manifest.rows, manifest.columns)?;
    if options.symmetries && manifest.rows != manifest.columns {
        let (what, value) = ("images to turn and mirror", format!("{} x {}", manifest.rows, manifest.columns));
        return Err(LearnError::Value { what, value, expected: "squares".into() });
    }
    let split = Split::of(set, options.held_out)?;
    let scale = training.input_scale(&split)?;
    let store = Checkpoint::new(training.checkpoint, set.manifest_sha256(), options);
    let mut state = match store.read(&shape)? {
        Some(state) => state,
        None => State::fresh(training.first_weights(&shape)?),
    };
    let mut network = descent(shape, &state, options)?;
    while state.epoch < options.epochs && state.epoch - state.best_epoch < options.patience {
        let begun = Instant::now();
        let mut pass = Pass { set, split: &split, options, scale: &scale, state: &mut state };
        let loss = pass.run(&mut network, &mut progress)?;
        state.tensors = network.tensors()?;
        state.moments = network.moments()?;
        let (held_out_loss, confusion) = held_out(set, &split, shape, &state.tensors, &scale)?;
        state.epoch += 1;
        let best = state.keep_if_best(held_out_loss);
        state.duration_s += begun.elapsed().as_secs_f64();
        store.write(&state)?;
        let held_out_iou = confusion.summary(0).0;
        progress(&Progress::Epoch(EpochReport { epoch: state.epoch, loss, held_out_loss, held_out_iou, best }));
    }
    if state.epoch == 0 {
        state.best_loss = held_out(set, &split, shape, &state.tensors, &scale)?.0;
    }
    finish::model(training, shape, &split, &scale, &state)
}

/// The network of a state.
fn descent(shape: UNetShape, state: &State, options: &TrainOptions) -> Result<NativeUNet, LearnError> {
    let moments = (state.steps > 0).then_some((&state.moments, state.steps));
    let class_weights = options.weights_of(shape.classes)?;
    NativeUNet::new(shape, &state.tensors, moments, &class_weights)
}

/// Shards to train on and shards held out.
struct Split {
    training: Vec<usize>,
    held_out: Vec<usize>,
}

impl Split {
    fn of(set: &TrainingSet, share: f64) -> Result<Self, LearnError> {
        let shards = set.manifest().shards();
        if shards < 2 {
            let (what, expected) = ("shards of the training set", "at least 2, one of which is held out".into());
            return Err(LearnError::Value { what, value: shards.to_string(), expected });
        }
        let held_out = ((shards as f64 * share).round() as usize).clamp(1, shards - 1);
        Ok(Self { training: (0..shards - held_out).collect(), held_out: (shards - held_out..shards).collect() })
    }

    fn samples(set: &TrainingSet, shards: &[usize]) -> usize {
        shards.iter().map(|&shard| set.manifest().samples_of(shard)).sum()
    }
}

/// Factors that bring each input image to a root mean square of 1 over a few shards.
fn input_scale(set: &TrainingSet, split: &Split) -> Result<Vec<f32>, LearnError> {
    let manifest = set.manifest();
    let (images, pixels) = (manifest.inputs.len(), manifest.pixels());
    let (mut squares, mut count) = (vec![0.0_f64; images], 0_usize);
    for &shard in split.training.iter().take(SHARDS_AT_ONCE) {
        let samples = set.read(shard)?;
        for (place, image) in samples.inputs.chunks_exact(pixels).enumerate() {
            squares[place % images] += image.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        }
        count += samples.labels.len();
    }
    let scale = |square: &f64| {
        let deviation = (square / count.max(1) as f64).sqrt();
        if deviation > 1e-12 { (1.0 / deviation) as f32 } else { 1.0 }
    };
    Ok(squares.iter().map(scale).collect())
}

/// Multiplies every image of a shard by its factor.
fn scaled(mut shard: Shard, scale: &[f32], pixels: usize) -> Shard {
    for (place, image) in shard.inputs.chunks_exact_mut(pixels).enumerate() {
        let factor = scale[place % scale.len()];
        image.iter_mut().for_each(|value| *value *= factor);
    }
    shard
}

/// One pass over the samples.
struct Pass<'a> {
    set: &'a TrainingSet,
    split: &'a Split,
    options: &'a TrainOptions,
    scale: &'a [f32],
    state: &'a mut State,
}

impl Pass<'_> {
    /// The mean loss.
    fn run(&mut self, network: &mut NativeUNet, progress: &mut impl FnMut(&Progress)) -> Result<f64, LearnError> {
        let manifest = self.set.manifest();
        let rate = self.options.rate(self.state.epoch);
        let seed = self.options.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(self.state.epoch as u64 + 1);
        let mut random = StdRng::seed_from_u64(seed);
        let mut shards = self.split.training.clone();
        shards.shuffle(&mut random);
        let all = Split::samples(self.set, &shards);
        let (mut done, mut sum) = (0, 0.0);
        for group in shards.chunks(SHARDS_AT_ONCE) {
            let mut pool = Shard::default();
            for &shard in group {
                let read = scaled(self.set.read(shard)?, self.scale, manifest.pixels());
                pool.inputs.extend(read.inputs);
                pool.labels.extend(read.labels);
            }
            let mut order: Vec<usize> = (0..pool.labels.len() / manifest.pixels()).collect();
            order.shuffle(&mut random);
            for chosen in order.chunks(self.options.batch) {
                let (mut inputs, mut labels) = gather(&pool, chosen, manifest.input_len(), manifest.pixels());
                if self.options.symmetries {
                    turn(&mut inputs, &mut labels, manifest, &mut random);
                }
                let batch = Batch {
                    count: chosen.len(),
                    rows: manifest.rows,
                    columns: manifest.columns,
                    inputs: &inputs,
                    labels: &labels,
                };
                let loss = network.step(&batch, rate);
                if !loss.is_finite() {
                    let expected = "a finite one; lower the learning rate".into();
                    return Err(LearnError::Value { what: "loss", value: loss.to_string(), expected });
                }
                self.state.steps += 1;
                done += chosen.len();
                sum += loss * chosen.len() as f64;
                progress(&Progress::Step(done, all, sum / done as f64));
            }
        }
        Ok(sum / done.max(1) as f64)
    }
}

fn gather(pool: &Shard, chosen: &[usize], input_len: usize, pixels: usize) -> (Vec<f32>, Vec<u8>) {
    let mut inputs = Vec::with_capacity(chosen.len() * input_len);
    let mut labels = Vec::with_capacity(chosen.len() * pixels);
    for &sample in chosen {
        inputs.extend_from_slice(&pool.inputs[sample * input_len..(sample + 1) * input_len]);
        labels.extend_from_slice(&pool.labels[sample * pixels..(sample + 1) * pixels]);
    }
    (inputs, labels)
}

/// Turns and mirrors every sample at random.
fn turn(inputs: &mut [f32], labels: &mut [u8], manifest: &Manifest, random: &mut StdRng) {
    let (pixels, side) = (manifest.pixels(), manifest.rows);
    let (mut image, mut truth) = (vec![0.0; pixels], vec![0; pixels]);
    for (inputs, labels) in inputs.chunks_exact_mut(manifest.input_len()).zip(labels.chunks_exact_mut(pixels)) {
        let symmetry = random.random_range(0..8);
        for given in inputs.chunks_exact_mut(pixels) {
            image.copy_from_slice(given);
            (0..pixels).for_each(|place| given[place] = image[turned(place, side, symmetry)]);
        }
        truth.copy_from_slice(labels);
        (0..pixels).for_each(|place| labels[place] = truth[turned(place, side, symmetry)]);
    }
}

/// The pixel that one of a square's symmetries brings to a place: columns exchanged, rows exchanged, both with each other.
fn turned(place: usize, side: usize, symmetry: u8) -> usize {
    let (mut row, mut column) = (place / side, place % side);
    if symmetry & 1 != 0 {
        column = side - 1 - column;
    }
    if symmetry & 2 != 0 {
        row = side - 1 - row;
    }
    if symmetry & 4 != 0 {
        (row, column) = (column, row);
    }
    row * side + column
}

/// Mean cross-entropy and counts of the frames held out, by the network that will run live.
fn held_out(
    set: &TrainingSet,
    split: &Split,
    shape: UNetShape,
    tensors: &Tensors,
    scale: &[f32],
) -> Result<(f64, Confusion), LearnError> {
    let manifest = set.manifest();
    let pixels = manifest.pixels();
    let mut network = Network::new(shape, tensors, manifest.rows, manifest.columns)?;
    let mut confusion = Confusion::new(shape.classes);
    let (mut sum, mut count) = (0.0, 0_usize);
    let (mut values, mut found) = (vec![0.0; shape.classes * pixels], vec![0; pixels]);
    for &shard in &split.held_out {
        let samples = scaled(set.read(shard)?, scale, pixels);
        for (input, truth) in samples.inputs.chunks_exact(manifest.input_len()).zip(samples.labels.chunks_exact(pixels))
        {
            network.logits(input, &mut values)?;
            most_likely(&values, shape.classes, &mut found);
            confusion.add(truth, &found)?;
            softmax(&mut values, shape.classes, 1.0);
            for (pixel, label) in truth.iter().enumerate() {
                sum -= f64::from(values[usize::from(*label) * pixels + pixel].max(1e-12)).ln();
            }
            count += pixels;
        }
    }
    Ok((sum / count.max(1) as f64, confusion))
}

#[cfg(test)]
mod tests;
