//! Text tables of numbers, one frame per row, with cells separated by commas, semicolons, tabs, bars or blanks.
//!
//! Separator, decimal mark and encoding are detected. Decimal commas work if the cells are quoted or have a different
//! separator. The first row may be a header of names or of consecutive numbers, with a row of units below it. Lines
//! that start with `#` or `%` are comments, and lines of text before the table are skipped. An empty cell, `nan`, `NA`
//! or `null` is a missing reading; infinite values are refused.
//!
//! Row counts, words, times and dates aren't readings. Times are taken from such columns, and [`FrameTable::notes`]
//! lists what was done. Names may state units, as in `(mV)` or `_mV`; readings are then converted to volts. Columns
//! named `re` and `im`, or magnitude and phase, are the parts of complex readings, either in pairs or one block after
//! the other. A single cell may also hold a complex reading, as NumPy and MATLAB write it: `1.5-2e-3j`, `(1.5-2e-3j)`,
//! `1.5-2e-3i`. A frame may be wrapped over several rows, if blank lines separate the frames or the skin's channel
//! count implies it. A table may also hold one reading per row, with a column that counts the channels.

pub(super) mod cell;
mod roles;
mod scan;
mod separator;
mod sketch;

use std::path::Path;

use self::roles::{Part, Role, called};
use self::scan::{EXPECTED, Refusal};
pub(super) use self::scan::{Table, WALL_NS};
pub(super) use self::sketch::Kind;
use super::text::Text;
use super::times;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

/// A rectangular table of numbers, for instance positions or frames.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberTable {
    /// Column names, if the first row holds names.
    pub header: Option<Vec<String>>,
    /// Number of columns, at least 1.
    pub columns: usize,
    /// Rows x columns, row-major. NaN where a cell is empty.
    pub values: Vec<f64>,
}

impl NumberTable {
    /// Number of rows of numbers.
    pub fn rows(&self) -> usize {
        self.values.len() / self.columns
    }

    /// One row, or `None` if there is no such row.
    pub fn row(&self, row: usize) -> Option<&[f64]> {
        self.values.chunks_exact(self.columns).nth(row)
    }

    /// Index of the column with this name.
    pub fn column_index(&self, name: &str) -> Option<usize> {
        self.header.as_ref()?.iter().position(|other| other == name)
    }

    /// Converts columns named as millimetres (`x_mm`, `x (mm)`) to metres (`x_m`).
    #[must_use]
    pub fn in_metres(self) -> Self {
        self.renamed("mm", "m", 1e-3)
    }

    /// Converts columns named as metres to millimetres (`x_mm`).
    #[must_use]
    pub fn in_millimetres(self) -> Self {
        self.renamed("m", "mm", 1e3)
    }

    fn renamed(mut self, from: &str, to: &str, factor: f64) -> Self {
        for (column, name) in self.header.iter_mut().flatten().enumerate() {
            let Some((base, unit)) = length_unit(name) else { continue };
            if unit == from {
                self.values.iter_mut().skip(column).step_by(self.columns).for_each(|value| *value *= factor);
            }
            if unit == from || unit == to {
                *name = format!("{base}_{to}");
            }
        }
        self
    }

    /// Values of one column from top to bottom; none if `index` is out of range.
    pub fn column(&self, index: usize) -> impl Iterator<Item = f64> {
        self.values.chunks_exact(self.columns).filter_map(move |row| row.get(index).copied())
    }
}

/// Splits a column's name from its length unit: `x` and `mm` for `x_mm`, `x (mm)` and `X [mm]`.
fn length_unit(name: &str) -> Option<(String, &str)> {
    let name = name.trim();
    let bracketed = |open: char, close: char| name.strip_suffix(close)?.rsplit_once(open);
    let (base, unit) = bracketed('(', ')').or_else(|| bracketed('[', ']')).or_else(|| name.rsplit_once('_'))?;
    let unit = unit.trim();
    matches!(unit, "m" | "mm").then(|| (base.trim().to_lowercase(), unit))
}

/// Reads a text table of numbers from a file.
///
/// # Errors
/// As [`parse`], and [`DeviceError::Io`].
pub fn read_numbers(path: &Path) -> Result<NumberTable, DeviceError> {
    parse(&super::read_bytes(path)?, path)
}

