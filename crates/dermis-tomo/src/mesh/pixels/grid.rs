//! The pixel grid of images.

use crate::mesh::core::{Mesh, MeshError};
use crate::mesh::plane::Point;
use crate::mesh::shapes;

/// Maximum number of pixels along a side.
const MOST_PIXELS: usize = 8192;

/// Square pixels in rows, row 0 at the top (+y), column 0 at the left (-x).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelGrid {
    /// Number of pixels in a row.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// x of the left edge, metres.
    pub left_m: f64,
    /// y of the top edge, metres.
    pub top_m: f64,
    /// Side of a pixel, metres.
    pub pixel_m: f64,
}

impl PixelGrid {
    /// The grid over a rectangle with `pixels` along its longer side. The shorter side gets as many as cover it; any
    /// excess is split between its two ends. For a disc, pass its full diameter
    /// ([`Outline::bounds_m`](crate::mesh::Outline::bounds_m)): the bounds of the mesh are slightly smaller.
    ///
    /// # Errors
    /// Bounds that are not finite or in the wrong order, and pixel counts of 0 or above 8192.
    pub fn covering(low_m: Point, high_m: Point, pixels: usize) -> Result<Self, MeshError> {
        let (width, height) = (high_m[0] - low_m[0], high_m[1] - low_m[1]);
        shapes::check_length("grid width", width)?;
        shapes::check_length("grid height", height)?;
        check_count("pixels", pixels)?;
        let pixel_m = width.max(height) / pixels as f64;
        // Rounding must not add a pixel to a rectangle that is a whole number of pixels wide.
        let count = |side: f64| ((side / pixel_m - 1e-9).ceil() as usize).max(1);
        let (columns, rows) = (count(width), count(height));
        let left_m = (low_m[0] + high_m[0] - columns as f64 * pixel_m) / 2.0;
        let top_m = (low_m[1] + high_m[1] + rows as f64 * pixel_m) / 2.0;
        Ok(Self { columns, rows, left_m, top_m, pixel_m })
    }

    /// The grid over a mesh's bounds.
    ///
    /// # Errors
    /// As [`PixelGrid::covering`].
    pub fn over_mesh(mesh: &Mesh, pixels: usize) -> Result<Self, MeshError> {
        let (low, high) = mesh.bounds();
        Self::covering([low[0], low[1]], [high[0], high[1]], pixels)
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// True if there are no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Centre of a pixel given by its row-major index, metres.
    pub fn centre_m(&self, index: usize) -> Point {
        let (row, column) = (index / self.columns, index % self.columns);
        [self.left_m + (column as f64 + 0.5) * self.pixel_m, self.top_m - (row as f64 + 0.5) * self.pixel_m]
    }

    /// Centres of all pixels, row-major, metres.
    pub fn centres_m(&self) -> Vec<Point> {
        (0..self.len()).map(|index| self.centre_m(index)).collect()
    }

    /// Row-major index of the pixel that contains a point, if any.
    pub fn pixel_at(&self, point_m: Point) -> Option<usize> {
        let column = ((point_m[0] - self.left_m) / self.pixel_m).floor();
        let row = ((self.top_m - point_m[1]) / self.pixel_m).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    pub(super) fn check(&self) -> Result<(), MeshError> {
        check_count("columns", self.columns)?;
        check_count("rows", self.rows)?;
        shapes::check_length("pixel_m", self.pixel_m)?;
        shapes::check_coordinate("left_m", self.left_m)?;
        shapes::check_coordinate("top_m", self.top_m)
    }

    /// Grid line number `k` across x (from the left) or y (from the bottom).
    pub(super) fn line(&self, axis: usize, k: usize) -> f64 {
        match axis {
            0 => self.left_m + k as f64 * self.pixel_m,
            _ => self.top_m - (self.rows - k) as f64 * self.pixel_m,
        }
    }

    pub(super) fn count(&self, axis: usize) -> usize {
        if axis == 0 { self.columns } else { self.rows }
    }
}

fn check_count(field: &'static str, count: usize) -> Result<(), MeshError> {
    if (1..=MOST_PIXELS).contains(&count) {
        return Ok(());
    }
    Err(MeshError::Shape { field, value: count.to_string(), expected: format!("between 1 and {MOST_PIXELS}") })
}
