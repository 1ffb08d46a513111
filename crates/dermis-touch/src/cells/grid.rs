//! Pixel positions of a flat grid on the skin.

use crate::error::{TouchError, require};
use serde::{Deserialize, Serialize};

/// A grid of square pixels in the skin's frame (x right, y up, metres).
///
/// Images on it are row-major with row 0 at the top: the pixel in row `r` and column `c` has index `r * columns + c`
/// and its centre at `(left_m + (c + 1/2) pixel_m, top_m - (r + 1/2) pixel_m)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridGeometry {
    /// Pixels in x.
    pub columns: usize,
    /// Pixels in y.
    pub rows: usize,
    /// Edge length of a pixel, metres.
    pub pixel_m: f64,
    /// x of the grid's left edge (not of a pixel centre), metres.
    pub left_m: f64,
    /// y of the grid's top edge (not of a pixel centre), metres.
    pub top_m: f64,
}

impl GridGeometry {
    /// A grid of `columns` x `rows` pixels of edge `pixel_m` centred on the origin.
    #[must_use]
    pub fn centred(columns: usize, rows: usize, pixel_m: f64) -> Self {
        let left_m = -0.5 * columns as f64 * pixel_m;
        Self { columns, rows, pixel_m, left_m, top_m: 0.5 * rows as f64 * pixel_m }
    }

    /// Number of pixels, inside and outside the skin.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// True if the grid has no pixels.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Position of a point in pixel coordinates (column, row), where whole numbers are pixel centres.
    #[must_use]
    pub fn position_m(&self, column: f64, row: f64) -> [f64; 2] {
        [self.left_m + (column + 0.5) * self.pixel_m, self.top_m - (row + 0.5) * self.pixel_m]
    }

    /// Centre of the pixel with index `index` of the row-major image.
    #[must_use]
    pub fn pixel_centre_m(&self, index: usize) -> [f64; 2] {
        self.position_m((index % self.columns) as f64, (index / self.columns) as f64)
    }

    /// Index of the pixel that contains a point, if any.
    #[must_use]
    pub fn pixel_at(&self, position_m: [f64; 2]) -> Option<usize> {
        let column = ((position_m[0] - self.left_m) / self.pixel_m).floor();
        let row = ((self.top_m - position_m[1]) / self.pixel_m).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// Pixels that share an edge with this one: left, right, above, below.
    pub(crate) fn edge_neighbours(&self, index: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (index % self.columns, index / self.columns);
        let neighbours = [
            (column > 0).then(|| index - 1),
            (column + 1 < self.columns).then(|| index + 1),
            (row > 0).then(|| index - self.columns),
            (row + 1 < self.rows).then(|| index + self.columns),
        ];
        neighbours.into_iter().flatten()
    }

    /// Pixels that share an edge or a corner with this one, row by row.
    pub(crate) fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (index % self.columns, index / self.columns);
        let rows = row.saturating_sub(1)..=(row + 1).min(self.rows - 1);
        let columns = column.saturating_sub(1)..=(column + 1).min(self.columns - 1);
        let stride = self.columns;
        let around = rows.flat_map(move |row| columns.clone().map(move |column| row * stride + column));
        around.filter(move |&other| other != index)
    }

    /// Checks that the grid has pixels and finite, positive sizes.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] naming the field.
    pub fn validate(&self) -> Result<(), TouchError> {
        require(self.columns > 0, "columns", self.columns as f64, "at least 1")?;
        require(self.rows > 0, "rows", self.rows as f64, "at least 1")?;
        let fits = self.columns.checked_mul(self.rows).is_some_and(|n| n < u32::MAX as usize);
        require(fits, "columns * rows", self.columns as f64 * self.rows as f64, "fewer than 2^32 pixels")?;
        require(self.pixel_m.is_finite() && self.pixel_m > 0.0, "pixel_m", self.pixel_m, "finite and above 0")?;
        require(self.left_m.is_finite(), "left_m", self.left_m, "finite")?;
        require(self.top_m.is_finite(), "top_m", self.top_m, "finite")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn row_zero_is_at_the_top() {
        let grid = GridGeometry::centred(4, 2, 0.01);
        let first = grid.pixel_centre_m(0);
        let last = grid.pixel_centre_m(7);
        // 0.01 is not exact in binary: allow for rounding only.
        assert!((first[0] + 0.015).abs() < 1e-15 && (first[1] - 0.005).abs() < 1e-15);
        assert!((last[0] - 0.015).abs() < 1e-15 && (last[1] + 0.005).abs() < 1e-15);
    }

    #[test]
    fn pixels_know_their_neighbours() {
        let grid = GridGeometry::centred(3, 3, 0.01);
        assert_eq!(grid.neighbours(4).collect::<Vec<_>>(), [0, 1, 2, 3, 5, 6, 7, 8]);
        assert_eq!(grid.neighbours(2).collect::<Vec<_>>(), [1, 4, 5]);
        assert_eq!(grid.edge_neighbours(4).collect::<Vec<_>>(), [3, 5, 1, 7]);
        assert_eq!(grid.edge_neighbours(6).collect::<Vec<_>>(), [7, 3]);
        assert_eq!(grid.pixel_at([0.014, 0.014]), Some(2));
        assert_eq!(grid.pixel_at([0.016, 0.0]), None);
    }

    #[test]
    fn impossible_grids_are_named() {
        let error = GridGeometry::centred(4, 0, 0.01).validate().unwrap_err();
        assert_eq!(error.to_string(), "rows = 0: expected at least 1");
        assert!(GridGeometry::centred(4, 4, f64::NAN).validate().is_err());
    }
}