/// Parses a text table of numbers; `file` is only used in messages.
///
/// # Errors
/// [`DeviceError::Foreign`] if it isn't text, [`DeviceError::Ragged`] or [`DeviceError::Cell`] with the line,
/// [`DeviceError::Empty`] if there is no row of numbers.
pub fn parse(content: &[u8], file: &Path) -> Result<NumberTable, DeviceError> {
    parse_with(content, file, &ReadOptions::default())
}

pub(super) fn parse_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<NumberTable, DeviceError> {
    let text = Text::of(content, file, EXPECTED)?;
    let table = scan::scan(&text, file, options).map_err(|refusal| no_table(refusal, &text, file, options))?;
    let at = |column: usize| {
        let line = scan::lines(&text.text, options.skip_rows).find(|(line, _)| *line >= table.sketch.first_line);
        let (line, text) = line.unwrap_or((table.sketch.first_line, ""));
        cell_error(file, line, column, table.sketch.separator.cells(text).nth(column).unwrap_or_default())
    };
    // Words, dates and complex cells are errors here.
    if let Some(column) = table.sketch.kinds.iter().position(|kind| *kind != Kind::Number) {
        return Err(at(column));
    }
    if !table.imaginary.is_empty() {
        let column = table.imaginary.iter().position(|part| *part != 0.0).unwrap_or(0) % table.sketch.columns;
        return Err(at(column));
    }
    Ok(NumberTable {
        columns: table.sketch.columns,
        header: table.sketch.header.map(|(_, names)| names),
        values: table.values,
    })
}

fn cell_error(file: &Path, line: usize, column: usize, cell: &str) -> DeviceError {
    let expected = "a number with a decimal point, nan or nothing";
    DeviceError::Cell { file: file.to_owned(), line, column: column + 1, found: crate::error::shorten(cell), expected }
}

/// The error for text that isn't a table: points to the first cell that isn't a number.
fn no_table(refusal: Refusal, text: &Text, file: &Path, options: &ReadOptions) -> DeviceError {
    match refusal {
        Refusal::Error(error) => error,
        Refusal::OtherLines => {
            let (line, text) = scan::lines(&text.text, options.skip_rows).next().unwrap_or((1, ""));
            cell_error(file, line, 0, text)
        }
    }
}

/// Decodes frames in rows.
///
/// # Errors
/// As [`parse`]; [`DeviceError::Count`] if the numbers of real and imaginary parts differ.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

/// Decodes frames in rows with the given options. Text that isn't a table is read like [`super::lines`].
pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let text = Text::of(content, file, EXPECTED)?;
    match scan::scan(&text, file, options) {
        Ok(table) => {
            let notes = described(&table);
            frames_of(table, notes, file, options)
        }
        Err(Refusal::OtherLines) => super::log::decode_text(&text.text, text.encoding, file, options),
        Err(Refusal::Error(error)) => Err(error),
    }
}

/// The cells of a table, without the kinds of its columns.
pub(super) fn numbers_of(table: Table) -> NumberTable {
    let Table { sketch, values, .. } = table;
    NumberTable { columns: sketch.columns, header: sketch.header.map(|(_, names)| names), values }
}

