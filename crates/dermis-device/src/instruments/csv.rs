//! Tables of numbers as text: one frame a row, cells separated by commas, semicolons, tabs or spaces.
//!
//! The first row may be a head of names; lines that start with `#` are comments and blank lines are skipped. An empty
//! cell, `nan` or `NaN` is a missing reading; infinite values are refused. Decimal points only. Cells may stand in
//! double quotes, with separators in them. Columns headed `time_s`, or `sequence` and the times that `dermis export`
//! writes, come before the readings and are the frames' numbers and times; columns headed `re ...` and `im ...` are the
//! parts of complex readings. A complex reading may also stand in one cell, as NumPy and MATLAB write it: `1.5-2e-3j`,
//! `(1.5-2e-3j)`, `1.5-2e-3i`; a plain number among such cells has no imaginary part.

use std::path::Path;

use super::text_of;
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Layout};

const EXPECTED: &str = "a text table of numbers";
/// Most columns of a table: more than 1024 electrodes give with any pattern in use.
const MOST_COLUMNS: usize = 1 << 21;
/// Most bytes of a line for each of its columns: numbers written out in full with blanks around.
const MOST_CELL_BYTES: usize = 1100;

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
    parse_cells(content, file, None)
}

/// As [`parse`]. Where complex cells are welcome, `imaginary` gets the imaginary part of every cell up to the last
/// complex one; without any it stays empty.
fn parse_cells(content: &[u8], file: &Path, mut imaginary: Option<&mut Vec<f64>>) -> Result<NumberTable, DeviceError> {
    let mut lines = lines(text_of(content, file, EXPECTED)?).peekable();
    let empty = || DeviceError::Empty { file: file.to_owned() };
    let &(_, first) = lines.peek().ok_or_else(empty)?;
    let separator = Separator::guess(first);
    let columns = columns_of(first, separator, file)?;
    let header = header_of(first, separator);
    if header.is_some() {
        lines.next();
    }
    let mut values = Vec::new();
    for (line, text) in lines {
        if text.len() > MOST_CELL_BYTES * columns + (1 << 16) {
            let found = separator.cells(text).count().max(columns + 1);
            return Err(DeviceError::Ragged { file: file.to_owned(), line, expected: columns, found });
        }
        let before = values.len();
        for (index, cell) in separator.cells(text).enumerate() {
            let fail = |expected| DeviceError::Cell {
                file: file.to_owned(),
                line,
                column: index + 1,
                found: shorten(cell),
                expected,
            };
            let value = match (number(cell), &mut imaginary) {
                (Ok(value), _) => value,
                (Err(expected), None) => return Err(fail(expected)),
                (Err(expected), Some(imaginary)) => {
                    let [real, part] = complex(cell).ok_or_else(|| fail(expected))?;
                    imaginary.resize(values.len(), 0.0);
                    imaginary.push(part);
                    real
                }
            };
            values.push(value);
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

/// Columns before the readings that say which frame a row is, and when it was.
const FRAME_COLUMNS: [&str; 5] = ["time_s", "sequence", "device_time_ns", "host_monotonic_ns", "host_wall_ns"];

/// Frames in rows.
///
/// # Errors
/// As [`parse`]; [`DeviceError::Count`] where real and imaginary parts are not equally many.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    let mut imaginary = Vec::new();
    let table = parse_cells(content, file, Some(&mut imaginary))?;
    let named = |index: usize| table.header.as_ref().and_then(|header| header.get(index)).map(String::as_str);
    let is_frame_column = |index: &usize| named(*index).is_some_and(|name| FRAME_COLUMNS.contains(&name));
    // A table of one column has readings, whatever it is called.
    let first = if table.columns > 1 { (0..table.columns).take_while(is_frame_column).count() } else { 0 };
    if first == table.columns {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    let is_imaginary = |index: usize| named(index).is_some_and(|name| name.starts_with("im "));
    let in_two = named(first).is_some_and(|name| name.starts_with("re "));
    let part = |of: &[f64], imaginary: bool| -> Vec<f64> {
        let columns: Vec<usize> = (first..table.columns).filter(|&k| !in_two || is_imaginary(k) == imaginary).collect();
        of.chunks_exact(table.columns).flat_map(|row| columns.iter().map(|&column| row[column])).collect()
    };
    let values = part(&table.values, false);
    let mut frames = FrameTable::new(Layout::Channels { count: values.len() / table.rows() }, values, file)?;
    if in_two {
        frames = frames.with_imaginary(part(&table.values, true))?;
    } else if !imaginary.is_empty() {
        imaginary.resize(table.values.len(), 0.0);
        frames = frames.with_imaginary(part(&imaginary, false))?;
    }
    let column = |name: &str| (0..first).find(|&index| named(index) == Some(name)).map(|index| table.column(index));
    let from_first = |times: Vec<f64>| -> Vec<f64> { times.iter().map(|ns| 1e-9 * (ns - times[0])).collect() };
    let is_whole = |times: &Vec<f64>| times.iter().all(|time| time.is_finite());
    let clock = |name: &str| column(name).map(|times| times.collect::<Vec<f64>>()).filter(is_whole).map(from_first);
    let times = column("time_s").map(|times| times.collect());
    if let Some(times) = times.or_else(|| clock("device_time_ns")).or_else(|| clock("host_monotonic_ns")) {
        frames = frames.with_times_s(times)?;
    }
    if let Some(sequences) = column("sequence").map(|numbers| numbers.collect::<Vec<f64>>()).filter(is_whole) {
        frames = frames.with_sequences(sequences.iter().map(|number| *number as u64).collect())?;
    }
    Ok(frames)
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
        let columns = columns_of(first, separator, file)?;
        let header = header_of(first, separator);
        let rows = lines.count() + usize::from(header.is_none());
        Ok(Self { header, columns, rows })
    }
}

/// Cells of the first line, counted before anything of them is kept.
fn columns_of(first: &str, separator: Separator, file: &Path) -> Result<usize, DeviceError> {
    match separator.cells(first).count() {
        found if found > MOST_COLUMNS => {
            Err(DeviceError::Wide { file: file.to_owned(), line: 1, limit: MOST_COLUMNS, found })
        }
        found => Ok(found),
    }
}

/// Lines that hold cells, with their number from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim_matches([' ', '\r'])));
    numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// Names in a first row: no cell is a number, and one has a letter.
fn header_of(line: &str, separator: Separator) -> Option<Vec<String>> {
    let filled = || separator.cells(line).filter(|cell| !cell.is_empty());
    let named = filled().all(|cell| cell.parse::<f64>().is_err() && complex(cell).is_none())
        && filled().any(|cell| cell.contains(char::is_alphabetic));
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

/// Both parts of a complex cell: `a+bj`, `bj`, with `i` for `j`, in parentheses or not; a part may be `nan`.
fn complex(cell: &str) -> Option<[f64; 2]> {
    let bare = cell.strip_prefix('(').and_then(|cell| cell.strip_suffix(')')).unwrap_or(cell);
    let body = bare.strip_suffix(['j', 'i', 'J', 'I'])?;
    // The last sign that is not of an exponent.
    let mut signs = body.char_indices().filter(|(at, c)| "+-".contains(*c) && !body[..*at].ends_with(['e', 'E']));
    let (real, imaginary) = body.split_at(signs.next_back().map_or(0, |(at, _)| at));
    // NumPy writes `1+-2j`.
    let real = real.strip_suffix('+').unwrap_or(real);
    let finite = |part: &str| part.trim().parse::<f64>().ok().filter(|value| !value.is_infinite());
    Some([if real.is_empty() { 0.0 } else { finite(real)? }, finite(imaginary)?])
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

    /// The cells of a line, without surrounding blanks and double quotes; marks between quotes are none.
    fn cells(self, line: &str) -> impl Iterator<Item = &str> {
        let (marked, spaced) = match self {
            Self::Mark(mark) => {
                let mut is_quoted = false;
                let is_end = move |c: char| {
                    is_quoted ^= c == '"';
                    c == mark && !is_quoted
                };
                (Some(line.split(is_end)), None)
            }
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

    #[test]
    fn lines_longer_than_any_frame_are_refused_before_they_are_read() {
        let file = Path::new("wide.csv");
        let wide = "1,".repeat(MOST_COLUMNS) + "2\n";
        let error = parse(wide.as_bytes(), file).unwrap_err().to_string();
        assert_eq!(
            error,
            format!("wide.csv:1: expected at most {MOST_COLUMNS} values in a line, found {}", MOST_COLUMNS + 1)
        );
        assert!(Shape::of(wide.as_bytes(), file).is_err());
        let ragged = format!("1,2\n{}\n", "1,".repeat(100_000));
        let error = parse(ragged.as_bytes(), file).unwrap_err().to_string();
        assert!(error.starts_with("wide.csv:2: expected 2 values as in the first row, found 100001"), "{error}");
    }

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
    fn exported_frames_are_read_back_with_numbers_and_times() {
        let text = "sequence,device_time_ns,host_monotonic_ns,host_wall_ns,1-2 > 3-4,\"2-3 > 4,5\"\n\
                    7,,1000000000,1790000000000000000,0.1,-2\n9,,1040000000,1790000000040000000,NaN,3\n";
        let table = decode(text.as_bytes(), Path::new("made.csv")).unwrap();
        assert_eq!((table.frames(), table.channels()), (2, 2));
        assert_eq!(table.sequences(), Some([7, 9].as_slice()));
        let times = table.times_s().unwrap();
        assert!(times[0] == 0.0 && (times[1] - 0.04).abs() < 1e-12, "{times:?}");
        assert!(table.row(0) == Some(&[0.1, -2.0][..]) && table.row(1).unwrap()[0].is_nan());
        let complex = decode(b"sequence,re a,re b,im a,im b\n0,1,2,3,4\n", Path::new("made.csv")).unwrap();
        assert_eq!((complex.values(), complex.imaginary()), ([1.0, 2.0].as_slice(), Some([3.0, 4.0].as_slice())));
        assert!(decode(b"sequence,re a,im a,im b\n0,1,2,3\n", Path::new("made.csv")).is_err());
        assert!(decode(b"sequence,time_s\n0,1\n", Path::new("made.csv")).is_err());
    }

    #[test]
    fn complex_readings_stand_in_one_cell_as_numpy_and_matlab_write_them() {
        let decoded = |text: &str| decode(text.as_bytes(), Path::new("made.csv"));
        // numpy.savetxt with and without a delimiter, MATLAB's writematrix, and a plain number among them.
        for text in [
            "(1.5e+00+2.0e-01j),(-3e0+-4e0j)\n5,nan-1j\n",
            " (1.5+0.2j) (-3-4j)\n (5+0j) (nan-1j)\n",
            "1.5+0.2i;-3-4i\n5;NaN-1i\n",
            "time_s,a,b\n0,1.5+2e-1j,-3e+0-4e+0J\n1,5,nan-1j\n",
        ] {
            let table = decoded(text).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!((table.frames(), table.channels()), (2, 2), "{text}");
            assert_eq!(table.imaginary(), Some([0.2, -4.0, 0.0, -1.0].as_slice()), "{text}");
            assert!(table.values()[..3] == [1.5, -3.0, 5.0] && table.values()[3].is_nan(), "{text}");
        }
        let alone = decoded("2j,1\n").unwrap();
        assert_eq!((alone.values(), alone.imaginary()), ([0.0, 1.0].as_slice(), Some([2.0, 0.0].as_slice())));
        assert!(decoded("1,2\n").unwrap().imaginary().is_none());
        for broken in ["1,1+infj", "1,1+j", "1,1+2k", "1,(1+2j", "1,1 + 2j3"] {
            let message = decoded(&format!("3,4\n{broken}\n")).unwrap_err().to_string();
            assert!(message.starts_with("made.csv:2: column 2"), "{broken}: {message}");
        }
        // Positions are no complex numbers.
        assert!(message("1,2\n1+2j,3\n").contains("expected a number"), "{}", message("1,2\n1+2j,3\n"));
    }

    #[test]
    fn a_leading_time_column_gives_times() {
        let table = decode(b"time_s,a,b\n0,1,2\n0.05,3,4\n", Path::new("made.csv")).unwrap();
        assert_eq!(table.times_s(), Some([0.0, 0.05].as_slice()));
        assert_eq!(table.values(), [1.0, 2.0, 3.0, 4.0]);
    }
}
