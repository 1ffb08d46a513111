//! Times as loggers write them: dates and clock times in cells, numbers whose unit must be inferred from their size,
//! and clocks that start late, step back or use a different unit than their name says.

/// A date, a time of day, or both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stamp {
    /// Nanoseconds since 1970-01-01, or since midnight if there is no date.
    pub ns: i64,
    pub has_date: bool,
    pub has_time: bool,
}

/// Parses `2024-03-01 14:07:12.040`, `2024-03-01T14:07:12Z`, `01.03.2024 14:07:12,04`, `03/01/2024 2:07:12 PM`,
/// `14:07:12.040` and the like; `None` for anything else. If both of two numbers could be the month, it is the first
/// one in dates with slashes and the second one in dates with points.
pub(super) fn stamp(text: &str) -> Option<Stamp> {
    let text = text.trim();
    if !(5..=40).contains(&text.len()) || !text.is_ascii() || !text.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let (date, time) = match text.find(['T', ' ', '_']) {
        Some(at) => (text[..at].trim_end_matches('.'), text[at + 1..].trim()),
        None if text.contains(':') => ("", text),
        None => (text, ""),
    };
    // A time followed by AM or PM, without a date.
    let (date, time) = if date.contains(':') { ("", text) } else { (date, time) };
    let days = if date.is_empty() { 0 } else { days(date)? };
    let ns = if time.is_empty() { 0 } else { time_of_day_ns(time)? };
    let (has_date, has_time) = (!date.is_empty(), !time.is_empty());
    Some(Stamp { ns: days.checked_mul(86_400_000_000_000)?.checked_add(ns)?, has_date, has_time })
}

fn days(date: &str) -> Option<i64> {
    let mark = date.chars().find(|c| !c.is_ascii_digit()).filter(|c| "-/.".contains(*c))?;
    let mut parts = date.split(mark);
    let mut part =
        || parts.next().filter(|part| (1..=4).contains(&part.len())).map(|part| (part, part.parse::<i64>().ok()));
    let ((a, first), (_, second), (c, third)) = (part()?, part()?, part()?);
    if parts.next().is_some() {
        return None;
    }
    let (first, second, third) = (first?, second?, third?);
    let (year, month, day) = match (a.len(), c.len()) {
        (4, 1..=2) => (first, second, third),
        (1..=2, 4) if (mark == '/' && first <= 12) || second > 12 => (third, first, second),
        (1..=2, 4) => (third, second, first),
        _ => return None,
    };
    ((1..=12).contains(&month) && (1..=31).contains(&day)).then(|| days_since_1970(year, month, day))
}

/// Days since 1970-01-01 in the Gregorian calendar. Years are counted from March, so the leap day is the last one.
pub(super) fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let month_from_march = (month + 9) % 12;
    let day_of_year = (153 * month_from_march + 2) / 5 + day - 1;
    365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + day_of_year - 719_468
}

fn time_of_day_ns(time: &str) -> Option<i64> {
    let upper = time.to_ascii_uppercase();
    let (body, half) = match (upper.strip_suffix("AM"), upper.strip_suffix("PM")) {
        (Some(body), _) => (body.trim_end(), Some(0)),
        (_, Some(body)) => (body.trim_end(), Some(12)),
        _ => (upper.as_str(), None),
    };
    let (body, zone_s) = zone(body)?;
    let mut parts = body.trim().split(':');
    let mut number = |most: i64| {
        let part = parts.next()?;
        part.parse::<i64>().ok().filter(|value| (0..=most).contains(value) && part.len() <= 2)
    };
    let (hour, minute) = (number(24)?, number(59)?);
    let hour = half.map_or(hour, |half| hour % 12 + half);
    let seconds_ns = match parts.next() {
        None => 0,
        Some(text) => {
            let (whole, fraction) = text.split_once(['.', ',']).unwrap_or((text, ""));
            let whole = whole.parse::<i64>().ok().filter(|value| (0..=60).contains(value) && whole.len() <= 2)?;
            if fraction.len() > 12 || !fraction.bytes().all(|byte| byte.is_ascii_digit()) {
                return None;
            }
            let nanos: String = fraction.chars().chain(std::iter::repeat('0')).take(9).collect();
            whole * 1_000_000_000 + nanos.parse::<i64>().ok()?
        }
    };
    parts.next().is_none().then_some((hour * 3600 + minute * 60 - zone_s) * 1_000_000_000 + seconds_ns)
}