/// Turns a table of columns from any file format into frames. `notes` holds the notes made so far.
pub(super) fn frames_of(
    mut table: Table,
    mut notes: Vec<String>,
    file: &Path,
    options: &ReadOptions,
) -> Result<FrameTable, DeviceError> {
    let chosen = roles::chosen(&table, &options.columns, file)?;
    let roles = roles::roles(&table, chosen.as_deref(), &options.channels, &mut notes);
    let mut readings: Vec<usize> = match &chosen {
        Some(chosen) => chosen.clone(),
        None => (0..roles.len()).filter(|&column| matches!(roles[column], Role::Reading { .. })).collect(),
    };
    let per_row = if chosen.is_none() { roles::channel_column(&table, &readings) } else { None };
    if let Some(roles::ChannelColumn { column, channels }) = per_row {
        readings.retain(|reading| *reading != column);
        notes.push(format!("one reading per row, with its channel in {}", called(&table, column)));
        notes.push(format!("{channels} rows make one frame"));
    }
    if readings.is_empty() {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    let scales: Vec<f64> = readings
        .iter()
        .map(|&column| match roles[column] {
            Role::Reading { scale } => scale,
            _ => 1.0,
        })
        .collect();
    if scales.iter().any(|scale| *scale != 1.0) {
        notes.push("readings converted to volts (ohms) from the units in their names".to_owned());
    }
    let columns = table.sketch.columns;
    let gather = |of: &[f64], which: &[usize]| -> Vec<f64> {
        of.chunks_exact(columns)
            .flat_map(|row| which.iter().map(|&index| row[readings[index]] * scales[index]))
            .collect()
    };
    let all: Vec<usize> = (0..readings.len()).collect();
    let (rows, cells) = (table.rows(), table.values.len());
    let (values, imaginary) = match parts(&table, &readings, file, &mut notes)? {
        Some((first, second, kind)) => combined(gather(&table.values, &first), gather(&table.values, &second), kind),
        // Nothing to leave out or scale: take the numbers as they are.
        None if readings.len() == columns && scales.iter().all(|scale| *scale == 1.0) && chosen.is_none() => {
            (std::mem::take(&mut table.values), None)
        }
        None => (gather(&table.values, &all), None),
    };
    let imaginary = imaginary.or_else(|| {
        let mut parts = table.imaginary.clone();
        parts.resize(if parts.is_empty() { 0 } else { cells }, 0.0);
        (!parts.is_empty()).then(|| gather(&parts, &all))
    });
    let count = values.len() / rows;
    let has_frame_columns = roles.iter().any(|role| !matches!(role, Role::Reading { .. } | Role::LeftOut));
    let per_frame = match per_row {
        Some(roles::ChannelColumn { channels, .. }) => channels,
        None => rows_per_frame(&table, rows, count, has_frame_columns, options, &mut notes),
    };
    if per_frame == 1 && options.looks_transposed(rows, count) {
        return Err(DeviceError::Transposed { file: file.to_owned(), frames: rows, channels: count });
    }
    let layout = Layout::Channels { count: count * per_frame };
    let mut frames = FrameTable::new(layout, values, file)?;
    if let Some(imaginary) = imaginary {
        frames = frames.with_imaginary(imaginary)?;
    }
    if per_row.is_some() {
        table.keep_every(per_frame);
    }
    if per_frame == 1 || per_row.is_some() {
        frames = with_clocks(frames, &table, &roles, &mut notes)?;
    }
    if let (1, Some((_, names))) = (per_frame, &table.sketch.header)
        && count == readings.len()
    {
        frames = frames.with_channel_names(readings.iter().map(|&column| names[column].clone()).collect())?;
    }
    Ok(frames.with_notes(notes))
}

/// Notes on encoding, header, decimal mark and separators.
fn described(table: &Table) -> Vec<String> {
    let sketch = &table.sketch;
    let mut notes = Vec::new();
    if let Some(encoding) = table.encoding {
        notes.push(encoding.to_owned());
    }
    if sketch.passed_over > 0 {
        notes.push(format!("{} lines of text before the table skipped", sketch.passed_over));
    }
    if let Some((line, _)) = &sketch.header {
        notes.push(format!("header in line {line}"));
    }
    if sketch.decimal == cell::Decimal::Comma {
        notes.push("decimal commas".to_owned());
    }
    if sketch.has_trailing {
        notes.push("separators at line ends".to_owned());
    }
    notes
}

/// Number of rows per frame, from blank lines or the skin's channels.
fn rows_per_frame(
    table: &Table,
    rows: usize,
    count: usize,
    has_frame_columns: bool,
    options: &ReadOptions,
    notes: &mut Vec<String>,
) -> usize {
    if has_frame_columns || options.channels.contains(&count) || (count > 1 && options.looks_transposed(rows, count)) {
        return 1;
    }
    let fits = |per_frame: usize| per_frame > 1 && rows.is_multiple_of(per_frame);
    let by_skin = options.channels.iter().filter(|wanted| wanted.is_multiple_of(count)).map(|wanted| wanted / count);
    let by_blanks = table.rows_in_group.filter(|_| options.channels.is_empty());
    match by_skin.chain(by_blanks).find(|per_frame| fits(*per_frame)) {
        Some(per_frame) => {
            notes.push(format!("{per_frame} rows of {count} make one frame"));
            per_frame
        }
        None => 1,
    }
}

/// Positions of both parts of complex readings among the readings' columns, and the kind of the second part.
type Parts = (Vec<usize>, Vec<usize>, SecondPart);

enum SecondPart {
    Imaginary,
    /// A phase; the factor converts it to radians.
    Phase(f64),
}

fn parts(
    table: &Table,
    readings: &[usize],
    file: &Path,
    notes: &mut Vec<String>,
) -> Result<Option<Parts>, DeviceError> {
    let parts: Vec<Option<Part>> = readings.iter().map(|&column| table.name(column).and_then(roles::part_of)).collect();
    let of = |part: Part| -> Vec<usize> { (0..parts.len()).filter(|&index| parts[index] == Some(part)).collect() };
    let (real, imaginary) = (of(Part::Real), of(Part::Imaginary));
    if !real.is_empty() && real.len() + imaginary.len() == parts.len() {
        if real.len() != imaginary.len() {
            let (expected, found) = (real.len(), imaginary.len());
            return Err(DeviceError::Count { file: file.to_owned(), what: "imaginary parts", expected, found });
        }
        return Ok(Some((real, imaginary, SecondPart::Imaginary)));
    }
    let (magnitude, phase) = (of(Part::Magnitude), of(Part::Phase));
    if magnitude.is_empty() || magnitude.len() + phase.len() != parts.len() || phase.is_empty() {
        return Ok(None);
    }
    if magnitude.len() != phase.len() {
        let (expected, found) = (magnitude.len(), phase.len());
        return Err(DeviceError::Count { file: file.to_owned(), what: "phases", expected, found });
    }
    let column = readings[phase[0]];
    let stated = table.name(column).and_then(|name| roles::split_unit(name).1).and_then(roles::angle);
    let largest = table
        .values
        .chunks_exact(table.sketch.columns)
        .flat_map(|row| phase.iter().map(|&index| row[readings[index]].abs()))
        .fold(0.0, f64::max);
    // Phases beyond a full turn must be in degrees.
    let to_rad = stated.or_else(|| (largest > std::f64::consts::TAU).then_some(std::f64::consts::PI / 180.0));
    let Some(to_rad) = to_rad else {
        let found = table.name(column).unwrap_or_default();
        let expected = "a name that states the unit of phases, as in `phase1 (deg)` or `phase1_rad`";
        return Err(DeviceError::field(file, table.sketch.first_line, "phase", found, expected));
    };
    let unit = if to_rad == 1.0 { "radians" } else { "degrees" };
    notes.push(format!("magnitudes and phases ({unit}) from {} pairs of columns", phase.len()));
    Ok(Some((magnitude, phase, SecondPart::Phase(to_rad))))
}

fn combined(mut first: Vec<f64>, mut second: Vec<f64>, kind: SecondPart) -> (Vec<f64>, Option<Vec<f64>>) {
    if let SecondPart::Phase(to_rad) = kind {
        for (magnitude, phase) in first.iter_mut().zip(&mut second) {
            let (sin, cos) = (*phase * to_rad).sin_cos();
            *phase = *magnitude * sin;
            *magnitude *= cos;
        }
    }
    (first, Some(second))
}

/// Adds the frames' times and numbers.
fn with_clocks(
    mut frames: FrameTable,
    table: &Table,
    roles: &[Role],
    notes: &mut Vec<String>,
) -> Result<FrameTable, DeviceError> {
    let columns = table.sketch.columns;
    let values = |column: usize| -> Vec<f64> { table.values.iter().skip(column).step_by(columns).copied().collect() };
    let is_whole = |values: &Vec<f64>| values.iter().all(|value| value.is_finite());
    let named =
        |name: &str| (0..columns).find(|&column| roles[column] == Role::Clock && table.name(column) == Some(name));
    let from_first = |times: Vec<f64>| -> Vec<f64> { times.iter().map(|ns| 1e-9 * (ns - times[0])).collect() };
    let clock = |name: &str| named(name).map(values).filter(is_whole).map(from_first);
    // Columns of dates and of times of day.
    let stamps: Vec<&(usize, Vec<Option<times::Stamp>>)> =
        table.stamps.iter().filter(|(column, _)| roles[*column] == Role::Stamp).collect();
    let moments = (!stamps.is_empty()).then(|| moments_ns(&stamps)).flatten();
    let time = roles.iter().enumerate().find_map(|(column, role)| match role {
        Role::Time { unit_s } => Some((column, *unit_s)),
        _ => None,
    });
    let mut times_s = None;
    if let Some((column, unit_s)) = time {
        let name = called(table, column);
        notes.push(format!("times from {name}"));
        times_s = Some(times::seconds(&values(column), unit_s, &name, notes));
    } else if let Some((moments, has_date)) = &moments {
        notes.push(format!("times from {}", called(table, stamps[0].0)));
        let from_first = moments.iter().map(|ns| (i128::from(*ns) - i128::from(moments[0])) as f64 * 1e-9).collect();
        times_s = Some(from_first);
        if *has_date {
            frames = frames.with_wall_ns(moments.clone())?;
        }
    }
    let times_s = times_s.or_else(|| clock("device_time_ns")).or_else(|| clock("host_monotonic_ns"));
    if let Some(mut times_s) = times_s {
        times::mend(&mut times_s, notes);
        frames = frames.with_times_s(times_s)?;
    }
    let wall = table.stamps.iter().find(|(column, _)| roles[*column] == Role::Clock);
    if let Some(wall) = wall.and_then(|(_, wall)| wall.iter().map(|stamp| stamp.map(|stamp| stamp.ns)).collect()) {
        frames = frames.with_wall_ns(wall)?;
    }
    let sequence = roles.iter().position(|role| *role == Role::Sequence).map(values).filter(is_whole);
    if let Some(sequence) = sequence {
        frames = frames.with_sequences(sequence.iter().map(|number| *number as u64).collect())?;
    }
    Ok(frames)
}

/// Combines a column of dates, of times of day, or both into one timestamp per row. `None` if any is missing. Times of
/// day continue past midnight.
fn moments_ns(stamps: &[&(usize, Vec<Option<times::Stamp>>)]) -> Option<(Vec<i64>, bool)> {
    const DAY_NS: i64 = 86_400_000_000_000;
    let first: Vec<times::Stamp> = stamps[0].1.iter().copied().collect::<Option<_>>()?;
    let mut moments: Vec<i64> = first.iter().map(|stamp| stamp.ns).collect();
    let mut has_date = first[0].has_date;
    if let Some((_, second)) = stamps.get(1).map(|column| (column.0, &column.1))
        && second.iter().flatten().all(|stamp| stamp.has_date != has_date)
    {
        let second: Vec<times::Stamp> = second.iter().copied().collect::<Option<_>>()?;
        moments.iter_mut().zip(&second).for_each(|(moment, stamp)| *moment = moment.saturating_add(stamp.ns));
        has_date = true;
    }
    if !has_date {
        let mut days = 0;
        for index in 1..moments.len() {
            if moments[index] + days < moments[index - 1] - DAY_NS / 2 {
                days += DAY_NS;
            }
            moments[index] += days;
        }
    }
    Some((moments, has_date))
}

/// Factor from the unit in a name to volts (or ohms); 1 if there is no unit.
pub(super) fn unit_scale(name: &str) -> f64 {
    roles::split_unit(name).1.and_then(roles::scale_of).unwrap_or(1.0)
}

/// True for the names of times, counts and clocks.
pub(super) fn is_clock_or_count(name: &str) -> bool {
    roles::is_clock_or_count(name)
}

/// `Some` for the name of a time column. The inner value is its unit in seconds, if stated.
pub(super) fn is_time(name: &str) -> Option<Option<f64>> {
    roles::time_unit(name, None)
}

/// Dimensions of a text table, found without parsing its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Column names, if the first row is a header.
    pub header: Option<Vec<String>>,
    /// Cells in the first row.
    pub columns: usize,
    /// Number of rows, without the header.
    pub rows: usize,
}

impl Shape {
    /// Inspects a file's whole content; `file` is only used in messages. `None` if the lines aren't rows of a table.
    ///
    /// # Errors
    /// [`DeviceError::Foreign`] if it isn't a text table, [`DeviceError::Empty`] if it has no rows.
    pub fn of(content: &[u8], file: &Path) -> Result<Option<Self>, DeviceError> {
        Self::with(content, file, &ReadOptions::default())
    }

    pub(super) fn with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<Option<Self>, DeviceError> {
        let text = Text::of(content, file, EXPECTED)?;
        let sketch = match scan::sketch(&text.text, file, options) {
            Ok(sketch) => sketch,
            Err(Refusal::OtherLines) => return Ok(None),
            Err(Refusal::Error(error)) => return Err(error),
        };
        let rows = scan::lines(&text.text, options.skip_rows).filter(|(line, _)| *line >= sketch.first_line).count();
        Ok(Some(Self { header: sketch.header.map(|(_, names)| names), columns: sketch.columns, rows }))
    }
}

#[cfg(test)]
mod tests;
