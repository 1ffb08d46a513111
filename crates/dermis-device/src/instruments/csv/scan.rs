//! Reads every row of a text table as numbers, once its structure is known.

use std::path::Path;

use super::cell::{Decimal, complex, leading_number, number};
use super::separator::Separator;
use super::sketch::{Kind, Line, NoTable, Sketch, looks_like_thousands};
use crate::error::shorten;
use crate::instruments::text::Text;
use crate::instruments::times::{Stamp, stamp};
use crate::{DeviceError, ReadOptions};

pub(super) const EXPECTED: &str = "a text table of numbers";
/// Maximum number of columns: more than any common pattern yields with 1024 electrodes.
pub(super) const MOST_COLUMNS: usize = 1 << 21;
/// Maximum bytes of a line per column: enough for numbers written out in full, with blanks around them.
const MOST_CELL_BYTES: usize = 1100;
/// Name of a column whose integers are too large for a double.
pub(in crate::instruments) const WALL_NS: &str = "host_wall_ns";

/// A table with its contents.
#[derive(Debug)]
pub(in crate::instruments) struct Table {
    pub(super) sketch: Sketch,
    /// Rows x columns, row-major. NaN for cells that are empty or not numbers.
    pub(super) values: Vec<f64>,
    /// Imaginary parts of all cells up to the last complex one; empty if no cell is complex.
    pub(super) imaginary: Vec<f64>,
    /// Columns of dates, times of day and `host_wall_ns`: column index, and one value per row.
    pub(super) stamps: Vec<(usize, Vec<Option<Stamp>>)>,
    /// Number of rows between blank lines, if it is the same everywhere.
    pub(super) rows_in_group: Option<usize>,
    pub(super) encoding: Option<&'static str>,
}

impl Table {
    /// Builds a table from the named columns of a binary file. `values` is row-major, with NaN in columns without
    /// numbers. `stamps` lists the columns of dates and times.
    pub(in crate::instruments) fn of_columns(
        names: Vec<String>,
        kinds: Vec<Kind>,
        values: Vec<f64>,
        stamps: Vec<(usize, Vec<Option<Stamp>>)>,
    ) -> Self {
        let sketch = Sketch::of_columns(names, kinds);
        Self { sketch, values, imaginary: Vec::new(), stamps, rows_in_group: None, encoding: None }
    }

    pub(super) fn rows(&self) -> usize {
        self.values.len() / self.sketch.columns
    }

    /// Keeps the first of every `step` rows.
    pub(super) fn keep_every(&mut self, step: usize) {
        let columns = self.sketch.columns;
        self.values = self.values.chunks_exact(columns).step_by(step).flatten().copied().collect();
        for (_, stamps) in &mut self.stamps {
            *stamps = stamps.iter().step_by(step).copied().collect();
        }
    }

    /// Name of a column, if there is a header.
    pub(super) fn name(&self, column: usize) -> Option<&str> {
        self.sketch.header.as_ref().and_then(|(_, names)| names.get(column)).map(String::as_str)
    }
}

/// Reason why a text yields no table.
pub(super) enum Refusal {
    /// The lines aren't rows of a table, but may still hold frames.
    OtherLines,
    /// An error with its place.
    Error(DeviceError),
}

impl From<DeviceError> for Refusal {
    fn from(error: DeviceError) -> Self {
        Self::Error(error)
    }
}

/// The lines that hold cells, with their numbers from 1. Blank lines and comments are skipped.
pub(super) fn lines<'a>(text: &'a str, skip_rows: usize) -> impl Iterator<Item = Line<'a>> {
    numbered(text, skip_rows).filter(|(_, line)| !line.is_empty() && !is_comment(line))
}

fn numbered<'a>(text: &'a str, skip_rows: usize) -> impl Iterator<Item = Line<'a>> {
    let numbered =
        text.lines().enumerate().map(|(index, line)| (index + 1, line.trim_matches([' ', '\r', '\u{feff}'])));
    numbered.skip(skip_rows)
}

fn is_comment(line: &str) -> bool {
    line.starts_with(['#', '%']) || is_separator_note(line)
}

/// True for `sep=;`, a hint for Excel.
fn is_separator_note(line: &str) -> bool {
    line.len() == 5 && line.get(..4).is_some_and(|start| start.eq_ignore_ascii_case("sep="))
}

