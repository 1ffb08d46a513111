//! Responses of spots over positions and radii, interpolated along x, y and log r by cubics (Catmull and Rom).

use faer::{Mat, MatRef};
use rayon::prelude::*;

use super::products::{KINDS, WeightedColumns, sum_up};
use super::shape::SpotShape;
use crate::mesh::Point;

/// Largest ratio of neighbouring radii: the response changes little enough between them for cubics.
const RADIUS_FACTOR: f64 = 1.4;
/// Positions beyond the outermost pixels, in steps, for the cubics and for spots centred on the rim.
const MARGIN: usize = 2;
/// Largest number of positions along the longer side.
const MOST_ALONG: f64 = 44.0;
/// Minimum smoothing of edges, in pixels: sharper ones would make the pixels visible.
const LEAST_SMOOTHING: f64 = 0.5;

/// The range of spots that the table covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotOptions {
    /// Smallest radius, metres: about a pixel. Below that, the pixels become visible.
    pub smallest_radius_m: f64,
    /// Largest radius, metres.
    pub largest_radius_m: f64,
    /// Expected radius (the mean of the prior), metres.
    pub typical_radius_m: f64,
    /// Standard deviation by which the layer smooths the edges of discs, metres. Without it, spots are Gaussian.
    pub smoothing_m: Option<f64>,
    /// Largest number of spots fitted together.
    pub most_spots: usize,
}

impl SpotOptions {
    /// The same on pixels of this side, metres.
    pub(super) fn on_pixels(self, pixel_m: f64) -> Self {
        let smoothing_m = self.smoothing_m.map(|smoothing_m| smoothing_m.max(LEAST_SMOOTHING * pixel_m));
        Self { smoothing_m, ..self }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Table {
    /// Lowest position.
    low_m: Point,
    step_m: f64,
    columns: usize,
    rows: usize,
    log_first: f64,
    log_step: f64,
    radii: usize,
    /// Length of a response.
    length: usize,
    /// Responses by radius, then by position (row by row).
    values: Vec<f32>,
}

impl Table {
    /// Tabulates the responses. `reduced` is combinations x pixels.
    pub(super) fn new(reduced: MatRef<'_, f64>, positions_m: &[Point], pixel_m: f64, options: &SpotOptions) -> Self {
        let extreme =
            |axis: usize, of: fn(f64, f64) -> f64, start: f64| positions_m.iter().map(|p| p[axis]).fold(start, of);
        let low = [0, 1].map(|axis| extreme(axis, f64::min, f64::INFINITY));
        let high = [0, 1].map(|axis| extreme(axis, f64::max, f64::NEG_INFINITY));
        // The step must be finer than the smallest spot, but no finer than necessary.
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        let step_m = pixel_m.min(0.9 * options.smallest_radius_m).max(extent / MOST_ALONG);
        let count = |axis: usize| ((high[axis] - low[axis]) / step_m).ceil() as usize + 1 + 2 * MARGIN;
        let (columns, rows) = (count(0), count(1));
        let span = (options.largest_radius_m / options.smallest_radius_m).ln();
        let intervals = (span / RADIUS_FACTOR.ln()).ceil().max(1.0);
        // One more radius at either end, for the cubics.
        let (log_step, radii) = (span / intervals, intervals as usize + 3);
        let log_first = options.smallest_radius_m.ln() - log_step;
        let low_m = low.map(|l| l - MARGIN as f64 * step_m);
        let x_of = |column: usize| low_m[0] + column as f64 * step_m;
        let of_radius = |r: f64| -> Vec<f32> {
            let shape = SpotShape::new(r, options.smoothing_m);
            let [_, reach] = shape.edges_m();
            // One row of positions at a time, with only the pixels near it, which are contiguous.
            let of_row = |row: usize| -> Vec<f32> {
                let y = low_m[1] + row as f64 * step_m;
                let near = |p: &Point| (p[1] - y).abs() <= reach;
                let first = positions_m.iter().position(near).unwrap_or(0);
                let end = positions_m.iter().rposition(near).map_or(first, |last| last + 1);
                let spots = Mat::from_fn(end - first, columns, |pixel, column| {
                    let [x_m, y_m] = positions_m[first + pixel];
                    shape.at((x_m - x_of(column)).powi(2) + (y_m - y).powi(2))
                });
                let responses = reduced.subcols(first, end - first) * &spots;
                responses.col_iter().flat_map(|column| column.iter().map(|v| *v as f32).collect::<Vec<_>>()).collect()
            };
            (0..rows).into_par_iter().flat_map_iter(of_row).collect()
        };
        let radii_m = (0..radii).map(|radius| (log_first + radius as f64 * log_step).exp());
        let values: Vec<f32> = radii_m.flat_map(of_radius).collect();
        Self { low_m, step_m, columns, rows, log_first, log_step, radii, length: reduced.nrows(), values }
    }

    /// The response at a position and log radius, then its derivatives by x, y (per metre) and log r, one after the
    /// other in `out` (four times the length). `None` outside the table.
    pub(super) fn evaluate(&self, position_m: Point, log_radius: f64, out: &mut [f32]) -> Option<()> {
        let Around { first, x: [wx, dx], y: [wy, dy], r: [wr, dr] } = self.around(position_m, log_radius)?;
        let (per_m, per_log) = (1.0 / self.step_m, 1.0 / self.log_step);
        let mut terms = [([0.0_f32; KINDS], 0); 64];
        for (n, (weights, start)) in terms.iter_mut().enumerate() {
            let (k, j, i) = (n / 16, n / 4 % 4, n % 4);
            let of_kind = [
                wx[i] * wy[j] * wr[k],
                dx[i] * wy[j] * wr[k] * per_m,
                wx[i] * dy[j] * wr[k] * per_m,
                wx[i] * wy[j] * dr[k] * per_log,
            ];
            *weights = of_kind.map(|weight| weight as f32);
            *start = (first + (k * self.rows + j) * self.columns + i) * self.length;
        }
        sum_up(Samples { terms: &terms, values: &self.values, length: self.length }, &mut out[..KINDS * self.length]);
        Some(())
    }

    fn around(&self, position_m: Point, log_radius: f64) -> Option<Around> {
        let (column, x) = cell((position_m[0] - self.low_m[0]) / self.step_m, self.columns)?;
        let (row, y) = cell((position_m[1] - self.low_m[1]) / self.step_m, self.rows)?;
        let (radius, r) = cell((log_radius - self.log_first) / self.log_step, self.radii)?;
        let first = (radius * self.rows + row) * self.columns + column;
        Some(Around { first, x: cubic(x), y: cubic(y), r: cubic(r) })
    }

    /// The response alone, without its derivatives; see [`Table::evaluate`].
    pub(super) fn value(&self, position_m: Point, log_radius: f64, out: &mut [f32]) -> Option<()> {
        let Around { first, x: [wx, _], y: [wy, _], r: [wr, _] } = self.around(position_m, log_radius)?;
        out.fill(0.0);
        for k in 0..4 {
            for j in 0..4 {
                let first = first + (k * self.rows + j) * self.columns;
                for i in 0..4 {
                    let entries = &self.values[(first + i) * self.length..(first + i + 1) * self.length];
                    let w = (wx[i] * wy[j] * wr[k]) as f32;
                    out.iter_mut().zip(entries).for_each(|(sum, entry)| *sum += w * entry);
                }
            }
        }
        Some(())
    }

    /// Positions between the margins, every `stride`-th along each side, metres.
    pub(super) fn places(&self, stride: usize) -> impl Iterator<Item = Point> + '_ {
        let along = move |count: usize| (MARGIN - 1..count.saturating_sub(MARGIN - 1)).step_by(stride);
        let at = |axis: usize, k: usize| self.low_m[axis] + k as f64 * self.step_m;
        along(self.rows).flat_map(move |row| along(self.columns).map(move |column| [at(0, column), at(1, row)]))
    }

    /// Length of a response.
    pub(super) fn length(&self) -> usize {
        self.length
    }

    /// True if spots are tabulated at a position.
    pub(super) fn holds(&self, position_m: Point) -> bool {
        cell((position_m[0] - self.low_m[0]) / self.step_m, self.columns).is_some()
            && cell((position_m[1] - self.low_m[1]) / self.step_m, self.rows).is_some()
    }

    /// Logarithms of the smallest and largest radius.
    pub(super) fn log_radii(&self) -> [f64; 2] {
        [self.log_first + self.log_step, self.log_first + (self.radii - 2) as f64 * self.log_step]
    }
}

/// The 4 x 4 x 4 samples around a place in the table: index of the first, and the weights and slopes along each axis.
struct Around {
    first: usize,
    x: [[f64; 4]; 2],
    y: [[f64; 4]; 2],
    r: [[f64; 4]; 2],
}

/// Samples around a place: their weights, and where each begins among the values.
struct Samples<'a> {
    terms: &'a [([f32; KINDS], usize); 64],
    values: &'a [f32],
    length: usize,
}

