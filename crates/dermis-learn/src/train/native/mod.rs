//! Training on the CPU without a framework: forward and backward pass of exactly this U-Net on the kernels used live,
//! and Adam (Kingma & Ba, ICLR 2015, algorithm 1). The samples of a batch run in parallel on all threads. Sums over
//! samples keep their order, so training gives the same weights for any number of threads.

mod layer;
mod learned;
mod loss;
mod sample;

use pulp::Arch;
use rayon::prelude::*;

use super::training::Batch;
use crate::LearnError;
use crate::kernels::{pool, pool_back, repeat, repeat_back};
use crate::shape::{TensorSpec, UNetShape};
use crate::weights::Tensors;
use layer::Layer;
use learned::{Learned, Loader};
use loss::Head;
use sample::{Place, Sample, layout_of};

/// A U-Net in training.
pub(super) struct NativeUNet {
    shape: UNetShape,
    layers: Vec<Layer>,
    head: Head,
    program: Vec<Step>,
    samples: Vec<Sample>,
    /// Number of Adam steps made.
    steps: usize,
    arch: Arch,
}

/// An operation on every sample. The backward pass runs them in reverse order.
#[derive(Clone, Copy, Debug)]
enum Step {
    Layer(usize),
    /// Max-pooling into the coarser `level`.
    Pool {
        level: usize,
        from: Place,
        to: usize,
    },
    /// Upsampling from the coarser `level`.
    Repeat {
        level: usize,
        from: usize,
        to: usize,
    },
}

impl NativeUNet {
    /// Builds the network from weights. `moments`, if given, holds Adam's moments as written by
    /// [`NativeUNet::moments`] and the number of steps made.
    pub(super) fn new(
        shape: UNetShape,
        tensors: &Tensors,
        moments: Option<(&Tensors, usize)>,
        class_weights: &[f32],
    ) -> Result<Self, LearnError> {
        let loader = Loader { tensors, moments: moments.map(|(moments, _)| moments) };
        let specs = shape.tensors();
        let (of_layers, of_head) = specs.split_at(specs.len() - 2);
        let mut five = of_layers.chunks_exact(5);
        let (mut layers, mut program) = (Vec::new(), Vec::new());
        let mut layer = |level: usize, from: usize, to: Place, program: &mut Vec<Step>| {
            let Some(specs) = five.next() else { return Ok(()) };
            program.push(Step::Layer(layers.len()));
            layers.push(Layer::new(&loader, specs, layers.len(), level, from, to)?);
            Ok::<(), LearnError>(())
        };
        let whole = |plane: usize| Place { plane, channel: 0 };
        let coarsest = shape.levels - 1;
        for level in 0..shape.levels {
            let own = if level < coarsest { shape.channels(level + 1) } else { 0 };
            let joined = Place { plane: sample::joined(level), channel: own };
            layer(level, sample::entrance(level), whole(sample::middle_down(level)), &mut program)?;
            layer(level, sample::middle_down(level), joined, &mut program)?;
            if level < coarsest {
                program.push(Step::Pool { level: level + 1, from: joined, to: sample::entrance(level + 1) });
            }
        }
        for level in (0..coarsest).rev() {
            let below = if level + 1 == coarsest { sample::joined(level + 1) } else { sample::risen(level + 1) };
            program.push(Step::Repeat { level: level + 1, from: below, to: sample::joined(level) });
            layer(level, sample::joined(level), whole(sample::middle_up(level)), &mut program)?;
            layer(level, sample::middle_up(level), whole(sample::risen(level)), &mut program)?;
        }
        let last = if coarsest == 0 { sample::joined(0) } else { sample::risen(0) };
        let head = Head::new(&loader, of_head, shape.classes, last, class_weights)?;
        let (samples, steps) = (Vec::new(), moments.map_or(0, |(_, steps)| steps));
        Ok(Self { shape, layers, head, program, samples, steps, arch: Arch::new() })
    }