/// Infers the structure of a text's table.
pub(super) fn sketch(text: &str, file: &Path, options: &ReadOptions) -> Result<Sketch, Refusal> {
    let mut lines = lines(text, options.skip_rows).peekable();
    let empty = || DeviceError::Empty { file: file.to_owned() };
    let &(first, line) = lines.peek().ok_or_else(empty)?;
    if line.starts_with(['{', '<']) {
        return Err(crate::instruments::foreign(file, EXPECTED, line.as_bytes()).into());
    }
    let widest = Separator::ALL.iter().map(|separator| separator.cells(line).take(MOST_COLUMNS + 1).count()).max();
    if let Some(found) = widest.filter(|found| *found > MOST_COLUMNS) {
        return Err(DeviceError::Wide { file: file.to_owned(), line: first, limit: MOST_COLUMNS, found }.into());
    }
    let comment = numbered(text, options.skip_rows)
        .take_while(|(_, line)| line.is_empty() || is_comment(line))
        .filter(|(_, line)| line.len() > 1)
        .last();
    Sketch::of(lines, comment, &options.channels).map_err(|refusal| match refusal {
        NoTable::NoNumbers => empty().into(),
        NoTable::OtherLines => Refusal::OtherLines,
        NoTable::Header { line, names, cells } => {
            DeviceError::Ragged { file: file.to_owned(), line: line + 1, expected: names, found: cells }.into()
        }
        NoTable::Row { line, cells, usual } => {
            DeviceError::Ragged { file: file.to_owned(), line, expected: usual, found: cells }.into()
        }
        NoTable::Thousands { line, cell } => {
            let expected = "numbers without thousands separators, such as 1234.5";
            DeviceError::field(file, line, "numbers", &cell, expected).into()
        }
        NoTable::CommaBetweenCommas { line, cell } => {
            let expected = "decimal points, or a separator other than the comma: these look like decimal commas between \
                            commas, which is ambiguous";
            DeviceError::field(file, line, "numbers", &cell, expected).into()
        }
    })
}

/// Reads the whole text.
pub(super) fn scan(text: &Text, file: &Path, options: &ReadOptions) -> Result<Table, Refusal> {
    let sketch = sketch(&text.text, file, options)?;
    let has_comma = |error: &DeviceError| {
        // A count that has reached 1,000 is not a fraction.
        matches!(error, DeviceError::Cell { found, .. } if found.contains(',') && !looks_like_thousands(found, Decimal::Comma))
    };
    let can_have_comma = sketch.decimal == Decimal::Point && sketch.separator != Separator::Mark(b',');
    match rows(text, sketch.clone(), file, options) {
        // Decimal commas may have gone unnoticed because the first rows had only integers.
        Err(error) if can_have_comma && has_comma(&error) => {
            rows(text, Sketch { decimal: Decimal::Comma, ..sketch }, file, options).map_err(|_| error.into())
        }
        other => Ok(other?),
    }
}

fn rows(text: &Text, sketch: Sketch, file: &Path, options: &ReadOptions) -> Result<Table, DeviceError> {
    let header = sketch.header.as_ref().map(|(_, names)| names.as_slice()).unwrap_or_default();
    let wall = header.iter().position(|name| name == WALL_NS);
    let stamped = (0..sketch.columns).filter(|&column| sketch.kinds[column] == Kind::Stamp || wall == Some(column));
    let stamps = stamped.map(|column| (column, Vec::new())).collect();
    let mut reader = Rows { file, wall, sketch: &sketch, values: Vec::new(), imaginary: Vec::new(), stamps };
    let (mut groups, mut in_group) = (Groups::default(), 0_usize);
    let first = numbered(&text.text, options.skip_rows).skip_while(|(line, _)| *line < sketch.first_line);
    for (line, text_of_line) in first {
        if text_of_line.is_empty() {
            groups.end(std::mem::take(&mut in_group));
        } else if !is_comment(text_of_line) {
            if in_group == 0 && reader.values.is_empty() {
                // Number of rows if all are as long as this one.
                reader.values.reserve(sketch.columns * (1 + text.text.len() / (text_of_line.len() + 1)));
            }
            reader.row(line, text_of_line)?;
            in_group += 1;
        }
    }
    groups.end(in_group);
    let Rows { values, imaginary, stamps, .. } = reader;
    if values.is_empty() {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    Ok(Table { sketch, values, imaginary, stamps, rows_in_group: groups.size(), encoding: text.encoding })
}

/// Groups of rows between blank lines.
#[derive(Default)]
struct Groups {
    count: usize,
    size: usize,
    differ: bool,
}

impl Groups {
    fn end(&mut self, rows: usize) {
        if rows == 0 {
            return;
        }
        self.differ |= self.count > 0 && rows != self.size;
        self.size = rows;
        self.count += 1;
    }

    fn size(&self) -> Option<usize> {
        (self.count > 1 && self.size > 1 && !self.differ).then_some(self.size)
    }
}

/// Collects rows one by one.
struct Rows<'a> {
    file: &'a Path,
    sketch: &'a Sketch,
    wall: Option<usize>,
    values: Vec<f64>,
    imaginary: Vec<f64>,
    stamps: Vec<(usize, Vec<Option<Stamp>>)>,
}

