//! Exports parts of a recording as tables for other programs: CSV for spreadsheets, Parquet for data frames, NPY for
//! the frames' readings only. Tables are streamed, so memory doesn't grow with the recording. Frames of any other file
//! that dermis reads are exported in the same formats.

mod format;
mod parquet;
mod read_frames;
mod rows;

use std::io::{Read, Seek, Write};
use std::path::Path;
use std::str::FromStr;

use dermis_device::Frame;
use dermis_device::instruments::npy::{self, Number};

use super::messages::{origin_name, phase_name};
use super::{BaselineEntry, Entry, EventEntry, Recording, TouchesEntry};
use crate::Error;
use crate::sink::staged::StagedFile;
use format::row_writer;
pub use format::{Exported, TableFormat};
pub use read_frames::export_frames;
use rows::{Cell, Column, Kind};

/// The part of a recording to export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Table {
    /// One row per frame: number, times, readings.
    Frames,
    /// One row per touch in each frame.
    Touches,
    /// One row per baseline.
    Baselines,
    /// One row per event.
    Events,
}

impl FromStr for Table {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "frames" => Ok(Self::Frames),
            "touches" => Ok(Self::Touches),
            "baselines" => Ok(Self::Baselines),
            "events" => Ok(Self::Events),
            _ => Err("expected frames, touches, baselines or events".to_owned()),
        }
    }
}

/// Writes a table of `recording`, starting from its beginning, to `path`. The file appears only when it is complete.
///
/// # Errors
/// An error if anything but frames is requested as NPY, or if only some frames are complex; an I/O error.
pub fn export<R: Read + Seek>(
    recording: &mut Recording<R>,
    table: Table,
    format: TableFormat,
    path: &Path,
) -> Result<Exported, Error> {
    recording.rewind();
    let complex = matches!(recording.next_frame_peek()?, Some(frame) if !frame.imaginary.is_empty());
    recording.rewind();
    if format == TableFormat::Npy {
        return export_array(recording, table, complex, path);
    }
    let columns = columns(recording, table, complex);
    let mut file = StagedFile::create(path)?;
    let mut writer = row_writer(&mut file, &columns, format).map_err(Error::io(path))?;
    let mut rows = 0;
    let mut cells = Vec::new();
    while let Some(entry) = recording.next_entry()? {
        match (table, entry) {
            (Table::Frames, Entry::Frame(frame)) => {
                check_parts(frame, complex)?;
                frame_cells(frame, &mut cells);
            }
            (Table::Touches, Entry::Touches { entry, .. }) => {
                for cells in touch_rows(entry) {
                    writer.row(&cells).map_err(Error::io(path))?;
                    rows += 1;
                }
                continue;
            }
            (Table::Baselines, Entry::Baseline { wall_ns, entry }) => baseline_cells(wall_ns, entry, &mut cells),
            (Table::Events, Entry::Event { wall_ns, entry }) => event_cells(wall_ns, entry, &mut cells),
            _ => continue,
        }
        writer.row(&cells).map_err(Error::io(path))?;
        cells.clear();
        rows += 1;
    }
    writer.finish().map_err(Error::io(path))?;
    drop(writer);
    file.finish()?;
    Ok(Exported { rows, columns: columns.len(), damage: recording.damage() })
}

/// Exports the frames' readings as an array. Its header states their number, so the frames are read twice.
fn export_array<R: Read + Seek>(
    recording: &mut Recording<R>,
    table: Table,
    complex: bool,
    path: &Path,
) -> Result<Exported, Error> {
    if table != Table::Frames {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: "table to export as npy".to_owned(),
            expected: "frames".to_owned(),
            got: format!("{table:?}").to_lowercase(),
        }));
    }
    let channels = recording.head().layout.channels();
    let mut frame = Frame::default();
    let mut rows = 0;
    while recording.next_frame(&mut frame)? {
        check_parts(&frame, complex)?;
        rows += 1;
    }
    recording.rewind();
    let shape = if complex { vec![rows, 2, channels] } else { vec![rows, channels] };
    let mut file = StagedFile::create(path)?;
    npy::write_header::<f64>(&mut file, &shape).map_err(Error::io(path))?;
    while recording.next_frame(&mut frame)? {
        let values = frame.values.iter().chain(&frame.imaginary);
        values.copied().try_for_each(|value| value.write_to(&mut file)).map_err(Error::io(path))?;
    }
    file.flush().map_err(Error::io(path))?;
    file.finish()?;
    let columns = if complex { 2 * channels } else { channels };
    Ok(Exported { rows: rows as u64, columns, damage: recording.damage() })
}

fn check_parts(frame: &Frame, complex: bool) -> Result<(), Error> {
    if frame.imaginary.is_empty() != complex {
        return Ok(());
    }
    let (real, both) = ("real readings, as in the first frame", "complex readings, as in the first frame");
    let (expected, got) = if complex { (both, "real ones") } else { (real, "complex ones") };
    let what = format!("frame {} to export", frame.sequence);
    Err(Error::Live(dermis_live::Error::Frames { what, expected: expected.to_owned(), got: got.to_owned() }))
}

