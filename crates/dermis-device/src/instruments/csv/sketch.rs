//! The structure of a text table, inferred from its first lines: separator, decimal mark, first row, and the names and
//! kinds of the columns.

use super::cell::{Decimal, complex, number};
use super::separator::Separator;
use crate::instruments::times::stamp;

/// Maximum number of rows to inspect.
const MOST_LINES: usize = 200;
/// Number of rows that are always inspected, whatever their length.
const FEWEST_LINES: usize = 8;
/// Total bytes after which no further row is inspected.
const MOST_BYTES: usize = 1 << 18;
/// Minimum run of consecutive integers that is always a header: no frame reads 0, 1, 2, ..., 7.
const SURE_COUNT: usize = 8;
/// Minimum run of consecutive integers that is a header if all readings below it have a fractional part.
const LIKELY_COUNT: usize = 3;
/// Minimum run of consecutive integers that is a header unless the row below continues the count, as in a hand-made
/// table.
const SINGLE_COUNT: usize = 4;

/// Kind of content in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::instruments) enum Kind {
    /// Numbers, missing or complex readings.
    Number,
    /// Dates or times of day.
    Stamp,
    /// Words.
    Words,
}

/// Appearance of a single cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Look {
    Number,
    Missing,
    Complex,
    Stamp,
    Word,
    /// A word that contains a number in some other notation: `V1:0.2`, `(0.1`.
    Tangled,
}

impl Look {
    fn of(cell: &str, decimal: Decimal) -> Self {
        match number(cell, decimal) {
            Ok(value) if value.is_nan() => Self::Missing,
            Ok(_) | Err("a finite number or nan") => Self::Number,
            _ if complex(cell).is_some() => Self::Complex,
            _ if stamp(cell).is_some() => Self::Stamp,
            _ if cell.contains([':', '=', '(', ')', '[', ']', '{', '}', '>'])
                && cell.contains(|c: char| c.is_ascii_digit()) =>
            {
                Self::Tangled
            }
            _ => Self::Word,
        }
    }

    fn is_reading(self) -> bool {
        matches!(self, Self::Number | Self::Complex)
    }

    fn is_word(self) -> bool {
        matches!(self, Self::Word | Self::Tangled)
    }
}

/// A line with cells, and its number from 1.
pub(super) type Line<'a> = (usize, &'a str);

/// Structure of a text table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sketch {
    pub separator: Separator,
    pub decimal: Decimal,
    /// Cells per row. A separator at the end of a line adds no cell.
    pub columns: usize,
    pub kinds: Vec<Kind>,
    /// Line number and column names of the header.
    pub header: Option<(usize, Vec<String>)>,
    /// Units from a separate line below the names.
    pub units: Option<Vec<String>>,
    /// Line number of the first row.
    pub first_line: usize,
    /// Number of lines before the table, without the header.
    pub passed_over: usize,
    /// True if every line ends in a separator.
    pub has_trailing: bool,
}

/// Reason why a text isn't a readable table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum NoTable {
    /// No line has a number.
    NoNumbers,
    /// The lines contain words, labels or brackets around the numbers.
    OtherLines,
    /// The header's number of names differs from the first row's number of cells.
    Header { line: usize, names: usize, cells: usize },
    /// A row above the others has a different number of cells.
    Row { line: usize, cells: usize, usual: usize },
    /// Decimal commas in a table separated by commas: the line and a cell.
    CommaBetweenCommas { line: usize, cell: String },
    /// Thousands separators: the line and a cell.
    Thousands { line: usize, cell: String },
}

struct Candidate {
    separator: Separator,
    decimal: Decimal,
    looks: Vec<Vec<Look>>,
    /// Most frequent number of cells in lines with numbers.
    width: usize,
    score: usize,
}

impl Candidate {
    fn of(separator: Separator, decimal: Decimal, lines: &[Line]) -> Self {
        let looks: Vec<Vec<Look>> =
            lines.iter().map(|(_, line)| separator.cells(line).map(|cell| Look::of(cell, decimal)).collect()).collect();
        let with_numbers = || looks.iter().filter(|cells| is_row(cells));
        // Ties go to the width that comes first.
        let widths: Vec<usize> = with_numbers().map(Vec::len).collect();
        let frequency = |width: usize| widths.iter().filter(|other| **other == width).count();
        let width = widths.iter().copied().rev().max_by_key(|width| frequency(*width)).unwrap_or(0);
        let readings = |cells: &Vec<Look>| cells.iter().filter(|look| look.is_reading()).count();
        let score = with_numbers().filter(|cells| cells.len() == width).map(readings).sum();
        Self { separator, decimal, looks, width, score }
    }

