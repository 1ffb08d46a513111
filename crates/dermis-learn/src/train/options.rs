//! Training options.

use serde::{Deserialize, Serialize};

use crate::LearnError;

/// Learning rate of the last pass relative to the first; half a cosine in between.
const LAST_RATE: f64 = 0.02;

/// Training options.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainOptions {
    /// Channels of the finest level.
    pub width: usize,
    /// Number of levels.
    pub levels: usize,
    /// Maximum number of passes over the samples. With 0, the initial weights are evaluated and given a card.
    pub epochs: usize,
    /// Batch size.
    pub batch: usize,
    /// Adam's initial learning rate; falls to a fiftieth along half a cosine.
    pub learning_rate: f64,
    /// Stop after this many passes without improvement on the held-out frames.
    pub patience: usize,
    /// Share of the shards held out, taken from the end.
    pub held_out: f64,
    /// Seed of the initial weights and of the sample order.
    pub seed: u64,
    /// Class weights in the loss; empty for equal weights.
    pub class_weights: Vec<f32>,
    /// Rotate and mirror samples at random by the eight symmetries of the square. For skins whose outline, electrodes
    /// and protocol have these symmetries, so that the image of a rotated scene is the rotated image.
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

/// Single-precision values kept per image value on its way through a block, including gradients: convolution, norm,
/// Softsign.
const OF_A_BLOCK: f64 = 4.0;
/// Blocks per level: two on the way down and two on the way up.
const BLOCKS: f64 = 4.0;
/// Copies of every weight: value, gradient, Adam's two moments, best value.
const OF_A_WEIGHT: f64 = 5.0;

impl TrainOptions {
    /// Approximate peak memory of a training on images of this size, bytes: a batch on its way through all levels,
    /// plus the weights.
    pub fn bytes(&self, inputs: usize, rows: usize, columns: usize) -> f64 {
        let (width, pixels) = (self.width as f64, rows as f64 * columns as f64);
        let levels = self.levels.min(64) as i32;
        let level = |level: i32| width * 2_f64.powi(level) * pixels / 4_f64.powi(level);
        let images: f64 = (0..levels).map(level).sum::<f64>() * OF_A_BLOCK * BLOCKS + inputs as f64 * pixels;
        // The coarsest level has most of the weights, in four 3x3 convolutions. A third is added for the finer
        // levels.
        let weights = 9.0 * 4.0 * (width * 2_f64.powi(levels - 1)).powi(2) * 4.0 / 3.0;
        4.0 * (self.batch as f64 * images + OF_A_WEIGHT * weights)
    }

    pub(super) fn check(&self) -> Result<(), LearnError> {
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

    /// Weights of `classes` classes.
    pub(super) fn weights_of(&self, classes: usize) -> Result<Vec<f32>, LearnError> {
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

    /// Adam's learning rate in a pass, counted from 0.
    pub(super) fn rate(&self, epoch: usize) -> f64 {
        let along = epoch as f64 / self.epochs as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * along).cos());
        self.learning_rate * (LAST_RATE + (1.0 - LAST_RATE) * cosine)
    }
}
