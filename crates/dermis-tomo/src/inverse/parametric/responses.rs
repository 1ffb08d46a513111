//! Responses of spots in the combinations of channels of one model. The table is made once and shared by all models
//! derived from it (other noise, channels left out). Each has its own small matrix from the table's combinations to
//! its own, and applies it only to the responses that a fit asks for, not to the whole table.

use std::sync::Arc;

use faer::{Mat, MatRef};

use super::table::Table;

/// Values per response: the response itself, and its derivatives by x, y and log r.
const KINDS: usize = 4;

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
        position_m: [f64; 2],
        log_radius: f64,
        scratch: &mut [f32],
        out: &mut [f32],
    ) -> Option<()> {
        let Some(combination) = &self.combination else { return self.table.evaluate(position_m, log_radius, out) };
        self.table.evaluate(position_m, log_radius, scratch)?;
        combine(combination, scratch, out);
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
    pub(super) fn places(&self, stride: usize) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.table.places(stride)
    }

    /// True if spots are tabulated at a position.
    pub(super) fn holds(&self, position_m: [f64; 2]) -> bool {
        self.table.holds(position_m)
    }

    /// Logarithms of the smallest and largest radius.
    pub(super) fn log_radii(&self) -> [f64; 2] {
        self.table.log_radii()
    }
}

/// Multiplies all values of a response, stored one after the other in `from` and `out`, by a matrix that is read only
/// once.
fn combine(matrix: &Mat<f32>, from: &[f32], out: &mut [f32]) {
    let (length, rows) = (matrix.ncols(), matrix.nrows());
    out.fill(0.0);
    let (value, rest) = out.split_at_mut(rows);
    let (by_x, rest) = rest.split_at_mut(rows);
    let (by_y, by_r) = rest.split_at_mut(rows);
    let by_r = &mut by_r[..rows];
    for n in 0..length {
        let [v, x, y, r] = [0, 1, 2, 3].map(|kind| from[kind * length + n]);
        let column = &matrix.col_as_slice(n)[..rows];
        for k in 0..rows {
            value[k] += v * column[k];
            by_x[k] += x * column[k];
            by_y[k] += y * column[k];
            by_r[k] += r * column[k];
        }
    }
}
