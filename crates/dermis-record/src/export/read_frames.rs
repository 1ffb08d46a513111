//! Exports frames that were read from any file: a converter between the formats of laboratories.

use std::io::Write;
use std::path::Path;

use dermis_device::FrameTable;
use dermis_device::instruments::npy::{self, Number};

use super::format::{Exported, TableFormat, row_writer};
use super::rows::{Cell, Column, Kind};
use crate::sink::staged::StagedFile;
use crate::{Damage, Error};

/// Writes the frames of `table` to `path`, in their own units. The file appears only when it is complete.
///
/// CSV and Parquet have one row per frame: its number (`sequence`), its time in seconds from the first frame (`time_s`)
/// and its wall-clock time in nanoseconds (`host_wall_ns`), each where the file has it, then the readings. Columns of
/// complex readings begin with `re ` and `im `, real parts first. NPY is frames x channels, or frames x 2 x channels
/// with real parts first.
///
/// # Errors
/// An I/O error.
pub fn export_frames(table: &FrameTable, format: TableFormat, path: &Path) -> Result<Exported, Error> {
    let mut file = StagedFile::create(path)?;
    let columns = if format == TableFormat::Npy {
        write_array(table, &mut file).map_err(Error::io(path))?
    } else {
        let columns = columns(table);
        let mut writer = row_writer(&mut file, &columns, format).map_err(Error::io(path))?;
        for frame in 0..table.frames() {
            writer.row(&cells(table, frame)).map_err(Error::io(path))?;
        }
        writer.finish().map_err(Error::io(path))?;
        columns.len()
    };
    file.flush().map_err(Error::io(path))?;
    file.finish()?;
    Ok(Exported { rows: table.frames() as u64, columns, damage: Damage::NONE })
}

/// Writes the readings as an array. Returns the number of values per frame.
fn write_array(table: &FrameTable, out: &mut impl Write) -> std::io::Result<usize> {
    let (frames, channels) = (table.frames(), table.channels());
    let is_complex = table.imaginary().is_some();
    let shape = if is_complex { vec![frames, 2, channels] } else { vec![frames, channels] };
    npy::write_header::<f64>(&mut *out, &shape)?;
    for value in (0..frames).flat_map(|frame| readings(table, frame)) {
        value.write_to(out)?;
    }
    Ok(if is_complex { 2 * channels } else { channels })
}

/// The readings of a frame, real parts first.
fn readings(table: &FrameTable, frame: usize) -> impl Iterator<Item = f64> + '_ {
    let imaginary = table.imaginary_row(frame).unwrap_or_default();
    table.row(frame).unwrap_or_default().iter().chain(imaginary).copied()
}

fn columns(table: &FrameTable) -> Vec<Column> {
    let mut columns = Vec::new();
    let mut add = |name: String, kind| columns.push(Column { name, kind });
    if table.sequences().is_some() {
        add("sequence".to_owned(), Kind::Count);
    }
    if table.times_s().is_some() {
        add("time_s".to_owned(), Kind::Number);
    }
    if table.wall_ns().is_some() {
        add("host_wall_ns".to_owned(), Kind::Time);
    }
    let parts: &[&str] = if table.imaginary().is_some() { &["re ", "im "] } else { &[""] };
    for part in parts {
        for channel in 0..table.channels() {
            let given = table.channel_names().and_then(|names| names.get(channel)).filter(|name| !name.is_empty());
            let name = given.cloned().unwrap_or_else(|| format!("channel {}", channel + 1));
            add(format!("{part}{name}"), Kind::Number);
        }
    }
    columns
}

fn cells(table: &FrameTable, frame: usize) -> Vec<Cell> {
    let mut cells = Vec::new();
    cells.extend(table.sequences().map(|sequences| Cell::Count(sequences[frame])));
    cells.extend(table.times_s().map(|times_s| Cell::Number(times_s[frame])));
    cells.extend(table.wall_ns().map(|wall_ns| Cell::Time(u64::try_from(wall_ns[frame]).ok())));
    cells.extend(readings(table, frame).map(Cell::Number));
    cells
}

#[cfg(test)]
mod tests {
    use dermis_device::Layout;

    use super::*;

    #[test]
    fn frames_of_a_table_are_written_with_times_and_names() {
        let values = vec![1.0, 2.0, 3.0, f64::NAN];
        let table = FrameTable::new(Layout::Channels { count: 2 }, values, "a.txt").unwrap();
        let table = table.with_times_s(vec![0.0, 0.5]).unwrap();
        let table = table.with_channel_names(vec!["E1-E2".to_owned(), String::new()]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.csv");
        let exported = export_frames(&table, TableFormat::of_name(&path), &path).unwrap();
        assert_eq!((exported.rows, exported.columns), (2, 3));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "time_s,E1-E2,channel 2\n0,1,2\n0.5,3,NaN\n");

        // Complex readings come back from the array as they went in, real parts first.
        let table = table.with_imaginary(vec![0.1, 0.2, 0.3, 0.4]).unwrap();
        let path = folder.path().join("out.npy");
        assert_eq!(export_frames(&table, TableFormat::of_name(&path), &path).unwrap().columns, 4);
        let bytes = std::fs::read(&path).unwrap();
        let written: Vec<f64> =
            bytes[bytes.len() - 64..].chunks(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect();
        assert_eq!(written[..5], [1.0, 2.0, 0.1, 0.2, 3.0]);
        assert!(written[5].is_nan() && written[6..] == [0.3, 0.4]);
    }
}
