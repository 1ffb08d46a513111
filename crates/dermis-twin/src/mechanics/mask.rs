//! Faces of indenters given as pictures: a handprint, a letter, a gripper pad.

use dermis_tomo::mesh::Point;
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check};

/// Maximum number of rows and of columns of a [`Mask`].
pub const MOST_MASK_CELLS: usize = 32;

/// A picture of square cells that press (`#`) or do not (`.`), with row 0 at the top (+y) and its centre at the
/// indenter's centre. As text, it is a list of rows of equal length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>", into = "Vec<String>")]
pub struct Mask {
    /// Bit c of row r is the cell in column c.
    bits: [u32; MOST_MASK_CELLS],
    rows: u8,
    columns: u8,
}

impl Mask {
    /// Builds a mask from its rows.
    ///
    /// ```
    /// use dermis_twin::mechanics::Mask;
    ///
    /// let bow = Mask::from_rows(&[".##.", "#..#"])?;
    /// assert_eq!((bow.rows(), bow.columns(), bow.pressed_cells()), (2, 4, 4));
    /// # Ok::<(), dermis_twin::TwinError>(())
    /// ```
    ///
    /// # Errors
    /// No rows or more than 32, rows of different lengths or longer than 32, other characters, or no pressing cell.
    pub fn from_rows<S: AsRef<str>>(rows: &[S]) -> Result<Self, TwinError> {
        let most = MOST_MASK_CELLS as f64;
        check("mask rows", rows.len() as f64, 1.0, most, "1 to 32")?;
        let columns = rows.first().map_or(0, |row| row.as_ref().chars().count());
        check("mask columns", columns as f64, 1.0, most, "1 to 32")?;
        let mut mask = Self { bits: [0; MOST_MASK_CELLS], rows: rows.len() as u8, columns: columns as u8 };
        for (bits, row) in mask.bits.iter_mut().zip(rows) {
            let length = row.as_ref().chars().count() as f64;
            check("mask columns", length, columns as f64, columns as f64, "rows of equal length")?;
            for (column, cell) in row.as_ref().chars().enumerate() {
                match cell {
                    '#' => *bits |= 1 << column,
                    '.' => {}
                    other => {
                        let (value, expected) = (f64::from(u32::from(other)), "'#' (35) or '.' (46)");
                        return Err(TwinError::Value { field: "mask cell (code point)", value, expected });
                    }
                }
            }
        }
        check("mask cells that press", mask.pressed_cells() as f64, 1.0, f64::MAX, "at least 1")?;
        Ok(mask)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        usize::from(self.rows)
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        usize::from(self.columns)
    }

    /// True if a cell presses; false outside the picture.
    pub fn presses(&self, row: usize, column: usize) -> bool {
        row < self.rows() && column < self.columns() && self.bits[row] >> column & 1 == 1
    }

    /// Number of cells that press.
    pub fn pressed_cells(&self) -> usize {
        self.bits.iter().map(|bits| bits.count_ones() as usize).sum()
    }

    /// Sum of the smoothed indicator functions of all pressing cells at a position, in cells from the centre (x
    /// right, y up); `below(edge, position)` is the smoothed step at an edge.
    pub(super) fn profile(&self, [x, y]: Point, below: impl Fn(f64, f64) -> f64) -> f64 {
        let (left, top) = (-0.5 * f64::from(self.columns), 0.5 * f64::from(self.rows));
        let mut across = [0.0; MOST_MASK_CELLS];
        let mut before = below(left, x);
        for (column, share) in across.iter_mut().enumerate().take(self.columns()) {
            let after = below(left + column as f64 + 1.0, x);
            *share = after - before;
            before = after;
        }
        let mut sum = 0.0;
        let mut above = below(top, y);
        for (row, bits) in self.bits.iter().enumerate().take(self.rows()) {
            let under = below(top - row as f64 - 1.0, y);
            let pressed = across.iter().enumerate().filter(|(column, _)| bits >> column & 1 == 1);
            sum += (above - under) * pressed.map(|(_, share)| share).sum::<f64>();
            above = under;
        }
        sum
    }
}

impl TryFrom<Vec<String>> for Mask {
    type Error = TwinError;

    fn try_from(rows: Vec<String>) -> Result<Self, TwinError> {
        Self::from_rows(&rows)
    }
}

impl From<Mask> for Vec<String> {
    fn from(mask: Mask) -> Self {
        let cell = |row, column| if mask.presses(row, column) { '#' } else { '.' };
        (0..mask.rows()).map(|row| (0..mask.columns()).map(|column| cell(row, column)).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_survives_parsing_and_printing() {
        let rows = vec!["#..".to_string(), ".##".to_string()];
        let mask = Mask::try_from(rows.clone()).unwrap();
        assert!(mask.presses(0, 0) && mask.presses(1, 2) && !mask.presses(0, 2) && !mask.presses(9, 0));
        assert_eq!(Vec::from(mask), rows);
    }

    #[test]
    fn bad_input_is_refused() {
        assert!(Mask::from_rows::<&str>(&[]).is_err());
        assert!(Mask::from_rows(&["##", "#"]).is_err());
        assert!(Mask::from_rows(&["..", ".."]).is_err());
        let error = Mask::from_rows(&["#x"]).unwrap_err().to_string();
        assert_eq!(error, "mask cell (code point): 120 refused; expected '#' (35) or '.' (46)");
        assert!(Mask::from_rows(&["#".repeat(33)]).is_err());
    }
}
