//! A reference frame next to a target frame: four columns without a header, one channel per row. The columns are the
//! real and imaginary parts of the reference, then of the target.

use std::path::Path;

use super::csv::{self, NumberTable, Shape};
use crate::{DeviceError, FrameTable, Layout};

/// Decodes two complex frames named `reference` and `target`.
///
/// # Errors
/// As [`csv::parse`], and [`DeviceError::Count`] if there are not four columns.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    let table = csv::parse(content, file)?;
    if table.columns != 4 {
        let what = "columns (real and imaginary part of reference and target)";
        return Err(DeviceError::Count { file: file.to_owned(), what, expected: 4, found: table.columns });
    }
    let pair = |first, second| table.column(first).chain(table.column(second)).collect();
    FrameTable::new(Layout::Channels { count: table.rows() }, pair(0, 2), file)?
        .with_imaginary(pair(1, 3))?
        .with_names(vec!["reference".to_owned(), "target".to_owned()])
}

/// True for four columns without a header and n(n-3) rows: with n electrodes, the number of adjacent measurements
/// that leave out the driven electrodes.
pub(super) fn looks_like(shape: &Shape) -> bool {
    shape.header.is_none()
        && shape.columns == 4
        && (8..=64).any(|electrodes| shape.rows == electrodes * (electrodes - 3))
}

/// True if the numbers look like two frames, so that target and reference differ less than the channels do. If the
/// rows were frames of four channels, rows would be similar and columns would not.
pub(super) fn holds_two_frames(table: &NumberTable) -> bool {
    let spread = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    };
    let (reference, target): (Vec<f64>, Vec<f64>) = (table.column(0).collect(), table.column(2).collect());
    let differences: Vec<f64> = reference.iter().zip(&target).map(|(a, b)| a - b).collect();
    let size = (differences.iter().map(|value| value * value).sum::<f64>() / differences.len() as f64).sqrt();
    size < 0.5 * spread(&reference)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_four_columns_are_two_complex_frames() {
        let table = decode(b"1,-2,3,-4\n5,-6,7,-8\n", Path::new("made.csv")).unwrap();
        assert_eq!(table.row(0), Some([1.0, 5.0].as_slice()));
        assert_eq!(table.imaginary_row(0), Some([-2.0, -6.0].as_slice()));
        assert_eq!(table.row(1), Some([3.0, 7.0].as_slice()));
        assert_eq!(table.imaginary_row(1), Some([-4.0, -8.0].as_slice()));
    }

    #[test]
    fn another_number_of_columns_is_refused() {
        let error = decode(b"1,2,3\n", Path::new("made.csv")).unwrap_err().to_string();
        assert!(error.contains("expected 4 columns") && error.ends_with("found 3"), "{error}");
    }
}
