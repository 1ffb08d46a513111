//! How a training goes.

use serde::{Deserialize, Serialize};

use crate::LearnError;

/// Share of the first step that the last one has; between them a half cosine.
const LAST_RATE: f64 = 0.02;

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

/// Single-precision numbers kept for each number of an image on its way through a block, and its gradient: convolution,
/// norm, Softsign. Two blocks on the way down and two on the way up.
const OF_A_BLOCK: f64 = 4.0;
const BLOCKS: f64 = 4.0;
/// Copies of every weight: value, gradient, two moments of Adam, best value so far.
const OF_A_WEIGHT: f64 = 5.0;

impl TrainOptions {
    /// Bytes that a training on images of this size takes at once, about: a batch on its way through all levels, and
    /// the weights.
    pub fn bytes(&self, inputs: usize, rows: usize, columns: usize) -> f64 {
        let (width, pixels) = (self.width as f64, rows as f64 * columns as f64);
        let levels = self.levels.min(64) as i32;
        let level = |level: i32| width * 2_f64.powi(level) * pixels / 4_f64.powi(level);
        let images: f64 = (0..levels).map(level).sum::<f64>() * OF_A_BLOCK * BLOCKS + inputs as f64 * pixels;
        // The coarsest level has most weights: four 3x3 convolutions. A third is added for the finer levels.
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

    /// Weights of so many classes.
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

    /// Adam's step in a pass counted from 0.
    pub(super) fn rate(&self, epoch: usize) -> f64 {
        let along = epoch as f64 / self.epochs as f64;
        let cosine = 0.5 * (1.0 + (std::f64::consts::PI * along).cos());
        self.learning_rate * (LAST_RATE + (1.0 - LAST_RATE) * cosine)
    }
}
