//! Parquet files from pandas, Polars, DuckDB and Spark. Each row is a frame; each channel is a column, or one column
//! of lists holds all channels. Columns of times, counts, words and units are recognised as in text tables
//! ([`super::csv`]), and date columns are times. Only the numbers are held in memory.

use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use bytes::Bytes;
use parquet::basic::{ConvertedType, LogicalType, TimeUnit, Type as Physical};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::file::reader::{ChunkReader, FileReader, SerializedFileReader};
use parquet::schema::types::ColumnDescriptor;

use super::arrays::{self, Named};
use super::columns;
use super::content::{PARQUET_MAGIC, open_regular};
use super::csv::{self, Kind, Table};
use super::npy::{MOST_ELEMENTS, half};
use super::times::Stamp;
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

const EXPECTED: &str = "a Parquet file";
/// Number of rows per read.
const BATCH: usize = 1 << 13;
/// Maximum number of columns in a file.
const MOST_COLUMNS: usize = 1 << 20;

/// Decodes frames from a file's content.
///
/// # Errors
/// [`DeviceError::Foreign`] if it can't be read, [`DeviceError::Ragged`] if the lengths of the lists differ,
/// [`DeviceError::Field`] if several columns of lists could hold frames, and the errors of [`super::csv`].
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    frames(Bytes::copy_from_slice(content), file, options)
}

/// True if a file begins like a Parquet file.
pub(super) fn is_parquet(path: &Path) -> bool {
    let mut first = [0; PARQUET_MAGIC.len()];
    open_regular(path).and_then(|mut file| std::io::Read::read_exact(&mut file, &mut first)).is_ok()
        && first == PARQUET_MAGIC
}

/// Reads frames from a file. Only the numbers are held in memory.
pub(super) fn read_frames(path: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let opened: File = open_regular(path).map_err(|error| DeviceError::io(path, "read", error))?;
    frames(opened, path, options)
}

/// A column that is read.
struct Column {
    /// Index among the file's columns.
    leaf: usize,
    name: String,
    kind: Kind,
    /// Stored values are divided by this.
    divisor: f64,
    /// Nanoseconds per count; 0 for columns without dates or times.
    tick_ns: i64,
    has_date: bool,
    is_list: bool,
    is_half: bool,
    /// Definition level of a present value.
    full_level: i16,
    /// Definition level of a missing value. For lists, lower levels mean empty lists.
    missing_level: i16,
}

/// Decodes frames. The library panics on some damaged files, such as one with a column of negative length.
fn frames(source: impl ChunkReader + 'static, file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    catch_unwind(AssertUnwindSafe(|| decoded(source, file, options))).unwrap_or_else(|_| {
        let found = "a damaged one".to_owned();
        Err(DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found })
    })
}

