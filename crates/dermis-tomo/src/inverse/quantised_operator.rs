//! The operator in the form used by the live pipeline. A frame takes one pass over its entries, limited by memory
//! bandwidth, so the entries are few and small: channels with the same sensitivities (reciprocal ones) are summed
//! first and share a column, and entries are 16-bit fractions of the largest in their row. Allocates nothing per
//! frame.
//!
//! Rounding an entry to 1/32767 of the row's largest changes a pixel by at most `4.4e-6 |dv|` times the pixel's
//! standard deviation under white noise of unit size (uniform rounding, `max |row| <= |row|`). That is below the
//! pixel's noise for frames of up to 2e5 times the noise of one channel.

use std::ops::Range;

use pulp::{Arch, NullaryFnOnce};

use super::Operator;
use super::reciprocity::ReciprocalColumns;

/// `image[p] = scale_p sum_g row_p[g] merged[g]`, with `merged[g] = sum_c share_c dv[c]` over the channels of group
/// g.
#[derive(Clone, Debug)]
pub struct QuantisedOperator {
    unknowns: usize,
    /// Group of each channel and its share in the group.
    channels: Vec<(u32, f32)>,
    /// Blocks of [`LANES`] unknowns, each with the entries of one group after the other; zeros after the last
    /// unknown.
    blocks: Vec<i16>,
    scales: Vec<f32>,
    groups: usize,
    merged: Vec<f32>,
    arch: Arch,
}

/// Unknowns summed together: enough vector registers that their additions do not wait for each other.
const LANES: usize = 64;

impl QuantisedOperator {
    /// Copies an operator, with each unknown multiplied by `scale` (polarity and units of the image).
    pub fn new(operator: &Operator, scale: f64) -> Self {
        let unknowns = operator.matrix.nrows();
        let alike = ReciprocalColumns::of_columns(operator.matrix.as_ref());
        let matrix = alike.merged(operator.matrix.as_ref());
        let mut largest = vec![0.0_f64; unknowns];
        for column in matrix.col_iter() {
            largest.iter_mut().zip(column.iter()).for_each(|(most, entry)| *most = most.max(entry.abs()));
        }
        let (groups, full) = (alike.count(), f64::from(i16::MAX));
        let mut blocks = vec![0_i16; groups * unknowns.next_multiple_of(LANES)];
        for (group, column) in matrix.col_iter().enumerate() {
            for (unknown, (entry, most)) in column.iter().zip(&largest).enumerate() {
                let place = (unknown / LANES * groups + group) * LANES + unknown % LANES;
                blocks[place] = (entry / most * full).round() as i16; // 0 / 0 becomes 0
            }
        }
        let channels =
            alike.group.iter().zip(&alike.share).map(|(&group, &share)| (group as u32, share as f32)).collect();
        let scales = largest.iter().map(|most| (most * scale / full) as f32).collect();
        Self { unknowns, channels, blocks, scales, groups, merged: Vec::with_capacity(groups), arch: Arch::new() }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.unknowns
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Reconstructs one frame of difference data into `image` (one value per unknown).
    ///
    /// # Panics
    /// If the lengths do not match the operator. This is a programming error, checked where frames enter the
    /// pipeline.
    pub fn apply(&mut self, dv: &[f32], image: &mut [f32]) {
        let mut merged = std::mem::take(&mut self.merged);
        self.apply_near(dv, 0..self.unknowns, &mut merged, image);
        self.merged = merged;
    }

    /// As [`QuantisedOperator::apply`], but sets only these unknowns, and up to 63 on each side of them. `merged` is
    /// working memory.
    ///
    /// # Panics
    /// As [`QuantisedOperator::apply`], and for unknowns that don't exist.
    pub fn apply_near(&self, dv: &[f32], unknowns: Range<usize>, merged: &mut Vec<f32>, image: &mut [f32]) {
        assert_eq!(dv.len(), self.channels.len(), "channels of the frame");
        assert_eq!(image.len(), self.unknowns, "unknowns of the image");
        merged.clear();
        merged.resize(self.groups, 0.0);
        for (&(group, share), value) in self.channels.iter().zip(dv) {
            merged[group as usize] += share * value;
        }
        let (first, end) = (unknowns.start / LANES * LANES, unknowns.end.next_multiple_of(LANES).min(self.unknowns));
        self.arch.dispatch(Product {
            blocks: &self.blocks[first * self.groups..],
            values: merged,
            scales: &self.scales[first..end],
            image: &mut image[first..end],
        });
    }
}

struct Product<'a> {
    blocks: &'a [i16],
    values: &'a [f32],
    scales: &'a [f32],
    image: &'a mut [f32],
}

impl NullaryFnOnce for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let targets = self.image.chunks_mut(LANES).zip(self.scales.chunks(LANES));
        for (block, (pixels, scales)) in targets.enumerate() {
            let entries = self.blocks[block * self.values.len() * LANES..].as_chunks::<LANES>().0;
            let mut sums = [0.0_f32; LANES];
            for (entries, value) in entries.iter().zip(self.values) {
                for (sum, entry) in sums.iter_mut().zip(entries) {
                    *sum = f32::from(*entry).mul_add(*value, *sum);
                }
            }
            for ((pixel, sum), scale) in pixels.iter_mut().zip(sums).zip(scales) {
                *pixel = sum * scale;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inverse::DataPrecision;
    use faer::Mat;

    #[test]
    fn live_images_are_the_operator_s_within_the_rounding_of_its_entries() {
        // Counts that are not multiples of the lanes and groups; channels that are multiples of others; a row of
        // zeros.
        for (unknowns, channels) in [(1, 1), (7, 13), (4, 16), (150, 208), (5, 49), (3, 0)] {
            let entry = |row: usize, column: usize| (((row + 1) * (column % 20 + 3) * 13) % 17) as f64 - 8.0;
            let matrix = Mat::from_fn(unknowns, channels, |row, column| {
                if row == 2 { 0.0 } else { entry(row, column) * (1.0 + (column / 20) as f64) }
            });
            let (data_precision, noise_deviation) = (DataPrecision::Whole(Mat::zeros(0, 0)), Vec::new());
            let operator = Operator { matrix, data_precision, hyperparameter: 1.0, noise_deviation };
            let dv: Vec<f64> = (0..channels).map(|c| (c as f64).cos()).collect();
            let expected = operator.apply(&dv).unwrap();
            let mut image = vec![f32::NAN; unknowns];
            let single: Vec<f32> = dv.iter().map(|v| *v as f32).collect();
            let mut live = QuantisedOperator::new(&operator, -2.0);
            live.apply(&single, &mut image);
            let mut part = vec![f32::NAN; unknowns];
            let middle = unknowns / 2..unknowns * 2 / 3;
            live.apply_near(&single, middle.clone(), &mut Vec::new(), &mut part);
            assert_eq!(part[middle.clone()], image[middle]);
            for (row, (found, expected)) in image.iter().zip(&expected).enumerate() {
                // Rounding error per entry of half a step of 1/32767 of the row's largest, plus single precision.
                let most: f64 = (0..channels).map(|c| operator.matrix[(row, c)].abs()).sum();
                let bound = 2.0 * most * (0.5 / 32767.0) * 20.0_f64.min(channels as f64) + 1e-6 * most;
                assert!((f64::from(*found) + 2.0 * expected).abs() <= bound, "{found} {expected} {bound}");
            }
        }
    }
}