    /// True if most rows have the same number of cells, and more than one.
    fn is_regular(&self) -> bool {
        let rows = || self.looks.iter().filter(|cells| is_row(cells));
        self.width > 1 && 2 * rows().filter(|cells| cells.len() == self.width).count() > rows().count()
    }
}

/// True for the cells of a row: at least one reading, and at most half of the cells are words.
fn is_row(cells: &[Look]) -> bool {
    let words = cells.iter().filter(|look| look.is_word()).count();
    cells.iter().any(|look| look.is_reading()) && 2 * words <= cells.len()
}

impl Sketch {
    /// A sketch with known column names and kinds.
    pub(super) fn of_columns(names: Vec<String>, kinds: Vec<Kind>) -> Self {
        Self {
            separator: Separator::Mark(b'\t'),
            decimal: Decimal::Point,
            columns: kinds.len(),
            kinds,
            header: Some((1, names)),
            units: None,
            first_line: 1,
            passed_over: 0,
            has_trailing: false,
        }
    }

    /// Infers the structure from the first `lines` with cells. `comment` is the last comment before them. `wanted`
    /// lists the possible numbers of readings in a frame, if known.
    pub(super) fn of<'a>(
        lines: impl Iterator<Item = Line<'a>>,
        comment: Option<Line<'a>>,
        wanted: &[usize],
    ) -> Result<Self, NoTable> {
        let mut bytes = 0;
        let lines: Vec<Line> = lines
            .take(MOST_LINES)
            .enumerate()
            .take_while(|(index, (_, line))| {
                bytes += line.len();
                *index < FEWEST_LINES || bytes <= MOST_BYTES
            })
            .map(|(_, line)| line)
            .collect();
        let has_digits = lines.iter().any(|(_, line)| line.contains(|c: char| c.is_ascii_digit()));
        if let Some((line, cell)) = both_marks(&lines) {
            return Err(NoTable::Thousands { line, cell });
        }
        let none = if has_digits { NoTable::OtherLines } else { NoTable::NoNumbers };
        let best = best_candidate(&lines).ok_or(none)?;
        let Candidate { separator, decimal, looks, width, .. } = best;
        let full = |cells: &[Look]| is_row(cells) && cells.len() == width;
        let last_empty = |index: usize| separator.cells(lines[index].1).last().is_some_and(str::is_empty);
        let rows: Vec<usize> = (0..lines.len()).filter(|&index| full(&looks[index])).collect();
        let tangled = rows.iter().filter(|&&row| looks[row].contains(&Look::Tangled)).count();
        let wordy =
            rows.iter().filter(|&&row| 2 * looks[row].iter().filter(|look| look.is_word()).count() > width).count();
        if 2 * tangled.max(wordy) > rows.len() {
            return Err(NoTable::OtherLines);
        }
        // A numeric header looks like a row.
        let numeric_header = rows.first().copied().filter(|&first| {
            // Directly below names it is a frame.
            if first > 0 && looks[first - 1].len() == width && is_names(&looks[first - 1]) {
                return false;
            }
            let below: Vec<&str> = rows.iter().skip(1).map(|&row| lines[row].1).collect();
            is_numeric_header(lines[first].1, &below, separator, decimal)
        });
        let mut first = match numeric_header {
            Some(header) => *rows.iter().find(|&&row| row > header).ok_or(NoTable::NoNumbers)?,
            None => *rows.first().ok_or(NoTable::NoNumbers)?,
        };
        // Include leading frames in which every reading is missing.
        while first > 0
            && numeric_header.is_none_or(|header| first - 1 > header)
            && looks[first - 1].len() == width
            && looks[first - 1].iter().all(|look| *look == Look::Missing)
        {
            first -= 1;
        }
        // An earlier row with a different width is damaged, unless it is short enough to be a title.
        let damaged = |index: &usize| is_row(&looks[*index]) && 2 * looks[*index].len() >= width;
        if let Some(index) = (0..first).filter(|index| Some(*index) != numeric_header).find(damaged) {
            return Err(NoTable::Row { line: lines[index].0, cells: looks[index].len(), usual: width });
        }
        let body: Vec<usize> = rows.iter().copied().filter(|&row| row >= first).collect();
        let names_of = |line: &str| -> Vec<String> { separator.cells(line).map(str::to_owned).collect() };
        let mut has_trailing = width > 1
            && !wanted.contains(&width)
            && separator != Separator::Spaces
            && body.iter().all(|&row| last_empty(row));
        let head = match numeric_header {
            Some(header) => Some((header, names_of(lines[header].1))),
            None => first.checked_sub(1).map(|above| (above, names_of(lines[above].1))),
        };
        // If the last column has a name, it is a channel without readings.
        has_trailing &= !head.as_ref().is_some_and(|(_, names)| names.len() == width && !names[width - 1].is_empty());
        let columns = width - usize::from(has_trailing);
        let kinds: Vec<Kind> = (0..columns).map(|column| kind_of(body.iter().map(|&row| looks[row][column]))).collect();
        let mut sketch = Self {
            separator,
            decimal,
            columns,
            kinds,
            header: None,
            units: None,
            first_line: lines[first].0,
            passed_over: first,
            has_trailing,
        };
        if let Some(cell) = comma_between_commas(&sketch, body.iter().map(|&row| lines[row].1)) {
            return Err(NoTable::CommaBetweenCommas { line: lines[first].0, cell });
        }
        if let Some((row, cell)) = thousands(&sketch, &body.iter().map(|&row| lines[row].1).collect::<Vec<_>>()) {
            return Err(NoTable::Thousands { line: lines[body[row]].0, cell });
        }
        if let Some((above, mut names)) = head {
            let is_names = numeric_header.is_some() || is_names(&looks[above]);
            let above_that = above.checked_sub(1).map(|index| names_of(lines[index].1));
            match above_that {
                Some(real) if is_names && are_units(&names) && real.len() == names.len() => {
                    sketch.units = Some(std::mem::replace(&mut names, real));
                    sketch.passed_over -= 1;
                }
                _ => {}
            }
            if is_names {
                sketch.take_header(lines[above].0, names)?;
            }
        } else if let Some((line, text)) = comment {
            let names = names_of(text.trim_start_matches(['#', '%', ' ']));
            if columns > 1 && names.len() == columns && names.iter().all(|name| Look::of(name, decimal).is_word()) {
                sketch.header = Some((line, names));
            }
        }
        Ok(sketch)
    }

    /// Uses the line above the rows as the header if its names fit. A line with few cells is a title.
    fn take_header(&mut self, line: usize, mut names: Vec<String>) -> Result<(), NoTable> {
        let columns = self.columns;
        if names.len() == columns + 1 && names.last().is_some_and(String::is_empty) {
            names.pop();
        }
        // R writes no name above its column of row names.
        let has_row_names = columns > 2 && names.len() + 1 == columns && self.kinds[0] != Kind::Number;
        if has_row_names {
            names.insert(0, String::new());
            self.units.iter_mut().for_each(|units| units.insert(0, String::new()));
        }
        if names.len() == columns {
            self.header = Some((line, names));
            self.passed_over -= 1;
        } else if names.len() > 1 && 2 * names.len() >= columns {
            return Err(NoTable::Header { line, names: names.len(), cells: columns });
        }
        Ok(())
    }
}