fn decoded(source: impl ChunkReader + 'static, file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let broken = |error: ParquetError| foreign(&error, file);
    let reader = SerializedFileReader::new(source).map_err(broken)?;
    let metadata = reader.metadata();
    let schema = metadata.file_metadata().schema_descr();
    let rows = usize::try_from(metadata.file_metadata().num_rows()).unwrap_or(0);
    if schema.num_columns() > MOST_COLUMNS {
        let found = format!("{} columns", schema.num_columns());
        return Err(DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found });
    }
    let columns: Vec<Column> = (0..schema.num_columns()).map(|leaf| Column::of(leaf, &schema.column(leaf))).collect();
    if rows == 0 || columns.is_empty() {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    let mut notes = Vec::new();
    let (mut flat, lists): (Vec<Column>, Vec<Column>) = columns.into_iter().partition(|column| !column.is_list);
    let wide = match lists.is_empty() {
        true if options.array.is_some() => {
            let found = options.array.as_deref().unwrap_or_default();
            return Err(DeviceError::field(file, 1, "--array", found, "nothing: the file has no column of lists"));
        }
        true => None,
        false => Some(List::read(&reader, &lists, rows, file, options, &mut notes)?),
    };
    let wide_count = wide.as_ref().map_or(0, |wide| wide.count);
    // Next to lists, numeric columns other than times and counts aren't readings.
    if wide.is_some() {
        let is_other = |column: &Column| column.kind == Kind::Number && !csv::is_clock_or_count(&column.name);
        notes.extend(
            flat.iter()
                .filter(|column| is_other(column))
                .map(|column| format!("column `{}` left out: it is next to the lists", shorten(&column.name))),
        );
        flat.retain(|column| !is_other(column));
    }
    let count = flat.len() + wide_count;
    check_size(rows, count, file)?;
    let mut values = vec![f64::NAN; rows * count];
    let mut stamps = Vec::new();
    for (at, column) in flat.iter().enumerate().filter(|(_, column)| column.kind != Kind::Words) {
        let is_stamp = column.tick_ns != 0;
        let mut moments: Vec<Option<Stamp>> = vec![None; if is_stamp { rows } else { 0 }];
        let mut row = 0;
        each(&reader, column, &mut |cell: Option<Cell>| {
            match cell {
                _ if row >= rows => return Err(ParquetError::General("more rows than the file says".to_owned())),
                Some(Cell::Number(number)) => values[row * count + at] = number / column.divisor,
                Some(Cell::Whole(number)) if is_stamp => {
                    let ns = number.checked_mul(column.tick_ns);
                    let has_date = column.has_date;
                    moments[row] = ns.map(|ns| Stamp { ns, has_date, has_time: column.tick_ns < 86_400_000_000_000 });
                }
                Some(Cell::Whole(number)) => values[row * count + at] = number as f64 / column.divisor,
                None | Some(Cell::Next) => {}
            }
            row += 1;
            Ok(())
        })
        .map_err(broken)?;
        if row != rows {
            return Err(DeviceError::Count {
                file: file.to_owned(),
                what: "values in a column",
                expected: rows,
                found: row,
            });
        }
        if is_stamp {
            stamps.push((at, moments));
        }
    }
    if let Some(wide) = &wide {
        for (row, frame) in wide.values.chunks_exact(wide.count).enumerate() {
            values[row * count + flat.len()..][..wide.count].copy_from_slice(frame);
        }
    }
    let kinds = flat.iter().map(|column| column.kind).chain(std::iter::repeat_n(Kind::Number, wide_count)).collect();
    let names = flat.into_iter().map(|column| column.name);
    let names = names.chain((0..wide_count).map(|channel| format!("channel {channel}"))).collect();
    let table = Table::of_columns(names, kinds, values, stamps);
    if options.transpose {
        return columns::of_table(csv::numbers_of(table), file, |count| Layout::Channels { count });
    }
    csv::frames_of(table, notes, file, options)
}

fn check_size(rows: usize, columns: usize, file: &Path) -> Result<(), DeviceError> {
    let found = (rows as u64).saturating_mul(columns as u64);
    if found <= MOST_ELEMENTS {
        return Ok(());
    }
    Err(DeviceError::TooLarge { file: file.to_owned(), limit: 8 * MOST_ELEMENTS, found: found.saturating_mul(8) })
}

