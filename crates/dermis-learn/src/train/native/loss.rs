//! The 1x1 convolution that gives the logits, softmax and cross-entropy, with their gradients. With class weights,
//! the loss is the weighted mean, as in PyTorch's `cross_entropy`.

use pulp::Arch;
use rayon::prelude::*;

use super::learned::{Learned, Loader};
use super::sample::{Sample, layout_of};
use crate::LearnError;
use crate::kernels::Layout;
use crate::shape::TensorSpec;
use crate::train::training::Batch;

/// Computes the loss from the last image.
pub(super) struct Head {
    pub(super) weight: Learned,
    pub(super) bias: Learned,
    classes: usize,
    /// Index of the input image.
    from: usize,
    class_weights: Vec<f32>,
}

impl Head {
    pub(super) fn new(
        loader: &Loader<'_>,
        specs: &[TensorSpec],
        classes: usize,
        from: usize,
        class_weights: &[f32],
    ) -> Result<Self, LearnError> {
        if class_weights.len() != classes {
            let (what, got) = ("weights of the classes", class_weights.len());
            return Err(LearnError::Size { what, expected: classes, got });
        }
        let (weight, bias) = (loader.learned(&specs[0])?, loader.learned(&specs[1])?);
        Ok(Self { weight, bias, classes, from, class_weights: class_weights.to_vec() })
    }

    /// The mean loss; leaves the gradients of the weights, the biases and the last image.
    pub(super) fn run(&mut self, arch: Arch, batch: &Batch<'_>, samples: &mut [Sample]) -> f64 {
        let layout = layout_of(batch, 0);
        let all: f64 = batch.labels.iter().map(|label| f64::from(self.class_weights[usize::from(*label)])).sum();
        let share = (1.0 / all.max(f64::MIN_POSITIVE)) as f32;
        let head = &*self;
        samples.par_iter_mut().zip(batch.labels.par_chunks_exact(layout.pixels())).for_each(|(sample, labels)| {
            arch.dispatch(|| head.logits(layout, sample));
            sample.loss = head.entropy(layout, share, sample, labels);
            arch.dispatch(|| head.backward(layout, sample));
        });
        self.weight.slope.fill(0.0);
        self.bias.slope.fill(0.0);
        for sample in &*samples {
            let (weight, bias) = sample.kernel_slope.split_at(self.weight.slope.len());
            self.weight.slope.iter_mut().zip(weight).for_each(|(sum, value)| *sum += value);
            self.bias.slope.iter_mut().zip(bias).for_each(|(sum, value)| *sum += value);
        }
        samples.iter().map(|sample| sample.loss).sum::<f64>() / all.max(f64::MIN_POSITIVE)
    }

    #[inline(always)]
    fn logits(&self, layout: Layout, sample: &mut Sample) {
        let (pitch, image) = (layout.pitch(), &sample.planes[self.from]);
        let width = self.weight.value.len() / self.classes;
        for (class, logits) in sample.logits.chunks_exact_mut(pitch).enumerate() {
            logits.fill(self.bias.value[class]);
            for (weight, channel) in self.weight.value[class * width..].iter().zip(image.chunks_exact(pitch)) {
                logits.iter_mut().zip(channel).for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }

    /// The weighted sum of `-ln p`; replaces the logits with their gradients, times `share`.
    fn entropy(&self, layout: Layout, share: f32, sample: &mut Sample, labels: &[u8]) -> f64 {
        let (pitch, mut loss) = (layout.pitch(), 0.0);
        let mut shares = [0.0_f32; 64];
        for (row, labels) in labels.chunks_exact(layout.columns).enumerate() {
            for (place, label) in layout.row(row).zip(labels) {
                let label = usize::from(*label);
                let logit = |class: usize| sample.logits[class * pitch + place];
                let largest = (0..self.classes).map(logit).fold(f32::NEG_INFINITY, f32::max);
                let mut sum = 0.0;
                for class in 0..self.classes {
                    shares[class] = (logit(class) - largest).exp();
                    sum += shares[class];
                }
                let weight = self.class_weights[label];
                loss += f64::from(weight * (sum.ln() + largest - logit(label)));
                for (class, value) in shares.iter().enumerate().take(self.classes) {
                    let truth = if class == label { 1.0 } else { 0.0 };
                    sample.logits[class * pitch + place] = share * weight * (value / sum - truth);
                }
            }
        }
        for channel in sample.logits.chunks_exact_mut(pitch) {
            layout.clear_border(channel);
        }
        loss
    }

    #[inline(always)]
    fn backward(&self, layout: Layout, sample: &mut Sample) {
        let pitch = layout.pitch();
        let width = self.weight.value.len() / self.classes;
        let (image, slope) = (&sample.planes[self.from], &mut sample.slopes[self.from]);
        sample.kernel_slope.clear();
        for logits in sample.logits.chunks_exact(pitch) {
            for channel in image.chunks_exact(pitch) {
                sample.kernel_slope.push(super::layer::sums(layout, logits, channel)[1] as f32);
            }
        }
        for logits in sample.logits.chunks_exact(pitch) {
            sample.kernel_slope.push(super::layer::sums(layout, logits, logits)[0] as f32);
        }
        for (k, slope) in slope.chunks_exact_mut(pitch).enumerate() {
            slope.fill(0.0);
            for (class, logits) in sample.logits.chunks_exact(pitch).enumerate() {
                let weight = self.weight.value[class * width + k];
                slope.iter_mut().zip(logits).for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }
}
