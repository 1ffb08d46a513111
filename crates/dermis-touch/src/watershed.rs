//! Splits an image into the basins of its peaks by flooding from the top.
//!
//! Pixels are visited from the highest down (ties by index, so the result is deterministic); a pixel without flooded
//! neighbours opens a basin, others join the basin of their highest neighbour. Where two basins first meet stands their
//! saddle: the lower one is absorbed when its prominence over the saddle is too small. This is the watershed by
//! immersion of Vincent and Soille, IEEE PAMI 13 (1991) 583, run downwards and with merging by persistence.

/// When two basins that meet are one peak.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MergeRule {
    /// One peak when saddle > this part of the lower peak.
    pub saddle_ratio: f32,
    /// One peak when the lower peak rises less than this many sigma above the saddle.
    pub min_prominence_sigma: f32,
}

/// A peak and the pixels that drain to it.
#[derive(Debug, Clone, Copy)]
struct Basin {
    peak: f32,
    /// Padded index of the peak's pixel.
    pixel: u32,
    /// Index of the basin that absorbed this one, or its own.
    parent: u32,
    /// Prominence that the peak must have to stand alone, image units.
    min_prominence: f32,
}

/// The flooded image, with the memory it is flooded in.
///
/// Values and labels carry a border of one pixel, NaN in the values, so that neighbours need no bounds.
#[derive(Debug, Clone)]
pub(crate) struct Watershed {
    columns: usize,
    rows: usize,
    stride: usize,
    /// Oriented so that contacts are positive; NaN outside.
    values: Vec<f32>,
    /// Basin index + 1; 0 = not flooded.
    labels: Vec<u32>,
    /// (descending value, ascending padded index) packed into one integer.
    order: Vec<u64>,
    basins: Vec<Basin>,
}

impl Watershed {
    pub(crate) fn new(columns: usize, rows: usize) -> Self {
        let stride = columns + 2;
        let padded = stride * (rows + 2);
        Self {
            columns,
            rows,
            stride,
            values: vec![f32::NAN; padded],
            labels: vec![0; padded],
            order: Vec::with_capacity(columns * rows),
            // Peaks are never neighbours.
            basins: Vec::with_capacity(columns.div_ceil(2) * rows.div_ceil(2)),
        }
    }

    /// Copies an image in, row by row: values times `factor`, NaN where they are not finite or their noise is not usable,
    /// and returns the largest value (0 when none is positive).
    pub(crate) fn load(&mut self, image: &[f32], sigma: Option<&[f32]>, factor: f32) -> f32 {
        for row in 0..self.rows {
            let range = row * self.columns..(row + 1) * self.columns;
            let start = (row + 1) * self.stride + 1;
            let target = &mut self.values[start..start + self.columns];
            let oriented = |value: f32| if value.abs() <= f32::MAX { factor * value } else { f32::NAN };
            match sigma {
                None => target.iter_mut().zip(&image[range]).for_each(|(to, &from)| *to = oriented(from)),
                Some(sigma) => {
                    for ((to, &from), &sigma) in target.iter_mut().zip(&image[range.clone()]).zip(&sigma[range]) {
                        *to = if (0.0..=f32::MAX).contains(&sigma) { oriented(from) } else { f32::NAN };
                    }
                }
            }
        }
        largest_of(&self.values, |value| value)
    }

    /// Floods every pixel at or above `floor` (which must be positive); `sigma` gives the noise at an image index.
    pub(crate) fn flood(&mut self, floor: f32, rule: MergeRule, sigma: impl Fn(usize) -> f32) {
        self.sort_pixels(floor);
        self.labels.fill(0);
        self.basins.clear();
        for position in 0..self.order.len() {
            let pixel = unpack_pixel(self.order[position]);
            self.flood_pixel(pixel, rule, &sigma);
        }
    }

    fn sort_pixels(&mut self, floor: f32) {
        self.order.clear();
        for row in 1..=self.rows {
            let start = row * self.stride;
            for index in start + 1..=start + self.columns {
                let value = self.values[index];
                if value >= floor {
                    // Positive floats sort as their bit patterns do.
                    self.order.push((u64::from(!value.to_bits()) << 32) | index as u64);
                }
            }
        }
        self.order.sort_unstable();
    }