/// The separator and decimal mark that yield the most numbers. Ties go to the first.
fn best_candidate(lines: &[Line]) -> Option<Candidate> {
    let is_quoted = lines.iter().any(|(_, line)| line.contains('"'));
    let mut best: Option<Candidate> = None;
    for separator in Separator::ALL {
        // Two tabs in a row enclose an empty cell, but a run of blanks is a single separator.
        let is_tabbed = |best: &Candidate| best.separator == Separator::Mark(b'\t') && best.is_regular();
        if separator == Separator::Spaces && best.as_ref().is_some_and(is_tabbed) {
            continue;
        }
        for decimal in [Decimal::Point, Decimal::Comma] {
            // A comma can't be both separator and decimal mark unless cells are quoted.
            if separator == Separator::Mark(b',') && decimal == Decimal::Comma && !is_quoted {
                continue;
            }
            let candidate = Candidate::of(separator, decimal, lines);
            if candidate.score > best.as_ref().map_or(0, |best| best.score) {
                best = Some(candidate);
            }
        }
    }
    best
}

/// True for names: at least one cell is a word and none is a reading.
fn is_names(looks: &[Look]) -> bool {
    !looks.iter().any(|look| look.is_reading()) && looks.iter().any(|look| look.is_word())
}

/// True for a line of units below the names: `s;V;V`, `(s),(mV)`.
fn are_units(names: &[String]) -> bool {
    let units =
        ["s", "ms", "us", "µs", "ns", "v", "mv", "uv", "µv", "nv", "ohm", "kohm", "a", "ma", "hz", "deg", "rad", ""];
    let bare = |name: &String| name.trim_matches(['(', ')', '[', ']', ' ']).to_lowercase();
    names.iter().all(|name| units.contains(&bare(name).as_str())) && names.iter().any(|name| !name.is_empty())
}

