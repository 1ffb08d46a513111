//! `channels` in `[backend]`: every reading by its electrodes, in the skin file or in a CSV file next to it. For
//! protocols that no drive and measurement pattern describes: any order, any mixture, pairs that read themselves.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use dermis_tomo::eit::{Pattern, Protocol, ProtocolError};

use crate::check::Checker;
use crate::error::Error;
use crate::parts::read_beside;

/// Maximum length of a list: 128 electrodes where every adjacent pair drives and every adjacent pair reads.
pub(crate) const MOST_CHANNELS: usize = 1 << 14;

/// The channels of a frame, in order. Electrodes are numbered from 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected a list of [sink, source, plus, minus] (or [a, b] for pairs that read themselves), or the path of a CSV file"
)]
pub enum ChannelList {
    /// Listed in the skin file.
    Listed(Vec<ListedChannel>),
    /// A CSV file next to the skin file, with columns for sink, source, plus and minus, or two columns for pairs that
    /// read themselves. Reading a skin replaces the name with the rows.
    File(String),
}

/// One channel of a list. Current enters at `source` and leaves at `sink`. The reading is the potential of `plus`
/// minus the potential of `minus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum ListedChannel {
    /// `[sink, source, plus, minus]`.
    Pairs([u32; 4]),
    /// `[a, b]`: the driving pair reads itself. Sink a, source b; the reading is the potential of b minus that of a.
    Itself([u32; 2]),
    /// `[sink, source, plus, "mean"]` or `[sink, source, plus, "sink"]`: a single-ended reading.
    SingleEnded(u32, u32, u32, AgainstWord),
}

/// Reference of a single-ended reading in a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AgainstWord {
    /// The mean of all electrodes.
    Mean,
    /// The electrode that sinks the current.
    Sink,
}

impl ListedChannel {
    /// The electrodes that this channel names, and how many there are.
    fn electrodes(&self) -> ([u32; 4], usize) {
        match *self {
            Self::Pairs(four) => (four, 4),
            Self::Itself([a, b]) => ([a, b, 0, 0], 2),
            Self::SingleEnded(sink, source, plus, _) => ([sink, source, plus, 0], 3),
        }
    }

    /// The channel as written in a skin file.
    fn text(&self) -> String {
        match self {
            Self::Pairs([a, b, c, d]) => format!("[{a}, {b}, {c}, {d}]"),
            Self::Itself([a, b]) => format!("[{a}, {b}]"),
            Self::SingleEnded(a, b, c, AgainstWord::Mean) => format!("[{a}, {b}, {c}, \"mean\"]"),
            Self::SingleEnded(a, b, c, AgainstWord::Sink) => format!("[{a}, {b}, {c}, \"sink\"]"),
        }
    }

    /// The drive pair [sink, source], counted from 0, and the measurement pattern.
    fn patterns(&self, count: usize) -> ([u32; 2], Pattern) {
        // Numbers start at 1. A mistaken 0 wraps to an index that is out of range and is refused.
        let index = |number: u32| number.wrapping_sub(1);
        let pair = |plus, minus| Pattern::pair(index(plus), index(minus), 1.0);
        match *self {
            Self::Pairs([sink, source, plus, minus]) => ([index(sink), index(source)], pair(plus, minus)),
            Self::Itself([a, b]) => ([index(a), index(b)], pair(b, a)),
            Self::SingleEnded(sink, source, plus, AgainstWord::Sink) => {
                ([index(sink), index(source)], pair(plus, sink))
            }
            Self::SingleEnded(sink, source, plus, AgainstWord::Mean) => {
                let mut entries = vec![(index(plus), 1.0)];
                entries.extend((0..count as u32).map(|other| (other, -1.0 / count as f64)));
                ([index(sink), index(source)], Pattern::new(entries))
            }
        }
    }
}

impl ChannelList {
    /// The channels, if they are listed in place.
    pub fn channels(&self) -> &[ListedChannel] {
        match self {
            Self::Listed(channels) => channels,
            Self::File(_) => &[],
        }
    }

    /// Reads the list from its file in `folder`, if it is in one.
    pub(crate) fn read(&mut self, file: &str, folder: Option<&Path>) -> Result<(), Error> {
        let Self::File(path) = self else { return Ok(()) };
        let (text, name) = read_beside(FIELD, path, file, folder, "a list, or a CSV file next to the skin file")?;
        *self = Self::Listed(parse_csv(&text, &name)?);
        Ok(())
    }

