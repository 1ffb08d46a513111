//! Magnitudes from a 16-electrode tank with adjacent drive and measuring pairs, driven pairs included. Frames are
//! columns of 256 readings, drive-major, as in the EIDORS sample data by Soleimani, Gomez-Laberge and Adler (2006).

use std::path::Path;

use super::columns;
use super::csv::Shape;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

const LAYOUT: Layout = Layout::FullMatrix { electrodes: 16 };

/// Decodes frames in columns.
///
/// # Errors
/// As [`columns::decode`], and [`DeviceError::Count`] if there are not 256 rows.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    columns::decode_as(content, file, &ReadOptions::default(), |_| LAYOUT)
}

/// True for a header that begins with the reference, and 256 rows. Tables of 256 frames with few channels have other
/// names.
pub(super) fn looks_like(shape: &Shape) -> bool {
    columns::looks_like(shape) && shape.rows == LAYOUT.channels() && shape.columns < 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_full_matrices() {
        let rows: String = (0..256).map(|row| format!("{row} {}\n", -row)).collect();
        let table = decode(format!("rest ball\n{rows}").as_bytes(), Path::new("made.csv")).unwrap();
        assert_eq!(table.layout(), &LAYOUT);
        assert_eq!(table.row(1).unwrap()[17], -17.0);
        assert!(decode(b"rest\n1\n2\n", Path::new("made.csv")).is_err());
    }
}
