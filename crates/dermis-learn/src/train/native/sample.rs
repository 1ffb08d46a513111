//! State of one sample between forward and backward pass: every image of the network and its gradient.

use crate::kernels::Layout;
use crate::shape::UNetShape;
use crate::train::training::Batch;

/// Images per level.
const PLANES: usize = 5;

/// Input of a level on the way down.
pub(super) fn entrance(level: usize) -> usize {
    PLANES * level
}

/// Between a level's two layers on the way down.
pub(super) fn middle_down(level: usize) -> usize {
    PLANES * level + 1
}

/// The upsampled coarser image followed by the level's own; on the coarsest level, its own alone.
pub(super) fn joined(level: usize) -> usize {
    PLANES * level + 2
}

/// Between a level's two layers on the way up.
pub(super) fn middle_up(level: usize) -> usize {
    PLANES * level + 3
}

/// Output of a level on the way up.
pub(super) fn risen(level: usize) -> usize {
    PLANES * level + 4
}

/// Layout of a level's images.
pub(super) fn layout_of(batch: &Batch<'_>, level: usize) -> Layout {
    Layout { rows: batch.rows >> level, columns: batch.columns >> level }
}

/// One sample in training.
pub(super) struct Sample {
    pub(super) size: (usize, usize),
    pub(super) planes: Vec<Vec<f32>>,
    pub(super) slopes: Vec<Vec<f32>>,
    /// Convolution output of each layer before its batch norm.
    pub(super) raw: Vec<Vec<f32>>,
    /// Gradient of the current layer's kernel.
    pub(super) kernel_slope: Vec<f32>,
    /// Two sums per channel for the current layer.
    pub(super) sums: Vec<[f64; 2]>,
    /// Classes x layout.
    pub(super) logits: Vec<f32>,
    pub(super) loss: f64,
}

impl Sample {
    /// Allocates a sample. `layers` gives the output channels and level of each layer.
    pub(super) fn new(shape: &UNetShape, batch: &Batch<'_>, layers: impl Iterator<Item = (usize, usize)>) -> Self {
        let mut planes = Vec::new();
        for level in 0..shape.levels {
            let (own, last) = (shape.channels(level), level + 1 == shape.levels);
            let entering = if level == 0 { shape.inputs } else { shape.channels(level - 1) };
            let above = if last { 0 } else { shape.channels(level + 1) };
            let risen = if last { 0 } else { own };
            let pitch = layout_of(batch, level).pitch();
            for channels in [entering, own, above + own, risen, risen] {
                planes.push(vec![0.0; channels * pitch]);
            }
        }
        let raw = layers.map(|(outputs, level)| vec![0.0; outputs * layout_of(batch, level).pitch()]);
        Self {
            size: (batch.rows, batch.columns),
            slopes: planes.clone(),
            planes,
            raw: raw.collect(),
            kernel_slope: Vec::new(),
            sums: Vec::new(),
            logits: vec![0.0; shape.classes * layout_of(batch, 0).pitch()],
            loss: 0.0,
        }
    }
}

/// Channels of one image of a sample: the image, and its first channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) plane: usize,
    pub(super) channel: usize,
}
