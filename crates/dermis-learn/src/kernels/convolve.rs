//! The 3x3 convolution. Sums for four output channels and three vectors of pixels stay in registers while the taps of
//! all input channels are applied, so every loaded value is used four times and every tap three times per vector.

use pulp::{Arch, Simd, WithSimd};

use super::Layout;

/// Output channels summed together.
const BLOCK: usize = 4;
/// Vectors of pixels summed together. With [`BLOCK`] and the loaded values this fills all sixteen registers of AVX2.
const VECTORS: usize = 3;

/// Weights in order of use: blocks of four output channels, each with the taps of all inputs.
#[derive(Clone, Debug)]
pub(crate) struct Taps {
    inputs: usize,
    outputs: usize,
    /// Four weights per tap, one per output channel of the block; padded with zeros after the last channel.
    values: Vec<[f32; BLOCK]>,
}

impl Taps {
    /// All-zero weights.
    pub(crate) fn new(inputs: usize, outputs: usize) -> Self {
        Self { inputs, outputs, values: vec![[0.0; BLOCK]; outputs.div_ceil(BLOCK) * inputs * 9] }
    }

    /// Number of output channels.
    pub(crate) fn outputs(&self) -> usize {
        self.outputs
    }

    /// Loads a kernel of outputs x inputs x 3 x 3, with each output channel multiplied by its gain.
    pub(crate) fn set(&mut self, kernel: &[f32], gain: impl Fn(usize) -> f32) {
        for (output, kernel) in kernel.chunks_exact(9 * self.inputs).enumerate() {
            let block = &mut self.values[output / BLOCK * 9 * self.inputs..][..9 * self.inputs];
            let gain = gain(output);
            for (taps, value) in block.iter_mut().zip(kernel) {
                taps[output % BLOCK] = gain * value;
            }
        }
    }

    /// Loads the kernel that propagates gradients back: the inputs x outputs x 3 x 3 kernel, rotated by half a turn,
    /// with inputs and outputs exchanged.
    pub(crate) fn set_turned(&mut self, kernel: &[f32]) {
        for (input, kernel) in kernel.chunks_exact(9 * self.outputs).enumerate() {
            for (output, kernel) in kernel.chunks_exact(9).enumerate() {
                let block = &mut self.values[output / BLOCK * 9 * self.inputs..][9 * input..9 * input + 9];
                for (taps, value) in block.iter_mut().zip(kernel.iter().rev()) {
                    taps[output % BLOCK] = *value;
                }
            }
        }
    }
}

/// Operation applied to the sums.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Finish<'a> {
    /// Softsign of the sum plus each output channel's offset.
    Softsign(&'a [f32]),
    /// No operation.
    Plain,
}

/// Convolves `from` (inputs channels) into `to` (outputs channels), both with the same layout. Overwrites `to`.
pub(crate) fn convolve(arch: Arch, layout: Layout, taps: &Taps, finish: Finish<'_>, from: &[f32], to: &mut [f32]) {
    debug_assert_eq!(from.len(), taps.inputs * layout.pitch());
    debug_assert_eq!(to.len(), taps.outputs * layout.pitch());
    arch.dispatch(Pass { layout, taps, finish, from, to });
}

struct Pass<'a> {
    layout: Layout,
    taps: &'a Taps,
    finish: Finish<'a>,
    from: &'a [f32],
    to: &'a mut [f32],
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let (first, run, pitch) = (self.layout.first(), self.layout.run(), self.layout.pitch());
        let vectors = run.div_ceil(S::F32_LANES);
        let mut done = 0;
        while done < vectors {
            let place = first + done * S::F32_LANES;
            for block in 0..self.taps.outputs.div_ceil(BLOCK) {
                match vectors - done {
                    1 => self.tile::<S, 1>(simd, block, place),
                    2 => self.tile::<S, 2>(simd, block, place),
                    _ => self.tile::<S, VECTORS>(simd, block, place),
                }
            }
            done += VECTORS;
        }
        for channel in self.to.chunks_exact_mut(pitch) {
            self.layout.clear_border(channel);
        }
    }
}

impl Pass<'_> {
    /// Computes `N` vectors of pixels from `place` on, for one block of output channels.
    #[inline(always)]
    fn tile<S: Simd, const N: usize>(&mut self, simd: S, block: usize, place: usize) {
        let (pitch, stride, inputs) = (self.layout.pitch(), self.layout.stride(), self.taps.inputs);
        let width = N * S::F32_LANES;
        let mut sums = [[simd.splat_f32s(0.0); N]; BLOCK];
        let taps = self.taps.values[block * 9 * inputs..(block + 1) * 9 * inputs].as_chunks::<3>().0;
        let mut taps = taps.iter();
        for channel in self.from.chunks_exact(pitch) {
            for line in 0..3 {
                let start = place + line * stride - stride - 1;
                let values = &channel[start..start + width + 2];
                let Some(taps) = taps.next() else { return };
                for (shift, tap) in taps.iter().enumerate() {
                    let (vectors, _) = S::as_simd_f32s(&values[shift..shift + width]);
                    for (sums, weight) in sums.iter_mut().zip(tap) {
                        let weight = simd.splat_f32s(*weight);
                        for (sum, value) in sums.iter_mut().zip(vectors) {
                            *sum = simd.mul_add_e_f32s(weight, *value, *sum);
                        }
                    }
                }
            }
        }
        for (k, sums) in sums.iter().enumerate().take(self.taps.outputs - block * BLOCK) {
            let output = block * BLOCK + k;
            let to = &mut self.to[output * pitch + place..][..width];
            let (to, _) = S::as_mut_simd_f32s(to);
            for (to, sum) in to.iter_mut().zip(sums) {
                *to = match self.finish {
                    Finish::Plain => *sum,
                    Finish::Softsign(offsets) => {
                        let sum = simd.add_f32s(*sum, simd.splat_f32s(offsets[output]));
                        simd.div_f32s(sum, simd.add_f32s(simd.splat_f32s(1.0), simd.abs_f32s(sum)))
                    }
                };
            }
        }
    }
}