/// Splits a time zone off the end, and converts it to seconds east of Greenwich.
fn zone(time: &str) -> Option<(&str, i64)> {
    if let Some(body) = ["Z", "UTC", "GMT"].iter().find_map(|name| time.strip_suffix(name)) {
        return Some((body.trim_end(), 0));
    }
    let Some(at) = time.rfind(['+', '-']) else { return Some((time, 0)) };
    let sign = if time.as_bytes()[at] == b'-' { -1 } else { 1 };
    let digits: String = time[at + 1..].chars().filter(|c| *c != ':').collect();
    let minutes = match digits.len() {
        2 => digits.parse::<i64>().ok()? * 60,
        4 => digits[..2].parse::<i64>().ok()? * 60 + digits[2..].parse::<i64>().ok()?,
        _ => return None,
    };
    Some((time[..at].trim_end(), sign * minutes * 60))
}

/// Converts a column of numbers to seconds, and adds notes on the conversion. `unit_s` is the unit in the column's
/// name; `name` describes the column in messages.
pub(super) fn seconds(values: &[f64], unit_s: Option<f64>, name: &str, notes: &mut Vec<String>) -> Vec<f64> {
    let step = usual_step(values);
    let unit = unit_s.unwrap_or_else(|| {
        let (unit, word) = likely_unit(values, step);
        if unit != 1.0 {
            notes.push(format!("times of {name} taken for {word}"));
        }
        unit
    });
    // Some loggers count milliseconds although the name says seconds.
    if unit_s == Some(1.0) && step >= 5.0 && values.iter().all(|value| value.fract() == 0.0) {
        notes.push(format!("frames are {step} s apart by {name}: are these milliseconds? (name the column `time_ms`)"));
    }
    values.iter().map(|value| value * unit).collect()
}

/// Infers the unit: from the size if the numbers count from 1970, and otherwise from the time step.
fn likely_unit(values: &[f64], step: f64) -> (f64, &'static str) {
    let first = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let by_size = [(1e18, 1e-9, "nanoseconds"), (1e15, 1e-6, "microseconds"), (1e12, 1e-3, "milliseconds")];
    if let Some((_, unit, word)) = by_size.into_iter().find(|(least, ..)| first >= *least && first < 1e1 * least) {
        return (unit, word);
    }
    let is_whole = values.iter().all(|value| value.fract() == 0.0 || value.is_nan());
    let by_step = [(2e6, 1e-9, "nanoseconds"), (2e3, 1e-6, "microseconds"), (2.0, 1e-3, "milliseconds")];
    match by_step.into_iter().find(|(least, ..)| is_whole && step >= *least) {
        Some((_, unit, word)) => (unit, word),
        None => (1.0, "seconds"),
    }
}