impl WeightedColumns for Samples<'_> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.terms.len()
    }

    #[inline(always)]
    fn column(&self, n: usize) -> ([f32; KINDS], &[f32]) {
        let (weights, start) = self.terms[n];
        (weights, &self.values[start..start + self.length])
    }
}

/// Index of the first of the four samples around a coordinate, and its fractional position between the middle two.
fn cell(at: f64, count: usize) -> Option<(usize, f64)> {
    // Rounding may put the very ends just outside.
    let at = if at < 1.0 && at > 1.0 - 1e-9 { 1.0 } else { at };
    let at = if at > (count - 2) as f64 && at < (count - 2) as f64 + 1e-9 { (count - 2) as f64 } else { at };
    if !(at >= 1.0 && at <= (count - 2) as f64) {
        return None;
    }
    let middle = (at.floor() as usize).min(count - 3);
    Some((middle - 1, at - middle as f64))
}

/// Weights of four evenly spaced samples for the value between the middle two, and for its slope.
fn cubic(t: f64) -> [[f64; 4]; 2] {
    let (t2, t3) = (t * t, t * t * t);
    [
        [
            0.5 * (-t3 + 2.0 * t2 - t),
            0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
            0.5 * (-3.0 * t3 + 4.0 * t2 + t),
            0.5 * (t3 - t2),
        ],
        [
            0.5 * (-3.0 * t2 + 4.0 * t - 1.0),
            0.5 * (9.0 * t2 - 10.0 * t),
            0.5 * (-9.0 * t2 + 8.0 * t + 1.0),
            0.5 * (3.0 * t2 - 2.0 * t),
        ],
    ]
}