fn kind_of(looks: impl Iterator<Item = Look>) -> Kind {
    let (mut words, mut stamps, mut others) = (false, false, false);
    for look in looks {
        match look {
            Look::Word | Look::Tangled => words = true,
            Look::Stamp => stamps = true,
            Look::Missing => {}
            Look::Number | Look::Complex => others = true,
        }
    }
    match (words, stamps, others) {
        (true, false, false) => Kind::Words,
        (false, true, false) => Kind::Stamp,
        // Anything else in a column of numbers becomes an error that names its place.
        _ => Kind::Number,
    }
}

/// True for consecutive integers from 0 or 1, after up to three other cells. pandas writes such a header for columns
/// without names.
fn is_numeric_header(line: &str, below: &[&str], separator: Separator, decimal: Decimal) -> bool {
    let cells: Vec<&str> = separator.cells(line).collect();
    let lead = cells.iter().take(3).take_while(|cell| cell.parse::<u32>().is_err()).count();
    let mut counted = &cells[lead..];
    if let [rest @ .., ""] = counted {
        counted = rest;
    }
    let first: Option<u32> = counted.first().and_then(|cell| cell.parse().ok()).filter(|first| *first <= 1);
    let Some(first) = first else { return false };
    let counts = counted.iter().zip(first..).all(|(cell, expected)| *cell == expected.to_string());
    let broken =
        |cell: &str| cell.contains([decimal.mark() as char, 'e', 'E']) || number(cell, decimal).is_ok_and(f64::is_nan);
    let all_broken = || !below.is_empty() && below.iter().all(|line| separator.cells(line).skip(lead).all(broken));
    let counts_on = || {
        let next = below.first().and_then(|line| separator.cells(line).nth(lead)).and_then(|cell| cell.parse().ok());
        next == Some(first + counted.len() as u32)
    };
    counts
        && (counted.len() >= SURE_COUNT
            || (counted.len() >= SINGLE_COUNT && !below.is_empty() && !counts_on())
            || (counted.len() >= LIKELY_COUNT && all_broken()))
}

/// A cell showing that both decimal mark and separator are commas, which makes the table ambiguous. All cells must be
/// integers. The second of each pair must look like the digits of a fraction: at least one starts with a zero, or all
/// have the same length and the first ones are shorter.
fn comma_between_commas<'a>(sketch: &Sketch, rows: impl Iterator<Item = &'a str>) -> Option<String> {
    if sketch.separator != Separator::Mark(b',')
        || sketch.decimal == Decimal::Comma
        || !sketch.columns.is_multiple_of(2)
    {
        return None;
    }
    let cells: Vec<Vec<&str>> = rows.map(|row| sketch.separator.cells(row).take(sketch.columns).collect()).collect();
    let all = || cells.iter().flatten();
    let digits = |cell: &str| cell.trim_start_matches('-').bytes().all(|byte| byte.is_ascii_digit());
    if !all().all(|cell| digits(cell)) {
        return None;
    }
    let seconds = || cells.iter().flat_map(|row| row.iter().skip(1).step_by(2));
    if let Some(cell) = seconds().find(|cell| cell.len() > 1 && cell.starts_with('0')) {
        return Some((*cell).to_owned());
    }
    let firsts = || cells.iter().flat_map(|row| row.iter().step_by(2));
    let length = seconds().next()?.len();
    let is_fraction =
        length >= 3 && seconds().all(|cell| cell.len() == length) && firsts().all(|cell| cell.len() < length);
    (is_fraction && sketch.columns >= 4).then(|| seconds().next().map_or_else(String::new, |cell| (*cell).to_owned()))
}

