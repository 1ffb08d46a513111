//! Memory layout of a channel's pixels, and resampling between two sizes.

/// Padding after the last row for vectors that overrun it: the widest run of a kernel.
const SLACK: usize = 64;

/// Positions of a channel's pixels within its values. The border and the padding are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
}

impl Layout {
    /// Number of values from one row to the next.
    pub(crate) fn stride(self) -> usize {
        self.columns + 2
    }

    /// Index of the first pixel.
    pub(crate) fn first(self) -> usize {
        self.stride() + 1
    }

    /// Number of values from the first pixel to the last, inclusive, with the zeros between rows.
    pub(crate) fn run(self) -> usize {
        (self.rows - 1) * self.stride() + self.columns
    }

    /// Number of values in a channel.
    pub(crate) fn pitch(self) -> usize {
        (self.rows + 2) * self.stride() + SLACK
    }

    /// Indices of the pixels in a row.
    pub(crate) fn row(self, row: usize) -> std::ops::Range<usize> {
        let start = self.first() + row * self.stride();
        start..start + self.columns
    }

    /// Number of pixels.
    pub(crate) fn pixels(self) -> usize {
        self.rows * self.columns
    }

    /// The layout with twice as many rows and columns.
    pub(crate) fn finer(self) -> Self {
        Self { rows: 2 * self.rows, columns: 2 * self.columns }
    }

    /// Sets everything except the pixels of a channel to zero.
    pub(crate) fn clear_border(self, channel: &mut [f32]) {
        channel[..self.first()].fill(0.0);
        for row in 0..self.rows - 1 {
            let end = self.row(row).end;
            channel[end..end + 2].fill(0.0);
        }
        channel[self.first() + self.run()..].fill(0.0);
    }
}

/// 2x2 max-pooling. `layout` is that of `to`; `from` has twice the rows and columns.
pub(crate) fn pool(layout: Layout, from: &[f32], to: &mut [f32]) {
    let finer = layout.finer();
    for (from, to) in from.chunks_exact(finer.pitch()).zip(to.chunks_exact_mut(layout.pitch())) {
        for row in 0..layout.rows {
            let (upper, lower) = (&from[finer.row(2 * row)], &from[finer.row(2 * row + 1)]);
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
            for (value, (a, b)) in to[layout.row(row)].iter_mut().zip(pairs) {
                *value = a[0].max(a[1]).max(b[0].max(b[1]));
            }
        }
    }
}

/// Backward pass of [`pool`]: adds each gradient in `to_slope` to the first largest of its four pixels in
/// `from_slope`.
pub(crate) fn pool_back(layout: Layout, from: &[f32], to: &[f32], to_slope: &[f32], from_slope: &mut [f32]) {
    let finer = layout.finer();
    let channels = from.chunks_exact(finer.pitch()).zip(from_slope.chunks_exact_mut(finer.pitch()));
    let coarse = to.chunks_exact(layout.pitch()).zip(to_slope.chunks_exact(layout.pitch()));
    for ((from, from_slope), (to, to_slope)) in channels.zip(coarse) {
        for row in 0..layout.rows {
            let (start, upper, lower) = (layout.row(row).start, finer.row(2 * row).start, finer.row(2 * row + 1).start);
            for column in 0..layout.columns {
                let four = [upper, upper + 1, lower, lower + 1].map(|place| place + 2 * column);
                let largest = to[start + column];
                if let Some(place) = four.into_iter().find(|&place| from[place] == largest) {
                    from_slope[place] += to_slope[start + column];
                }
            }
        }
    }
}

/// Repeats every pixel four times. `layout` is that of `from`; `to` has twice the rows and columns.
pub(crate) fn repeat(layout: Layout, from: &[f32], to: &mut [f32]) {
    let finer = layout.finer();
    for (from, to) in from.chunks_exact(layout.pitch()).zip(to.chunks_exact_mut(finer.pitch())) {
        for row in 0..layout.rows {
            let upper = finer.row(2 * row);
            for (pair, value) in to[upper.clone()].as_chunks_mut::<2>().0.iter_mut().zip(&from[layout.row(row)]) {
                *pair = [*value; 2];
            }
            to.copy_within(upper, finer.row(2 * row + 1).start);
        }
    }
}

/// Backward pass of [`repeat`]: sums the gradients of each pixel's four copies. Overwrites `from_slope`.
pub(crate) fn repeat_back(layout: Layout, to_slope: &[f32], from_slope: &mut [f32]) {
    let finer = layout.finer();
    for (from, to) in from_slope.chunks_exact_mut(layout.pitch()).zip(to_slope.chunks_exact(finer.pitch())) {
        for row in 0..layout.rows {
            let (upper, lower) = (&to[finer.row(2 * row)], &to[finer.row(2 * row + 1)]);
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
            for (value, (a, b)) in from[layout.row(row)].iter_mut().zip(pairs) {
                *value = a[0] + a[1] + b[0] + b[1];
            }
        }
    }
}
