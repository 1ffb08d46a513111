//! From the best weights to a model: temperature, novelty score and the metrics for the card.

use super::split::{Split, scaled};
use super::{TrainOptions, Training};
use crate::LearnError;
use crate::metrics::{Calibration, Confusion, HeldOut, most_likely};
use crate::model::{CARD_FORMAT, Model, ModelCard, TrainingRecord};
use crate::network::{Network, softmax};
use crate::novelty::Novelty;
use crate::shape::UNetShape;
use crate::train::checkpoint::State;
use crate::weights::Tensors;

/// Maximum number of frames used for features.
const MOST_FEATURE_FRAMES: usize = 2000;
/// Maximum number of frames used to fit the temperature.
const MOST_TEMPERATURE_FRAMES: usize = 200;

/// Runs the frames of some shards through the network.
struct Run<'a> {
    training: &'a Training<'a>,
    scale: &'a [f32],
    network: Network,
}

impl Run<'_> {
    /// Passes the logits, truth and features of every frame to `each` until it returns false.
    fn over(
        &mut self,
        shards: &[usize],
        mut each: impl FnMut(&[f32], &[u8], &[f32]) -> Result<bool, LearnError>,
    ) -> Result<(), LearnError> {
        let manifest = self.training.set.manifest();
        let pixels = manifest.pixels();
        let mut logits = vec![0.0; manifest.classes.len() * pixels];
        for &shard in shards {
            let samples = scaled(self.training.set.read(shard)?, self.scale, pixels);
            let inputs = samples.inputs.chunks_exact(manifest.input_len());
            for (input, truth) in inputs.zip(samples.labels.chunks_exact(pixels)) {
                self.network.logits(input, &mut logits)?;
                if !each(&logits, truth, self.network.features())? {
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}

/// Removes the class weights of the loss from the logits. Training with weights w yields outputs proportional to
/// `w_c p_c` instead of the probabilities `p_c` (the prior shift of Saerens et al., Neural Computation 14, 2002, eq.
/// 2.4), so subtracting `ln w_c` restores probabilities.
fn unweigh(tensors: &mut Tensors, weights: &[f32]) -> Result<(), LearnError> {
    let Some((dims, bias)) = tensors.get("head.bias").filter(|(_, bias)| bias.len() == weights.len()) else {
        return Ok(());
    };
    let bias = bias.iter().zip(weights).map(|(bias, weight)| bias - weight.ln()).collect();
    tensors.insert("head.bias", dims.to_vec(), bias)
}

pub(super) fn model(
    training: &Training<'_>,
    shape: UNetShape,
    split: &Split,
    scale: &[f32],
    state: &State,
) -> Result<Model, LearnError> {
    let manifest = training.set.manifest();
    let mut tensors = state.best.clone();
    unweigh(&mut tensors, &training.options.class_weights)?;
    let network = Network::new(shape, &tensors, manifest.rows, manifest.columns)?;
    let mut run = Run { training, scale, network };
    let mut features = Vec::new();
    run.over(&split.training, |_, _, frame| {
        features.push(frame.to_vec());
        Ok(features.len() < MOST_FEATURE_FRAMES)
    })?;
    // Held-out frames alternate: even ones fit the temperature, odd ones measure the calibration error.
    let mut held_out = HeldOut { classes: shape.classes, logits: Vec::new(), truth: Vec::new() };
    let (mut held_out_features, mut number) = (Vec::new(), 0_usize);
    run.over(&split.held_out, |logits, truth, frame| {
        if number.is_multiple_of(2) && held_out.truth.len() < MOST_TEMPERATURE_FRAMES {
            held_out.logits.push(logits.to_vec());
            held_out.truth.push(truth.to_vec());
        }
        held_out_features.push(frame.to_vec());
        number += 1;
        Ok(true)
    })?;
    let temperature = held_out.temperature();
    Novelty::fit(&features, &held_out_features)?.store(&mut tensors)?;
    let (calibration, confusion) = judge(&mut run, split, shape.classes, temperature)?;
    let options: &TrainOptions = training.options;
    let card = ModelCard {
        format: CARD_FORMAT.into(),
        weights: "weights.safetensors".into(),
        weights_bytes: 0,
        weights_sha256: String::new(),
        shape,
        rows: manifest.rows,
        columns: manifest.columns,
        skin: manifest.skin.clone(),
        skin_sha256: manifest.skin_sha256.clone(),
        inputs: manifest.inputs.clone(),
        input_scale: scale.to_vec(),
        classes: manifest.classes.clone(),
        temperature,
        first: None,
        training: TrainingRecord {
            command: training.command.into(),
            seed: options.seed,
            data_sha256: training.set.manifest_sha256().into(),
            samples: [Split::samples(training.set, &split.training), Split::samples(training.set, &split.held_out)],
            epochs: state.epoch,
            best_epoch: state.best_epoch,
            learning_rate: options.learning_rate,
            batch: options.batch,
            duration_s: state.duration_s.round(),
            held_out_loss: state.best_loss,
            held_out_iou: confusion.summary(0).0,
            calibration_error: calibration.error(),
        },
    };
    Ok(Model::new(card, tensors))
}

fn judge(
    run: &mut Run<'_>,
    split: &Split,
    classes: usize,
    temperature: f32,
) -> Result<(Calibration, Confusion), LearnError> {
    let (mut calibration, mut confusion, mut number) = (Calibration::default(), Confusion::new(classes), 0_usize);
    let (mut values, mut found) = (Vec::new(), Vec::new());
    run.over(&split.held_out, |logits, truth, _| {
        values.clear();
        values.extend_from_slice(logits);
        softmax(&mut values, classes, temperature);
        found.resize(truth.len(), 0);
        most_likely(&values, classes, &mut found);
        confusion.add(truth, &found)?;
        if !number.is_multiple_of(2) {
            calibration.add(&values, truth)?;
        }
        number += 1;
        Ok(true)
    })?;
    Ok((calibration, confusion))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_of_classes_are_taken_out_of_the_probabilities() {
        let mut tensors = Tensors::default();
        // With weights 1 and 4 and class probabilities 0.8 and 0.2, the network learns 0.8 to 0.8.
        tensors.insert("head.bias", vec![2], vec![0.3, 0.3]).unwrap();
        unweigh(&mut tensors, &[1.0, 4.0]).unwrap();
        let mut values = tensors.get("head.bias").unwrap().1.to_vec();
        softmax(&mut values, 2, 1.0);
        assert!((values[0] - 0.8).abs() < 1e-6 && (values[1] - 0.2).abs() < 1e-6, "{values:?}");
        // Equal weights may be omitted and change nothing.
        unweigh(&mut tensors, &[]).unwrap();
        assert_eq!(tensors.get("head.bias").unwrap().1, [0.3, 0.3 - 4.0_f32.ln()]);
    }
}
