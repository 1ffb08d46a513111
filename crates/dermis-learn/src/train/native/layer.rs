//! A convolution with batch norm (Ioffe & Szegedy, ICML 2015, algorithm 1 and its gradients) and Softsign.

use pulp::Arch;
use rayon::prelude::*;

use super::learned::{Learned, Loader};
use super::sample::{Place, Sample, layout_of};
use crate::LearnError;
use crate::kernels::{Finish, Layout, Taps, add_kernel_slopes, convolve};
use crate::network::NORM_EPSILON;
use crate::shape::TensorSpec;
use crate::train::training::Batch;

/// Momentum of the running mean and variance; PyTorch's default.
const MOMENTUM: f32 = 0.1;
/// Number of kernel values whose gradients one thread sums.
const KERNEL_CHUNK: usize = 2048;

/// One layer.
pub(super) struct Layer {
    /// Index among the layers, which is also that of its raw values in a sample.
    number: usize,
    pub(super) level: usize,
    pub(super) outputs: usize,
    from: usize,
    to: Place,
    pub(super) kernel: Learned,
    pub(super) gain: Learned,
    pub(super) offset: Learned,
    pub(super) mean: Vec<f32>,
    pub(super) variance: Vec<f32>,
    taps: Taps,
    /// Propagates gradients back; `None` for the layer that reads the input images.
    back: Option<Taps>,
    /// Mean and 1 / standard deviation of each channel over the batch.
    norm: Vec<[f32; 2]>,
}

impl Layer {
    pub(super) fn new(
        loader: &Loader<'_>,
        specs: &[TensorSpec],
        number: usize,
        level: usize,
        from: usize,
        to: Place,
    ) -> Result<Self, LearnError> {
        let (outputs, inputs) = (specs[0].dims[0], specs[0].dims[1]);
        Ok(Self {
            number,
            level,
            outputs,
            from,
            to,
            kernel: loader.learned(&specs[0])?,
            gain: loader.learned(&specs[1])?,
            offset: loader.learned(&specs[2])?,
            mean: loader.running(&specs[3])?,
            variance: loader.running(&specs[4])?,
            taps: Taps::new(inputs, outputs),
            back: (from != super::sample::entrance(0)).then(|| Taps::new(outputs, inputs)),
            norm: vec![[0.0; 2]; outputs],
        })
    }

    /// Loads the current kernel.
    pub(super) fn refresh(&mut self) {
        self.taps.set(&self.kernel.value, |_| 1.0);
        if let Some(back) = &mut self.back {
            back.set_turned(&self.kernel.value);
        }
    }

    fn pixels(batch: &Batch<'_>, layout: Layout) -> f64 {
        (batch.count * layout.pixels()) as f64
    }

    /// Forward pass over all samples; updates the running mean and variance.
    pub(super) fn forward(&mut self, arch: Arch, batch: &Batch<'_>, samples: &mut [Sample]) {
        let (layout, number) = (layout_of(batch, self.level), self.number);
        let (from, taps) = (self.from, &self.taps);
        samples.par_iter_mut().for_each(|sample| {
            let raw = &mut sample.raw[number];
            convolve(arch, layout, taps, Finish::Plain, &sample.planes[from], raw);
            sample.sums.clear();
            sample.sums.extend(
                raw.chunks_exact(layout.pitch()).map(|channel| arch.dispatch(|| sums(layout, channel, channel))),
            );
        });
        let count = Self::pixels(batch, layout);
        for channel in 0..self.outputs {
            let [sum, square] = total(samples, channel);
            let mean = sum / count;
            let variance = (square / count - mean * mean).max(0.0);
            self.norm[channel] = [mean as f32, (1.0 / (variance + f64::from(NORM_EPSILON)).sqrt()) as f32];
            let toward = |running: &mut f32, value: f64| *running += MOMENTUM * (value as f32 - *running);
            toward(&mut self.mean[channel], mean);
            toward(&mut self.variance[channel], variance);
        }
        let (to, norm, gain, offset) = (self.to, &self.norm, &self.gain.value, &self.offset.value);
        samples.par_iter_mut().for_each(|sample| {
            let target = sample.planes[to.plane][to.channel * layout.pitch()..].chunks_exact_mut(layout.pitch());
            for (channel, (target, raw)) in target.zip(sample.raw[number].chunks_exact(layout.pitch())).enumerate() {
                let [mean, scale] = norm[channel];
                let (gain, offset) = (gain[channel] * scale, offset[channel] - gain[channel] * scale * mean);
                arch.dispatch(|| {
                    for (value, raw) in target.iter_mut().zip(raw) {
                        let z = gain * raw + offset;
                        *value = z / (1.0 + z.abs());
                    }
                });
                layout.clear_border(target);
            }
        });
    }