    /// Loss of a batch. Leaves the gradients next to the learned values and updates the running means and variances.
    fn slopes(&mut self, batch: &Batch<'_>) -> f64 {
        self.take_in(batch);
        let samples = &mut self.samples[..batch.count];
        for layer in &mut self.layers {
            layer.refresh();
        }
        for step in &self.program {
            match *step {
                Step::Layer(number) => self.layers[number].forward(self.arch, batch, samples),
                Step::Pool { level, from, to } => {
                    let (finer, layout) = (layout_of(batch, level - 1), layout_of(batch, level));
                    samples.par_iter_mut().for_each(|sample| {
                        let mut target = std::mem::take(&mut sample.planes[to]);
                        pool(layout, &sample.planes[from.plane][from.channel * finer.pitch()..], &mut target);
                        sample.planes[to] = target;
                    });
                }
                Step::Repeat { level, from, to } => samples.par_iter_mut().for_each(|sample| {
                    let mut target = std::mem::take(&mut sample.planes[to]);
                    repeat(layout_of(batch, level), &sample.planes[from], &mut target);
                    sample.planes[to] = target;
                }),
            }
        }
        let loss = self.head.run(self.arch, batch, samples);
        for step in self.program.iter().rev() {
            match *step {
                Step::Layer(number) => self.layers[number].backward(self.arch, batch, samples),
                Step::Pool { level, from, to } => samples.par_iter_mut().for_each(|sample| {
                    let start = from.channel * layout_of(batch, level - 1).pitch();
                    let mut target = std::mem::take(&mut sample.slopes[from.plane]);
                    let (values, coarse) = (&sample.planes[from.plane][start..], &sample.planes[to]);
                    pool_back(layout_of(batch, level), values, coarse, &sample.slopes[to], &mut target[start..]);
                    sample.slopes[from.plane] = target;
                }),
                Step::Repeat { level, from, to } => samples.par_iter_mut().for_each(|sample| {
                    let mut target = std::mem::take(&mut sample.slopes[from]);
                    repeat_back(layout_of(batch, level), &sample.slopes[to], &mut target);
                    sample.slopes[from] = target;
                }),
            }
        }
        loss
    }

    /// Allocates the samples and copies the images into them.
    fn take_in(&mut self, batch: &Batch<'_>) {
        let fits = self.samples.first().is_none_or(|sample| sample.size == (batch.rows, batch.columns));
        if !fits {
            self.samples.clear();
        }
        while self.samples.len() < batch.count {
            let layers = self.layers.iter().map(|layer| (layer.outputs, layer.level));
            self.samples.push(Sample::new(&self.shape, batch, layers));
        }
        let layout = layout_of(batch, 0);
        let given = batch.inputs.chunks_exact(self.shape.inputs * layout.pixels());
        for (sample, images) in self.samples.iter_mut().zip(given) {
            let channels = sample.planes[sample::entrance(0)].chunks_exact_mut(layout.pitch());
            for (channel, image) in channels.zip(images.chunks_exact(layout.pixels())) {
                for (row, values) in image.chunks_exact(layout.columns).enumerate() {
                    channel[layout.row(row)].copy_from_slice(values);
                }
            }
        }
    }

    fn learned(&mut self) -> impl Iterator<Item = &mut Learned> {
        let of_layers =
            self.layers.iter_mut().flat_map(|layer| [&mut layer.kernel, &mut layer.gain, &mut layer.offset]);
        of_layers.chain([&mut self.head.weight, &mut self.head.bias])
    }
}

impl NativeUNet {
    /// One Adam step on a batch; returns the loss before the step.
    pub(super) fn step(&mut self, batch: &Batch<'_>, rate: f64) -> f64 {
        let loss = self.slopes(batch);
        self.steps += 1;
        let steps = self.steps;
        self.learned().for_each(|learned| learned.step(rate, steps));
        loss
    }

    /// The current weights.
    pub(super) fn tensors(&self) -> Result<Tensors, LearnError> {
        let mut tensors = Tensors::default();
        let specs = self.shape.tensors();
        let (of_layers, of_head) = specs.split_at(specs.len() - 2);
        let mut put =
            |spec: &TensorSpec, values: &[f32]| tensors.insert(spec.name.clone(), spec.dims.clone(), values.to_vec());
        for (specs, layer) in of_layers.chunks_exact(5).zip(&self.layers) {
            put(&specs[0], &layer.kernel.value)?;
            put(&specs[1], &layer.gain.value)?;
            put(&specs[2], &layer.offset.value)?;
            put(&specs[3], &layer.mean)?;
            put(&specs[4], &layer.variance)?;
        }
        put(&of_head[0], &self.head.weight.value)?;
        put(&of_head[1], &self.head.bias.value)?;
        Ok(tensors)
    }

    /// Adam's moments, as `first.NAME` and `second.NAME`.
    pub(super) fn moments(&self) -> Result<Tensors, LearnError> {
        let mut tensors = Tensors::default();
        let specs = self.shape.tensors();
        let (of_layers, of_head) = specs.split_at(specs.len() - 2);
        let mut put = |spec: &TensorSpec, learned: &Learned| {
            for (prefix, values) in [("first", &learned.first), ("second", &learned.second)] {
                tensors.insert(format!("{prefix}.{}", spec.name), spec.dims.clone(), values.clone())?;
            }
            Ok::<(), LearnError>(())
        };
        for (specs, layer) in of_layers.chunks_exact(5).zip(&self.layers) {
            put(&specs[0], &layer.kernel)?;
            put(&specs[1], &layer.gain)?;
            put(&specs[2], &layer.offset)?;
        }
        put(&of_head[0], &self.head.weight)?;
        put(&of_head[1], &self.head.bias)?;
        Ok(tensors)
    }
}

#[cfg(test)]
mod tests;
