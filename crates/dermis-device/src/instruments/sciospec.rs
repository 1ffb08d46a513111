//! Sciospec `.eit` files, version 2: text, one frame a file, every electrode's complex potential for every injection.
//!
//! The first line counts the header's lines, itself included; then, in fixed places, version, name, date, frequencies,
//! amplitude and rate, and further down the measuring channels under their name. After the header, each injection is a
//! line with the two electrode numbers (current in, current out) and a line of real and imaginary parts in volts,
//! either of the measuring channels or of all channels that the instrument has.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::{foreign, read_bytes, text_of};
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Layout};

const EXPECTED: &str = "a Sciospec .eit file (text, version 2)";
const MOST_ELECTRODES: usize = 256;
const CHANNELS_KEY: &str = "MeasurementChannels:";
const PRESENT_KEY: &str = "MeasurementChannelsIndependentFromInjectionPattern:";

/// What the header says about a measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Name of the data set.
    pub name: String,
    /// Start of the frame, seconds since 1970-01-01 on the instrument's local calendar.
    pub time_s: f64,
    /// Excitation frequency.
    pub frequency_hz: f64,
    /// Injected current.
    pub amplitude_a: f64,
    /// Frames in a second.
    pub frames_per_s: f64,
    /// Numbers of the measuring channels as the instrument counts them, in file order; index in this list = electrode.
    pub channels: Vec<usize>,
    /// Channels of which every row has a pair of numbers; those that do not measure are skipped.
    columns: Vec<usize>,
}

/// One file's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Header.
    pub setup: Setup,
    /// Electrode (from 0) at which the current enters and electrode at which it leaves, for each injection.
    pub injections: Vec<(usize, usize)>,
    /// Real parts in volts, injections x electrodes.
    pub real_v: Vec<f64>,
    /// Imaginary parts in volts.
    pub imaginary_v: Vec<f64>,
}

/// Whether a file's name or first lines are those of a `.eit` text file.
pub(super) fn looks_like(path: &Path, content: &[u8]) -> bool {
    let named = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("eit"));
    let start = &content[..content.len().min(4096)];
    named || start.windows(CHANNELS_KEY.len()).any(|window| window == CHANNELS_KEY.as_bytes())
}

/// One frame, numbered as its file is.
///
/// # Errors
/// As [`parse`].
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    let measurement = parse(content, file)?;
    into_table(vec![(file_number(file), measurement)], file)
}

/// All `.eit` files of a directory in the order of the numbers in their names. A directory without any, but with one
/// sub-directory that has them, stands for that one (the instrument writes `run/setup/setup_00001.eit`).
///
/// # Errors
/// As [`parse`] for the first unreadable file; [`DeviceError::Foreign`] without `.eit` files;
/// [`DeviceError::Field`] for a file whose channels, injections or frequency differ from the first one's.
pub fn read_directory(directory: &Path) -> Result<FrameTable, DeviceError> {
    let mut files = numbered_files(directory)?;
    if files.is_empty() {
        files = files_below(directory)?;
    }
    let mut measurements = Vec::with_capacity(files.len());
    for (number, file) in files {
        let measurement = parse(&read_bytes(&file)?, &file)?;
        if let Some((_, first)) = measurements.first() {
            refuse_other_setup(first, &measurement, &file)?;
        }
        measurements.push((number, measurement));
    }
    into_table(measurements, directory)
}

fn into_table(measurements: Vec<(Option<u64>, Measurement)>, source: &Path) -> Result<FrameTable, DeviceError> {
    let Some((_, first)) = measurements.first() else { return Err(DeviceError::Empty { file: source.to_owned() }) };
    let layout = Layout::SingleEnded { electrodes: first.setup.channels.len(), stimulations: first.injections.clone() };
    let start_s = first.setup.time_s;
    let times_s = measurements.iter().map(|(_, measurement)| measurement.setup.time_s - start_s).collect();
    let numbers: Option<Vec<u64>> = measurements.iter().map(|(number, _)| *number).collect();
    let capacity = measurements.len() * layout.channels();
    let (mut real_v, mut imaginary_v) = (Vec::with_capacity(capacity), Vec::with_capacity(capacity));
    for (_, measurement) in &measurements {
        real_v.extend_from_slice(&measurement.real_v);
        imaginary_v.extend_from_slice(&measurement.imaginary_v);
    }
    let table = FrameTable::new(layout, real_v, source)?.with_imaginary(imaginary_v)?.with_times_s(times_s)?;
    match numbers {
        Some(numbers) => table.with_sequences(numbers),
        None => Ok(table),
    }
}

