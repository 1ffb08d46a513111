//! Gradient of a loss with respect to the taps of a 3x3 convolution: the correlation of its input with the gradient
//! of its output.

use pulp::{Arch, Simd, WithSimd};

use super::Layout;

/// Output channels processed together.
const BLOCK: usize = 4;

/// Adds the gradient of a kernel (outputs x inputs x 3 x 3) to `kernel_slope`. `from` is the input of the
/// convolution, `to_slope` the gradient of its output, whose border must be zero.
pub(crate) fn add_kernel_slopes(arch: Arch, layout: Layout, from: &[f32], to_slope: &[f32], kernel_slope: &mut [f32]) {
    arch.dispatch(Pass { layout, from, to_slope, kernel_slope });
}

struct Pass<'a> {
    layout: Layout,
    from: &'a [f32],
    to_slope: &'a [f32],
    kernel_slope: &'a mut [f32],
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let outputs = self.to_slope.len() / self.layout.pitch();
        let mut output = 0;
        while output < outputs {
            match outputs - output {
                1 => self.block::<S, 1>(simd, output),
                2 => self.block::<S, 2>(simd, output),
                3 => self.block::<S, 3>(simd, output),
                _ => self.block::<S, BLOCK>(simd, output),
            }
            output += BLOCK;
        }
    }
}

impl Pass<'_> {
    /// Processes `N` output channels starting at `output`.
    #[inline(always)]
    fn block<S: Simd, const N: usize>(&mut self, simd: S, output: usize) {
        let (pitch, stride, first) = (self.layout.pitch(), self.layout.stride(), self.layout.first());
        let inputs = self.from.len() / pitch;
        let vectors = self.layout.run().div_ceil(S::F32_LANES);
        let length = vectors * S::F32_LANES;
        let slopes: [&[S::f32s]; N] =
            std::array::from_fn(|k| S::as_simd_f32s(&self.to_slope[(output + k) * pitch + first..][..length]).0);
        for (input, channel) in self.from.chunks_exact(pitch).enumerate() {
            for line in 0..3 {
                let start = first + line * stride - stride - 1;
                let values: [&[S::f32s]; 3] =
                    std::array::from_fn(|shift| S::as_simd_f32s(&channel[start + shift..][..length]).0);
                let sums = correlate::<S, N>(simd, slopes, values, vectors);
                for (k, sums) in sums.iter().enumerate() {
                    let place = ((output + k) * inputs + input) * 9 + 3 * line;
                    for (slope, sum) in self.kernel_slope[place..place + 3].iter_mut().zip(sums) {
                        *slope += simd.reduce_sum_f32s(*sum);
                    }
                }
            }
        }
    }
}

/// Sums, over a run, of the products of `N` channels of gradients with a line of values at three shifts.
#[inline(always)]
fn correlate<S: Simd, const N: usize>(
    simd: S,
    slopes: [&[S::f32s]; N],
    values: [&[S::f32s]; 3],
    vectors: usize,
) -> [[S::f32s; 3]; N] {
    let (slopes, values) = (slopes.map(|s| &s[..vectors]), values.map(|v| &v[..vectors]));
    let mut sums = [[simd.splat_f32s(0.0); 3]; N];
    for k in 0..vectors {
        let three = [values[0][k], values[1][k], values[2][k]];
        for (sums, slopes) in sums.iter_mut().zip(&slopes) {
            for (sum, value) in sums.iter_mut().zip(three) {
                *sum = simd.mul_add_e_f32s(slopes[k], value, *sum);
            }
        }
    }
    sums
}
