//! Inputs and starting point of a training.

use rand::Rng;
use std::path::Path;

use rand::SeedableRng;
use rand::rngs::StdRng;

use super::TrainOptions;
use super::split::{Split, input_scale};
use crate::LearnError;
use crate::shape::{TensorRole, UNetShape};
use crate::shards::TrainingSet;
use crate::weights::Tensors;

/// Inputs of a training, and where its checkpoints go.
pub struct Training<'a> {
    /// The training set.
    pub set: &'a TrainingSet,
    /// Training options.
    pub options: &'a TrainOptions,
    /// Folder of the checkpoint; training resumes from an existing one.
    pub checkpoint: &'a Path,
    /// The command line, for the card.
    pub command: &'a str,
    /// Initial weights; random if `None`.
    pub start: Option<&'a Tensors>,
    /// Factors applied to the input images; if `None`, each is scaled to a root mean square of 1.
    pub input_scale: Option<&'a [f32]>,
}

impl Training<'_> {
    pub(super) fn input_scale(&self, split: &Split) -> Result<Vec<f32>, LearnError> {
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

    pub(super) fn first_weights(&self, shape: &UNetShape) -> Result<Tensors, LearnError> {
        let Some(start) = self.start else {
            return initial(shape, &mut StdRng::seed_from_u64(self.options.seed));
        };
        start.check(shape, Path::new("weights to begin with"))?;
        // Leave out other tensors such as a novelty score, which belongs to another training.
        let mut tensors = Tensors::default();
        for spec in shape.tensors() {
            let values = start.get(&spec.name).map(|(_, values)| values.to_vec()).unwrap_or_default();
            tensors.insert(spec.name, spec.dims, values)?;
        }
        Ok(tensors)
    }
}

/// Samples of one step: images are batch x inputs x rows x columns, labels batch x rows x columns.
pub(super) struct Batch<'a> {
    pub(super) count: usize,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) inputs: &'a [f32],
    pub(super) labels: &'a [u8],
}

/// Initial weights: kernels uniform within `sqrt(3 / fan-in)` (unit gain), gains 1, offsets 0.
pub(super) fn initial(shape: &UNetShape, random: &mut impl Rng) -> Result<Tensors, LearnError> {
    let mut tensors = Tensors::default();
    for spec in shape.tensors() {
        let count = spec.len();
        let values = match spec.role {
            TensorRole::Kernel => {
                let bound = (3.0 / spec.dims[1..].iter().product::<usize>() as f32).sqrt();
                (0..count).map(|_| random.random_range(-bound..bound)).collect()
            }
            TensorRole::Gain | TensorRole::RunningVariance => vec![1.0; count],
            TensorRole::Offset | TensorRole::RunningMean => vec![0.0; count],
        };
        tensors.insert(spec.name, spec.dims, values)?;
    }
    Ok(tensors)
}