impl Rows<'_> {
    fn row(&mut self, line: usize, text: &str) -> Result<(), DeviceError> {
        let (file, sketch) = (self.file, self.sketch);
        let Sketch { separator, decimal, columns, has_trailing, ref kinds, .. } = *sketch;
        let bytes = text.as_bytes();
        let is_spaced = separator == Separator::Spaces;
        let is_blank = |byte: u8| byte == b' ' || byte == b'\t' && separator != Separator::Mark(b'\t');
        let is_end = |at: usize| match (bytes.get(at), separator) {
            (None, _) => true,
            (Some(byte), Separator::Mark(mark)) => *byte == mark,
            (Some(byte), Separator::Spaces) => byte.is_ascii_whitespace(),
        };
        let ragged = || DeviceError::Ragged {
            file: file.to_owned(),
            line,
            expected: columns,
            found: separator.cells(text).count(),
        };
        if bytes.len() > MOST_CELL_BYTES * columns + (1 << 16) {
            return Err(ragged());
        }
        let (mut at, mut count, mark) = (0, 0, decimal.mark());
        loop {
            while bytes.get(at).is_some_and(|byte| is_blank(*byte)) {
                at += 1;
            }
            if at == bytes.len() && is_spaced {
                break;
            }
            if count == columns {
                return Err(ragged());
            }
            let fast = if kinds[count] == Kind::Number && self.wall != Some(count) {
                leading_number(&bytes[at..], mark).and_then(|(value, length)| {
                    let mut end = at + length;
                    while !is_spaced && bytes.get(end).is_some_and(|byte| is_blank(*byte)) {
                        end += 1;
                    }
                    (is_end(end) && value.is_finite()).then_some((value, end))
                })
            } else {
                None
            };
            let end = match fast {
                Some((value, end)) => {
                    self.values.push(value);
                    end
                }
                None => {
                    let (cell, end) = separator.cell_at(text, at);
                    self.slow(line, count, cell)?;
                    end
                }
            };
            count += 1;
            if end >= bytes.len() {
                break;
            }
            at = end + 1;
            // A separator at the very end adds an empty cell, unless all lines end with one.
            if at == bytes.len() && !is_spaced {
                if !has_trailing {
                    if count == columns {
                        return Err(ragged());
                    }
                    self.slow(line, count, "")?;
                    count += 1;
                }
                break;
            }
        }
        if count == columns {
            return Ok(());
        }
        Err(DeviceError::Ragged { file: file.to_owned(), line, expected: columns, found: count })
    }

    /// Reads a cell that isn't a plain number.
    fn slow(&mut self, line: usize, column: usize, cell: &str) -> Result<(), DeviceError> {
        let fail = |expected| {
            let file = self.file.to_owned();
            Err(DeviceError::Cell { file, line, column: column + 1, found: shorten(cell), expected })
        };
        if let Some((_, stamps)) = self.stamps.iter_mut().find(|(stamped, _)| *stamped == column) {
            let found = if self.wall == Some(column) {
                cell.parse().ok().map(|ns| Stamp { ns, has_date: true, has_time: true })
            } else {
                stamp(cell)
            };
            if found.is_none() && !number(cell, self.sketch.decimal).is_ok_and(f64::is_nan) {
                return fail("a date or a time as in the rows above");
            }
            stamps.push(found);
            self.values.push(f64::NAN);
            return Ok(());
        }
        let value = match (self.sketch.kinds[column], number(cell, self.sketch.decimal)) {
            (Kind::Words, _) => f64::NAN,
            (_, Ok(value)) => value,
            (_, Err(expected)) => {
                let Some([real, part]) = complex(cell) else { return fail(expected) };
                self.imaginary.resize(self.values.len(), 0.0);
                self.imaginary.push(part);
                real
            }
        };
        self.values.push(value);
        Ok(())
    }
}