fn refuse_other_setup(first: &Measurement, other: &Measurement, file: &Path) -> Result<(), DeviceError> {
    let expected = first.injections.len();
    if other.injections.len() != expected {
        let found = other.injections.len();
        return Err(DeviceError::Count {
            file: file.to_owned(),
            what: "injections as in the first file",
            expected,
            found,
        });
    }
    let differ = |field, found: String, expected: String| {
        Err(DeviceError::field(file, 1, field, &found, format!("{expected} as in the first file")))
    };
    if other.setup.channels != first.setup.channels {
        let text = |setup: &Setup| shorten(&format!("{:?}", setup.channels));
        return differ("measurement channels", text(&other.setup), text(&first.setup));
    }
    if let Some(at) = (0..expected).find(|&at| first.injections[at] != other.injections[at]) {
        let text = |pair: (usize, usize)| format!("{:?} (from 0)", pair);
        return differ("injection", text(other.injections[at]), text(first.injections[at]));
    }
    if other.setup.frequency_hz != first.setup.frequency_hz {
        let text = |setup: &Setup| format!("{} Hz", setup.frequency_hz);
        return differ("frequency", text(&other.setup), text(&first.setup));
    }
    Ok(())
}

/// Parses one file; `file` is for messages.
///
/// # Errors
/// [`DeviceError::Foreign`] for other content, [`DeviceError::Field`] and [`DeviceError::Cell`] with the line,
/// [`DeviceError::Empty`] without an injection.
pub fn parse(content: &[u8], file: &Path) -> Result<Measurement, DeviceError> {
    let text = text_of(content, file, EXPECTED)?;
    let mut reader = Lines { file, lines: text.lines().collect(), content };
    while reader.lines.last().is_some_and(|line| line.trim().is_empty()) {
        reader.lines.pop();
    }
    let (header_lines, setup) = reader.header()?;
    let mut measurement = Measurement { setup, injections: vec![], real_v: vec![], imaginary_v: vec![] };
    let mut seen = HashSet::new();
    let mut line = header_lines + 1;
    while line <= reader.lines.len() {
        let injection = reader.injection(line, &measurement.setup.channels)?;
        if !seen.insert(injection) {
            return Err(reader.wrong(line, "injection", "a pair that is not in the file yet"));
        }
        measurement.injections.push(injection);
        reader.readings(line + 1, &mut measurement)?;
        line += 2;
    }
    if measurement.injections.is_empty() {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    Ok(measurement)
}

/// The lines of one file, numbered from 1 as in messages.
struct Lines<'a> {
    file: &'a Path,
    lines: Vec<&'a str>,
    content: &'a [u8],
}

