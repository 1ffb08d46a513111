//! Stands in for the reader of NumPy archives in a browser, where nothing opens files: the ZIP library would import
//! functions that the page does not have.

use std::path::Path;

use crate::{DeviceError, FrameTable, ReadOptions};

/// Refuses the archive.
///
/// # Errors
/// Always [`DeviceError::Foreign`].
pub fn decode(_content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    let expected = "a file that this build can read";
    Err(DeviceError::Foreign { file: file.to_owned(), expected, found: "an archive (ZIP)".to_owned() })
}

pub(super) fn looks_like(_content: &[u8]) -> bool {
    false
}

pub(super) fn is_npz(_path: &Path) -> bool {
    false
}

pub(super) fn read_frames(path: &Path, _options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    decode(&[], path)
}

pub(super) fn holds(_content: &[u8], _name: &str) -> bool {
    false
}

pub(super) fn decode_with(content: &[u8], file: &Path, _options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    decode(content, file)
}
