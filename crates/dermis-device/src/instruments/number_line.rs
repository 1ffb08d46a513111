//! Parses the numbers in a line, as instruments and sketches print them: separated by commas, semicolons or blanks, in
//! brackets, behind a label or a time, as `name:value` pairs, with or without a unit, with or without a separator at
//! the end.

use std::borrow::Cow;

use super::csv::cell::{Decimal, leading_number};
use super::times::stamp;

/// Content of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Found {
    /// The numbers of a frame, in the buffer.
    Numbers,
    /// No numbers: an empty line, a comment, a heading, a message.
    Nothing,
    /// Numbers that don't form a frame, with the reason.
    Bad(String),
}

/// One word of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Word<'a> {
    Number(f64),
    /// A number with its own name, `V1:0.2`.
    Named(f64),
    /// Text before a colon: the label of the line, or the name of the next number.
    Label,
    /// A time, a date, a bracket, an arrow.
    Mark,
    Text(&'a str),
}

/// Units after numbers. All numbers in a line have the same unit.
const UNITS: [&str; 8] = ["V", "mV", "uV", "µV", "Ohm", "ohm", "kOhm", "Ω"];

/// Reads the numbers of a line into `numbers`. `channels` is the expected count, if known.
pub(super) fn read(line: &str, channels: Option<usize>, numbers: &mut Vec<f64>) -> Found {
    numbers.clear();
    let line = line.trim();
    if line.is_empty() || line.starts_with(['#', '%']) {
        return Found::Nothing;
    }
    let line = &with_points_in_times(line);
    let decimal = decimal_of(line);
    let words: Vec<Word> = words(line, decimal);
    let count = |wanted: fn(&Word) -> bool| words.iter().filter(|word| wanted(word)).count();
    let named = count(|word| matches!(word, Word::Named(_)));
    let text = count(|word| matches!(word, Word::Text(_)));
    if named >= 2 {
        // Numbers before the first name are line numbers. A bare number after it has lost its name.
        let first = words.iter().position(|word| matches!(word, Word::Named(_))).unwrap_or(0);
        let bare = words[first..].iter().filter(|word| matches!(word, Word::Number(_))).count();
        numbers.extend(words.iter().filter_map(|word| if let Word::Named(value) = word { Some(*value) } else { None }));
        let texts = words[first..].iter().filter(|word| matches!(word, Word::Text(_) | Word::Label)).count();
        return match bare + texts {
            0 => Found::Numbers,
            others => Found::Bad(format!("{named} named numbers and {others} words without a name or a number")),
        };
    }
    // The numbers follow the last label, time or arrow.
    let tail = words.iter().rposition(|word| matches!(word, Word::Label | Word::Mark)).map_or(0, |at| at + 1);
    let tail = &words[tail..];
    // Leading words are a heading, as in `DATA 0.1 0.2`.
    let begin = tail.iter().position(|word| matches!(word, Word::Number(_) | Word::Named(_))).unwrap_or(tail.len());
    let rest = &tail[begin..];
    numbers.extend(rest.iter().filter_map(|word| match word {
        Word::Number(value) | Word::Named(value) => Some(*value),
        _ => None,
    }));
    let words_within: Vec<&str> =
        rest.iter().filter_map(|word| if let Word::Text(text) = word { Some(*text) } else { None }).collect();
    // The same unit after every number.
    let unit = words_within.first().filter(|unit| UNITS.contains(unit));
    if let Some(unit) = unit
        && words_within.len() == numbers.len()
        && words_within.iter().all(|word| word == unit)
    {
        numbers.iter_mut().for_each(|number| *number *= scale(unit));
        return Found::Numbers;
    }
    let is_frame = channels == Some(rest.len()) || numbers.len() > words_within.len().max(1);
    let has_heading = begin > 0 && channels != Some(numbers.len());
    match (numbers.len(), words_within.len()) {
        (0, 0) => Found::Nothing,
        (count, 0) if !has_heading || count > 2 => Found::Numbers,
        (_, 0) => Found::Nothing,
        (count, _) if is_frame || channels == Some(text + count) => {
            Found::Bad(format!("the word '{}' among {count} numbers", crate::error::shorten(words_within[0])))
        }
        _ => Found::Nothing,
    }
}

/// Replaces the comma in times such as Python's `14:07:12,040` by a point, because it isn't a separator.
fn with_points_in_times(line: &str) -> Cow<'_, str> {
    let bytes = line.as_bytes();
    let is_digit = |at: usize| bytes.get(at).is_some_and(u8::is_ascii_digit);
    let mut text = Cow::Borrowed(line);
    for (at, _) in line.match_indices(',') {
        let behind_seconds =
            at >= 4 && bytes[at - 3] == b':' && is_digit(at - 4) && is_digit(at - 2) && is_digit(at - 1);
        let has_millis =
            (1..=3).all(|next| is_digit(at + next)) && bytes.get(at + 4).is_none_or(|next| b" ]\t".contains(next));
        if behind_seconds && has_millis {
            text.to_mut().replace_range(at..=at, ".");
        }
    }
    text
}

/// Detects decimal commas. They are possible if semicolons or tabs separate the words, or if blanks do and every word
/// has one comma between digits.
fn decimal_of(line: &str) -> Decimal {
    if !line.contains(',') {
        return Decimal::Point;
    }
    let is_decimal = |word: &str| leading_number(word.as_bytes(), b',').is_some_and(|(_, length)| length == word.len());
    let split = |mark: char| line.split(mark).map(str::trim).filter(|word| !word.is_empty());
    for mark in [';', '\t', ' '] {
        let with_comma = split(mark).filter(|word| word.contains(',') && is_decimal(word)).count();
        let others = split(mark).filter(|word| word.contains(',') && !is_decimal(word)).count();
        if line.contains(mark) && with_comma > usize::from(mark == ' ') && others == 0 {
            return Decimal::Comma;
        }
    }
    Decimal::Point
}

