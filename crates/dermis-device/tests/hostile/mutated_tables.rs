//! Tables in every style that spreadsheets, loggers and libraries use, intact or damaged. The result is either the
//! original table or an error.

use std::fmt::Write as _;
use std::path::Path;

use dermis_device::{Format, FrameSelect, FrameTable, ReadOptions, decode_with};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Style of a table.
#[derive(Debug, Clone)]
struct Way {
    separator: &'static str,
    has_comma: bool,
    header: Header,
    leading: Leading,
    has_trailing: bool,
    encoding: Encoding,
    line_end: &'static str,
    blank_lines: bool,
    comment: bool,
    title: bool,
    quoted: bool,
    missing: &'static str,
    exponent: bool,
    is_told: bool,
    damage: Damage,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Header {
    None,
    Names,
    Numbers(usize),
    Millivolts,
    UnitsBelow,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Leading {
    None,
    Count(usize),
    Seconds,
    Milliseconds,
    Dates,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Utf8,
    Marked,
    WideLittle,
    WideBig,
    Windows,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Damage {
    None,
    LostCell,
    DoubledCell,
    Word,
    OtherDecimalMark,
    CutOff,
    Infinite,
}

fn ways() -> impl Strategy<Value = Way> {
    let separator = prop::sample::select(vec![",", ";", "\t", "|", " ", "   ", ", ", " ; "]);
    let header = prop::sample::select(vec![
        Header::None,
        Header::Names,
        Header::Numbers(0),
        Header::Numbers(1),
        Header::Millivolts,
        Header::UnitsBelow,
    ]);
    let leading = prop::sample::select(vec![
        Leading::None,
        Leading::None,
        Leading::Count(0),
        Leading::Count(1),
        Leading::Seconds,
        Leading::Milliseconds,
        Leading::Dates,
    ]);
    let encoding = prop::sample::select(vec![
        Encoding::Utf8,
        Encoding::Utf8,
        Encoding::Marked,
        Encoding::WideLittle,
        Encoding::WideBig,
        Encoding::Windows,
    ]);
    let damage = prop::sample::select(vec![
        Damage::None,
        Damage::None,
        Damage::None,
        Damage::LostCell,
        Damage::DoubledCell,
        Damage::Word,
        Damage::OtherDecimalMark,
        Damage::CutOff,
        Damage::Infinite,
    ]);
    let line_end = prop::sample::select(vec!["\n", "\r\n", "\r"]);
    let missing = prop::sample::select(vec!["nan", "NaN", "NA", "", "null"]);
    let flags = prop::array::uniform8(any::<bool>());
    (separator, header, leading, encoding, damage, line_end, missing, flags).prop_map(
        |(separator, header, leading, encoding, damage, line_end, missing, flags)| {
            let [has_comma, has_trailing, blank_lines, comment, title, quoted, exponent, is_told] = flags;
            let is_spaced = separator.trim().is_empty() && separator != "\t";
            let is_comma = separator.trim() == ",";
            Way {
                separator,
                // Decimal commas between commas are ambiguous, unless cells are quoted.
                has_comma: has_comma && (!is_comma || quoted),
                header,
                // With blanks as separators, a date that contains a blank is two cells.
                leading: if is_spaced && leading == Leading::Dates { Leading::Seconds } else { leading },
                has_trailing: has_trailing && !is_spaced,
                encoding,
                line_end,
                blank_lines,
                comment,
                title,
                quoted,
                missing: if is_spaced && missing.is_empty() { "nan" } else { missing },
                exponent,
                is_told,
                damage,
            }
        },
    )
}

/// Rows of readings: volts below 0.1, volts of either sign, ADC counts, or values of any magnitude.
fn readings() -> impl Strategy<Value = Vec<Vec<Option<f64>>>> {
    let cell = |kind: usize| {
        let value = match kind {
            0 => (1_i64..9_999_999).prop_map(|digits| digits as f64 * 1e-8).boxed(),
            1 => (-9_999_999_i64..9_999_999).prop_map(|digits| digits as f64 * 1e-6).boxed(),
            2 => (0_i64..4096).prop_map(|count| count as f64).boxed(),
            _ => (-999_999_i64..999_999, -9_i32..6)
                .prop_map(|(digits, power)| digits as f64 * 10_f64.powi(power))
                .boxed(),
        };
        prop::option::weighted(0.97, value)
    };
    (4_usize..12, prop::sample::select(vec![4_usize, 6, 16, 40]), 0_usize..4)
        .prop_flat_map(move |(rows, columns, kind)| {
            prop::collection::vec(prop::collection::vec(cell(kind), columns), rows)
        })
        .prop_filter("every row has a reading", |rows| {
            rows.iter().all(|row| row.iter().filter(|cell| cell.is_some()).count() > 1)
        })
}

impl Way {
    fn number(&self, value: f64) -> String {
        let text = match (self.exponent, value.fract() == 0.0) {
            (true, _) => format!("{value:e}"),
            (false, true) => format!("{value}"),
            (false, false) => Some(format!("{value:.8}"))
                .filter(|text| text.parse().is_ok_and(|read: f64| (read - value).abs() <= 1e-13 * value.abs()))
                .unwrap_or_else(|| format!("{value}")),
        };
        if self.has_comma { text.replace('.', ",") } else { text }
    }

    fn cell(&self, text: String) -> String {
        if self.quoted { format!("\"{text}\"") } else { text }
    }

    fn line(&self, cells: &[String]) -> String {
        let end = if self.has_trailing { self.separator.trim_end_matches(' ') } else { "" };
        cells.join(self.separator) + end
    }

    fn lead(&self, row: usize) -> Option<String> {
        Some(match self.leading {
            Leading::None => return None,
            Leading::Count(first) => (first + row).to_string(),
            Leading::Seconds => self.cell(self.number(0.02 * row as f64)),
            Leading::Milliseconds => (20 * row).to_string(),
            Leading::Dates => format!("2024-03-01 14:07:{:02}.{:03}", row / 50, 20 * (row % 50)),
        })
    }

    fn heading(&self, columns: usize) -> Vec<Vec<String>> {
        let lead = match self.leading {
            Leading::None => None,
            Leading::Count(_) => Some(""),
            Leading::Seconds => Some("Time (s)"),
            Leading::Milliseconds => Some("time_ms"),
            Leading::Dates => Some("timestamp"),
        };
        // With blanks as separators, a name must have letters and no blanks.
        let lead = lead.map(|lead| match (self.separator.trim().is_empty() && self.separator != "\t", lead) {
            (true, "") => "index",
            (true, "Time (s)") => "time_s",
            _ => lead,
        });
        let name = |column: usize| match self.header {
            Header::Numbers(first) => (first + column).to_string(),
            Header::Millivolts if self.encoding == Encoding::Windows => format!("Kanäle{column}_mV"),
            Header::Millivolts => format!("ch{column}_mV"),
            _ => format!("ch{column}"),
        };
        let row = |lead: Option<&str>, name: &dyn Fn(usize) -> String| {
            lead.map(str::to_owned).into_iter().chain((0..columns).map(name)).collect::<Vec<String>>()
        };
        let unit = match self.leading {
            Leading::None => None,
            Leading::Seconds => Some("s"),
            Leading::Milliseconds => Some("ms"),
            // With blanks as separators, there are no empty cells.
            _ if self.separator.trim().is_empty() && self.separator != "\t" => return vec![row(lead, &name)],
            _ => Some(""),
        };
        match self.header {
            Header::None => Vec::new(),
            Header::UnitsBelow => vec![row(lead, &name), row(unit, &|_| "V".to_owned())],
            _ => vec![row(lead, &name)],
        }
    }

    fn write(&self, rows: &[Vec<Option<f64>>]) -> Vec<u8> {
        let scale = if self.header == Header::Millivolts { 1e3 } else { 1.0 };
        let mut lines = Vec::new();
        if self.title {
            lines.push("Measurement".to_owned());
        }
        if self.comment {
            lines.push("# written by a logger".to_owned());
        }
        for names in self.heading(rows[0].len()) {
            lines.push(self.line(&names));
        }
        let (at, column) = (rows.len() / 2, rows[0].len() / 2);
        for (index, row) in rows.iter().enumerate() {
            let mut cells: Vec<String> = self.lead(index).into_iter().collect();
            let lead = cells.len();
            cells.extend(row.iter().map(|cell| {
                self.cell(cell.map_or_else(|| self.missing.to_owned(), |value| self.number(value * scale)))
            }));
            if index == at {
                let place = lead + column;
                match self.damage {
                    Damage::LostCell => drop(cells.remove(place)),
                    Damage::DoubledCell => cells.insert(place, cells[place].clone()),
                    Damage::Word => cells[place] = "ovf".to_owned(),
                    Damage::Infinite => cells[place] = "inf".to_owned(),
                    Damage::OtherDecimalMark => {
                        let (from, to) = if self.has_comma { (",", ".") } else { (".", ",") };
                        cells[place] = cells[place].replace(from, to);
                    }
                    _ => {}
                }
            }
            lines.push(self.line(&cells));
            if self.blank_lines {
                lines.push(String::new());
            }
        }
        let mut text = lines.join(self.line_end);
        if self.damage == Damage::CutOff {
            let end = text.len() - lines.last().map_or(0, String::len).max(8) / 2;
            text.truncate((0..=end).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0));
        } else {
            let _ = write!(text, "{}", self.line_end);
        }
        let wide = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        match self.encoding {
            Encoding::Utf8 => text.into_bytes(),
            Encoding::Marked => [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            Encoding::WideLittle => [b"\xff\xfe", &wide(u16::to_le_bytes)[..]].concat(),
            Encoding::WideBig => [b"\xfe\xff", &wide(u16::to_be_bytes)[..]].concat(),
            Encoding::Windows => text.chars().map(|c| c as u8).collect(),
        }
    }

    fn has_unnamed_times(&self) -> bool {
        self.header == Header::None && matches!(self.leading, Leading::Seconds | Leading::Milliseconds)
    }

    fn read(&self, content: &[u8], channels: usize) -> Result<FrameTable, String> {
        let told = if self.is_told { vec![channels, 4096] } else { Vec::new() };
        let options = ReadOptions::default().with_channels(told);
        let path = Path::new("made.csv");
        let format = Format::detect(path, content).map_err(|error| error.to_string())?;
        decode_with(format, content, path, &options).map_err(|error| error.to_string())
    }
}

/// Checks that the frames are the first ones that were written, or all of them.
fn holds(table: &FrameTable, rows: &[Vec<Option<f64>>]) -> Result<(), String> {
    if table.channels() != rows[0].len() || table.frames() > rows.len() {
        return Err(format!("{} instead of {} x {}", table.understood(), rows.len(), rows[0].len()));
    }
    for (found, written) in table.rows().zip(rows) {
        for (found, written) in found.iter().zip(written) {
            let same = match written {
                None => found.is_nan(),
                Some(value) => (found - value).abs() <= 1e-12 * value.abs(),
            };
            if !same {
                return Err(format!("{found} instead of {written:?}; {}", table.understood()));
            }
        }
    }
    Ok(())
}

/// The same few hundred tables in every run; `PROPTEST_CASES=20000 PROPTEST_RNG_SEED=7` runs that many different ones.
fn cases() -> ProptestConfig {
    let mut config = ProptestConfig { failure_persistence: None, ..ProptestConfig::default() };
    if std::env::var_os("PROPTEST_CASES").is_none() {
        config.cases = 400;
    }
    if std::env::var_os("PROPTEST_RNG_SEED").is_none() {
        config.rng_seed = RngSeed::Fixed(36);
    }
    config
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn tables_are_read_as_written_or_refused(way in ways(), rows in readings()) {
        let content = way.write(&rows);
        let shown = || String::from_utf8_lossy(&content).into_owned();
        match (way.read(&content, rows[0].len()), way.damage) {
            // If the number of channels isn't given, unnamed times are taken for readings, and one channel too many
            // is found.
            (Ok(table), _) if way.has_unnamed_times() && !way.is_told => {
                prop_assert_eq!(table.channels(), rows[0].len() + 1, "{}", shown());
            }
            (Ok(table), Damage::None) => {
                prop_assert_eq!(table.frames(), rows.len(), "{}", shown());
                if let Err(error) = holds(&table, &rows) {
                    return Err(TestCaseError::fail(format!("{error}\n{}", shown())));
                }
                let has_times = !matches!(way.leading, Leading::None | Leading::Count(_));
                if has_times && (way.header != Header::None || way.leading == Leading::Dates) {
                    let times_s = table.times_s().ok_or_else(|| TestCaseError::fail("no times"))?;
                    let elapsed_s = times_s[times_s.len() - 1] - times_s[0];
                    prop_assert!((elapsed_s - 0.02 * (rows.len() - 1) as f64).abs() < 1e-6, "{times_s:?}");
                }
            }
            (Ok(table), damage) => {
                let result = if damage == Damage::CutOff {
                    // The last number may be cut off; everything before it is right.
                    holds_but_last(&table, &rows)
                } else {
                    holds(&table, &rows)
                };
                // A missing cell has no decimal mark to exchange.
                if let Err(error) = result {
                    return Err(TestCaseError::fail(format!("{damage:?}: {error}\n{}", shown())));
                }
            }
            (Err(error), Damage::None) => return Err(TestCaseError::fail(format!("{error}\n{}", shown()))),
            (Err(error), _) => prop_assert!(error.starts_with("made.csv"), "{}", error),
        }
    }
}

/// As [`holds`], but ignores the last row.
fn holds_but_last(table: &FrameTable, rows: &[Vec<Option<f64>>]) -> Result<(), String> {
    if table.frames() < rows.len() {
        return holds(table, rows);
    }
    let before = format!("0..{}", rows.len() - 1).parse::<FrameSelect>().map_err(|error| error.to_string())?;
    let table = table.clone().select(&before).map_err(|error| error.to_string())?;
    holds(&table, rows)
}