impl Lines<'_> {
    /// The line with this number; past the end, an empty one.
    fn line(&self, number: usize) -> &str {
        number.checked_sub(1).and_then(|index| self.lines.get(index)).map_or("", |line| line.trim())
    }

    fn wrong(&self, line: usize, field: &'static str, expected: &str) -> DeviceError {
        let found = if line > self.lines.len() { "the end of the file" } else { self.line(line) };
        DeviceError::field(self.file, line, field, found, expected)
    }

    fn field<T: FromStr>(
        &self,
        line: usize,
        field: &'static str,
        expected: &str,
        good: impl Fn(&T) -> bool,
    ) -> Result<T, DeviceError> {
        self.line(line).parse().ok().filter(good).ok_or_else(|| self.wrong(line, field, expected))
    }

    /// Number of header lines, and what they say.
    fn header(&self) -> Result<(usize, Setup), DeviceError> {
        let count: usize = self.line(1).parse().map_err(|_| foreign(self.file, EXPECTED, self.content))?;
        if !(11..=64).contains(&count) {
            return Err(self.wrong(1, "number of header lines", "11 to 64 (version 2)"));
        }
        if count > self.lines.len() {
            return Err(self.wrong(self.lines.len() + 1, "header", &format!("{count} header lines as line 1 says")));
        }
        let positive = |value: &f64| value.is_finite() && *value > 0.0;
        self.field(2, "version", "2", |&version: &u32| version == 2)?;
        let time_s = self.time(4)?;
        let frequency_hz = self.field(5, "lowest frequency", "a positive number of hertz", positive)?;
        self.field(6, "highest frequency", "a positive number of hertz", positive)?;
        self.field(8, "number of frequencies", "1 (several are not read)", |&count: &usize| count == 1)?;
        let amplitude_a = self.field(9, "amplitude", "a positive number of amperes", positive)?;
        let frames_per_s = self.field(10, "frame rate", "a positive number", positive)?;
        let (channels, columns) = self.channels(count)?;
        let name = self.line(3).to_owned();
        Ok((count, Setup { name, time_s, frequency_hz, amplitude_a, frames_per_s, channels, columns }))
    }

    /// A date such as `2025.02.12. 13:19:58.685`, in seconds since 1970-01-01 without regard to time zones.
    fn time(&self, line: usize) -> Result<f64, DeviceError> {
        parse_time(self.line(line)).ok_or_else(|| self.wrong(line, "date", "year.month.day. hour:minute:second"))
    }

    /// The measuring channels, and those that have a place in every row: the first row's length tells whether these
    /// are the measuring channels or all that are present.
    fn channels(&self, header_lines: usize) -> Result<(Vec<usize>, Vec<usize>), DeviceError> {
        let first_row = header_lines + 2;
        let readings = self.line(first_row).split_whitespace().count();
        let Some(measuring) = self.listed(header_lines, CHANNELS_KEY)? else {
            if !(4..=2 * MOST_ELECTRODES).contains(&readings) || !readings.is_multiple_of(2) {
                let expected = "a pair of numbers for each of 2 to 256 channels, as the header lists none";
                return Err(DeviceError::field(
                    self.file,
                    first_row,
                    "readings",
                    &format!("{readings} numbers"),
                    expected,
                ));
            }
            let all: Vec<usize> = (1..=readings / 2).collect();
            return Ok((all.clone(), all));
        };
        let present = self.listed(header_lines, PRESENT_KEY)?.unwrap_or_default();
        if readings == 2 * present.len() && measuring.iter().all(|channel| present.contains(channel)) {
            return Ok((measuring, present));
        }
        Ok((measuring.clone(), measuring))
    }

    /// The channel numbers that stand in the header under a name, if the name does.
    fn listed(&self, header_lines: usize, key: &str) -> Result<Option<Vec<usize>>, DeviceError> {
        let Some(line) = (1..=header_lines).find(|&line| self.line(line).starts_with(key)) else { return Ok(None) };
        let list = self.line(line)[key.len()..].split(',').take(MOST_ELECTRODES + 1);
        let channels: Option<Vec<usize>> = list.map(|number| number.trim().parse().ok().filter(|&n| n > 0)).collect();
        channels
            .filter(|channels| (2..=MOST_ELECTRODES).contains(&channels.len()))
            .filter(|channels| channels.iter().collect::<HashSet<_>>().len() == channels.len())
            .map(Some)
            .ok_or_else(|| self.wrong(line, "measurement channels", "2 to 256 different channel numbers from 1"))
    }

    /// Electrodes of an injection line such as `1 2`, from 0.
    fn injection(&self, line: usize, channels: &[usize]) -> Result<(usize, usize), DeviceError> {
        let electrode = |number: &str| {
            let number: usize = number.parse().ok()?;
            channels.iter().position(|&channel| channel == number)
        };
        let mut numbers = self.line(line).split_whitespace();
        match (numbers.next().and_then(electrode), numbers.next().and_then(electrode), numbers.next()) {
            (Some(from), Some(to), None) if from != to => Ok((from, to)),
            _ => Err(self.wrong(line, "injection", "two different numbers of measurement channels")),
        }
    }

    /// Appends the measuring channels of a line of real and imaginary parts.
    fn readings(&self, line: usize, measurement: &mut Measurement) -> Result<(), DeviceError> {
        if line > self.lines.len() {
            return Err(self.wrong(line, "readings", "a line of readings after its injection"));
        }
        let setup = &measurement.setup;
        let expected = 2 * setup.columns.len();
        let cells: Vec<&str> = self.line(line).split_whitespace().collect();
        if cells.len() != expected {
            let what = format!("{expected} numbers (real and imaginary part of {} channels)", expected / 2);
            return Err(DeviceError::field(self.file, line, "readings", &format!("{} numbers", cells.len()), what));
        }
        for channel in &setup.channels {
            let Some(column) = setup.columns.iter().position(|other| other == channel) else { continue };
            measurement.real_v.push(self.reading(line, 2 * column, &cells)?);
            measurement.imaginary_v.push(self.reading(line, 2 * column + 1, &cells)?);
        }
        Ok(())
    }

    fn reading(&self, line: usize, column: usize, cells: &[&str]) -> Result<f64, DeviceError> {
        let value = cells[column].parse().ok().filter(|value: &f64| !value.is_infinite());
        value.ok_or_else(|| DeviceError::Cell {
            file: self.file.to_owned(),
            line,
            column: column + 1,
            found: shorten(cells[column]),
            expected: "a finite number or NaN",
        })
    }
}

