//! The forward pass, one frame at a time. Images lie pixel by pixel with their channels together and a border of zeros
//! around, so that a 3x3 convolution reads three contiguous runs for each output pixel and needs no special cases at the
//! rim; batch norms are folded into the convolutions before them. All memory is allocated once.

mod convolution;

use crate::LearnError;
use crate::shape::{StageSpec, UNetShape};
use crate::weights::Tensors;
use convolution::Convolution;

/// PyTorch's default, with which the batch norms were trained.
pub(crate) const NORM_EPSILON: f32 = 1e-5;

/// A U-Net ready to run on images of one size.
#[derive(Clone, Debug)]
pub struct Network {
    shape: UNetShape,
    rows: usize,
    columns: usize,
    down: Vec<Stage>,
    up: Vec<Stage>,
    /// classes x width.
    head: Vec<f32>,
    head_bias: Vec<f32>,
    /// Padded input of each level's first block on the way down.
    entrances: Vec<Plane>,
    /// Between the two blocks of a level.
    middles: Vec<Plane>,
    /// Coarser image repeated, then the level's own: what the way up starts from. The coarsest level's own output alone.
    joined: Vec<Plane>,
    /// What the way up ends in at each level.
    risen: Vec<Plane>,
    features: Vec<f32>,
}

/// Two convolutions.
#[derive(Clone, Debug)]
struct Stage {
    first: Convolution,
    second: Convolution,
}

/// An image of several channels with a border of zeros, pixel by pixel.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    rows: usize,
    columns: usize,
    channels: usize,
    values: Vec<f32>,
}

impl Plane {
    fn new(rows: usize, columns: usize, channels: usize) -> Self {
        Self { rows, columns, channels, values: vec![0.0; (rows + 2) * (columns + 2) * channels] }
    }

    /// Where the channels of a pixel begin.
    fn at(&self, row: usize, column: usize) -> usize {
        ((row + 1) * (self.columns + 2) + column + 1) * self.channels
    }
}

impl Stage {
    fn new(spec: &StageSpec, tensors: &Tensors) -> Result<Self, LearnError> {
        Ok(Self {
            first: Convolution::folded(tensors, &spec.name, 1, spec.inputs, spec.outputs)?,
            second: Convolution::folded(tensors, &spec.name, 2, spec.outputs, spec.outputs)?,
        })
    }
}

impl Network {
    /// Lays out the weights and the memory for images of `rows` x `columns`.
    ///
    /// # Errors
    /// Weights of another architecture, or an image that cannot be halved often enough.
    pub fn new(shape: UNetShape, tensors: &Tensors, rows: usize, columns: usize) -> Result<Self, LearnError> {
        shape.check()?;
        shape.check_image(rows, columns)?;
        tensors.check(&shape, std::path::Path::new("weights"))?;
        let stage = |spec: StageSpec| Stage::new(&spec, tensors);
        let size = |level: usize| (rows >> level, columns >> level);
        let plane = |level: usize, channels: usize| Plane::new(size(level).0, size(level).1, channels);
        let coarsest = shape.levels - 1;
        let joined = |level: usize| {
            let above = if level < coarsest { shape.channels(level + 1) } else { 0 };
            plane(level, above + shape.channels(level))
        };
        let values = |name: &str| tensors.get(name).map(|(_, values)| values.to_vec()).unwrap_or_default();
        Ok(Self {
            shape,
            rows,
            columns,
            down: shape.down().map(stage).collect::<Result<_, _>>()?,
            up: shape.up().map(stage).collect::<Result<_, _>>()?,
            head: values("head.weight"),
            head_bias: values("head.bias"),
            entrances: shape.down().map(|spec| plane(spec.level, spec.inputs)).collect(),
            middles: (0..shape.levels).map(|level| plane(level, shape.channels(level))).collect(),
            joined: (0..shape.levels).map(joined).collect(),
            risen: (0..shape.levels).map(|level| plane(level, shape.channels(level))).collect(),
            features: vec![0.0; shape.channels(coarsest)],
        })
    }

    /// Architecture.
    pub fn shape(&self) -> &UNetShape {
        &self.shape
    }

    /// Rows and columns of the images.
    pub fn image_size(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// Logits of one frame. `input` is inputs x rows x columns, values that are not finite (outside the skin) count as 0;
    /// `logits` is classes x rows x columns.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn logits(&mut self, input: &[f32], logits: &mut [f32]) -> Result<(), LearnError> {
        let pixels = self.rows * self.columns;
        for (what, expected, got) in [
            ("input of the network", self.shape.inputs * pixels, input.len()),
            ("output of the network", self.shape.classes * pixels, logits.len()),
        ] {
            if expected != got {
                return Err(LearnError::Size { what, expected, got });
            }
        }
        self.enter(input);
        self.descend();
        self.gather_features();
        self.rise();
        self.leave(logits);
        Ok(())
    }

