//! Tables of numbers as text: one frame a row, cells separated by commas, semicolons, tabs or spaces.
//!
//! The first row may be a head of names; lines that start with `#` are comments and blank lines are skipped. An empty
//! cell, `nan` or `NaN` is a missing reading; infinite values are refused. Decimal points only. A first column headed
//! `time_s` gives the frames' times.

use std::path::Path;

use super::text_of;
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Layout};

const EXPECTED: &str = "a text table of numbers";

/// A rectangular table of numbers, as for positions or frames.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberTable {
    /// Names of the columns, if the first row holds names.
    pub header: Option<Vec<String>>,
    /// Cells in every row, at least 1.
    pub columns: usize,
    /// Rows x columns, row-major; NaN where a cell is empty.
    pub values: Vec<f64>,
}

impl NumberTable {
    /// Number of rows of numbers.
    pub fn rows(&self) -> usize {
        self.values.len() / self.columns
    }

    /// One row, or none if there is no such row.
    pub fn row(&self, row: usize) -> Option<&[f64]> {
        self.values.chunks_exact(self.columns).nth(row)
    }

    /// Index of the column with this name.
    pub fn column_index(&self, name: &str) -> Option<usize> {
        self.header.as_ref()?.iter().position(|other| other == name)
    }

    /// The values of one column, from the top; no column has an index of `columns` or more.
    pub fn column(&self, index: usize) -> impl Iterator<Item = f64> {
        self.values.chunks_exact(self.columns).filter_map(move |row| row.get(index).copied())
    }
}

/// Reads a text table of numbers from a file.
///
/// # Errors
/// As [`parse`], and [`DeviceError::Io`].
pub fn read_numbers(path: &Path) -> Result<NumberTable, DeviceError> {
    parse(&super::read_bytes(path)?, path)
}

/// Parses a text table of numbers; `file` is for messages.
///
/// # Errors
/// [`DeviceError::Foreign`] if it is no text, [`DeviceError::Ragged`] or [`DeviceError::Cell`] with the line,
/// [`DeviceError::Empty`] without a row of numbers.
pub fn parse(content: &[u8], file: &Path) -> Result<NumberTable, DeviceError> {
    let mut lines = lines(text_of(content, file, EXPECTED)?).peekable();
    let empty = || DeviceError::Empty { file: file.to_owned() };
    let &(_, first) = lines.peek().ok_or_else(empty)?;
    let separator = Separator::guess(first);
    let header = header_of(first, separator);
    let columns = separator.cells(first).count();
    if header.is_some() {
        lines.next();
    }
    let mut values = Vec::new();
    for (line, text) in lines {
        let before = values.len();
        for (index, cell) in separator.cells(text).enumerate() {
            let fail = |expected| DeviceError::Cell {
                file: file.to_owned(),
                line,
                column: index + 1,
                found: shorten(cell),
                expected,
            };
            values.push(number(cell).map_err(fail)?);
        }
        let found = values.len() - before;
        if found != columns {
            return Err(DeviceError::Ragged { file: file.to_owned(), line, expected: columns, found });
        }
    }
    if values.is_empty() {
        return Err(empty());
    }
    Ok(NumberTable { header, columns, values })
}

/// Frames in rows.
///
/// # Errors
/// As [`parse`].
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    let table = parse(content, file)?;
    let timed = table.columns > 1 && table.column_index("time_s") == Some(0);
    if !timed {
        return FrameTable::new(Layout::Channels { count: table.columns }, table.values, file);
    }
    let times_s = table.column(0).collect();
    let values = table.values.chunks_exact(table.columns).flat_map(|row| &row[1..]).copied().collect();
    FrameTable::new(Layout::Channels { count: table.columns - 1 }, values, file)?.with_times_s(times_s)
}

/// The shape of a text table, found without reading its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Names in the first row, if it is a head.
    pub header: Option<Vec<String>>,
    /// Cells in the first row.
    pub columns: usize,
    /// Rows without the head.
    pub rows: usize,
}

impl Shape {
    /// Looks at a file's whole content; `file` is for messages.
    ///
    /// # Errors
    /// [`DeviceError::Foreign`] if it is no text table, [`DeviceError::Empty`] if it has no rows.
    pub fn of(content: &[u8], file: &Path) -> Result<Self, DeviceError> {
        let mut lines = lines(text_of(content, file, EXPECTED)?);
        let (_, first) = lines.next().ok_or_else(|| DeviceError::Empty { file: file.to_owned() })?;
        if first.starts_with(['{', '<']) {
            return Err(super::foreign(file, EXPECTED, first.as_bytes()));
        }
        let separator = Separator::guess(first);
        let header = header_of(first, separator);
        let rows = lines.count() + usize::from(header.is_none());
        Ok(Self { header, columns: separator.cells(first).count(), rows })
    }
}

/// Lines that hold cells, with their number from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim_matches([' ', '\r'])));
    numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// Names in a first row: every cell that is not empty has a letter and is no number, and there is one.
