//! Responses of spots in the combinations of channels of one model. The table is made once and shared by all models
//! derived from it (other noise, channels left out). Each has its own small matrix from the table's combinations to
//! its own, and applies it only to the responses that a fit asks for, not to the whole table.

use std::sync::Arc;

use faer::{Mat, MatRef};

use super::products::{KINDS, WeightedColumns, sum_up};
use super::table::Table;
use crate::mesh::Point;

#[derive(Clone, Debug)]
pub(super) struct Responses {
    table: Arc<Table>,
    /// From the table's combinations (columns) to the model's (rows); `None` where they are the same.
    combination: Option<Mat<f32>>,
}

impl Responses {
    pub(super) fn new(table: Table) -> Self {
        Self { table: Arc::new(table), combination: None }
    }

    /// Every response multiplied by a matrix.
    pub(super) fn combined(&self, matrix: MatRef<'_, f32>) -> Self {
        let combination = match &self.combination {
            Some(before) => matrix * before,
            None => matrix.to_owned(),
        };
        Self { table: self.table.clone(), combination: Some(combination) }
    }

    /// Memory for [`Responses::evaluate`].
    pub(super) fn scratch(&self) -> Vec<f32> {
        vec![0.0; if self.combination.is_some() { KINDS * self.table.length() } else { 0 }]
    }

    /// As [`Table::evaluate`], in the model's combinations.
    pub(super) fn evaluate(
        &self,
        position_m: Point,
        log_radius: f64,
        scratch: &mut [f32],
        out: &mut [f32],
    ) -> Option<()> {
        let Some(combination) = &self.combination else { return self.table.evaluate(position_m, log_radius, out) };
        self.table.evaluate(position_m, log_radius, scratch)?;
        sum_up(Combined { matrix: combination, from: scratch }, &mut out[..KINDS * combination.nrows()]);
        Some(())
    }

    /// As [`Table::value`], in the model's combinations.
    pub(super) fn value(&self, position_m: Point, log_radius: f64, scratch: &mut [f32], out: &mut [f32]) -> Option<()> {
        if self.combination.is_none() {
            return self.table.value(position_m, log_radius, out);
        }
        let tabulated = &mut scratch[..self.table.length()];
        self.table.value(position_m, log_radius, tabulated)?;
        self.combine_one(tabulated, out);
        Some(())
    }

    /// Converts one response from the table's combinations to the model's.
    pub(super) fn combine_one(&self, tabulated: &[f32], out: &mut [f32]) {
        match &self.combination {
            None => out.copy_from_slice(tabulated),
            Some(matrix) => {
                out.fill(0.0);
                for (value, column) in tabulated.iter().zip(matrix.col_iter()) {
                    out.iter_mut().zip(column.iter()).for_each(|(sum, entry)| *sum += value * entry);
                }
            }
        }
    }

    /// Positions of the table, every `stride`-th along each side, metres.
    pub(super) fn places(&self, stride: usize) -> impl Iterator<Item = Point> + '_ {
        self.table.places(stride)
    }

    /// True if spots are tabulated at a position.
    pub(super) fn holds(&self, position_m: Point) -> bool {
        self.table.holds(position_m)
    }

    /// Logarithms of the smallest and largest radius.
    pub(super) fn log_radii(&self) -> [f64; 2] {
        self.table.log_radii()
    }
}

/// A matrix times each kind of value of a response; the values are stored one kind after the other.
struct Combined<'a> {
    matrix: &'a Mat<f32>,
    from: &'a [f32],
}

impl WeightedColumns for Combined<'_> {
    #[inline(always)]
    fn count(&self) -> usize {
        self.matrix.ncols()
    }

    #[inline(always)]
    fn column(&self, n: usize) -> ([f32; KINDS], &[f32]) {
        let length = self.matrix.ncols();
        ([0, 1, 2, 3].map(|kind| self.from[kind * length + n]), self.matrix.col_as_slice(n))
    }
}
