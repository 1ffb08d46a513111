//! Reads a whole file, if it is not too large.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Maximum size of a mesh file, bytes.
const MOST_BYTES: u64 = 128 << 20;

/// The bytes of a file.
///
/// # Errors
/// It is not a regular file, cannot be read, or is too large.
pub(super) fn read_whole(file: &Path) -> Result<Vec<u8>, String> {
    let found = std::fs::metadata(file).map_err(|error| error.to_string())?;
    // A device or a pipe may be endless.
    if !found.is_file() {
        return Err("not a file: expected a regular file".to_owned());
    }
    let length = found.len();
    if length > MOST_BYTES {
        return Err(format!("{length} bytes: expected at most {MOST_BYTES}"));
    }
    let mut bytes = Vec::new();
    // A file may grow while it is read.
    let opened = File::open(file).and_then(|opened| opened.take(MOST_BYTES).read_to_end(&mut bytes));
    opened.map_err(|error| error.to_string())?;
    Ok(bytes)
}
