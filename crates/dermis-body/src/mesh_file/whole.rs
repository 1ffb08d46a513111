//! Reads a whole file, if it is not too large.

use std::path::Path;

/// Maximum size of a mesh file, bytes.
const MOST_BYTES: u64 = 128 << 20;

/// The bytes of a file.
///
/// # Errors
/// It cannot be read, or is too large.
pub(super) fn read_whole(file: &Path) -> Result<Vec<u8>, String> {
    let length = std::fs::metadata(file).map_err(|error| error.to_string())?.len();
    if length > MOST_BYTES {
        return Err(format!("{length} bytes: expected at most {MOST_BYTES}"));
    }
    std::fs::read(file).map_err(|error| error.to_string())
}
