//! Roles of the columns in a table of frames: readings or parts of them, times, frame numbers, or nothing useful.

use super::scan::Table;
use super::sketch::Kind;
use crate::{DeviceError, FrameItem, FrameSelect};
use std::path::Path;

/// Role of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Role {
    /// A reading. Multiply by `scale` for volts (or ohms).
    Reading { scale: f64 },
    /// A time, with its unit in seconds if known.
    Time { unit_s: Option<f64> },
    /// A date or a time of day.
    Stamp,
    /// The frame number.
    Sequence,
    /// One of the clock columns that `dermis export` writes.
    Clock,
    /// A row count or words; ignored.
    LeftOut,
}

/// Part of a complex reading in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Real,
    Imaginary,
    Magnitude,
    Phase,
}

/// Columns that `dermis export` writes before the readings.
const CLOCKS: [&str; 3] = ["device_time_ns", "host_monotonic_ns", "host_wall_ns"];

const TIMES: [&str; 20] = [
    "time",
    "t",
    "timestamp",
    "times",
    "timestamps",
    "zeit",
    "uhrzeit",
    "temps",
    "tiempo",
    "tempo",
    "elapsed",
    "seconds",
    "sec",
    "millis",
    "milliseconds",
    "micros",
    "date",
    "datetime",
    "datum",
    "clock",
];

const COUNTS: [&str; 22] = [
    "index",
    "idx",
    "frame",
    "frames",
    "frame no",
    "frame number",
    "frame id",
    "sample",
    "samples",
    "n",
    "no",
    "nr",
    "number",
    "#",
    "id",
    "seq",
    "count",
    "counter",
    "row",
    "step",
    "scan",
    "record",
];

/// Splits a column's name from its unit: `Time (s)` becomes `time` and `s`, `ch1_mV` becomes `ch1` and `mV`.
pub(super) fn split_unit(name: &str) -> (String, Option<&str>) {
    let name = name.trim();
    let bracket = |open: char, close: char| {
        let inside = name.strip_suffix(close)?;
        let (base, unit) = inside.rsplit_once(open)?;
        Some((base, unit.trim()))
    };
    let plain = |base: &str| {
        base.trim().trim_end_matches(['_', '-', '/', ',', ':']).replace(['_', '-'], " ").trim().to_lowercase()
    };
    if let Some((base, unit)) =
        bracket('(', ')').or_else(|| bracket('[', ']')).filter(|(base, _)| !base.trim().is_empty())
    {
        return (plain(base), Some(unit));
    }
    match name.rsplit_once(['_', ' ', '/', '.']) {
        Some((base, unit))
            if !base.is_empty()
                && (time_unit_s(unit).is_some() || scale_of(unit).is_some() || angle(unit).is_some()) =>
        {
            (plain(base), Some(unit))
        }
        _ => (plain(name), None),
    }
}

fn time_unit_s(unit: &str) -> Option<f64> {
    Some(match unit {
        "s" | "S" | "sec" | "secs" | "second" | "seconds" => 1.0,
        "ms" | "msec" | "millis" | "milliseconds" => 1e-3,
        "us" | "µs" | "μs" | "usec" | "micros" | "microseconds" => 1e-6,
        "ns" | "nanoseconds" => 1e-9,
        "min" | "minutes" => 60.0,
        "h" | "hours" => 3600.0,
        _ => return None,
    })
}

/// Factor from a unit to volts or ohms.
pub(super) fn scale_of(unit: &str) -> Option<f64> {
    Some(match unit {
        "V" | "v" | "volt" | "volts" | "Volt" | "Volts" | "Ohm" | "ohm" | "ohms" | "Ohms" | "\u{3a9}" | "\u{2126}" => {
            1.0
        }
        "mV" | "mv" | "millivolt" | "millivolts" | "mOhm" | "mohm" | "mΩ" => 1e-3,
        "uV" | "uv" | "µV" | "μV" | "microvolts" => 1e-6,
        "nV" => 1e-9,
        "kOhm" | "kohm" | "kΩ" => 1e3,
        _ => return None,
    })
}

/// Factor from a unit to radians.
pub(super) fn angle(unit: &str) -> Option<f64> {
    Some(match unit {
        "deg" | "°" | "degree" | "degrees" | "Deg" | "grad" | "Grad" => std::f64::consts::PI / 180.0,
        "rad" | "radian" | "radians" | "Rad" => 1.0,
        "mrad" => 1e-3,
        _ => return None,
    })
}

