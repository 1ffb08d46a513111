//! Split into training and held-out shards, and scaling of the inputs.

use crate::LearnError;
use crate::shards::{Shard, TrainingSet};

/// Number of shards whose samples are shuffled together; bounds the memory.
pub(super) const SHARDS_AT_ONCE: usize = 8;

/// Shards for training and held-out shards.
pub(super) struct Split {
    pub(super) training: Vec<usize>,
    pub(super) held_out: Vec<usize>,
}

impl Split {
    pub(super) fn of(set: &TrainingSet, share: f64) -> Result<Self, LearnError> {
        let shards = set.manifest().shards();
        if shards < 2 {
            let (what, expected) = ("shards of the training set", "at least 2, one of which is held out".into());
            return Err(LearnError::Value { what, value: shards.to_string(), expected });
        }
        let held_out = ((shards as f64 * share).round() as usize).clamp(1, shards - 1);
        Ok(Self { training: (0..shards - held_out).collect(), held_out: (shards - held_out..shards).collect() })
    }

    pub(super) fn samples(set: &TrainingSet, shards: &[usize]) -> usize {
        shards.iter().map(|&shard| set.manifest().samples_of(shard)).sum()
    }
}

/// Factors that scale each input image to a root mean square of 1 over a few shards.
pub(super) fn input_scale(set: &TrainingSet, split: &Split) -> Result<Vec<f32>, LearnError> {
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
pub(super) fn scaled(mut shard: Shard, scale: &[f32], pixels: usize) -> Shard {
    for (place, image) in shard.inputs.chunks_exact_mut(pixels).enumerate() {
        let factor = scale[place % scale.len()];
        image.iter_mut().for_each(|value| *value *= factor);
    }
    shard
}