    /// Backward pass: gradients of the kernel, gain, offset and input from the gradient of the output, which is
    /// overwritten.
    pub(super) fn backward(&mut self, arch: Arch, batch: &Batch<'_>, samples: &mut [Sample]) {
        let (layout, number) = (layout_of(batch, self.level), self.number);
        let (to, norm) = (self.to, &self.norm);
        let pitch = layout.pitch();
        samples.par_iter_mut().for_each(|sample| {
            let start = to.channel * pitch;
            let slopes = sample.slopes[to.plane][start..].chunks_exact_mut(pitch);
            let values =
                sample.planes[to.plane][start..].chunks_exact(pitch).zip(sample.raw[number].chunks_exact(pitch));
            sample.sums.clear();
            sample.sums.extend(slopes.zip(values).zip(norm).map(|((slope, (value, raw)), &[mean, scale])| {
                arch.dispatch(|| {
                    for (slope, value) in slope.iter_mut().zip(value) {
                        let rest = 1.0 - value.abs();
                        *slope *= rest * rest;
                    }
                    let [sum, product] = sums(layout, slope, raw);
                    // Product with the normalised values, derived from the product with the raw values.
                    [sum, f64::from(scale) * (product - f64::from(mean) * sum)]
                })
            }));
        });
        for channel in 0..self.outputs {
            let [sum, product] = total(samples, channel);
            (self.offset.slope[channel], self.gain.slope[channel]) = (sum as f32, product as f32);
        }
        let count = Self::pixels(batch, layout) as f32;
        let (gain, gain_slope, offset_slope) = (&self.gain.value, &self.gain.slope, &self.offset.slope);
        let (from, back, size) = (self.from, self.back.as_ref(), self.kernel.value.len());
        samples.par_iter_mut().for_each(|sample| {
            let mut slopes = std::mem::take(&mut sample.slopes[to.plane]);
            let own = &mut slopes[to.channel * pitch..];
            for (channel, (slope, raw)) in
                own.chunks_exact_mut(pitch).zip(sample.raw[number].chunks_exact(pitch)).enumerate()
            {
                let [mean, scale] = norm[channel];
                let factor = gain[channel] * scale;
                let (level, tilt) = (offset_slope[channel] / count, gain_slope[channel] / count * scale);
                arch.dispatch(|| {
                    for (slope, raw) in slope.iter_mut().zip(raw) {
                        *slope = factor * (*slope - level - tilt * (raw - mean));
                    }
                });
                layout.clear_border(slope);
            }
            sample.kernel_slope.clear();
            sample.kernel_slope.resize(size, 0.0);
            add_kernel_slopes(arch, layout, &sample.planes[from], own, &mut sample.kernel_slope);
            if let Some(back) = back {
                convolve(arch, layout, back, Finish::Plain, own, &mut sample.slopes[from]);
            }
            sample.slopes[to.plane] = slopes;
        });
        let samples = &*samples;
        self.kernel.slope.par_chunks_mut(KERNEL_CHUNK).enumerate().for_each(|(chunk, slope)| {
            let start = chunk * KERNEL_CHUNK;
            slope.fill(0.0);
            for sample in samples {
                let part = &sample.kernel_slope[start..start + slope.len()];
                slope.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
            }
        });
    }
}

/// Sum of a channel, and of its products with another, over the pixels only.
#[inline(always)]
pub(super) fn sums(layout: Layout, channel: &[f32], other: &[f32]) -> [f64; 2] {
    let mut sums = [0.0_f64; 2];
    for row in 0..layout.rows {
        let (channel, other) = (&channel[layout.row(row)], &other[layout.row(row)]);
        let (mut sum, mut product) = ([0.0_f32; 8], [0.0_f32; 8]);
        let (eights, rest) = channel.as_chunks::<8>();
        let (other_eights, other_rest) = other.as_chunks::<8>();
        for (a, b) in eights.iter().zip(other_eights) {
            for lane in 0..8 {
                sum[lane] += a[lane];
                product[lane] += a[lane] * b[lane];
            }
        }
        for (lane, (a, b)) in rest.iter().zip(other_rest).enumerate() {
            sum[lane] += a;
            product[lane] += a * b;
        }
        sums[0] += f64::from(sum.iter().sum::<f32>());
        sums[1] += f64::from(product.iter().sum::<f32>());
    }
    sums
}

/// Sums over the samples, in their order.
fn total(samples: &[Sample], channel: usize) -> [f64; 2] {
    samples.iter().fold([0.0; 2], |[a, b], sample| [a + sample.sums[channel][0], b + sample.sums[channel][1]])
}