    fn flood_pixel(&mut self, pixel: usize, rule: MergeRule, sigma: &impl Fn(usize) -> f32) {
        let value = self.values[pixel];
        let mut roots = [0u32; 8];
        let mut count = 0;
        let mut highest = (f32::NEG_INFINITY, 0u32);
        let mut last = (0u32, 0u32);
        for neighbour in self.neighbours(pixel) {
            let label = self.labels[neighbour];
            if label == 0 {
                continue;
            }
            // Most neighbours carry one label: look its basin up once.
            if label != last.0 {
                last = (label, self.root(label - 1));
                if !roots[..count].contains(&last.1) {
                    roots[count] = last.1;
                    count += 1;
                }
            }
            if self.values[neighbour] > highest.0 {
                highest = (self.values[neighbour], last.1);
            }
        }
        if count == 0 {
            let basin = self.basins.len() as u32;
            let min_prominence = rule.min_prominence_sigma * sigma(self.image_index(pixel));
            self.basins.push(Basin { peak: value, pixel: pixel as u32, parent: basin, min_prominence });
            self.labels[pixel] = basin + 1;
            return;
        }
        self.labels[pixel] = highest.1 + 1;
        if count > 1 {
            // Basins are numbered in the order of their peaks: the lowest number is the highest peak.
            roots[..count].sort_unstable();
            self.absorb_at_saddle(&roots[..count], value, rule);
        }
    }

    fn absorb_at_saddle(&mut self, roots: &[u32], saddle: f32, rule: MergeRule) {
        for &lower in &roots[1..] {
            let Basin { peak, min_prominence, .. } = self.basins[lower as usize];
            if saddle > rule.saddle_ratio * peak || peak - saddle < min_prominence {
                self.basins[lower as usize].parent = roots[0];
            }
        }
    }

    fn neighbours(&self, pixel: usize) -> [usize; 8] {
        let (up, down) = (pixel - self.stride, pixel + self.stride);
        [up - 1, up, up + 1, pixel - 1, pixel + 1, down - 1, down, down + 1]
    }

    /// The basin that finally holds `basin`.
    pub(crate) fn root(&mut self, mut basin: u32) -> u32 {
        while self.basins[basin as usize].parent != basin {
            let parent = self.basins[basin as usize].parent;
            self.basins[basin as usize].parent = self.basins[parent as usize].parent;
            basin = parent;
        }
        basin
    }

    /// Standing peaks from the highest down: (basin, value, padded pixel).
    pub(crate) fn peaks(&self) -> impl Iterator<Item = (u32, f32, usize)> + '_ {
        self.basins
            .iter()
            .enumerate()
            .filter(|(index, basin)| basin.parent == *index as u32)
            .map(|(index, basin)| (index as u32, basin.peak, basin.pixel as usize))
    }

    /// Lets one standing basin absorb another.
    pub(crate) fn absorb(&mut self, basin: u32, into: u32) {
        self.basins[basin as usize].parent = into;
    }

    /// Number of flooded pixels.
    pub(crate) fn flooded(&self) -> usize {
        self.order.len()
    }

    /// The `position`-th flooded pixel from the highest down: (padded pixel, value, standing basin).
    pub(crate) fn flooded_pixel(&mut self, position: usize) -> (usize, f32, u32) {
        let pixel = unpack_pixel(self.order[position]);
        let basin = self.root(self.labels[pixel] - 1);
        (pixel, self.values[pixel], basin)
    }

    /// Standing basin of a padded pixel, if it was flooded.
    pub(crate) fn basin_of(&mut self, pixel: usize) -> Option<u32> {
        match self.labels[pixel] {
            0 => None,
            label => Some(self.root(label - 1)),
        }
    }

    /// Value at a padded pixel, NaN outside.
    pub(crate) fn value(&self, pixel: usize) -> f32 {
        self.values[pixel]
    }

    /// Length of a padded row.
    pub(crate) fn stride(&self) -> usize {
        self.stride
    }

    /// (column, row) of a padded pixel.
    pub(crate) fn column_row(&self, pixel: usize) -> (usize, usize) {
        (pixel % self.stride - 1, pixel / self.stride - 1)
    }

    /// Padded index of (column, row).
    pub(crate) fn padded(&self, column: usize, row: usize) -> usize {
        (row + 1) * self.stride + column + 1
    }

    /// Index in the image of a padded pixel.
    pub(crate) fn image_index(&self, pixel: usize) -> usize {
        let (column, row) = self.column_row(pixel);
        row * self.columns + column
    }
}

