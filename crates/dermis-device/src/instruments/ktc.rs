//! Voltages of the Kuopio Tomography Challenge 2023: frames in columns of 2356 readings, 76 injections times the 31
//! differences e(k) - e(k+1) of 32 electrodes, injection-major.

use std::path::Path;

use super::columns;
use super::csv::Shape;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

/// Readings in a frame: 76 injections x 31 differences.
pub const CHANNELS: usize = 76 * 31;

/// Frames in columns.
///
/// # Errors
/// As [`columns::decode`], and [`DeviceError::Count`] for another number of rows.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    columns::decode_as(content, file, &ReadOptions::default(), |_| Layout::Channels { count: CHANNELS })
}

/// A head that begins with the reference, and as many rows as there are channels.
pub(super) fn looks_like(shape: &Shape) -> bool {
    columns::looks_like(shape) && shape.rows == CHANNELS && shape.columns < 32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_too_few_is_counted() {
        let mut text = String::from("ref,x\n");
        for row in 1..CHANNELS {
            text += &format!("{row},{row}.5\n");
        }
        let error = decode(text.as_bytes(), Path::new("v.csv")).unwrap_err();
        assert_eq!(error.to_string(), "v.csv: expected 2356 rows, one for each channel, found 2355");
        text += "nan,0\n";
        let table = decode(text.as_bytes(), Path::new("v.csv")).unwrap();
        assert_eq!(table.row(1).unwrap()[..2], [1.5, 2.5]);
        assert!(table.row(0).unwrap()[CHANNELS - 1].is_nan());
    }
}
