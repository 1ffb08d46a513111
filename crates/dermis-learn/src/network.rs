//! The forward pass, one frame at a time. Images are stored channel by channel with a border of zeros (see
//! [`crate::kernels`]); batch norms are folded into the convolutions before them. All memory is allocated once.

use pulp::Arch;

use crate::LearnError;
use crate::kernels::{Finish, Layout, Taps, convolve, pool, repeat};
use crate::shape::{StageSpec, UNetShape};
use crate::weights::Tensors;

/// PyTorch's default, used when the batch norms were trained.
pub(crate) const NORM_EPSILON: f32 = 1e-5;

/// A U-Net ready to run on images of one size.
#[derive(Clone, Debug)]
pub struct Network {
    shape: UNetShape,
    rows: usize,
    columns: usize,
    down: Vec<Stage>,
    up: Vec<Stage>,
    /// Classes x width.
    head: Vec<f32>,
    head_bias: Vec<f32>,
    /// Input of each level's first block on the way down.
    entrances: Vec<Plane>,
    /// Image between the two blocks of a level.
    middles: Vec<Plane>,
    /// Input of the way up: the upsampled coarser image followed by the level's own output. On the coarsest level,
    /// its own output alone.
    joined: Vec<Plane>,
    /// Output of the way up at each level.
    risen: Vec<Plane>,
    features: Vec<f32>,
    arch: Arch,
}

/// Two consecutive convolutions.
#[derive(Clone, Debug)]
struct Stage {
    first: Convolution,
    second: Convolution,
}

/// `softsign(gain (w * x) + offset)`.
#[derive(Clone, Debug)]
struct Convolution {
    taps: Taps,
    offsets: Vec<f32>,
}

/// A multi-channel image.
#[derive(Clone, Debug)]
struct Plane {
    layout: Layout,
    values: Vec<f32>,
}

impl Plane {
    fn new(layout: Layout, channels: usize) -> Self {
        Self { layout, values: vec![0.0; layout.pitch() * channels] }
    }