    /// Probabilities of one frame: the softmax of the logits over `temperature`; sizes as in [`Network::logits`].
    ///
    /// # Errors
    /// As [`Network::logits`].
    pub fn probabilities(
        &mut self,
        input: &[f32],
        temperature: f32,
        probabilities: &mut [f32],
    ) -> Result<(), LearnError> {
        self.logits(input, probabilities)?;
        softmax(probabilities, self.shape.classes, temperature);
        Ok(())
    }

    /// Means over the image of the coarsest level's channels for the last frame: what the novelty score looks at.
    pub fn features(&self) -> &[f32] {
        &self.features
    }

    fn enter(&mut self, input: &[f32]) {
        let plane = &mut self.entrances[0];
        let pixels = self.rows * self.columns;
        for row in 0..self.rows {
            for column in 0..self.columns {
                let place = plane.at(row, column);
                for (channel, value) in plane.values[place..place + plane.channels].iter_mut().enumerate() {
                    let given = input[channel * pixels + row * self.columns + column];
                    *value = if given.is_finite() { given } else { 0.0 };
                }
            }
        }
    }

    fn descend(&mut self) {
        for level in 0..self.shape.levels {
            let stage = &self.down[level];
            stage.first.apply(&self.entrances[level], &mut self.middles[level], 0);
            let offset = self.joined[level].channels - self.shape.channels(level);
            stage.second.apply(&self.middles[level], &mut self.joined[level], offset);
            if level + 1 < self.shape.levels {
                pool(&self.joined[level], offset, &mut self.entrances[level + 1]);
            }
        }
    }

    fn gather_features(&mut self) {
        let plane = &self.joined[self.shape.levels - 1];
        self.features.fill(0.0);
        for row in 0..plane.rows {
            let run = &plane.values[plane.at(row, 0)..plane.at(row, plane.columns)];
            for pixel in run.chunks_exact(plane.channels) {
                self.features.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value);
            }
        }
        let share = 1.0 / (plane.rows * plane.columns) as f32;
        self.features.iter_mut().for_each(|sum| *sum *= share);
    }

    fn rise(&mut self) {
        for (stage, level) in self.up.iter().zip((0..self.shape.levels - 1).rev()) {
            if level + 2 == self.shape.levels {
                let (finer, coarser) = self.joined.split_at_mut(level + 1);
                repeat(&coarser[0], &mut finer[level]);
            } else {
                repeat(&self.risen[level + 1], &mut self.joined[level]);
            }
            stage.first.apply(&self.joined[level], &mut self.middles[level], 0);
            stage.second.apply(&self.middles[level], &mut self.risen[level], 0);
        }
    }

    fn leave(&mut self, logits: &mut [f32]) {
        let plane = if self.shape.levels == 1 { &self.joined[0] } else { &self.risen[0] };
        let (width, pixels) = (self.shape.width, self.rows * self.columns);
        for (class, target) in logits.chunks_exact_mut(pixels).enumerate() {
            let weights = &self.head[class * width..(class + 1) * width];
            for (row, target) in target.chunks_exact_mut(self.columns).enumerate() {
                let run = &plane.values[plane.at(row, 0)..];
                for (logit, pixel) in target.iter_mut().zip(run.chunks_exact(plane.channels)) {
                    let sum: f32 = weights.iter().zip(pixel).map(|(w, v)| w * v).sum();
                    *logit = self.head_bias[class] + sum;
                }
            }
        }
    }
}

/// Largest of every four pixels, of the channels from `offset` on.
fn pool(from: &Plane, offset: usize, to: &mut Plane) {
    let step = (from.columns + 2) * from.channels;
    for row in 0..to.rows {
        for column in 0..to.columns {
            let source = from.at(2 * row, 2 * column) + offset;
            let [a, b, c, d] = [source, source + from.channels, source + step, source + step + from.channels]
                .map(|place| &from.values[place..place + to.channels]);
            let place = to.at(row, column);
            for (k, value) in to.values[place..place + to.channels].iter_mut().enumerate() {
                *value = a[k].max(b[k]).max(c[k]).max(d[k]);
            }
        }
    }
}

/// Every pixel four times, into the first channels of an image of twice the size.
fn repeat(from: &Plane, to: &mut Plane) {
    for row in 0..to.rows {
        for column in 0..to.columns {
            let (source, place) = (from.at(row / 2, column / 2), to.at(row, column));
            to.values[place..place + from.channels].copy_from_slice(&from.values[source..source + from.channels]);
        }
    }
}

/// Softmax over classes of logits / temperature, in place; `values` is classes x pixels.
pub(crate) fn softmax(values: &mut [f32], classes: usize, temperature: f32) {
    let pixels = values.len() / classes;
    for pixel in 0..pixels {
        let largest = (0..classes).map(|c| values[c * pixels + pixel]).fold(f32::NEG_INFINITY, f32::max);
        let mut sum = 0.0;
        for class in 0..classes {
            let value = &mut values[class * pixels + pixel];
            *value = ((*value - largest) / temperature).exp();
            sum += *value;
        }
        (0..classes).for_each(|class| values[class * pixels + pixel] /= sum);
    }
}

#[cfg(test)]
pub(crate) mod tests;
