//! The U-Net on `burn` tensors: the same architecture as [`crate::Network`], differentiable. Tensors are held by their
//! names in [`UNetShape::tensors`], so that weights and the optimiser's moments are saved alike.

use burn::optim::{Adam, AdamConfig, AdamState, AdaptiveMomentumState, Optimizer};
use burn::tensor::activation::log_softmax;
use burn::tensor::module::{batch_norm_train, conv2d, interpolate, max_pool2d};
use burn::tensor::ops::{ConvOptions, InterpolateMode, InterpolateOptions, MaxPoolOptions};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use super::{Batch, Descent, MOMENTUM};
use crate::LearnError;
use crate::network::NORM_EPSILON;
use crate::shape::{TensorSpec, UNetShape};
use crate::weights::Tensors;

/// A U-Net being trained.
pub(super) struct BurnUNet {
    shape: UNetShape,
    blocks: Vec<Block>,
    head: Learned<4>,
    head_bias: Learned<1>,
    optimiser: Adam,
    class_weights: Vec<f32>,
    device: Device,
}

/// Convolution and batch norm.
struct Block {
    kernel: Learned<4>,
    gain: Learned<1>,
    offset: Learned<1>,
    mean: Tensor<1>,
    variance: Tensor<1>,
}

/// A tensor that descent moves, with Adam's moments of it.
struct Learned<const D: usize> {
    value: Tensor<D>,
    state: Option<AdamState<D>>,
}

impl<const D: usize> Learned<D> {
    fn step(&mut self, optimiser: &Adam, rate: f64, gradients: &Gradients) {
        if let Some(gradient) = self.value.grad(gradients) {
            let (value, state) = optimiser.step(rate, self.value.clone().inner(), gradient, self.state.take());
            self.value = Tensor::from_inner(value).require_grad();
            self.state = state;
        }
    }
}

impl BurnUNet {
    /// From weights; `moments`, where given, holds Adam's as written by [`BurnUNet::moments`] after `steps` steps.
    pub(super) fn new(
        shape: UNetShape,
        tensors: &Tensors,
        moments: Option<(&Tensors, usize)>,
        class_weights: &[f32],
        device: &Device,
    ) -> Result<Self, LearnError> {
        let specs = shape.tensors();
        let (blocks, head) = specs.split_at(specs.len() - 2);
        let loader = Loader { tensors, moments, device };
        let block = |five: &[TensorSpec]| {
            Ok(Block {
                kernel: loader.learned(&five[0])?,
                gain: loader.learned(&five[1])?,
                offset: loader.learned(&five[2])?,
                mean: loader.tensor(tensors, &five[3].name, &five[3])?,
                variance: loader.tensor(tensors, &five[4].name, &five[4])?,
            })
        };
        Ok(Self {
            shape,
            blocks: blocks.chunks_exact(5).map(block).collect::<Result<_, LearnError>>()?,
            head: loader.learned(&head[0])?,
            head_bias: loader.learned(&head[1])?,
            optimiser: AdamConfig::new().with_epsilon(1e-8).build(),
            class_weights: class_weights.to_vec(),
            device: device.clone(),
        })
    }

    fn images(&self, batch: &Batch<'_>) -> Tensor<4> {
        let data = TensorData::new(batch.inputs.to_vec(), [batch.count, self.shape.inputs, batch.rows, batch.columns]);
        Tensor::from_data(data, &self.device)
    }

    /// Weighted mean cross-entropy.
    fn loss(&self, logits: Tensor<4>, batch: &Batch<'_>) -> Tensor<1> {
        let pixels = batch.rows * batch.columns;
        let mut one_hot = vec![0.0_f32; batch.count * self.shape.classes * pixels];
        let mut count = 0.0;
        for (place, &label) in batch.labels.iter().enumerate() {
            let (frame, pixel) = (place / pixels, place % pixels);
            one_hot[(frame * self.shape.classes + usize::from(label)) * pixels + pixel] =
                self.class_weights[usize::from(label)];
            count += f64::from(self.class_weights[usize::from(label)]);
        }
        let data = TensorData::new(one_hot, [batch.count, self.shape.classes, batch.rows, batch.columns]);
        let target = Tensor::<4>::from_data(data, &self.device);
        (log_softmax(logits, 1) * target).sum().mul_scalar(-1.0 / count as f32)
    }

    /// Logits; moves the running means and variances.
    fn forward(&mut self, images: Tensor<4>) -> Tensor<4> {
        let levels = self.shape.levels;
        let mut blocks = self.blocks.iter_mut();
        let mut both = |x: Tensor<4>| blocks.by_ref().take(2).fold(x, |x, block| block.forward(x));
        let mut x = images;
        let mut kept = Vec::with_capacity(levels);
        for level in 0..levels {
            if level > 0 {
                x = max_pool2d(x, MaxPoolOptions::new([2, 2]));
            }
            x = both(x);
            kept.push(x.clone());
        }
        kept.pop();
        while let Some(own) = kept.pop() {
            let [_, _, rows, columns] = own.dims();
            let options = InterpolateOptions::new(InterpolateMode::Nearest).with_output_size([rows, columns]);
            x = both(Tensor::cat(vec![interpolate(x, options), own], 1));
        }
        let options = ConvOptions::new([1, 1], [0, 0], [1, 1], 1);
        conv2d(x, self.head.value.clone(), Some(self.head_bias.value.clone()), options)
    }
}