    /// The channels from `channel` on.
    fn channels_from(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.layout.pitch()..]
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

impl Convolution {
    /// Loads `PREFIX.convN` and folds in `PREFIX.normN`: `gain = weight / sqrt(var + eps)` and
    /// `offset = bias - gain mean`.
    fn folded(
        tensors: &Tensors,
        prefix: &str,
        number: usize,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self, LearnError> {
        let values = |part: &str, leaf: &str, expected: usize| {
            let name = format!("{prefix}.{part}{number}.{leaf}");
            match tensors.get(&name) {
                Some((_, values)) if values.len() == expected => Ok(values),
                found => {
                    let got = found.map_or(0, |(_, values)| values.len());
                    Err(LearnError::Size { what: "values of a tensor", expected, got })
                }
            }
        };
        let kernel = values("conv", "weight", outputs * inputs * 9)?;
        let (weight, bias) = (values("norm", "weight", outputs)?, values("norm", "bias", outputs)?);
        let (mean, variance) = (values("norm", "running_mean", outputs)?, values("norm", "running_var", outputs)?);
        let gain = |output: usize| weight[output] / (variance[output] + NORM_EPSILON).sqrt();
        let mut taps = Taps::new(inputs, outputs);
        taps.set(kernel, gain);
        Ok(Self { taps, offsets: (0..outputs).map(|output| bias[output] - gain(output) * mean[output]).collect() })
    }

    /// Writes to the first channels of `to`, one per output.
    fn apply(&self, arch: Arch, layout: Layout, from: &[f32], to: &mut [f32]) {
        let to = &mut to[..self.taps.outputs() * layout.pitch()];
        convolve(arch, layout, &self.taps, Finish::Softsign(&self.offsets), from, to);
    }
}

impl Network {
    /// Prepares the weights and the memory for images of `rows` x `columns`.
    ///
    /// # Errors
    /// Fails if the weights have another architecture or the image cannot be halved often enough.
    pub fn new(shape: UNetShape, tensors: &Tensors, rows: usize, columns: usize) -> Result<Self, LearnError> {
        shape.check()?;
        shape.check_image(rows, columns)?;
        tensors.check(&shape, std::path::Path::new("weights"))?;
        let stage = |spec: StageSpec| Stage::new(&spec, tensors);
        let layout = |level: usize| Layout { rows: rows >> level, columns: columns >> level };
        let plane = |level: usize, channels: usize| Plane::new(layout(level), channels);
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
            arch: Arch::new(),
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

    /// Logits of one frame. `input` is inputs x rows x columns; non-finite values (outside the skin) count as 0.
    /// `logits` is classes x rows x columns.
    ///
    /// # Errors
    /// Fails if the lengths do not match.
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

    /// Probabilities of one frame: the softmax of the logits divided by `temperature`. Sizes as in
    /// [`Network::logits`].
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

    /// Image means of the coarsest level's channels for the last frame; the input of the novelty score.
    pub fn features(&self) -> &[f32] {
        &self.features
    }

    fn enter(&mut self, input: &[f32]) {
        let Plane { layout, values } = &mut self.entrances[0];
        for (channel, image) in values.chunks_exact_mut(layout.pitch()).zip(input.chunks_exact(layout.pixels())) {
            for (row, given) in image.chunks_exact(layout.columns).enumerate() {
                for (value, given) in channel[layout.row(row)].iter_mut().zip(given) {
                    *value = if given.is_finite() { *given } else { 0.0 };
                }
            }
        }
    }

    fn descend(&mut self) {
        let coarsest = self.shape.levels - 1;
        for level in 0..=coarsest {
            let (stage, layout) = (&self.down[level], self.entrances[level].layout);
            stage.first.apply(self.arch, layout, &self.entrances[level].values, &mut self.middles[level].values);
            let above = if level < coarsest { self.shape.channels(level + 1) } else { 0 };
            let own = &mut self.joined[level].values[above * layout.pitch()..];
            stage.second.apply(self.arch, layout, &self.middles[level].values, own);
            if level < coarsest {
                let next = &mut self.entrances[level + 1];
                pool(next.layout, self.joined[level].channels_from(above), &mut next.values);
            }
        }
    }

    fn gather_features(&mut self) {
        let Plane { layout, values } = &self.joined[self.shape.levels - 1];
        let share = 1.0 / layout.pixels() as f32;
        for (feature, channel) in self.features.iter_mut().zip(values.chunks_exact(layout.pitch())) {
            // Only pixels contribute: the border is zero.
            *feature = channel.iter().sum::<f32>() * share;
        }
    }

    fn rise(&mut self) {
        for (stage, level) in self.up.iter().zip((0..self.shape.levels - 1).rev()) {
            let (finer, coarser) = self.joined.split_at_mut(level + 1);
            let (joined, coarser) = (&mut finer[level], &coarser[0]);
            let below = if level + 2 == self.shape.levels { coarser } else { &self.risen[level + 1] };
            repeat(below.layout, &below.values, &mut joined.values);
            stage.first.apply(self.arch, joined.layout, &joined.values, &mut self.middles[level].values);
            stage.second.apply(self.arch, joined.layout, &self.middles[level].values, &mut self.risen[level].values);
        }
    }

    fn leave(&self, logits: &mut [f32]) {
        let Plane { layout, values } = if self.shape.levels == 1 { &self.joined[0] } else { &self.risen[0] };
        for (class, target) in logits.chunks_exact_mut(layout.pixels()).enumerate() {
            target.fill(self.head_bias[class]);
            let weights = &self.head[class * self.shape.width..];
            for (weight, channel) in weights.iter().zip(values.chunks_exact(layout.pitch())) {
                for (row, target) in target.chunks_exact_mut(layout.columns).enumerate() {
                    target.iter_mut().zip(&channel[layout.row(row)]).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    }
}

/// Softmax over classes of logits / temperature, in place. `values` is classes x pixels.
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