fn header_of(line: &str, separator: Separator) -> Option<Vec<String>> {
    let is_name = |cell: &str| cell.contains(char::is_alphabetic) && cell.parse::<f64>().is_err();
    let mut filled = separator.cells(line).filter(|cell| !cell.is_empty()).peekable();
    let named = filled.peek().is_some() && filled.all(is_name);
    named.then(|| separator.cells(line).map(str::to_owned).collect())
}

/// A cell's value, or what it should have been.
fn number(cell: &str) -> Result<f64, &'static str> {
    if cell.is_empty() {
        return Ok(f64::NAN);
    }
    match cell.parse::<f64>() {
        Ok(value) if value.is_infinite() => Err("a finite number or nan"),
        Ok(value) => Ok(value),
        Err(_) => Err("a number with a decimal point, nan or nothing"),
    }
}

/// What stands between cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Separator {
    Mark(char),
    Spaces,
}

impl Separator {
    fn guess(line: &str) -> Self {
        [';', '\t', ','].into_iter().find(|&mark| line.contains(mark)).map_or(Self::Spaces, Self::Mark)
    }

    /// The cells of a line, without surrounding blanks and double quotes.
    fn cells(self, line: &str) -> impl Iterator<Item = &str> {
        let (marked, spaced) = match self {
            Self::Mark(mark) => (Some(line.split(mark)), None),
            Self::Spaces => (None, Some(line.split_whitespace())),
        };
        marked.into_iter().flatten().chain(spaced.into_iter().flatten()).map(unquote)
    }
}

fn unquote(cell: &str) -> &str {
    let cell = cell.trim();
    cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"')).unwrap_or(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<NumberTable, DeviceError> {
        parse(text.as_bytes(), Path::new("made.csv"))
    }

    fn message(text: &str) -> String {
        parsed(text).unwrap_err().to_string()
    }

    #[test]
    fn every_separator_reads_the_same_table() {
        for text in [
            "1,2.5\n-3e2,4\n",
            "1;2.5\r\n-3e2;4\r\n",
            "1\t2.5\n-3e2\t4",
            " 1   2.5 \n\n-3e2 4\n",
            "\u{feff}1, 2.5\n# note\n-3e2 ,\"4\"\n",
        ] {
            let table = parsed(text).unwrap();
            assert_eq!((table.columns, table.values), (2, vec![1.0, 2.5, -300.0, 4.0]), "{text:?}");
        }
    }

    #[test]
    fn a_head_of_names_is_kept() {
        let table = parsed("x_m,y_m\n0.5,-1\n").unwrap();
        assert_eq!(table.column_index("y_m"), Some(1));
        assert_eq!(table.column(1).collect::<Vec<_>>(), [-1.0]);
    }

    #[test]
    fn missing_cells_are_nan() {
        let table = parsed("1,,3\nnan,NaN,\n").unwrap();
        let missing: Vec<bool> = table.values.iter().map(|value| value.is_nan()).collect();
        assert_eq!(missing, [false, true, false, true, true, true]);
    }

    #[test]
    fn ragged_rows_give_line_and_counts() {
        assert_eq!(message("# run\n1,2,3\n4,5\n"), "made.csv:3: expected 3 values as in the first row, found 2");
        assert_eq!(message("a,b\n1,2,3\n"), "made.csv:2: expected 2 values as in the first row, found 3");
    }

    #[test]
    fn cells_that_are_no_finite_number_give_line_and_column() {
        let wanted = "expected a number with a decimal point, nan or nothing";
        assert_eq!(message("1,2\n3,four\n"), format!("made.csv:2: column 2: {wanted}, found 'four'"));
        assert_eq!(message("1,x\n3,4\n"), format!("made.csv:1: column 2: {wanted}, found 'x'"));
        assert_eq!(message("1,5;2,5\n"), format!("made.csv:1: column 1: {wanted}, found '1,5'"));
        for infinite in ["inf", "-Infinity", "1e999"] {
            let expected = format!("made.csv:2: column 1: expected a finite number or nan, found '{infinite}'");
            assert_eq!(message(&format!("1,2\n{infinite},2\n")), expected);
        }
    }

    #[test]
    fn nothing_and_foreign_content_are_told_apart() {
        assert!(message("").contains("found none"));
        assert!(message("# only\n\n").contains("found none"));
        assert!(message("a,b\n").contains("found none"));
        let zip = parse(b"PK\x03\x04\0\0\xff", Path::new("a.csv")).unwrap_err().to_string();
        assert_eq!(zip, "a.csv: expected a text table of numbers, found a ZIP archive (npz or xlsx?)");
    }

    #[test]
    fn a_leading_time_column_gives_times() {
        let table = decode(b"time_s,a,b\n0,1,2\n0.05,3,4\n", Path::new("made.csv")).unwrap();
        assert_eq!(table.times_s(), Some([0.0, 0.05].as_slice()));
        assert_eq!(table.values(), [1.0, 2.0, 3.0, 4.0]);
    }
}
