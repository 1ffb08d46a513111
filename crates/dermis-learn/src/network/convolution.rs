//! A 3x3 convolution with its batch norm and Softsign, as a product of small matrices in registers: a run of pixels by a
//! block of output channels. The loops are plain; `pulp` has them compiled for the vector instructions of the machine.

use pulp::{Arch, NullaryFnOnce};

use super::{NORM_EPSILON, Plane};
use crate::LearnError;
use crate::weights::Tensors;

/// Output channels summed together.
const LANES: usize = 16;
/// Pixels summed together: with [`LANES`] enough independent sums to keep the multipliers busy.
const RUN: usize = 4;
/// The same where there are no more than [`NARROW`] output channels.
const NARROW: usize = 8;
const NARROW_RUN: usize = 8;

/// `softsign(gain (w * x) + offset)`.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    inputs: usize,
    outputs: usize,
    lanes: usize,
    /// Blocks of `lanes` output channels, in each the 9 x inputs taps one after the other; zeros after the last channel.
    taps: Vec<f32>,
    offsets: Vec<f32>,
    arch: Arch,
}

impl Convolution {
    /// Takes `PREFIX.convN` and folds `PREFIX.normN` in: `gain = weight / sqrt(var + eps)`, `offset = bias - gain mean`.
    pub(super) fn folded(
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
        let lanes = if outputs <= NARROW { NARROW } else { LANES };
        let blocks = outputs.div_ceil(lanes);
        let mut taps = vec![0.0; blocks * 9 * inputs * lanes];
        let mut offsets = vec![0.0; blocks * lanes];
        for output in 0..outputs {
            let gain = weight[output] / (variance[output] + NORM_EPSILON).sqrt();
            offsets[output] = bias[output] - gain * mean[output];
            for input in 0..inputs {
                for tap in 0..9 {
                    let place = ((output / lanes * 9 + tap) * inputs + input) * lanes + output % lanes;
                    taps[place] = gain * kernel[(output * inputs + input) * 9 + tap];
                }
            }
        }
        Ok(Self { inputs, outputs, lanes, taps, offsets, arch: Arch::new() })
    }

    /// Into the channels of `to` from `offset` on.
    pub(super) fn apply(&self, from: &Plane, to: &mut Plane, offset: usize) {
        if self.lanes == NARROW {
            self.arch.dispatch(Pass::<NARROW, NARROW_RUN> { convolution: self, from, to, offset });
        } else {
            self.arch.dispatch(Pass::<LANES, RUN> { convolution: self, from, to, offset });
        }
    }
}

struct Pass<'a, const L: usize, const R: usize> {
    convolution: &'a Convolution,
    from: &'a Plane,
    to: &'a mut Plane,
    offset: usize,
}

impl<const L: usize, const R: usize> NullaryFnOnce for Pass<'_, L, R> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        for block in 0..self.convolution.outputs.div_ceil(L) {
            for row in 0..self.from.rows {
                let mut column = 0;
                while column + R <= self.from.columns {
                    self.run::<R>(block, row, column);
                    column += R;
                }
                while column < self.from.columns {
                    self.run::<1>(block, row, column);
                    column += 1;
                }
            }
        }
    }
}

impl<const L: usize, const R: usize> Pass<'_, L, R> {
    /// `N` pixels of a row, one block of output channels.
    #[inline(always)]
    fn run<const N: usize>(&mut self, block: usize, row: usize, column: usize) {
        let inputs = self.convolution.inputs;
        let taps = self.convolution.taps[block * 9 * inputs * L..(block + 1) * 9 * inputs * L].as_chunks::<L>().0;
        let mut sums = [[0.0_f32; L]; N];
        sums.fill(self.convolution.offsets.as_chunks::<L>().0[block]);
        let count = 3 * inputs;
        for (line, taps) in taps.chunks_exact(count).enumerate() {
            let start = ((row + line) * (self.from.columns + 2) + column) * inputs;
            let pixels: [&[f32]; N] = std::array::from_fn(|k| &self.from.values[start + k * inputs..][..count]);
            for (k, tap) in taps.iter().enumerate() {
                for (sum, pixel) in sums.iter_mut().zip(&pixels) {
                    let value = pixel[k];
                    for lane in 0..L {
                        sum[lane] = value.mul_add(tap[lane], sum[lane]);
                    }
                }
            }
        }
        for (k, sum) in sums.iter_mut().enumerate() {
            sum.iter_mut().for_each(|value| *value /= 1.0 + value.abs());
            let first = block * L;
            let here = L.min(self.convolution.outputs - first);
            let place = self.to.at(row, column + k) + self.offset + first;
            self.to.values[place..place + here].copy_from_slice(&sum[..here]);
        }
    }
}
