//! Reads files and recognises their content.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use crate::DeviceError;

/// First bytes of every NumPy array file.
pub const NPY_MAGIC: &[u8] = b"\x93NUMPY";

/// First bytes of a ZIP archive.
pub(super) const ZIP_MAGIC: &[u8] = b"PK\x03\x04";

/// First and last bytes of every Parquet file.
pub(super) const PARQUET_MAGIC: &[u8] = b"PAR1";

/// Largest file that is read into memory, in bytes.
pub const MOST_BYTES: u64 = 1 << 30;

/// Opens a regular file for reading. Devices and pipes are refused, because they may never end or may have no writer.
///
/// # Errors
/// The operating system's errors, and [`std::io::ErrorKind::InvalidInput`] for anything but a regular file.
pub fn open_regular(path: &Path) -> std::io::Result<File> {
    let found = fs::metadata(path)?;
    if found.is_dir() {
        return Err(std::io::ErrorKind::IsADirectory.into());
    }
    if !found.is_file() {
        let text = "not a regular file; expected a file that has an end";
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, text));
    }
    File::open(path)
}

/// Reads a whole regular file, refusing more than [`MOST_BYTES`].
///
/// # Errors
/// [`DeviceError::Io`] or [`DeviceError::TooLarge`].
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, DeviceError> {
    let failed = |error| DeviceError::io(path, "read", error);
    let file = open_regular(path).map_err(failed)?;
    let found = file.metadata().map_err(failed)?.len();
    let mut content = Vec::new();
    if found <= MOST_BYTES {
        file.take(MOST_BYTES + 1).read_to_end(&mut content).map_err(failed)?;
    }
    let found = found.max(content.len() as u64);
    if found > MOST_BYTES {
        return Err(DeviceError::TooLarge { file: path.to_owned(), limit: MOST_BYTES, found });
    }
    Ok(content)
}

/// Description of the content for messages about foreign files.
pub(crate) fn describe(content: &[u8]) -> &'static str {
    const SIGNATURES: [(&[u8], &str); 18] = [
        (NPY_MAGIC, "a NumPy array (npy)"),
        (ZIP_MAGIC, "a ZIP archive that is neither npz nor xlsx (save sheets as xlsx or CSV)"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"MATLAB 5.0", "a MATLAB 5 file"),
        (b"MATLAB 7.3", "a MATLAB 7.3 file (HDF5); save it with -v7"),
        (b"\xd0\xcf\x11\xe0", "an old Office file (xls?); save it as xlsx"),
        (b"\x89MCAP0\r\n", "an MCAP recording"),
        (b"\x89PNG", "a PNG image"),
        (b"\xff\xd8\xff", "a JPEG image"),
        (b"%PDF", "a PDF document"),
        (PARQUET_MAGIC, "a Parquet file"),
        (b"\x1f\x8b", "gzip-compressed data"),
        (b"\x28\xb5\x2f\xfd", "zstd-compressed data"),
        (b"\xff\xfe", "UTF-16 text"),
        (b"\xfe\xff", "UTF-16 text"),
        (b"{", "JSON text"),
        (b"<", "XML or HTML text"),
        (b"---Draeger", "a Draeger .eit file"),
    ];
    if content.is_empty() {
        return "an empty file";
    }
    match SIGNATURES.iter().find(|(signature, _)| content.starts_with(signature)) {
        Some((_, name)) => name,
        None if content.iter().take(4096).any(|&byte| byte == 0) => "binary data",
        None if std::str::from_utf8(content).is_err() => "text or data that is not UTF-8",
        None => "other text",
    }
}

/// Makes a [`DeviceError::Foreign`] that describes the content.
pub(crate) fn foreign(file: &Path, expected: &'static str, content: &[u8]) -> DeviceError {
    DeviceError::Foreign { file: file.to_owned(), expected, found: describe(content).to_owned() }
}

/// The content as text without a byte-order mark. The error describes the content.
pub(crate) fn text_of<'a>(content: &'a [u8], file: &Path, expected: &'static str) -> Result<&'a str, DeviceError> {
    let content = content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content);
    match std::str::from_utf8(content) {
        Ok(text) if !text.contains('\0') => Ok(text),
        _ => Err(foreign(file, expected, content)),
    }
}