/// Part of a complex reading that a name refers to.
pub(super) fn part_of(name: &str) -> Option<Part> {
    if name.starts_with('|') && name[1..].contains('|') {
        return Some(Part::Magnitude);
    }
    let lower = name.to_lowercase();
    let words = || lower.split(|c: char| !c.is_alphabetic());
    let stated = words().find_map(|word| match word {
        "re" | "real" | "rez" | "zre" | "zreal" => Some(Part::Real),
        "im" | "imag" | "imaginary" | "imz" | "zim" | "zimag" => Some(Part::Imaginary),
        "mag" | "magnitude" | "magnitudes" | "abs" | "amp" | "amplitude" | "modulus" | "zmag" | "zabs" | "zmod" => {
            Some(Part::Magnitude)
        }
        "phase" | "phi" | "arg" | "angle" | "theta" | "ph" | "φ" | "θ" | "zphase" | "zphz" | "zarg" => {
            Some(Part::Phase)
        }
        _ => None,
    });
    // `Z` by itself is a magnitude next to phases, but `Z1_phase` is a phase.
    stated.or_else(|| words().any(|word| word == "z").then_some(Part::Magnitude))
}

/// Columns that the user chose as readings: names, indices from 0, half-open ranges.
pub(super) fn chosen(table: &Table, columns: &FrameSelect, file: &Path) -> Result<Option<Vec<usize>>, DeviceError> {
    let FrameSelect::Listed(items) = columns else { return Ok(None) };
    let count = table.sketch.columns;
    let mut chosen = Vec::new();
    for item in items {
        let named = |wanted: &str| (0..count).find(|&column| table.name(column) == Some(wanted));
        let range = match item {
            FrameItem::Frame(name) => named(name).or_else(|| name.parse().ok()).map(|column: usize| column..column + 1),
            FrameItem::Range { first, end } => Some(*first..end.unwrap_or(count)),
        };
        let Some(range) = range.filter(|range| !range.is_empty() && range.end <= count) else {
            let names = table.sketch.header.as_ref().map(|(_, names)| {
                let shown: Vec<&str> = names.iter().take(8).map(String::as_str).collect();
                format!(", or names such as {}", shown.join(", "))
            });
            let expected = format!("columns from 0 to {}{}", count - 1, names.unwrap_or_default());
            return Err(DeviceError::field(file, table.sketch.first_line, "--columns", &item.to_string(), expected));
        };
        chosen.extend(range);
    }
    if chosen.iter().any(|column| table.sketch.kinds[*column] != Kind::Number) {
        let found = columns.to_string();
        return Err(DeviceError::field(file, table.sketch.first_line, "--columns", &found, "columns of numbers"));
    }
    Ok(Some(chosen))
}

/// Determines every column's role, and adds notes on columns that aren't readings.
pub(super) fn roles(table: &Table, chosen: Option<&[usize]>, wanted: &[usize], notes: &mut Vec<String>) -> Vec<Role> {
    let columns = table.sketch.columns;
    let numeric = table.sketch.kinds.iter().filter(|kind| **kind == Kind::Number).count();
    let mut roles: Vec<Role> = (0..columns).map(|column| role_by_name(table, column, numeric)).collect();
    if let Some(chosen) = chosen {
        for (column, role) in roles.iter_mut().enumerate() {
            match (chosen.contains(&column), *role) {
                (true, Role::Reading { .. })
                | (false, Role::Time { .. } | Role::Stamp | Role::Sequence | Role::Clock) => {}
                (true, _) => *role = Role::Reading { scale: 1.0 },
                (false, _) => *role = Role::LeftOut,
            }
        }
        return roles;
    }
    for (column, _) in roles.iter().enumerate().filter(|(_, role)| **role == Role::LeftOut) {
        let what = if table.sketch.kinds[column] == Kind::Words { "words" } else { "numbers of rows" };
        notes.push(format!("{} left out: {what}", called(table, column)));
    }
    // An unnamed first column holds row numbers or times, unless a frame has as many readings with it as expected.
    let readings = roles.iter().filter(|role| matches!(role, Role::Reading { .. })).count();
    let is_unnamed = table.name(0).is_none_or(|name| name.is_empty() || name.to_lowercase().starts_with("unnamed"));
    if matches!(roles[0], Role::Reading { .. }) && readings > 1 && is_unnamed && !wanted.contains(&readings) {
        let values: Vec<f64> = (0..table.rows()).map(|row| table.values[row * columns]).collect();
        let has_empty_name = table.name(0).is_some();
        let fits = wanted.contains(&(readings - 1));
        let enough = values.len() >= 4 && columns >= 4 || has_empty_name || fits;
        if enough && is_count(&values) {
            notes.push(format!("{} left out: it counts the rows", called(table, 0)));
            roles[0] = Role::LeftOut;
        } else if (fits || has_empty_name) && values.len() > 1 && values.windows(2).all(|pair| pair[1] > pair[0]) {
            notes.push(format!("{} taken for times", called(table, 0)));
            roles[0] = Role::Time { unit_s: None };
        }
    }
    roles
}

