//! Uneven sheets: a position-dependent factor on the conductance.

use dermis_tomo::mesh::Point;

/// A factor on the sheet conductance over the skin.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum ConductanceMap {
    /// 1 everywhere.
    #[default]
    Even,
    /// Bilinear interpolation of values on a grid, with rows from the bottom, metres.
    Grid {
        /// Bottom left corner.
        low_m: Point,
        /// Distance between neighbouring values along x and y.
        step_m: [f64; 2],
        /// Number of values in a row.
        columns: usize,
        /// The factors, row by row.
        factors: Vec<f64>,
    },
}

impl ConductanceMap {
    /// The factor at a place, metres.
    pub fn at(&self, place_m: Point) -> f64 {
        let Self::Grid { low_m, step_m, columns, factors } = self else { return 1.0 };
        let rows = factors.len() / columns;
        let along = |axis: usize, count: usize| {
            let x = ((place_m[axis] - low_m[axis]) / step_m[axis]).clamp(0.0, (count - 1) as f64);
            let k = (x as usize).min(count.saturating_sub(2));
            (k, x - k as f64)
        };
        let ((i, s), (j, t)) = (along(0, *columns), along(1, rows));
        let at = |row: usize, column: usize| factors[row.min(rows - 1) * columns + column.min(columns - 1)];
        let across = |row: usize| (1.0 - s) * at(row, i) + s * at(row, i + 1);
        (1.0 - t) * across(j) + t * across(j + 1)
    }
}

impl ConductanceMap {
    /// True if the factor is 1 everywhere.
    pub fn is_even(&self) -> bool {
        *self == Self::Even
    }
}