impl Descent for BurnUNet {
    fn step(&mut self, batch: &Batch<'_>, rate: f64) -> f64 {
        let logits = self.forward(self.images(batch));
        let loss = self.loss(logits, batch);
        let value = loss.clone().into_scalar::<f32>();
        let gradients = loss.backward();
        for block in &mut self.blocks {
            block.kernel.step(&self.optimiser, rate, &gradients);
            block.gain.step(&self.optimiser, rate, &gradients);
            block.offset.step(&self.optimiser, rate, &gradients);
        }
        self.head.step(&self.optimiser, rate, &gradients);
        self.head_bias.step(&self.optimiser, rate, &gradients);
        f64::from(value)
    }

    fn tensors(&self) -> Result<Tensors, LearnError> {
        let mut tensors = Tensors::default();
        let specs = self.shape.tensors();
        let (of_blocks, head) = specs.split_at(specs.len() - 2);
        for (five, block) in of_blocks.chunks_exact(5).zip(&self.blocks) {
            store(&mut tensors, &five[0].name, &block.kernel.value)?;
            store(&mut tensors, &five[1].name, &block.gain.value)?;
            store(&mut tensors, &five[2].name, &block.offset.value)?;
            store(&mut tensors, &five[3].name, &block.mean)?;
            store(&mut tensors, &five[4].name, &block.variance)?;
        }
        store(&mut tensors, &head[0].name, &self.head.value)?;
        store(&mut tensors, &head[1].name, &self.head_bias.value)?;
        Ok(tensors)
    }

    fn moments(&self) -> Result<Tensors, LearnError> {
        let mut tensors = Tensors::default();
        let specs = self.shape.tensors();
        let (of_blocks, head) = specs.split_at(specs.len() - 2);
        for (five, block) in of_blocks.chunks_exact(5).zip(&self.blocks) {
            store_moments(&mut tensors, &five[0].name, &block.kernel)?;
            store_moments(&mut tensors, &five[1].name, &block.gain)?;
            store_moments(&mut tensors, &five[2].name, &block.offset)?;
        }
        store_moments(&mut tensors, &head[0].name, &self.head)?;
        store_moments(&mut tensors, &head[1].name, &self.head_bias)?;
        Ok(tensors)
    }
}

impl Block {
    fn forward(&mut self, x: Tensor<4>) -> Tensor<4> {
        let x = conv2d(x, self.kernel.value.clone(), None, ConvOptions::new([1, 1], [1, 1], [1, 1], 1));
        let normed = batch_norm_train(x, self.gain.value.clone(), self.offset.value.clone(), f64::from(NORM_EPSILON));
        let toward = |running: &Tensor<1>, batch: Tensor<1>| {
            running.clone().mul_scalar(1.0 - MOMENTUM).add(batch.inner().mul_scalar(MOMENTUM))
        };
        self.mean = toward(&self.mean, normed.mean);
        self.variance = toward(&self.variance, normed.variance);
        let x = normed.output;
        x.clone() / x.abs().add_scalar(1.0)
    }
}

/// From named values to tensors.
struct Loader<'a> {
    tensors: &'a Tensors,
    moments: Option<(&'a Tensors, usize)>,
    device: &'a Device,
}

impl Loader<'_> {
    fn learned<const D: usize>(&self, spec: &TensorSpec) -> Result<Learned<D>, LearnError> {
        let value = self.tensor::<D>(self.tensors, &spec.name, spec)?;
        let state = match self.moments {
            None => None,
            Some((moments, steps)) => {
                let first = self.tensor(moments, &format!("first.{}", spec.name), spec)?;
                let second = self.tensor(moments, &format!("second.{}", spec.name), spec)?;
                Some(AdamState::new(AdaptiveMomentumState::new(steps, first, second)))
            }
        };
        Ok(Learned { value: Tensor::from_inner(value).require_grad(), state })
    }

    fn tensor<const D: usize>(
        &self,
        tensors: &Tensors,
        name: &str,
        spec: &TensorSpec,
    ) -> Result<Tensor<D>, LearnError> {
        let plain = self.device.clone().inner();
        match tensors.get(name) {
            Some((dims, values)) if dims == spec.dims && dims.len() == D => {
                Ok(Tensor::from_data(TensorData::new(values.to_vec(), dims), &plain))
            }
            found => {
                let got = found.map_or(0, |(_, values)| values.len());
                Err(LearnError::Size { what: "values of a tensor", expected: spec.len(), got })
            }
        }
    }
}

fn store<const D: usize>(tensors: &mut Tensors, name: &str, tensor: &Tensor<D>) -> Result<(), LearnError> {
    let data = tensor.clone().inner().into_data();
    let values = data.try_to_vec::<f32>().map_err(|error| LearnError::Value {
        what: "tensor",
        value: format!("{error:?}"),
        expected: "32-bit floating point numbers".into(),
    })?;
    tensors.insert(name, tensor.dims().to_vec(), values)
}

fn store_moments<const D: usize>(tensors: &mut Tensors, name: &str, learned: &Learned<D>) -> Result<(), LearnError> {
    match &learned.state {
        None => Ok(()),
        Some(state) => {
            store(tensors, &format!("first.{name}"), &state.momentum.moment_1)?;
            store(tensors, &format!("second.{name}"), &state.momentum.moment_2)
        }
    }
}
