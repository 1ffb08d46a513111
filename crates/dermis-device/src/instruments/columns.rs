//! Text tables with one frame per column, below a row of frame names. Cells are as in [`super::csv`]. In a single
//! column a missing reading must be written as `nan`, because blank lines are skipped.

use std::path::Path;

use super::csv::{self, NumberTable, Shape};
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

/// Decodes frames in columns. The channels stay in the file's order.
///
/// # Errors
/// As [`csv::parse`].
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    decode_as(content, file, options, |count| Layout::Channels { count })
}

/// True if the first name only makes sense above a column of readings.
pub(super) fn looks_like(shape: &Shape) -> bool {
    let first = shape.header.as_ref().and_then(|names| names.first());
    first.is_some_and(|name| ["ref", "reference", "baseline"].contains(&name.to_ascii_lowercase().as_str()))
}

/// Decodes frames in columns, with the layout for their number of rows.
pub(super) fn decode_as(
    content: &[u8],
    file: &Path,
    options: &ReadOptions,
    layout: impl FnOnce(usize) -> Layout,
) -> Result<FrameTable, DeviceError> {
    of_table(csv::parse_with(content, file, options)?, file, layout)
}

/// Frames from a table's columns, with the layout for their number of rows.
pub(super) fn of_table(
    table: NumberTable,
    file: &Path,
    layout: impl FnOnce(usize) -> Layout,
) -> Result<FrameTable, DeviceError> {
    let layout = layout(table.rows());
    if layout.channels() != table.rows() {
        let expected = layout.channels();
        let what = "rows, one for each channel";
        return Err(DeviceError::Count { file: file.to_owned(), what, expected, found: table.rows() });
    }
    let values = (0..table.columns).flat_map(|column| table.column(column)).collect();
    let frames = FrameTable::new(layout, values, file)?.with_notes(vec!["frames in columns".to_owned()]);
    match table.header {
        Some(names) => frames.with_names(names),
        None => Ok(frames),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_become_frames_with_names() {
        let table = decode(b"ref,a\n1,4\n2,\n3,6\n", Path::new("made.csv")).unwrap();
        assert_eq!((table.frames(), table.channels()), (2, 3));
        assert_eq!(table.row(0), Some([1.0, 2.0, 3.0].as_slice()));
        assert!(table.row(1).unwrap()[1].is_nan());
        assert_eq!(table.names().unwrap(), ["ref", "a"]);
    }

    #[test]
    fn only_names_of_a_reference_are_recognised() {
        let shape = |text: &str| Shape::of(text.as_bytes(), Path::new("made.csv")).unwrap().unwrap();
        assert!(looks_like(&shape("Reference,x\n1,2\n")));
        assert!(!looks_like(&shape("x,ref\n1,2\n")));
        assert!(!looks_like(&shape("1,2\n1,2\n")));
    }
}
