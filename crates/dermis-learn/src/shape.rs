//! The architecture: the tensors of a U-Net with given inputs, classes, width and levels. Names and layouts match a
//! PyTorch `state_dict`, so weights can be exchanged in both directions.
//!
//! Level 0 works on the whole image with `width` channels; every further level has half the rows and columns and
//! twice the channels. On the way down each level has two blocks (3x3 convolution, batch norm, Softsign), with 2x2
//! max-pooling between levels. On the way up the coarser image is upsampled by 2 (nearest neighbour), concatenated in
//! front of the level's own image from the way down, and passed through two blocks. A 1x1 convolution gives the
//! logits (Ronneberger, Fischer & Brox, MICCAI 2015, with Softsign instead of ReLU and without cropping).

use serde::{Deserialize, Serialize};

use crate::LearnError;

/// Size of a U-Net.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UNetShape {
    /// Number of input images per frame.
    pub inputs: usize,
    /// Number of classes.
    pub classes: usize,
    /// Channels of the finest level.
    pub width: usize,
    /// Number of levels, including the finest; each but the last is followed by a halving.
    pub levels: usize,
}

/// One tensor of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorSpec {
    /// Name in a `state_dict`.
    pub name: String,
    /// Dimensions; convolutions are outputs x inputs x rows x columns.
    pub dims: Vec<usize>,
    /// Role of the tensor.
    pub role: TensorRole,
}

/// Role of a tensor: learned by gradient descent, or accumulated during training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorRole {
    /// Kernel of a convolution.
    Kernel,
    /// Gain of a batch norm.
    Gain,
    /// Offset of a batch norm or of the head.
    Offset,
    /// Running mean of a batch norm; not learned by gradient descent.
    RunningMean,
    /// Running variance of a batch norm; not learned by gradient descent.
    RunningVariance,
}

impl TensorSpec {
    /// Number of values.
    pub fn len(&self) -> usize {
        self.dims.iter().product()
    }

    /// True if it has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Two convolutions with their norms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StageSpec {
    /// `down.0`, `up.2`, ...
    pub(crate) name: String,
    pub(crate) level: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
}

impl UNetShape {
    /// Checks that the sizes are valid.
    ///
    /// # Errors
    /// Fails if a size is zero or unreasonably large.
    pub fn check(&self) -> Result<(), LearnError> {
        for (what, value, most) in [
            ("inputs of the network", self.inputs, 64),
            ("classes of the network", self.classes, 64),
            ("width of the network", self.width, 256),
            ("levels of the network", self.levels, 7),
        ] {
            let least = if what.starts_with("classes") { 2 } else { 1 };
            if !(least..=most).contains(&value) {
                let expected = format!("from {least} to {most}");
                return Err(LearnError::Value { what, value: value.to_string(), expected });
            }
        }
        Ok(())
    }

    /// Checks that images of this size can be halved often enough.
    ///
    /// # Errors
    /// Fails if rows or columns are zero or not a multiple of 2^(levels - 1).
    pub fn check_image(&self, rows: usize, columns: usize) -> Result<(), LearnError> {
        let step = 1 << (self.levels - 1);
        for (what, value) in [("rows of the images", rows), ("columns of the images", columns)] {
            if value == 0 || !value.is_multiple_of(step) || value > 4096 {
                let expected = format!("a multiple of {step} up to 4096");
                return Err(LearnError::Value { what, value: value.to_string(), expected });
            }
        }
        Ok(())
    }

    /// Number of channels of a level.
    pub fn channels(&self, level: usize) -> usize {
        self.width << level
    }

    pub(crate) fn down(&self) -> impl Iterator<Item = StageSpec> + '_ {
        (0..self.levels).map(|level| StageSpec {
            name: format!("down.{level}"),
            level,
            inputs: if level == 0 { self.inputs } else { self.channels(level - 1) },
            outputs: self.channels(level),
        })
    }

    /// Stages of the way up, from the coarsest to the finest.
    pub(crate) fn up(&self) -> impl Iterator<Item = StageSpec> + '_ {
        (0..self.levels - 1).rev().map(|level| StageSpec {
            name: format!("up.{level}"),
            level,
            inputs: self.channels(level + 1) + self.channels(level),
            outputs: self.channels(level),
        })
    }

    /// All tensors, in order of use.
    pub fn tensors(&self) -> Vec<TensorSpec> {
        let mut list = Vec::new();
        for stage in self.down().chain(self.up()) {
            for (number, inputs) in [(1, stage.inputs), (2, stage.outputs)] {
                let prefix = &stage.name;
                list.push(TensorSpec {
                    name: format!("{prefix}.conv{number}.weight"),
                    dims: vec![stage.outputs, inputs, 3, 3],
                    role: TensorRole::Kernel,
                });
                for (leaf, role) in [
                    ("weight", TensorRole::Gain),
                    ("bias", TensorRole::Offset),
                    ("running_mean", TensorRole::RunningMean),
                    ("running_var", TensorRole::RunningVariance),
                ] {
                    let name = format!("{prefix}.norm{number}.{leaf}");
                    list.push(TensorSpec { name, dims: vec![stage.outputs], role });
                }
            }
        }
        let head = vec![self.classes, self.width, 1, 1];
        list.push(TensorSpec { name: "head.weight".into(), dims: head, role: TensorRole::Kernel });
        list.push(TensorSpec { name: "head.bias".into(), dims: vec![self.classes], role: TensorRole::Offset });
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tensors_match_the_drawing() {
        let shape = UNetShape { inputs: 1, classes: 3, width: 8, levels: 4 };
        let tensors = shape.tensors();
        // Seven stages of two blocks of five tensors, plus two for the head.
        assert_eq!(tensors.len(), 7 * 2 * 5 + 2);
        let dims = |name: &str| tensors.iter().find(|t| t.name == name).map(|t| t.dims.clone());
        assert_eq!(dims("down.3.conv1.weight"), Some(vec![64, 32, 3, 3]));
        assert_eq!(dims("up.0.conv1.weight"), Some(vec![8, 24, 3, 3]));
        assert_eq!(dims("up.2.norm2.running_var"), Some(vec![32]));
        assert_eq!(dims("head.weight"), Some(vec![3, 8, 1, 1]));
        // Counted by hand: 9 (8 + 64 + 128 + 256 + 512 + 1024 + 2048 + 4096) down, 9 (3072 + 1024 + 768 + 256 + 192 +
        // 64) up, 24 + 3 in the head, and 4 per channel of each norm, with 2 norms in each of the stages of 8 16 32
        // 64 32 16 8 channels.
        let expected = 9 * 8136 + 9 * 5376 + 27 + 8 * 176;
        assert_eq!(tensors.iter().map(TensorSpec::len).sum::<usize>(), expected);
    }

    #[test]
    fn impossible_shapes_are_named() {
        let good = UNetShape { inputs: 1, classes: 3, width: 8, levels: 4 };
        good.check().unwrap();
        good.check_image(64, 64).unwrap();
        let error = good.check_image(60, 64).unwrap_err().to_string();
        assert_eq!(error, "rows of the images = 60: expected a multiple of 8 up to 4096");
        let error = UNetShape { classes: 1, ..good }.check().unwrap_err().to_string();
        assert_eq!(error, "classes of the network = 1: expected from 2 to 64");
    }
}