    /// The protocol as explicit lists. Drives are in order of first appearance.
    pub(crate) fn protocol(&self, count: usize, amplitude_a: f64) -> Result<Protocol, ProtocolError> {
        let mut drives: Vec<[u32; 2]> = Vec::new();
        let mut known = std::collections::HashMap::new();
        let channels = self.channels().iter().map(|channel| {
            let (drive, pattern) = channel.patterns(count);
            let index = *known.entry(drive).or_insert_with(|| {
                drives.push(drive);
                drives.len() - 1
            });
            (pattern, index)
        });
        let channels: Vec<(Pattern, usize)> = channels.collect();
        let stimulations = drives.iter().map(|&[sink, source]| Pattern::pair(sink, source, -amplitude_a)).collect();
        Protocol::from_patterns(count, stimulations, channels)
    }

    /// Checks the list against the number of electrodes.
    pub(crate) fn check(&self, electrodes: usize, checker: &Checker<'_>) -> Result<(), Error> {
        let channels = match self {
            Self::Listed(channels) => channels,
            Self::File(path) => {
                let expected = "a list: a file of channels is read with the skin file that names it";
                return Err(checker.refused(FIELD, format!("{path:?}"), expected));
            }
        };
        if !(1..=MOST_CHANNELS).contains(&channels.len()) {
            let expected = format!("1 to {MOST_CHANNELS} channels");
            return Err(checker.refused(FIELD, format!("{} channels", channels.len()), expected));
        }
        for (number, channel) in (1..).zip(channels) {
            let refused = |expected: String| {
                Err(checker.refused(FIELD, format!("{}, channel {number}", channel.text()), expected))
            };
            let (named, count) = channel.electrodes();
            if let Some(electrode) = named[..count].iter().find(|e| !(1..=electrodes as u32).contains(e)) {
                let from_zero = if *electrode == 0 { "; add 1 to each if they count from 0" } else { "" };
                return refused(format!("electrodes 1 to {electrodes}, got {electrode}{from_zero}"));
            }
            if named[0] == named[1] {
                return refused("a drive of two different electrodes".into());
            }
            if count == 4 && named[2] == named[3] {
                return refused("a reading between two different electrodes".into());
            }
        }
        Ok(())
    }
}

/// Key in skin files.
const FIELD: &str = "backend.channels";

/// Role of each column in a CSV file.
const ROLES: [&str; 4] = ["sink", "source", "plus", "minus"];
/// Names of the four columns: our own, those of EIT firmware, and those of geoelectrics (A and B drive, M and N
/// read).
const NAMES: [&[&str]; 4] = [
    &["sink", "snk", "drive_sink", "i_minus", "isink", "current_sink", "current_out", "i_out", "b"],
    &["source", "src", "drive_source", "i_plus", "isource", "current_source", "current_in", "i_in", "a"],
    &["plus", "vp", "v_plus", "pos", "positive", "meas_plus", "measure_plus", "v_pos", "m"],
    &["minus", "vn", "v_minus", "neg", "negative", "meas_minus", "measure_minus", "v_neg", "n"],
];

/// Rows of a CSV file: whole numbers separated by commas, semicolons, tabs or spaces, below an optional header.
fn parse_csv(text: &str, file: &str) -> Result<Vec<ListedChannel>, Error> {
    let refuse = |line: usize, message: String| Error::SkinFile {
        file: file.into(),
        message: format!("line {line}: {message}"),
    };
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = (1..).zip(text.lines()).map(|(number, line)| (number, line.split('#').next().unwrap_or("").trim()));
    let mut lines = lines.filter(|(_, line)| !line.is_empty()).peekable();
    let Some(&(first, head)) = lines.peek() else {
        return Err(refuse(1, "nothing; expected a row for each channel: sink, source, plus, minus".into()));
    };
    let is_header =
        cells(head).iter().any(|cell| cell.starts_with(|c: char| c.is_alphabetic()) && against(cell).is_none());
    let width = cells(head).len();
    let columns: Vec<usize> = if is_header {
        lines.next();
        columns_of(&cells(head)).map_err(|message| refuse(first, message))?
    } else {
        (0..width).collect()
    };
    if columns.len() != 4 && columns.len() != 2 {
        let message =
            format!("{width} columns; expected 4 (sink, source, plus, minus), or 2 where pairs read themselves");
        return Err(refuse(first, message));
    }
    let mut channels = Vec::new();
    for (number, line) in lines {
        let row = cells(line);
        if row.len() != width {
            return Err(refuse(number, format!("{} values where the first row has {width}", row.len())));
        }
        let row: Vec<&str> = columns.iter().map(|&column| row[column].as_str()).collect();
        channels.push(channel_of(&row).map_err(|message| refuse(number, message))?);
        if channels.len() > MOST_CHANNELS {
            return Err(refuse(number, format!("more channels; expected at most {MOST_CHANNELS}")));
        }
    }
    Ok(channels)
}

