//! The operator as the live pipeline uses it: single precision, pixel after pixel, so that one frame is one pass over
//! memory in its order (which is what limits it). Allocates nothing per frame.

use pulp::{Simd, WithSimd};

use super::Operator;

/// `image[p] = sum_c row_p[c] dv[c]`, f32.
#[derive(Clone, Debug)]
pub struct LiveOperator {
    unknowns: usize,
    channels: usize,
    /// One row an unknown, zeros up to a whole number of groups.
    rows: Vec<f32>,
    arch: pulp::Arch,
}

/// Rows summed together, so that their additions do not wait for each other.
const GROUP: usize = 8;

impl LiveOperator {
    /// Copies an operator, each unknown multiplied by `scale` (polarity and units of the image).
    pub fn new(operator: &Operator, scale: f64) -> Self {
        let (unknowns, channels) = (operator.matrix.nrows(), operator.matrix.ncols());
        let mut rows = vec![0.0; channels * unknowns.next_multiple_of(GROUP)];
        for (channel, column) in operator.matrix.col_iter().enumerate() {
            let targets = rows.iter_mut().skip(channel).step_by(channels);
            targets.zip(column.iter()).for_each(|(to, from)| *to = (from * scale) as f32);
        }
        Self { unknowns, channels, rows, arch: pulp::Arch::new() }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Reconstructs one frame of difference data into `image` (one value an unknown).
    ///
    /// # Panics
    /// If the lengths are not those of the operator: a programming error, checked where frames enter the pipeline.
    pub fn apply(&self, dv: &[f32], image: &mut [f32]) {
        assert_eq!(dv.len(), self.channels, "channels of the frame");
        assert_eq!(image.len(), self.unknowns, "unknowns of the image");
        if self.channels > 0 {
            self.arch.dispatch(Product { rows: &self.rows, dv, image });
        }
    }
}

struct Product<'a> {
    rows: &'a [f32],
    dv: &'a [f32],
    image: &'a mut [f32],
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (values, last_values) = S::as_simd_f32s(self.dv);
        let channels = self.dv.len();
        for (group, pixels) in self.rows.chunks_exact(GROUP * channels).zip(self.image.chunks_mut(GROUP)) {
            let rows: [&[f32]; GROUP] = std::array::from_fn(|row| &group[row * channels..(row + 1) * channels]);
            let split = rows.map(|row| S::as_simd_f32s(row));
            let mut sums = [simd.splat_f32s(0.0); GROUP];
            for (k, &value) in values.iter().enumerate() {
                for (sum, (entries, _)) in sums.iter_mut().zip(&split) {
                    *sum = simd.mul_add_e_f32s(entries[k], value, *sum);
                }
            }
            for ((pixel, sum), (_, last)) in pixels.iter_mut().zip(sums).zip(&split) {
                let rest: f32 = last.iter().zip(last_values).map(|(entry, value)| entry * value).sum();
                *pixel = simd.reduce_sum_f32s(sum) + rest;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Mat;

    #[test]
    fn live_images_are_the_operator_s_in_single_precision() {
        // Counts that are no multiples of the lanes and groups.
        for (unknowns, channels) in [(1, 1), (7, 13), (4, 16), (33, 208), (5, 49)] {
            let matrix = Mat::from_fn(unknowns, channels, |row, column| ((row * 7 + column * 13) % 17) as f64 - 8.0);
            let (data_precision, noise_deviation) = (Mat::zeros(0, 0), Vec::new());
            let operator = Operator { matrix, data_precision, hyperparameter: 1.0, noise_deviation };
            let dv: Vec<f64> = (0..channels).map(|c| (c as f64).cos()).collect();
            let expected = operator.apply(&dv).unwrap();
            let mut image = vec![f32::NAN; unknowns];
            let single: Vec<f32> = dv.iter().map(|v| *v as f32).collect();
            LiveOperator::new(&operator, -2.0).apply(&single, &mut image);
            for (found, expected) in image.iter().zip(&expected) {
                // Entries up to 8, 208 terms, 24 bits: rounding stays below 8 * 208 * 2^-23 = 2e-4.
                assert!((f64::from(*found) + 2.0 * expected).abs() < 4e-4, "{found} {expected}");
            }
        }
    }
}