/// Description of a column for messages.
pub(super) fn called(table: &Table, column: usize) -> String {
    match table.name(column) {
        Some(name) if !name.is_empty() => format!("column `{name}`"),
        _ => format!("column {}", column + 1),
    }
}

/// True for integers that increase by one.
fn is_count(values: &[f64]) -> bool {
    values.first().is_some_and(|first| *first >= 0.0 && first.fract() == 0.0)
        && values.windows(2).all(|pair| pair[1] == pair[0] + 1.0)
}

fn role_by_name(table: &Table, column: usize, numeric: usize) -> Role {
    match table.sketch.kinds[column] {
        Kind::Words => return Role::LeftOut,
        Kind::Stamp => return Role::Stamp,
        Kind::Number => {}
    }
    let Some(name) = table.name(column) else { return Role::Reading { scale: 1.0 } };
    // A single column holds readings, whatever its name.
    if numeric == 1 {
        return Role::Reading { scale: 1.0 };
    }
    if CLOCKS.contains(&name) {
        return Role::Clock;
    }
    if name == "sequence" {
        return Role::Sequence;
    }
    let (base, unit) = split_unit(name);
    let unit = unit.or_else(|| {
        table
            .sketch
            .units
            .as_ref()
            .map(|units| units.get(column).map_or("", |unit| unit.trim_matches(['(', ')', '[', ']', ' '])))
    });
    if let Some(unit_s) = time_unit(name, unit) {
        return Role::Time { unit_s };
    }
    if COUNTS.contains(&base.as_str()) || base == "unnamed: 0" {
        return Role::LeftOut;
    }
    Role::Reading { scale: unit.and_then(scale_of).unwrap_or(1.0) }
}

/// True for the names of times, counts and clocks.
pub(super) fn is_clock_or_count(name: &str) -> bool {
    let (base, _) = split_unit(name);
    let is_count = COUNTS.contains(&base.as_str()) || name == "sequence" || CLOCKS.contains(&name);
    is_count || time_unit(name, None).is_some()
}

/// `Some` for the name of a time column. The inner value is the time unit in seconds, if the name or `unit` states it.
pub(super) fn time_unit(name: &str, unit: Option<&str>) -> Option<Option<f64>> {
    let (base, own) = split_unit(name);
    if !TIMES.contains(&base.as_str()) && !base.starts_with("time ") {
        return None;
    }
    let by_name = match base.as_str() {
        "seconds" | "sec" => Some(1.0),
        "millis" | "milliseconds" => Some(1e-3),
        "micros" => Some(1e-6),
        _ => None,
    };
    Some(own.or(unit).and_then(time_unit_s).or(by_name))
}

/// The column that counts the channels in a table with one reading per row, as databases and `melt` write them:
/// `frame, channel, value`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ChannelColumn {
    pub(super) column: usize,
    /// Channels of a frame, which is also its number of rows.
    pub(super) channels: usize,
}

/// Finds the column that counts from 0 or 1 to the number of channels, again and again. Readings never do that. With a
/// single frame the column must be called `channel`, since a column that counts once may number the rows.
pub(super) fn channel_column(table: &Table, readings: &[usize]) -> Option<ChannelColumn> {
    // The other columns are one reading, or both parts of a complex one.
    let parts = readings.iter().filter(|&&column| table.name(column).and_then(part_of).is_some()).count();
    if readings.len() != 2 && !(readings.len() == 3 && parts == 2) {
        return None;
    }
    readings.iter().find_map(|&column| {
        let values = || table.values.chunks_exact(table.sketch.columns).map(|row| row[column]);
        let start = values().next().filter(|start| *start == 0.0 || *start == 1.0)?;
        let channels = values().skip(1).position(|value| value == start).map_or(table.rows(), |index| index + 1);
        let is_named = table.name(column).is_some_and(|name| {
            let name = name.to_lowercase();
            ["channel", "chan", "ch", "measurement", "meas"].contains(&name.as_str())
        });
        let counts = values().enumerate().all(|(row, value)| value == start + (row % channels) as f64);
        let is_whole = table.rows().is_multiple_of(channels) && (is_named || table.rows() > channels);
        (channels > 2 && counts && is_whole).then_some(ChannelColumn { column, channels })
    })
}