fn cells(line: &str) -> Vec<String> {
    let by = |separator: char| {
        let line = line.strip_suffix(separator).unwrap_or(line);
        line.split(separator).map(|cell| cell.trim().trim_matches('"').trim().to_string()).collect()
    };
    match [',', ';'].into_iter().find(|separator| line.contains(*separator)) {
        Some(separator) => by(separator),
        None => line.split_whitespace().map(|cell| cell.trim_matches('"').to_string()).collect(),
    }
}

/// The role of each column, from the header.
fn columns_of(header: &[String]) -> Result<Vec<usize>, String> {
    if header.len() == 2 {
        return Ok(vec![0, 1]);
    }
    let simple = |name: &String| {
        let name = name.to_lowercase().replace('+', "_plus").replace('-', "_minus").replace([' ', '.'], "_");
        name.replace("__", "_").trim_matches('_').to_string()
    };
    let names: Vec<String> = header.iter().map(simple).collect();
    let column = |role: usize| {
        let found: Vec<usize> = (0..names.len()).filter(|&k| NAMES[role].contains(&names[k].as_str())).collect();
        match found[..] {
            [one] => Ok(one),
            [] => Err(format!(
                "no column for {}; expected columns named sink, source, plus and minus, got {}",
                ROLES[role],
                header.join(", ")
            )),
            _ => Err(format!("{} columns for {}: expected one", found.len(), ROLES[role])),
        }
    };
    (0..4).map(column).collect()
}

fn against(cell: &str) -> Option<AgainstWord> {
    match cell.to_lowercase().as_str() {
        "mean" => Some(AgainstWord::Mean),
        "sink" => Some(AgainstWord::Sink),
        _ => None,
    }
}

fn channel_of(row: &[&str]) -> Result<ListedChannel, String> {
    let number = |cell: &str| {
        cell.parse::<u32>().map_err(|_| {
            format!("`{cell}` is not an electrode; expected its number, from 1, or mean or sink as the fourth")
        })
    };
    match *row {
        [a, b] => Ok(ListedChannel::Itself([number(a)?, number(b)?])),
        [sink, source, plus, minus] => {
            let (sink, source, plus) = (number(sink)?, number(source)?, number(plus)?);
            match against(minus) {
                Some(word) => Ok(ListedChannel::SingleEnded(sink, source, plus, word)),
                None => Ok(ListedChannel::Pairs([sink, source, plus, number(minus)?])),
            }
        }
        _ => Err(format!("{} values; expected 4 or 2", row.len())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<ListedChannel>, String> {
        parse_csv(text, "list.csv").map_err(|error| error.to_string())
    }

    #[test]
    fn tables_of_channels_are_read_by_their_names() {
        let want = vec![ListedChannel::Pairs([1, 2, 3, 4]), ListedChannel::Pairs([5, 6, 8, 7])];
        for text in [
            "sink,source,plus,minus\n1,2,3,4\n5,6,8,7\n",
            "\u{feff}Source;Sink;V+;V-;\r\n2;1;3;4;\r\n6;5;8;7;\r\n",
            "channel,A,B,M,N\n1,2,1,3,4\n2,6,5,8,7\n",
            "# ours\n1 2 3 4\n\n5\t6 8 7 # last\n",
        ] {
            assert_eq!(read(text).unwrap(), want, "{text}");
        }
        let pairs = read("electrode_a,electrode_b\n1,2\n1,3\n").unwrap();
        assert_eq!(pairs, [[1, 2], [1, 3]].map(ListedChannel::Itself));
        let single = read("1,2,3,mean\n1,2,4,sink\n").unwrap();
        assert_eq!(single[0], ListedChannel::SingleEnded(1, 2, 3, AgainstWord::Mean));
        assert_eq!(single[1], ListedChannel::SingleEnded(1, 2, 4, AgainstWord::Sink));
    }

    #[test]
    fn invalid_lists_are_refused_with_their_line() {
        let refused = |text: &str, says: &str| {
            let message = read(text).unwrap_err();
            assert!(message.contains(says) && message.starts_with("list.csv: line "), "{message}");
        };
        refused("", "nothing");
        refused("first,second,third,fourth\n1,2,3,4\n", "no column for sink");
        refused("sink,source,plus,minus\n1,2,3,4\n1,2,3\n", "line 3: 3 values where the first row has 4");
        refused("1,2,3,4\n1,2,3.5,4\n", "`3.5` is not an electrode");
        refused("1,2,3\n", "3 columns; expected 4");
        refused("1,2,3,ground\n", "no column for");
    }
}
