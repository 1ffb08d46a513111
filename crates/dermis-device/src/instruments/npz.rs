//! Archives of NumPy arrays (`.npz`), of which one holds the frames and another may hold their times.

use std::io::{Cursor, Read};
use std::path::Path;

use zip::ZipArchive;

use super::npy::{self, Header};
use super::{csv, times};
use crate::error::shorten;
use crate::{DeviceError, FrameTable, ReadOptions};

/// Most arrays that an archive may hold.
const MOST_ARRAYS: usize = 1000;
/// Names of the array with the frames, where several would do.
const USUAL: [&str; 8] = ["frames", "voltages", "readings", "data", "v", "V", "measurements", "arr_0"];

/// Frames of the only array that can hold them.
///
/// # Errors
/// [`DeviceError::Foreign`] if it is no such archive, [`DeviceError::Field`] where several arrays would do or none, and
/// what is wrong with the array.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

/// Whether a ZIP archive holds arrays.
pub(super) fn looks_like(content: &[u8]) -> bool {
    let is_array =
        |name: zip::result::ZipResult<std::borrow::Cow<'_, str>>| name.is_ok_and(|name| name.ends_with(".npy"));
    ZipArchive::new(Cursor::new(content)).is_ok_and(|archive| archive.file_names().any(is_array))
}

/// An array of the archive.
struct Entry {
    index: usize,
    name: String,
    shape: Vec<usize>,
}

impl Entry {
    /// `frames (40, 208)`.
    fn described(&self) -> String {
        let lengths: Vec<String> = self.shape.iter().map(usize::to_string).collect();
        format!("{} ({})", shorten(&self.name), lengths.join(", "))
    }
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let broken = |found: String| DeviceError::Foreign {
        file: file.to_owned(),
        expected: "an archive of NumPy arrays (npz)",
        found,
    };
    let mut archive = ZipArchive::new(Cursor::new(content)).map_err(|error| broken(error.to_string()))?;
    if archive.len() > MOST_ARRAYS {
        return Err(broken(format!("{} entries", archive.len())));
    }
    let mut entries = Vec::new();
    let mut unreadable = Vec::new();
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(|error| broken(error.to_string()))?;
        let name = entry.name().map_err(|error| broken(error.to_string()))?.into_owned();
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let length = entry.size();
        match Header::read(&mut entry, length, file) {
            Ok((header, _)) => entries.push(Entry { index, name, shape: header.shape }),
            // Text and objects are no frames.
            Err(error) => unreadable.push((name, error)),
        }
    }
    if let Some(wanted) = &options.array
        && let Some(at) = unreadable.iter().position(|(name, _)| name == wanted)
    {
        return Err(unreadable.remove(at).1);
    }
    let chosen = choose(&entries, file, options)?;
    let mut read = |entry: &Entry| {
        let input = archive.by_index(entry.index).map_err(|error| broken(error.to_string()))?;
        let length = input.size();
        npy::read_from(&mut input.take(length), length, file)
    };
    let frames = read(chosen)?.into_frames_with(file, options)?;
    let mut notes = vec![format!("array `{}`", shorten(&chosen.name))];
    if entries.len() > 1 {
        let others: Vec<String> =
            entries.iter().filter(|entry| entry.index != chosen.index).take(6).map(Entry::described).collect();
        notes.push(format!("others: {}", others.join(", ")));
    }
    let has_times = |entry: &&Entry| entry.shape == [frames.frames()] && csv::is_time(&entry.name).is_some();
    let Some(clock) = entries.iter().filter(|entry| entry.index != chosen.index).find(has_times) else {
        return Ok(frames.with_notes(notes));
    };
    let name = format!("array `{}`", shorten(&clock.name));
    notes.push(format!("times from {name}"));
    let values = read(clock)?.values;
    let mut times_s = times::seconds(&values, csv::is_time(&clock.name).flatten(), &name, &mut notes);
    times::mend(&mut times_s, &mut notes);
    Ok(frames.with_times_s(times_s)?.with_notes(notes))
}

/// The array that was asked for, the only one of frames, or one by its usual name.
fn choose<'a>(entries: &'a [Entry], file: &Path, options: &ReadOptions) -> Result<&'a Entry, DeviceError> {
    let listed = || entries.iter().take(12).map(Entry::described).collect::<Vec<_>>().join(", ");
    let refuse = |found: &str| DeviceError::field(file, 1, "--array", found, format!("one of {}", listed()));
    if let Some(wanted) = &options.array {
        return entries.iter().find(|entry| entry.name == *wanted).ok_or_else(|| refuse(wanted));
    }
    let is_of_skin = |entry: &&Entry| {
        let product = |lengths: &[usize]| lengths.iter().product::<usize>();
        let shape = &entry.shape;
        options.channels.iter().any(|&channels| {
            shape.last() == Some(&channels)
                || (shape.len() > 1 && (product(&shape[1..]) == channels || shape[0] == channels))
        })
    };
    let is_of_many = |entry: &&Entry| entry.shape.len() > 1 && csv::is_time(&entry.name).is_none();
    let of_skin: Vec<&Entry> = entries.iter().filter(is_of_skin).collect();
    let candidates = if of_skin.is_empty() { entries.iter().filter(is_of_many).collect() } else { of_skin };
    match candidates[..] {
        [only] => Ok(only),
        [] if entries.len() == 1 => Ok(&entries[0]),
        _ => USUAL
            .iter()
            .find_map(|usual| candidates.iter().find(|entry| entry.name == *usual).copied())
            .ok_or_else(|| refuse("no array chosen")),
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
