//! Training: Adam on the cross-entropy of a training set's shards, with held-out frames for early stopping, for the
//! temperature and for the metrics on the model card. Every pass over the samples ends with a checkpoint, and a
//! resumed training gives the same result as an uninterrupted one.

mod checkpoint;
mod finish;
mod native;
mod options;
mod split;
mod training;

pub use options::TrainOptions;
use training::Batch;
pub use training::Training;

use std::time::Instant;

use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};

use crate::LearnError;
use crate::metrics::{Confusion, most_likely};
use crate::model::Model;
use crate::network::{Network, softmax};
use crate::shape::UNetShape;
use crate::shards::{Manifest, Shard, TrainingSet};
use crate::weights::Tensors;
use checkpoint::{Checkpoint, State};
use native::NativeUNet;
use split::{SHARDS_AT_ONCE, Split, scaled};

/// Progress reports during training.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Progress {
    /// After a step: samples done in this pass, samples per pass, mean loss of those samples.
    Step(usize, usize, f64),
    /// After a pass.
    Epoch(EpochReport),
}

/// Report on one pass over the samples.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochReport {
    /// Counted from 1.
    pub epoch: usize,
    /// Mean cross-entropy of the batches.
    pub loss: f64,
    /// Mean cross-entropy of the held-out frames.
    pub held_out_loss: f64,
    /// Intersection over union of each class on held-out frames; `None` for a class that does not occur.
    pub held_out_iou: Vec<Option<f64>>,
    /// True if this is the best pass up to now.
    pub best: bool,
}

/// Trains, or resumes a training, and returns the finished model (not yet saved).
///
/// # Errors
/// Fails if the options or the training set are invalid, shards are missing or damaged, the checkpoint belongs to
/// another training or cannot be written, or the loss is no longer finite.
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

/// The network for a training state.
fn descent(shape: UNetShape, state: &State, options: &TrainOptions) -> Result<NativeUNet, LearnError> {
    let moments = (state.steps > 0).then_some((&state.moments, state.steps));
    let class_weights = options.weights_of(shape.classes)?;
    NativeUNet::new(shape, &state.tensors, moments, &class_weights)
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
    /// Runs the pass and returns the mean loss.
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

/// Rotates and mirrors every sample at random.
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

/// Source index of the pixel that a symmetry of the square moves to `place`. The bits of `symmetry` mirror the
/// columns, mirror the rows and transpose.
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

/// Mean cross-entropy and confusion matrix of the held-out frames, by the network that runs live.
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
