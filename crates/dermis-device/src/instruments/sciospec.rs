//! Sciospec `.eit` files, versions 1 and 2: text files with one frame each, the complex potentials of all electrodes
//! for all injections.
//!
//! The first line gives the number of header lines, itself included. Version, name, date, frequencies, amplitude and
//! rate follow at fixed lines, and further down the measuring channels after their key. After the header, each
//! injection has a line with its two electrode numbers (current in, current out), and a line of real and imaginary
//! parts in volts for the measuring channels or for all channels of the instrument. A sweep has one such line per
//! frequency; one frequency is read, or the difference of two. Version 1 has nine header lines, without a version or a
//! list of channels.

pub mod live;

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::times::days_since_1970;
use super::{foreign, read_bytes, text_of};
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Frequencies, Layout, ReadOptions};

const EXPECTED: &str = "a Sciospec .eit file (text, version 1 or 2)";
const MOST_ELECTRODES: usize = 256;
/// Maximum number of frequencies in a sweep: more than instruments offer.
const MOST_FREQUENCIES: usize = 1024;
/// Number of header lines in version 1.
const LINES_OF_VERSION_1: usize = 9;
const CHANNELS_KEY: &str = "MeasurementChannels:";
const PRESENT_KEY: &str = "MeasurementChannelsIndependentFromInjectionPattern:";

/// Contents of the header.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Name of the data set.
    pub name: String,
    /// Start of the frame, in seconds since 1970-01-01 in the instrument's local time.
    pub time_s: f64,
    /// Excitation frequency of the readings; for a difference, the first of the two.
    pub frequency_hz: f64,
    /// All frequencies of the file.
    pub frequencies_hz: Vec<f64>,
    /// Injected current.
    pub amplitude_a: f64,
    /// Frame rate in frames per second.
    pub frames_per_s: f64,
    /// The instrument's numbers for the measuring channels, in file order. The index in this list is the electrode.
    pub channels: Vec<usize>,
    /// Frequencies that make up a reading, by position in the sweep, with their weights.
    taken: Vec<(usize, f64)>,
    /// Channels with a pair of numbers in every row. Those that don't measure are skipped.
    columns: Vec<usize>,
}

/// One file's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Header.
    pub setup: Setup,
    /// Electrodes (from 0) where the current enters and leaves, for each injection.
    pub injections: Vec<(usize, usize)>,
    /// Real parts in volts, injections x electrodes.
    pub real_v: Vec<f64>,
    /// Imaginary parts in volts.
    pub imaginary_v: Vec<f64>,
}

/// True if the file's name or its first lines are those of an `.eit` text file.
pub(super) fn looks_like(path: &Path, content: &[u8]) -> bool {
    let named = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("eit"));
    let start = &content[..content.len().min(4096)];
    named || start.windows(CHANNELS_KEY.len()).any(|window| window == CHANNELS_KEY.as_bytes())
}

/// Decodes one frame; its number comes from the file name.
///
/// # Errors
/// As [`parse`].
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let measurement = parse_with(content, file, options.frequencies_hz)?;
    into_table(vec![(file_number(file), measurement)], file)
}

/// Reads all `.eit` files in a directory, ordered by the numbers in their names. If the directory has no `.eit` files
/// and only one of its sub-directories does, that one is read (the instrument writes `run/setup/setup_00001.eit`).
///
/// # Errors
/// As [`parse`] for the first unreadable file; [`DeviceError::Foreign`] if there are no `.eit` files;
/// [`DeviceError::Field`] for a file whose channels, injections or frequency differ from the first one's.
pub fn read_directory(directory: &Path) -> Result<FrameTable, DeviceError> {
    read_directory_with(directory, &ReadOptions::default())
}