/// Values compared side by side: comparisons lane by lane become vector instructions, one running extreme does not.
const LANES: usize = 16;

/// The largest finite `size(value)`, or 0 when none is positive. Comparisons leave NaN out by themselves.
pub(crate) fn largest_of(values: &[f32], size: impl Fn(f32) -> f32) -> f32 {
    let mut most = [0.0_f32; LANES];
    let mut raise = |lane: usize, value: f32| {
        let value = size(value);
        most[lane] = if value > most[lane] && value <= f32::MAX { value } else { most[lane] };
    };
    let (blocks, rest) = values.as_chunks::<LANES>();
    for block in blocks {
        for lane in 0..LANES {
            raise(lane, block[lane]);
        }
    }
    rest.iter().enumerate().for_each(|(lane, &value)| raise(lane, value));
    most.into_iter().fold(0.0, f32::max)
}

/// The same over pixels of which the noise is usable, and the smallest usable noise (infinite when there is none).
pub(crate) fn largest_with_noise(values: &[f32], sigma: &[f32], size: impl Fn(f32) -> f32) -> (f32, f32) {
    let (mut most, mut least) = ([0.0_f32; LANES], [f32::INFINITY; LANES]);
    let mut take = |lane: usize, value: f32, sigma: f32| {
        let (value, usable) = (size(value), (0.0..=f32::MAX).contains(&sigma));
        most[lane] = if usable && value > most[lane] && value <= f32::MAX { value } else { most[lane] };
        least[lane] = if usable && sigma < least[lane] { sigma } else { least[lane] };
    };
    let (blocks, rest) = values.as_chunks::<LANES>();
    let (noises, rest_of_noise) = sigma.as_chunks::<LANES>();
    for (block, noise) in blocks.iter().zip(noises) {
        for lane in 0..LANES {
            take(lane, block[lane], noise[lane]);
        }
    }
    rest.iter().zip(rest_of_noise).enumerate().for_each(|(lane, (&value, &sigma))| take(lane, value, sigma));
    (most.into_iter().fold(0.0, f32::max), least.into_iter().fold(f32::INFINITY, f32::min))
}

fn unpack_pixel(key: u64) -> usize {
    (key & 0xffff_ffff) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flooded(columns: usize, image: &[f32], ratio: f32) -> Vec<(f32, usize)> {
        let mut shed = Watershed::new(columns, image.len() / columns);
        shed.load(image, None, 1.0);
        shed.flood(0.01, MergeRule { saddle_ratio: ratio, min_prominence_sigma: 0.0 }, |_| 0.0);
        let peaks: Vec<_> = shed.peaks().collect();
        peaks.into_iter().map(|(_, value, pixel)| (value, shed.image_index(pixel))).collect()
    }

    #[test]
    fn saddle_decides_between_one_and_two() {
        let ridge = [0.0, 2.0, 1.2, 1.5, 0.0];
        // 1.2 / 1.5 = 0.8.
        assert_eq!(flooded(5, &ridge, 0.75), [(2.0, 1)]);
        assert_eq!(flooded(5, &ridge, 0.85), [(2.0, 1), (1.5, 3)]);
    }

    #[test]
    fn nan_walls_separate_and_plateaus_have_one_peak() {
        assert_eq!(flooded(5, &[1.0, 1.0, f32::NAN, 1.0, 1.0], 0.75), [(1.0, 0), (1.0, 3)]);
    }

    #[test]
    fn rows_do_not_wrap() {
        // The last pixel of one row and the first of the next are no neighbours.
        let image = [0.0, 0.0, 0.0, 1.0, 0.9, 0.0, 0.0, 0.0];
        assert_eq!(flooded(4, &image, 0.75), [(1.0, 3), (0.9, 4)]);
    }
}