/// Number of cells needed to recognise thousands separators.
const SURE_THOUSANDS: usize = 3;

/// A row and a cell showing thousands separators. Their column has integers below 1000 without the mark, and other
/// numbers with exactly three digits after it. With decimal marks, all cells would have the mark, or the number of
/// digits would vary. Between commas, a point is a decimal point: who writes `1.234` for a thousand needs the comma for
/// decimals.
fn thousands(sketch: &Sketch, rows: &[&str]) -> Option<(usize, String)> {
    if (sketch.separator, sketch.decimal) == (Separator::Mark(b','), Decimal::Point) {
        return None;
    }
    #[derive(Default)]
    struct Column {
        whole: usize,
        marked: usize,
        others: usize,
        first: Option<(usize, String)>,
    }
    let mut columns: Vec<Column> = (0..sketch.columns).map(|_| Column::default()).collect();
    for (row, line) in rows.iter().enumerate() {
        for (cell, column) in sketch.separator.cells(line).zip(&mut columns) {
            let bare = cell.trim_start_matches('-');
            let is_whole = bare.len() <= 3 && !bare.is_empty() && bare.bytes().all(|byte| byte.is_ascii_digit());
            if is_whole {
                column.whole += 1;
            } else if looks_like_thousands(cell, sketch.decimal) {
                column.marked += 1;
                column.first.get_or_insert_with(|| (row, cell.to_owned()));
            } else if !number(cell, sketch.decimal).is_ok_and(f64::is_nan) {
                column.others += 1;
            }
        }
    }
    let shows = |column: &Column| column.whole > 0 && column.marked > 0 && column.others == 0;
    let marked: usize = columns.iter().filter(|column| shows(column)).map(|column| column.marked).sum();
    let found = columns.into_iter().find(shows)?;
    found.first.filter(|_| marked >= SURE_THOUSANDS)
}

/// A cell with marks between thousands and a decimal mark, if there are several in lines of numbers. Any separator but
/// the mark itself is tried, since the marks mislead the choice of the separator.
fn both_marks(lines: &[Line]) -> Option<(usize, String)> {
    let is_number = |cell: &str| [Decimal::Point, Decimal::Comma].iter().any(|mark| number(cell, *mark).is_ok());
    Separator::ALL.iter().find_map(|separator| {
        let cells = |line: &'_ str| separator.cells(line).map(str::to_owned).collect::<Vec<_>>();
        let rows = lines.iter().map(|(number, line)| (*number, cells(line)));
        let rows = rows
            .filter(|(_, cells)| cells.len() > 1 && cells.iter().all(|cell| is_number(cell) || has_both_marks(cell)));
        let marked = rows.flat_map(|(line, cells)| cells.into_iter().map(move |cell| (line, cell)));
        marked.filter(|(_, cell)| has_both_marks(cell)).nth(SURE_THOUSANDS - 1)
    })
}

/// True for a number with marks between thousands and a decimal mark: `1,234.5`, `-1.234,5`.
fn has_both_marks(cell: &str) -> bool {
    let bare = cell.trim_matches([' ', '"', '-', '+']);
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    [(',', '.'), ('.', ',')].into_iter().any(|(between, decimal)| {
        let Some((whole, fraction)) = bare.split_once(decimal) else { return false };
        let mut groups = whole.split(between);
        let first = groups.next().unwrap_or_default();
        let mut rest = groups.peekable();
        let has_rest = rest.peek().is_some();
        digits(fraction)
            && digits(first)
            && first.len() <= 3
            && has_rest
            && rest.all(|group| group.len() == 3 && digits(group))
    })
}

/// True for one to three digits, the mark and three digits: `1,234`, but not `0,234`.
pub(super) fn looks_like_thousands(cell: &str, decimal: Decimal) -> bool {
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    cell.trim_start_matches('-').split_once(decimal.mark() as char).is_some_and(|(before, behind)| {
        (1..=3).contains(&before.len())
            && !before.starts_with('0')
            && digits(before)
            && behind.len() == 3
            && digits(behind)
    })
}