impl Column {
    fn of(leaf: usize, column: &ColumnDescriptor) -> Self {
        const DAY_NS: i64 = 86_400_000_000_000;
        let is_list = column.max_rep_level() > 0;
        let path = column.path().parts();
        // `voltages.list.element` is the column `voltages`.
        let name = if is_list { path[0].clone() } else { path.join(".") };
        // pandas uses this name for an unnamed index.
        let name = if name.starts_with("__index_level_") { "index".to_owned() } else { name };
        let tick = |unit: &TimeUnit| match unit {
            TimeUnit::MILLIS => 1_000_000,
            TimeUnit::MICROS => 1_000,
            TimeUnit::NANOS => 1,
        };
        let (mut divisor, mut tick_ns, mut has_date, mut is_half) = (1.0, 0, true, false);
        match (column.logical_type_ref(), column.converted_type()) {
            (Some(LogicalType::Timestamp(kind)), _) => tick_ns = tick(&kind.unit),
            (Some(LogicalType::Time(kind)), _) => (tick_ns, has_date) = (tick(&kind.unit), false),
            (Some(LogicalType::Date), _) | (None, ConvertedType::DATE) => tick_ns = DAY_NS,
            (Some(LogicalType::Decimal(kind)), _) => divisor = 10_f64.powi(kind.scale),
            (Some(LogicalType::Float16), _) => is_half = true,
            (None, ConvertedType::TIMESTAMP_MILLIS) => tick_ns = 1_000_000,
            (None, ConvertedType::TIMESTAMP_MICROS) => tick_ns = 1_000,
            (None, ConvertedType::TIME_MILLIS) => (tick_ns, has_date) = (1_000_000, false),
            (None, ConvertedType::TIME_MICROS) => (tick_ns, has_date) = (1_000, false),
            (None, ConvertedType::DECIMAL) => divisor = 10_f64.powi(column.type_scale()),
            _ => {}
        }
        if column.physical_type() == Physical::INT96 || (name == csv::WALL_NS && tick_ns == 0) {
            tick_ns = 1;
        }
        let kind = match column.physical_type() {
            _ if name == csv::WALL_NS => Kind::Number,
            Physical::INT32 | Physical::INT64 | Physical::INT96 if tick_ns != 0 => Kind::Stamp,
            Physical::INT32 | Physical::INT64 | Physical::FLOAT | Physical::DOUBLE => Kind::Number,
            Physical::FIXED_LEN_BYTE_ARRAY if is_half => Kind::Number,
            _ => Kind::Words,
        };
        let full_level = column.max_def_level();
        let missing_level = match (is_list, column.self_type().is_optional()) {
            (false, _) => 0,
            (true, true) => full_level - 1,
            (true, false) => full_level,
        };
        Self { leaf, name, kind, divisor, tick_ns, has_date, is_list, is_half, full_level, missing_level }
    }
}

/// One value of a column.
#[derive(Debug, Clone, Copy)]
enum Cell {
    Number(f64),
    Whole(i64),
    /// Start of a list; carries no value.
    Next,
}

/// Passes every value of a column to a callback in row order, `None` if missing.
fn each(
    reader: &dyn FileReader,
    column: &Column,
    see: &mut dyn FnMut(Option<Cell>) -> Result<(), ParquetError>,
) -> Result<(), ParquetError> {
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group)?;
        match group.get_column_reader(column.leaf)? {
            ColumnReader::Int32ColumnReader(reader) => {
                batches(reader, column, |value| Some(Cell::Whole((*value).into())), see)
            }
            ColumnReader::Int64ColumnReader(reader) => batches(reader, column, |value| Some(Cell::Whole(*value)), see),
            ColumnReader::Int96ColumnReader(reader) => {
                batches(reader, column, |value| Some(Cell::Whole(value.to_nanos())), see)
            }
            ColumnReader::FloatColumnReader(reader) => {
                batches(reader, column, |value| Some(Cell::Number((*value).into())), see)
            }
            ColumnReader::DoubleColumnReader(reader) => {
                batches(reader, column, |value| Some(Cell::Number(*value)), see)
            }
            ColumnReader::FixedLenByteArrayColumnReader(reader) if column.is_half => {
                let number = |raw: &[u8]| raw.first_chunk().map(|raw| Cell::Number(half(u16::from_le_bytes(*raw))));
                batches(reader, column, |value| number(value.data()), see)
            }
            _ => Err(ParquetError::General(format!("column {} holds no numbers", column.name))),
        }?;
    }
    Ok(())
}