fn words(line: &str, decimal: Decimal) -> Vec<Word<'_>> {
    let is_separator =
        |c: char| c.is_whitespace() || matches!(c, ';' | '|' | '"' | '\'') || c == ',' && decimal == Decimal::Point;
    let is_bracket = |c: char| matches!(c, '(' | ')' | '[' | ']' | '{' | '}');
    let mut words = Vec::new();
    // True after a name whose number is the next word: `V1: 0.2`.
    let mut named = false;
    for raw in line.split(|c: char| is_separator(c) || is_bracket(c)).filter(|word| !word.is_empty()) {
        let word = match one(raw, decimal) {
            Word::Number(value) if named => {
                words.pop();
                Word::Named(value)
            }
            other => other,
        };
        named = matches!(word, Word::Label);
        words.push(word);
    }
    // A single label before many numbers belongs to the line.
    let names = words.iter().filter(|word| matches!(word, Word::Named(_))).count();
    if names == 1
        && words.len() > 1
        && let Some(at) = words.iter().position(|word| matches!(word, Word::Named(_)))
        && let Word::Named(value) = words[at]
    {
        words[at] = Word::Number(value);
        words.insert(at, Word::Label);
    }
    words
}

fn one(word: &str, decimal: Decimal) -> Word<'_> {
    let value = |text: &str| match leading_number(text.as_bytes(), decimal.mark()) {
        Some((value, length)) if value.is_finite() => {
            let unit = &text[length..];
            (unit.is_empty() || UNITS.contains(&unit)).then(|| value * scale(unit))
        }
        _ => text.eq_ignore_ascii_case("nan").then_some(f64::NAN),
    };
    if let Some(number) = value(word) {
        return Word::Number(number);
    }
    if stamp(word).is_some() {
        return Word::Mark;
    }
    if matches!(word, ":" | "=") || word.ends_with([':', '=']) {
        return Word::Label;
    }
    if let Some((name, rest)) = word.rsplit_once([':', '='])
        && !name.is_empty()
        && let Some(number) = value(rest)
    {
        return Word::Named(number);
    }
    if word.chars().all(|c| "->=<*~_/\\".contains(c)) { Word::Mark } else { Word::Text(word) }
}

/// Factor to volts or ohms.
fn scale(unit: &str) -> f64 {
    match unit {
        "mV" => 1e-3,
        "uV" | "µV" => 1e-6,
        "kOhm" => 1e3,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(line: &str, channels: Option<usize>) -> Result<Vec<f64>, String> {
        let mut numbers = Vec::new();
        match read(line, channels, &mut numbers) {
            Found::Numbers => Ok(numbers),
            Found::Nothing => Err("nothing".to_owned()),
            Found::Bad(reason) => Err(reason),
        }
    }

    #[test]
    fn every_way_to_print_a_frame_gives_its_numbers() {
        for line in [
            "0.1,0.2,-3e1",
            "0.1, 0.2, -3e1,",
            "(0.1, 0.2, -30)",
            "[0.1 0.2 -30.]",
            "V1:0.1,V2:0.2,V3:-30",
            "V1: 0.1, V2: 0.2, V3: -30",
            "a=0.1 b=0.2 c=-30",
            "magnitudes : 0.1 , 0.2 , -30 , ",
            "magnitudes:0.1,0.2,-30",
            "12:03:44.123 -> 0.1,0.2,-30",
            "[12:03:44] 0.1, 0.2, -30",
            "2024-03-01 14:07:12,040 INFO frame 17: 0.1 0.2 -30",
            "0,1;0,2;-30,0",
            "0,1 0,2 -30",
            "0.1V 0.2V -30V",
            "100mV, 200mV, -30000mV",
            "0.1 V, 0.2 V, -30 V",
            "100 mV, 200 mV, -30000 mV",
            "1:0.1 2:0.2 3:-30",
            "{\"v\": [0.1, 0.2, -30]}",
        ] {
            let numbers = found(line, None).unwrap_or_else(|reason| panic!("{line}: {reason}"));
            assert_eq!(numbers.len(), 3, "{line}: {numbers:?}");
            let expected = [0.1, 0.2, -30.0];
            assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{line}: {numbers:?}");
        }
        assert!(found("0.1,nan,3", None).unwrap()[1].is_nan());
    }

    #[test]
    fn words_are_distinguished_from_broken_frames() {
        for line in ["", "# ready", "ready", "ready 3", "Battery low", "Spectra v2 : ready", "baud 115200 set"] {
            assert_eq!(found(line, Some(208)), Err("nothing".to_owned()), "{line}");
        }
        assert_eq!(found("0.1,ovf,0.3", Some(3)), Err("the word 'ovf' among 2 numbers".to_owned()));
        assert_eq!(found("0.1,ovf", Some(2)), Err("the word 'ovf' among 1 numbers".to_owned()));
        assert!(found("V1:0.1,V2:ovf,V3:0.3", None).is_err());
        assert!(found("V1:0.1,V2:0.2,0.3", None).is_err());
        assert!(found("0.1,1e999,0.3", Some(3)).is_err());
    }
}