fn columns<R: Read + Seek>(recording: &Recording<R>, table: Table, complex: bool) -> Vec<Column> {
    let fixed: &[(&str, Kind)] = match table {
        Table::Frames => &[
            ("sequence", Kind::Count),
            ("device_time_ns", Kind::Time),
            ("host_monotonic_ns", Kind::Count),
            ("host_wall_ns", Kind::Count),
        ],
        Table::Touches => &[
            ("sequence", Kind::Count),
            ("host_monotonic_ns", Kind::Count),
            ("id", Kind::Count),
            ("phase", Kind::Text),
            ("x_mm", Kind::Number),
            ("y_mm", Kind::Number),
            ("amplitude", Kind::Number),
            ("area_mm2", Kind::Number),
            ("sigma_x_mm", Kind::Number),
            ("sigma_y_mm", Kind::Number),
            ("force_n", Kind::Number),
            ("force_range", Kind::Text),
            ("radius_mm", Kind::Number),
            ("other_x_mm", Kind::Number),
            ("other_y_mm", Kind::Number),
            ("other_probability", Kind::Number),
        ],
        Table::Baselines => &[
            ("wall_ns", Kind::Count),
            ("time_ns", Kind::Count),
            ("frames", Kind::Count),
            ("origin", Kind::Text),
            ("reason", Kind::Text),
            ("values", Kind::Text),
            ("noise_std", Kind::Text),
        ],
        Table::Events => {
            &[("wall_ns", Kind::Count), ("event", Kind::Text), ("detail", Kind::Text), ("values", Kind::Text)]
        }
    };
    let mut columns: Vec<Column> =
        fixed.iter().map(|(name, kind)| Column { name: (*name).to_owned(), kind: *kind }).collect();
    if table == Table::Frames {
        let head = recording.head();
        let label =
            |channel: usize| head.labels.get(channel).cloned().unwrap_or_else(|| format!("channel {}", channel + 1));
        let unit = if is_in_volts(&head.source) { " (V)" } else { "" };
        let parts: &[&str] = if complex { &["re ", "im "] } else { &[""] };
        let all = parts.iter().flat_map(|part| (0..head.layout.channels()).map(move |channel| (*part, channel)));
        columns.extend(
            all.map(|(part, channel)| Column { name: format!("{part}{}{unit}", label(channel)), kind: Kind::Number }),
        );
    }
    columns
}

/// Twins and instruments on the wire deliver volts; files hold whatever unit their author used.
fn is_in_volts(source: &str) -> bool {
    ["twin:", "tcp:", "serial:"].iter().any(|kind| source.starts_with(kind))
}

fn frame_cells(frame: &Frame, cells: &mut Vec<Cell>) {
    cells.push(Cell::Count(frame.sequence));
    cells.push(Cell::Time(frame.device_time_ns));
    cells.extend([Cell::Count(frame.host_monotonic_ns), Cell::Count(frame.host_wall_ns)]);
    cells.extend(frame.values.iter().chain(&frame.imaginary).map(|value| Cell::Number(*value)));
}

fn touch_rows(entry: &TouchesEntry) -> impl Iterator<Item = Vec<Cell>> + '_ {
    entry.touches.iter().map(|touch| {
        let (other_m, probability) = match touch.other_place {
            Some(other) => (other.position_m, other.probability),
            None => ([f64::NAN; 2], 0.0),
        };
        vec![
            Cell::Count(entry.sequence),
            Cell::Count(entry.time_ns),
            Cell::Count(touch.id),
            Cell::Text(phase_name(touch.phase).to_owned()),
            Cell::Number(1e3 * touch.position_m[0]),
            Cell::Number(1e3 * touch.position_m[1]),
            Cell::Number(touch.amplitude),
            Cell::Number(1e6 * touch.area_m2),
            Cell::Number(1e3 * touch.sigma_m[0]),
            Cell::Number(1e3 * touch.sigma_m[1]),
            Cell::Number(touch.force_n),
            Cell::Text(touch.force_range.clone()),
            Cell::Number(1e3 * touch.radius_m),
            Cell::Number(1e3 * other_m[0]),
            Cell::Number(1e3 * other_m[1]),
            Cell::Number(probability),
        ]
    })
}

fn baseline_cells(wall_ns: u64, BaselineEntry { record, values, noise_std }: &BaselineEntry, cells: &mut Vec<Cell>) {
    cells.extend([Cell::Count(wall_ns), Cell::Count(record.time_ns), Cell::Count(record.frames as u64)]);
    cells.extend([Cell::Text(origin_name(record.origin).to_owned()), Cell::Text(record.reason.clone())]);
    cells.extend([listed(values), listed(noise_std)]);
}

fn event_cells(wall_ns: u64, EventEntry { event, detail, values }: &EventEntry, cells: &mut Vec<Cell>) {
    cells.extend([Cell::Count(wall_ns), Cell::Text(event.clone()), Cell::Text(detail.clone()), listed(values)]);
}

/// Numbers in one cell, separated by spaces.
fn listed(values: &[f64]) -> Cell {
    Cell::Text(values.iter().map(f64::to_string).collect::<Vec<_>>().join(" "))
}