fn parse_time(text: &str) -> Option<f64> {
    let (date, time) = text.split_once(' ')?;
    let mut date = date.trim_end_matches('.').split('.').map(|part| part.parse::<i64>().ok());
    let (year, month, day) = (date.next()??, date.next()??, date.next()??);
    let mut time = time.trim().split(':');
    let (hour, minute) = (time.next()?.parse::<u32>().ok()?, time.next()?.parse::<u32>().ok()?);
    let second = time.next()?.parse::<f64>().ok()?;
    let in_calendar = (1..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    let in_day = hour < 24 && minute < 60 && (0.0..61.0).contains(&second);
    let whole = date.next().is_none() && time.next().is_none();
    (in_calendar && in_day && whole)
        .then(|| days_since_1970(year, month, day) as f64 * 86_400.0 + f64::from(hour * 3600 + minute * 60) + second)
}

/// Days from 1970-01-01 in the Gregorian calendar, counted in years that begin in March so that the leap day is last.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let month_from_march = (month + 9) % 12;
    let day_of_year = (153 * month_from_march + 2) / 5 + day - 1;
    365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + day_of_year - 719_468
}

/// The number at the end of a file's stem, as in `setup_00001.eit`.
fn file_number(file: &Path) -> Option<u64> {
    let stem = file.file_stem()?.to_str()?;
    let digits = stem.len() - stem.trim_end_matches(|letter: char| letter.is_ascii_digit()).len();
    stem[stem.len() - digits..].parse().ok()
}

/// `.eit` files of a directory by number, those without one last, equal ones by name.
fn numbered_files(directory: &Path) -> Result<Vec<(Option<u64>, PathBuf)>, DeviceError> {
    let failed = |error| DeviceError::io(directory, "list", error);
    let mut files = Vec::new();
    for entry in fs::read_dir(directory).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("eit")) && path.is_file() {
            files.push((file_number(&path), path));
        }
    }
    files.sort_by(|a, b| (a.0.is_none(), a.0, &a.1).cmp(&(b.0.is_none(), b.0, &b.1)));
    Ok(files)
}

/// The `.eit` files of the only sub-directory that has any.
fn files_below(directory: &Path) -> Result<Vec<(Option<u64>, PathBuf)>, DeviceError> {
    let failed = |error| DeviceError::io(directory, "list", error);
    let mut found: Vec<Vec<(Option<u64>, PathBuf)>> = Vec::new();
    for entry in fs::read_dir(directory).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            found.push(numbered_files(&path)?);
        }
    }
    found.retain(|files| !files.is_empty());
    if found.len() != 1 {
        let found = format!("a directory without .eit files and {} sub-directories with some", found.len());
        return Err(DeviceError::Foreign {
            file: directory.to_owned(),
            expected: "a directory of Sciospec .eit files",
            found,
        });
    }
    Ok(found.remove(0))
}

#[cfg(test)]
mod tests;
