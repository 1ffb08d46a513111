//! Voltages of the Kuopio Tomography Challenge 2023. Frames are columns of 2356 readings: for each of 76 injections,
//! the 31 differences e(k) - e(k+1) of 32 electrodes, injection-major.

use std::path::Path;

use super::columns;
use super::csv::Shape;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

/// Readings in a frame: 76 injections x 31 differences.
pub const CHANNELS: usize = 76 * 31;

/// Decodes frames in columns.
///
/// # Errors
/// As [`columns::decode`], and [`DeviceError::Count`] if there are not 2356 rows.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    columns::decode_as(content, file, &ReadOptions::default(), |_| Layout::Channels { count: CHANNELS })
}

/// True for a header that begins with the reference, and one row per channel.
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
