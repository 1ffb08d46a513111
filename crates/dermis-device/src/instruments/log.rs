//! Text lines that hold a frame's numbers among other things, such as program output or terminal recordings. They are
//! read like lines from a port ([`super::lines`]): labels, times, brackets and names are skipped. A line with an
//! unusual count of numbers is left out, with a note.

use std::collections::BTreeMap;
use std::path::Path;

use super::number_line::{self, Found};
use super::text::Text;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

/// Number of skipped lines that are reported individually.
const NAMED: usize = 3;

/// Decodes one frame per line.
///
/// # Errors
/// [`DeviceError::Foreign`] if it isn't text, [`DeviceError::Empty`] if no line has numbers, [`DeviceError::Ragged`]
/// if fewer than half of the lines have the same count.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let text = Text::of(content, file, "text with lines of numbers")?;
    decode_text(&text.text, text.encoding, file, options)
}

pub(super) fn decode_text(
    text: &str,
    encoding: Option<&'static str>,
    file: &Path,
    options: &ReadOptions,
) -> Result<FrameTable, DeviceError> {
    let lines = || text.lines().enumerate().skip(options.skip_rows).map(|(index, line)| (index + 1, line));
    let mut counts: BTreeMap<usize, (u64, usize)> = BTreeMap::new();
    let (mut numbers, mut held) = (Vec::new(), 0_u64);
    for (line, text) in lines() {
        if number_line::read(text, None, &mut numbers) == Found::Numbers {
            counts.entry(numbers.len()).or_insert((0, line)).0 += 1;
            held += 1;
        }
    }
    let by_skin = options.channels.iter().find_map(|wanted| counts.get(wanted).map(|_| *wanted));
    let usual = counts.iter().max_by_key(|(_, (lines, _))| *lines).map(|(count, _)| *count);
    let channels = by_skin.or(usual).ok_or_else(|| DeviceError::Empty { file: file.to_owned() })?;
    let (agreeing, _) = counts[&channels];
    if 2 * agreeing < held {
        let (found, (_, line)) = counts.iter().find(|(count, _)| **count != channels).unwrap_or((&0, &(0, 1)));
        return Err(DeviceError::Ragged { file: file.to_owned(), line: *line, expected: channels, found: *found });
    }
    let (mut values, mut sequences, mut next) = (Vec::new(), Vec::new(), 0_u64);
    let mut left_out = Vec::new();
    for (line, text) in lines() {
        match number_line::read(text, Some(channels), &mut numbers) {
            Found::Nothing => continue,
            Found::Numbers if numbers.len() == channels => {
                values.extend_from_slice(&numbers);
                sequences.push(next);
            }
            Found::Numbers => left_out.push(format!("line {line} has {} numbers", numbers.len())),
            Found::Bad(reason) => left_out.push(format!("line {line}: {reason}")),
        }
        next += 1;
    }
    let mut notes: Vec<String> = encoding.map(str::to_owned).into_iter().collect();
    notes.push("numbers picked out of the lines".to_owned());
    if !left_out.is_empty() {
        let more = if left_out.len() > NAMED { format!(" and {} more", left_out.len() - NAMED) } else { String::new() };
        notes.push(format!(
            "{} lines left out: {}{more}",
            left_out.len(),
            left_out[..left_out.len().min(NAMED)].join(", ")
        ));
    }
    let frames = FrameTable::new(Layout::Channels { count: channels }, values, file)?;
    Ok(frames.with_sequences(sequences)?.with_notes(notes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spliced_line_is_left_out_counted_and_named() {
        let text = "\n  mag : 1.5 , 2.5 , 3.5 , \n  mag : 4 , 5 , 6 , \n  mag : 7 , 8\n  mag : 10 , 11 , 12 , \n";
        let table = decode(text.as_bytes(), Path::new("log.txt")).unwrap();
        assert_eq!((table.frames(), table.channels()), (3, 3));
        assert_eq!(table.row(2), Some([10.0, 11.0, 12.0].as_slice()));
        assert_eq!(table.sequences(), Some([0, 1, 3].as_slice()), "the line is a lost frame");
        assert!(table.understood().contains("1 lines left out: line 4 has 2 numbers"), "{}", table.understood());
        assert!(decode(b"nothing here\n", Path::new("log.txt")).is_err());
        assert!(decode(b"a: 1 2 3\nb: 1 2\nc: 1\nd: 1 2 3 4\ne: 1 2 3 4 5\n", Path::new("log.txt")).is_err());
    }
}
