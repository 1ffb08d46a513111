//! Archives of NumPy arrays (`.npz`). One array holds the frames, another may hold their times.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use zip::ZipArchive;

use super::arrays::{self, MOST_ARRAYS, Named};
use super::content::{ZIP_MAGIC, open_regular};
use super::npy::{self, Header};
use crate::{DeviceError, FrameTable, ReadOptions};

/// Decodes frames from the only array that can hold them.
///
/// # Errors
/// [`DeviceError::Foreign`] if it isn't such an archive, [`DeviceError::Field`] if no array or several could hold
/// frames, and errors in the array itself.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

/// True if a ZIP archive contains arrays.
pub(super) fn looks_like(content: &[u8]) -> bool {
    holds_arrays(Cursor::new(content))
}

fn holds_arrays(input: impl Read + Seek) -> bool {
    let is_array =
        |name: zip::result::ZipResult<std::borrow::Cow<'_, str>>| name.is_ok_and(|name| name.ends_with(".npy"));
    ZipArchive::new(input).is_ok_and(|archive| archive.file_names().any(is_array))
}

fn open(path: &Path) -> std::io::Result<BufReader<File>> {
    open_regular(path).map(BufReader::new)
}

/// As [`looks_like`], for a path.
pub(super) fn is_npz(path: &Path) -> bool {
    let begins = |mut file: BufReader<File>| {
        let mut first = [0; ZIP_MAGIC.len()];
        file.read_exact(&mut first).is_ok() && first == ZIP_MAGIC
    };
    open(path).is_ok_and(begins) && open(path).is_ok_and(holds_arrays)
}

/// Reads frames from a file. Only the numbers are held in memory.
pub(super) fn read_frames(path: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    frames(open(path).map_err(|error| DeviceError::io(path, "read", error))?, path, options)
}

/// True if a ZIP archive has an entry with this name.
pub(super) fn holds(content: &[u8], name: &str) -> bool {
    ZipArchive::new(Cursor::new(content)).is_ok_and(|archive| archive.index_for_name(name).is_some())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    frames(Cursor::new(content), file, options)
}

fn frames(input: impl Read + Seek, file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let broken = |found: String| DeviceError::Foreign {
        file: file.to_owned(),
        expected: "an archive of NumPy arrays (npz)",
        found,
    };
    let mut archive = ZipArchive::new(input).map_err(|error| broken(error.to_string()))?;
    if archive.len() > MOST_ARRAYS {
        return Err(broken(format!("{} entries", archive.len())));
    }
    let (mut entries, mut indices) = (Vec::new(), Vec::new());
    let mut unreadable = Vec::new();
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(|error| broken(error.to_string()))?;
        let name = entry.name().map_err(|error| broken(error.to_string()))?.into_owned();
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let length = entry.size();
        match Header::read(&mut entry, length, file) {
            Ok((header, _)) => {
                entries.push(Named { name, shape: header.shape });
                indices.push(index);
            }
            // Arrays of text and objects can't be frames.
            Err(error) => unreadable.push((name, error)),
        }
    }
    if let Some(wanted) = &options.array
        && let Some(at) = unreadable.iter().position(|(name, _)| name == wanted)
    {
        return Err(unreadable.remove(at).1);
    }
    let chosen = arrays::choose(&entries, file, options)?;
    let mut read = |which: usize| {
        let input = archive.by_index(indices[which]).map_err(|error| broken(error.to_string()))?;
        let length = input.size();
        npy::read_from(&mut input.take(length), length, file)
    };
    let frames = arrays::with_notes(read(chosen)?.into_frames_with(file, options)?, &entries, chosen);
    match arrays::clock(&entries, chosen, frames.frames()) {
        Some(clock) => arrays::with_times(frames, &entries[clock], &read(clock)?.values),
        None => Ok(frames),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use zip::write::SimpleFileOptions;

    fn archive(arrays: &[(&str, &[usize], f64)]) -> Vec<u8> {
        let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, shape, first) in arrays {
            let deflated = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
            writer.start_file(format!("{name}.npy"), deflated).unwrap();
            npy::write_header::<f64>(&mut writer, shape).unwrap();
            for index in 0..shape.iter().product::<usize>() {
                writer.write_all(&(first + 0.02 * index as f64).to_le_bytes()).unwrap();
            }
        }
        writer.finish().unwrap().into_inner()
    }

    #[test]
    fn the_array_of_frames_is_found_asked_for_or_asked_about() {
        let content = archive(&[("t", &[4], 5.0), ("run", &[4, 3], 0.5), ("gain", &[2, 2], 1.0)]);
        let path = Path::new("a.npz");
        let decoded = |options: ReadOptions| decode_with(&content, path, &options);
        let table = decoded(ReadOptions::default().with_channels([3])).unwrap();
        assert_eq!((table.frames(), table.channels()), (4, 3));
        assert!((table.times_s().unwrap()[3] - 5.06).abs() < 1e-9);
        assert!(table.understood().contains("array `run`"), "{}", table.understood());
        let question = decoded(ReadOptions::default()).unwrap_err().to_string();
        assert!(question.contains("--array: expected one of t (4), run (4, 3), gain (2, 2)"), "{question}");
        let chosen = decoded(ReadOptions { array: Some("gain".into()), ..ReadOptions::default() }).unwrap();
        assert_eq!(chosen.channels(), 2);
        assert!(decoded(ReadOptions { array: Some("x".into()), ..ReadOptions::default() }).is_err());
        assert!(looks_like(&content) && !looks_like(b"PK\x03\x04"));
        for length in [0, 10, content.len() / 2, content.len() - 1] {
            assert!(decode(&content[..length], path).is_err());
        }
    }
}