/// Median of the positive steps between neighbours; 0 if there are none.
pub(super) fn usual_step(times: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    if steps.is_empty() {
        return 0.0;
    }
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Minimum gap in seconds that means that the clock was set. The gap must also exceed 10,000 times the usual step.
const LONGEST_GAP_S: f64 = 86_400.0;

/// Makes times increase. A first time from an earlier session is replaced. After a step back, or a jump forward of
/// more than a day, the following times continue at the usual step. If any time is missing, nothing is changed.
pub fn mend(times_s: &mut [f64], notes: &mut Vec<String>) {
    if times_s.len() < 3 || times_s.iter().any(|time| !time.is_finite()) {
        return;
    }
    let step = usual_step(times_s);
    if step <= 0.0 {
        return;
    }
    let jumps = |before: f64, after: f64| after < before || after - before > LONGEST_GAP_S.max(1e4 * step);
    if jumps(times_s[0], times_s[1]) && !jumps(times_s[1], times_s[2]) {
        notes.push(format!("the first time, {} s, does not belong to the others and was replaced", times_s[0]));
        times_s[0] = times_s[1] - step;
    }
    let (mut shift, mut told) = (0.0, 0);
    let mut before = times_s[0];
    for index in 1..times_s.len() {
        let raw = times_s[index];
        if jumps(before, raw) {
            // Continue from the corrected time of the previous frame.
            shift = times_s[index - 1] + step - raw;
            if told < 3 {
                let by = raw - before;
                notes.push(format!(
                    "times step by {by:.6} s at frame {index}; they continue from there at the usual interval"
                ));
            }
            told += 1;
        }
        before = raw;
        times_s[index] = raw + shift;
    }
    if told > 3 {
        notes.push(format!("{} further jumps in the times", told - 3));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_of_every_kind_are_the_same_moment() {
        let expected = 1_709_302_032_040_000_000;
        for text in [
            "2024-03-01 14:07:12.040",
            "2024-03-01T14:07:12.04Z",
            "2024-03-01T15:07:12.04+01:00",
            "2024/03/01 14:07:12,04",
            "01.03.2024 14:07:12,040",
            "03/01/2024 02:07:12.04 PM",
            "2024.03.01. 14:07:12.04",
        ] {
            assert_eq!(stamp(text).map(|stamp| stamp.ns), Some(expected), "{text}");
        }
        let clock = stamp("14:07:12.04").unwrap();
        assert_eq!((clock.ns, clock.has_date), (50_832_040_000_000, false));
        assert_eq!(stamp("31/12/2024").map(|stamp| stamp.ns), stamp("12/31/2024").map(|stamp| stamp.ns));
        for text in
            ["12.5", "1-2 > 3-4", "0.0626722", "V1:0.1", "2024", "1:2:3:4", "99:99", "2024-13-01", "12345", "1-2-3"]
        {
            assert_eq!(stamp(text), None, "{text}");
        }
    }

    #[test]
    fn stale_starts_and_steps_are_corrected_and_reported() {
        let mut notes = Vec::new();
        let mut stale = vec![812.34, 0.02, 0.04, 0.06];
        mend(&mut stale, &mut notes);
        assert!(stale[0].abs() < 1e-12 && notes[0].contains("812.34 s"), "{stale:?} {notes:?}");
        let mut back = vec![10.0, 10.02, 10.04, 8.0, 8.02, 8.04];
        mend(&mut back, &mut notes);
        assert!(back.windows(2).all(|pair| (pair[1] - pair[0] - 0.02).abs() < 1e-9), "{back:?}");
        let mut gap = vec![0.0, 0.02, 0.04, 5.0, 5.02];
        let before = gap.clone();
        mend(&mut gap, &mut notes);
        assert_eq!(gap, before, "lost frames are no step");
        assert_eq!(notes.len(), 2, "{notes:?}");
    }

    #[test]
    fn units_are_recognised_by_size_and_distance() {
        for (values, expected) in [
            (vec![0.0, 20.0, 40.0], 0.04),
            (vec![0.0, 20_000.0, 40_000.0], 0.04),
            (vec![0.0, 0.02, 0.04], 0.04),
            (vec![0.0, 1.0, 2.0], 2.0),
            (vec![1.7e12, 1.7e12 + 20.0, 1.7e12 + 40.0], 0.04),
        ] {
            let times = seconds(&values, None, "`time`", &mut Vec::new());
            assert!((times[2] - times[0] - expected).abs() < 1e-5, "{values:?}: {times:?}");
        }
        let mut notes = Vec::new();
        assert_eq!(seconds(&[0.0, 20.0, 40.0], Some(1.0), "`time_s`", &mut notes)[2], 40.0);
        assert!(notes[0].contains("milliseconds?"), "{notes:?}");
    }
}