fn batches<T: DataType>(
    mut reader: ColumnReaderImpl<T>,
    column: &Column,
    cell: impl Fn(&T::T) -> Option<Cell>,
    see: &mut dyn FnMut(Option<Cell>) -> Result<(), ParquetError>,
) -> Result<(), ParquetError> {
    let (mut values, mut present, mut repeated) = (Vec::new(), Vec::new(), Vec::new());
    loop {
        values.clear();
        present.clear();
        repeated.clear();
        let (records, _, levels) = reader.read_records(BATCH, Some(&mut present), Some(&mut repeated), &mut values)?;
        if records == 0 && levels == 0 {
            return Ok(());
        }
        let mut next = values.iter();
        // Without definition levels, no value is missing.
        if column.full_level == 0 {
            next.try_for_each(|value| see(cell(value)))?;
            continue;
        }
        for (at, level) in present.iter().enumerate() {
            if column.is_list && repeated.get(at) == Some(&0) {
                see(Some(Cell::Next))?;
            }
            if *level == column.full_level {
                see(next.next().and_then(&cell))?;
            } else if *level >= column.missing_level {
                see(None)?;
            }
        }
    }
}

/// Frames from a column of lists.
struct List {
    /// Number of readings per list.
    count: usize,
    values: Vec<f64>,
}

impl List {
    /// Reads the only column of lists that can hold frames, or the one that the user asked for.
    fn read(
        reader: &dyn FileReader,
        lists: &[Column],
        rows: usize,
        file: &Path,
        options: &ReadOptions,
        notes: &mut Vec<String>,
    ) -> Result<Self, DeviceError> {
        let broken = |error: ParquetError| foreign(&error, file);
        let lists: Vec<&Column> = lists.iter().filter(|list| list.kind == Kind::Number).collect();
        let mut named = Vec::new();
        for list in &lists {
            // Find the first row's length; the start of the second row ends the search.
            let (mut begun, mut count) = (0, 0);
            let first = each(reader, list, &mut |cell| {
                match cell {
                    Some(Cell::Next) => begun += 1,
                    _ => count += 1,
                }
                if begun > 1 { Err(ParquetError::General(String::new())) } else { Ok(()) }
            });
            if begun < 2 {
                first.map_err(broken)?;
            }
            named.push(Named { name: list.name.clone(), shape: vec![rows, count] });
        }
        if named.is_empty() {
            return Err(DeviceError::Empty { file: file.to_owned() });
        }
        let chosen = arrays::choose(&named, file, options)?;
        let (list, count) = (lists[chosen], named[chosen].shape[1]);
        check_size(rows, count, file)?;
        let scale = csv::unit_scale(&list.name);
        let mut values: Vec<f64> = Vec::new();
        let (mut row, mut wrong) = (0_usize, None);
        let mut end = |row: usize, held: usize| {
            let found = held.saturating_sub(row.saturating_sub(1) * count);
            if row > 0 && found != count && wrong.is_none() {
                wrong = Some((row, found));
            }
            wrong.is_none()
        };
        let read = each(reader, list, &mut |cell| {
            match cell {
                Some(Cell::Next) => {
                    if !end(row, values.len()) || row == rows {
                        return Err(ParquetError::General("more rows than the file says".to_owned()));
                    }
                    row += 1;
                }
                _ if values.len() >= row * count => {
                    end(row, values.len() + 1);
                    return Err(ParquetError::General("a list that is too long".to_owned()));
                }
                Some(Cell::Number(number)) => values.push(number * scale / list.divisor),
                Some(Cell::Whole(number)) => values.push(number as f64 * scale / list.divisor),
                None => values.push(f64::NAN),
            }
            Ok(())
        });
        if read.is_ok() {
            end(row, values.len());
        }
        if let Some((line, found)) = wrong {
            return Err(DeviceError::Ragged { file: file.to_owned(), line, expected: count, found });
        }
        read.map_err(broken)?;
        if row != rows || count == 0 {
            return Err(DeviceError::Count { file: file.to_owned(), what: "lists", expected: rows, found: row });
        }
        notes.push(format!("lists in column `{}`", shorten(&list.name)));
        if scale != 1.0 {
            notes.push("readings converted to volts (ohms) from the unit in its name".to_owned());
        }
        Ok(Self { count, values })
    }
}

fn foreign(error: &ParquetError, file: &Path) -> DeviceError {
    DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found: shorten(&error.to_string()) }
}