pub(super) fn read_directory_with(directory: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let mut files = numbered_files(directory)?;
    if files.is_empty() {
        files = files_below(directory)?;
    }
    let mut measurements = Vec::with_capacity(files.len());
    for (number, file) in files {
        let measurement = parse_with(&read_bytes(&file)?, &file, options.frequencies_hz)?;
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
    let hertz = |taken: &(usize, f64)| first.setup.frequencies_hz[taken.0].to_string();
    let taken: Vec<String> = first.setup.taken.iter().map(hertz).collect();
    let notes = vec![format!("Sciospec, {} Hz", taken.join(" Hz minus "))];
    let table = FrameTable::new(layout, real_v, source)?.with_imaginary(imaginary_v)?.with_times_s(times_s)?;
    let table = table.with_notes(notes);
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

/// Parses one file; `file` is only used in messages.
///
/// # Errors
/// [`DeviceError::Foreign`] for other content, [`DeviceError::Field`] and [`DeviceError::Cell`] with the line,
/// [`DeviceError::Empty`] if there are no injections.
pub fn parse(content: &[u8], file: &Path) -> Result<Measurement, DeviceError> {
    parse_with(content, file, Frequencies::Only)
}

fn parse_with(content: &[u8], file: &Path, wanted: Frequencies) -> Result<Measurement, DeviceError> {
    let text = text_of(content, file, EXPECTED)?;
    let mut reader = Lines { file, lines: text.lines().collect(), content };
    while reader.lines.last().is_some_and(|line| line.trim().is_empty()) {
        reader.lines.pop();
    }
    let (header_lines, setup) = reader.header(wanted)?;
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
        line += 1 + measurement.setup.frequencies_hz.len();
    }
    if measurement.injections.is_empty() {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    Ok(measurement)
}

/// The lines of a file. As in messages, line numbers start at 1.
struct Lines<'a> {
    file: &'a Path,
    lines: Vec<&'a str>,
    content: &'a [u8],
}

impl Lines<'_> {
    /// The line with this number; empty past the end.
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

    /// Parses the header. Also returns its number of lines.
    fn header(&self, wanted: Frequencies) -> Result<(usize, Setup), DeviceError> {
        let count: usize = self.line(1).parse().map_err(|_| foreign(self.file, EXPECTED, self.content))?;
        if count != LINES_OF_VERSION_1 && !(11..=64).contains(&count) {
            return Err(self.wrong(1, "number of header lines", "9 (version 1) or 11 to 64 (version 2)"));
        }
        if count > self.lines.len() {
            return Err(self.wrong(self.lines.len() + 1, "header", &format!("{count} header lines as line 1 says")));
        }
        let positive = |value: &f64| value.is_finite() && *value > 0.0;
        // The header of version 1 has no version line.
        let before = if count == LINES_OF_VERSION_1 { 1 } else { 2 };
        if before == 2 {
            self.field(2, "version", "2", |&version: &u32| version == 2)?;
        }
        let time_s = self.time(before + 2)?;
        let lowest_hz: f64 = self.field(before + 3, "lowest frequency", "a positive number of hertz", positive)?;
        let highest_hz: f64 = self.field(before + 4, "highest frequency", "a positive number of hertz", positive)?;
        let expected = format!("1 to {MOST_FREQUENCIES}");
        let steps: usize = self.field(before + 6, "number of frequencies", &expected, |steps: &usize| {
            (1..=MOST_FREQUENCIES).contains(steps)
        })?;
        let is_logarithmic = steps > 1
            && self
                .field(before + 5, "scale of frequencies", "0 (linear) or 1 (logarithmic)", |scale: &u8| *scale <= 1)?
                == 1;
        let frequencies_hz = sweep_hz(lowest_hz, highest_hz, steps, is_logarithmic);
        let taken = self.taken(&frequencies_hz, wanted, before + 6)?;
        let frequency_hz = taken.first().map_or(lowest_hz, |(index, _)| frequencies_hz[*index]);
        let amplitude_a = self.field(before + 7, "amplitude", "a positive number of amperes", positive)?;
        let frames_per_s = self.field(before + 8, "frame rate", "a positive number", positive)?;
        let (channels, columns) = self.channels(count)?;
        let name = self.line(before + 1).to_owned();
        Ok((
            count,
            Setup { name, time_s, frequency_hz, frequencies_hz, amplitude_a, frames_per_s, channels, taken, columns },
        ))
    }

    /// Frequencies that make up a reading, with their weights.
    fn taken(&self, all_hz: &[f64], wanted: Frequencies, line: usize) -> Result<Vec<(usize, f64)>, DeviceError> {
        let listed = || {
            let listed: Vec<String> = all_hz.iter().take(8).map(|hz| format!("{hz:.6}")).collect();
            let listed: Vec<&str> = listed.iter().map(|hz| hz.trim_end_matches('0').trim_end_matches('.')).collect();
            let more = if all_hz.len() > 8 { ", ..." } else { "" };
            format!("--frequency-hz with one of {}{more}, or two, A,B", listed.join(", "))
        };
        let refuse = |found: String| DeviceError::field(self.file, line, "frequency", &found, listed());
        let nearest = |hz: f64| {
            let apart = |index: &usize| (all_hz[*index] - hz).abs();
            let index = (0..all_hz.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0);
            if apart(&index) <= 0.01 * hz { Ok(index) } else { Err(refuse(format!("{hz} Hz"))) }
        };
        match wanted {
            Frequencies::Only if all_hz.len() == 1 => Ok(vec![(0, 1.0)]),
            Frequencies::Only => Err(refuse(format!("a sweep of {} frequencies", all_hz.len()))),
            Frequencies::One(hz) => Ok(vec![(nearest(hz)?, 1.0)]),
            Frequencies::Difference(first, second) => Ok(vec![(nearest(first)?, 1.0), (nearest(second)?, -1.0)]),
        }
    }

    /// A date such as `2025.02.12. 13:19:58.685`, in seconds since 1970-01-01; time zones are ignored.
    fn time(&self, line: usize) -> Result<f64, DeviceError> {
        parse_time(self.line(line)).ok_or_else(|| self.wrong(line, "date", "year.month.day. hour:minute:second"))
    }

    /// The measuring channels, and the channels with a place in every row. The length of the first row tells whether
    /// rows hold the measuring channels or all channels that are present.
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

    /// The channel numbers after a key in the header, if the key is there.
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

    /// Electrodes, from 0, of an injection line such as `1 2`.
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

    /// Appends the measuring channels from a line of real and imaginary parts.
    fn readings(&self, line: usize, measurement: &mut Measurement) -> Result<(), DeviceError> {
        if line > self.lines.len() {
            return Err(self.wrong(line, "readings", "a line of readings after its injection"));
        }
        let setup = &measurement.setup;
        let expected = 2 * setup.columns.len();
        let begin = measurement.real_v.len();
        for (step, weight) in &setup.taken {
            let line = line + step;
            let cells: Vec<&str> = self.line(line).split_whitespace().collect();
            if cells.len() != expected {
                let what = format!("{expected} numbers (real and imaginary part of {} channels)", expected / 2);
                return Err(DeviceError::field(self.file, line, "readings", &format!("{} numbers", cells.len()), what));
            }
            for (place, channel) in setup.channels.iter().enumerate() {
                let Some(column) = setup.columns.iter().position(|other| other == channel) else { continue };
                let real = weight * self.reading(line, 2 * column, &cells)?;
                let imaginary = weight * self.reading(line, 2 * column + 1, &cells)?;
                if measurement.real_v.len() > begin + place {
                    measurement.real_v[begin + place] += real;
                    measurement.imaginary_v[begin + place] += imaginary;
                } else {
                    measurement.real_v.push(real);
                    measurement.imaginary_v.push(imaginary);
                }
            }
        }
        // A sweep that ends within an injection is truncated.
        let last = line + setup.frequencies_hz.len() - 1;
        if last > self.lines.len() {
            return Err(self.wrong(last, "readings", "a line of readings for each frequency"));
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

/// The frequencies of a sweep.
fn sweep_hz(lowest_hz: f64, highest_hz: f64, steps: usize, is_logarithmic: bool) -> Vec<f64> {
    let share = |step: usize| step as f64 / (steps - 1).max(1) as f64;
    let linear = |step: usize| lowest_hz + share(step) * (highest_hz - lowest_hz);
    let logarithmic = |step: usize| lowest_hz * (highest_hz / lowest_hz).powf(share(step));
    (0..steps).map(|step| if is_logarithmic { logarithmic(step) } else { linear(step) }).collect()
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

/// The number at the end of a file name without its extension, as in `setup_00001.eit`.
fn file_number(file: &Path) -> Option<u64> {
    let stem = file.file_stem()?.to_str()?;
    let digits = stem.len() - stem.trim_end_matches(|letter: char| letter.is_ascii_digit()).len();
    stem[stem.len() - digits..].parse().ok()
}

/// The `.eit` files in a directory, by number and then by name. Those without a number come last.
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
