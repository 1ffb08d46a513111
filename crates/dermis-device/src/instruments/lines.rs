//! Instruments that print a line of numbers for each frame, as OpenEIT and many microcontroller sketches do. The
//! numbers may be separated by commas, semicolons or blanks, follow labels or times, be in brackets, or form
//! `name:value` pairs. Lines without numbers are skipped. A line with a different count of numbers, or with a word
//! among them, counts as damaged, with its reason. Frames have no numbers, so lost ones go unnoticed.

use std::time::Duration;

use super::number_line::{self, Found};
use crate::stream::{Dialogue, Inbox};
use crate::{HostStamp, Layout};

/// Longest line of numbers, in bytes.
const LONGEST_LINE: usize = 1 << 16;
/// Number of consecutive lines with the same count of numbers that determines the channel count.
const AGREEING: u32 = 3;

/// Lines of numbers as a [`Dialogue`].
#[derive(Debug, Default)]
pub struct Lines {
    line: Vec<u8>,
    /// The current line began before the connection, or is too long.
    skip: bool,
    begun: Option<HostStamp>,
    numbers: Vec<f64>,
    channels: Option<usize>,
    /// Count of numbers in the last line, and how many consecutive lines had that count.
    agreeing: (usize, u32),
    sequence: u64,
    /// Text that the instrument needs before it starts sending.
    greeting: Vec<u8>,
}

impl Lines {
    /// Expects lines of `channels` numbers, or of the first count that several lines share.
    pub fn new(channels: Option<usize>) -> Self {
        Self { channels, ..Self::default() }
    }

    /// Sends `greeting` on every connection, to start an instrument after its reset.
    #[must_use]
    pub fn with_greeting(self, greeting: &str) -> Self {
        Self { greeting: greeting.as_bytes().to_vec(), ..self }
    }

    fn finish(&mut self, at: HostStamp, inbox: &mut Inbox) {
        let skip = std::mem::replace(&mut self.skip, false);
        let line = std::mem::take(&mut self.line);
        let found = match (skip, str::from_utf8(&line)) {
            (true, _) if line.len() >= LONGEST_LINE => Found::Bad(format!("a line longer than {LONGEST_LINE} bytes")),
            (true, _) => Found::Nothing,
            (false, Ok(text)) => number_line::read(text, self.channels, &mut self.numbers),
            (false, Err(_)) => Found::Bad("a line that is not text".to_owned()),
        };
        self.line = line;
        self.line.clear();
        match found {
            Found::Numbers => {}
            Found::Nothing => return,
            // Output during start-up, before the channel count is known, isn't a frame.
            Found::Bad(_) if self.channels.is_none() => return,
            Found::Bad(reason) => return inbox.bad_because(reason),
        }
        let count = self.numbers.len();
        if self.channels.is_none() {
            self.agreeing = if self.agreeing.0 == count { (count, self.agreeing.1 + 1) } else { (count, 1) };
            self.channels = (self.agreeing.1 >= AGREEING).then_some(count);
            return;
        }
        if let Some(channels) = self.channels.filter(|channels| *channels != count) {
            inbox.bad_because(format!("a line of {count} numbers, expected {channels}"));
            return;
        }
        let (sequence, numbers) = (self.sequence, &self.numbers);
        self.sequence += 1;
        inbox.take(|frame| frame.refill(sequence, at, numbers, &[]));
    }
}

impl Dialogue for Lines {
    fn open(&mut self, send: &mut Vec<u8>) {
        send.extend_from_slice(&self.greeting);
        self.line.clear();
        self.begun = None;
        self.skip = true;
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, _send: &mut Vec<u8>) -> Result<(), String> {
        let mut stamp = self.begun.take().unwrap_or(at);
        let is_end = |byte: &u8| matches!(byte, b'\n' | b'\r');
        for piece in bytes.split_inclusive(is_end) {
            let text = &piece[..piece.len() - usize::from(piece.last().is_some_and(is_end))];
            let room = LONGEST_LINE - self.line.len();
            self.skip |= text.len() > room;
            self.line.extend_from_slice(&text[..text.len().min(room)]);
            if text.len() < piece.len() {
                self.finish(stamp, inbox);
                stamp = at;
            }
        }
        self.begun = (!self.line.is_empty()).then_some(stamp);
        Ok(())
    }

    fn tick(&mut self, open_for: Duration, _send: &mut Vec<u8>) -> Result<(), String> {
        if self.channels.is_none() && open_for > Duration::from_secs(4) {
            return Err("bytes arrived, but no lines with the same count of numbers".to_owned());
        }
        Ok(())
    }

    fn close(&mut self, _send: &mut Vec<u8>) {}

    fn is_frames_only(&self) -> bool {
        true
    }

    fn layout(&self) -> Option<Layout> {
        self.channels.map(|count| Layout::Channels { count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;

    fn frames(channels: Option<usize>, pieces: &[&str]) -> (Vec<Frame>, u64, Option<Layout>) {
        let mut lines = Lines::new(channels);
        let (mut inbox, out, _spare) = Inbox::new(32);
        lines.open(&mut Vec::new());
        for piece in pieces {
            lines.receive(piece.as_bytes(), HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
        }
        (out.try_iter().collect(), inbox.losses().1, lines.layout())
    }

    #[test]
    fn the_first_line_may_be_half_a_line_and_headings_are_no_frames() {
        let pieces = ["8,9\r\nmagnitudes: 1.0, 2", ".5\r\n# ready\nready 3\n-3e-1;4\n", "5\t6\n7", " 8\n9 10"];
        let (frames, bad, layout) = frames(Some(2), &pieces);
        let values: Vec<_> = frames.iter().map(|frame| frame.values.clone()).collect();
        assert_eq!(values, [[1.0, 2.5], [-0.3, 4.0], [5.0, 6.0], [7.0, 8.0]]);
        assert_eq!(frames.iter().map(|frame| frame.sequence).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!((bad, layout), (0, Some(Layout::Channels { count: 2 })));
    }

    #[test]
    fn tuples_pairs_and_trailing_separators_are_frames_and_bad_lines_are_counted_with_their_reason() {
        let mut lines = Lines::new(Some(3)).with_greeting("start\n");
        let (mut inbox, out, _spare) = Inbox::new(32);
        let mut send = Vec::new();
        lines.open(&mut send);
        assert_eq!(send, b"start\n");
        let text = "\n(1, 2, 3)\nV1:1,V2:2,V3:3\n1,2,3,\r\n1,ovf,3\n1,nan,3\nready\n1,2\n";
        lines.receive(text.as_bytes(), HostStamp::now(), &mut inbox, &mut send).unwrap();
        let frames: Vec<Frame> = out.try_iter().collect();
        assert_eq!(frames.len(), 4);
        assert!(frames[..3].iter().all(|frame| frame.values == [1.0, 2.0, 3.0]));
        assert!(frames[3].values[1].is_nan());
        assert_eq!(inbox.losses().1, 2);
        assert_eq!(inbox.reason(), Some("a line of 2 numbers, expected 3"));
    }

    #[test]
    fn three_lines_that_agree_settle_the_channels() {
        let (frames, bad, layout) = frames(None, &["x\n1 2 3\n1 2\n3 4\n5 6\n7 8\n9\n10 nan\n"]);
        assert_eq!(layout, Some(Layout::Channels { count: 2 }));
        assert_eq!((frames.len(), bad), (2, 1), "the short line is damaged");
        assert!(frames[1].values[1].is_nan());
    }

    #[test]
    fn a_line_without_end_keeps_bounded_memory_and_is_counted() {
        let mut lines = Lines::new(Some(1));
        let (mut inbox, out, _spare) = Inbox::new(4);
        lines.open(&mut Vec::new());
        for piece in ["\n", &"1".repeat(3 * LONGEST_LINE), "\n2\n"] {
            lines.receive(piece.as_bytes(), HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
            assert!(lines.line.len() <= LONGEST_LINE);
        }
        assert_eq!(out.try_iter().map(|frame| frame.values[0]).collect::<Vec<_>>(), [2.0]);
        assert_eq!(inbox.losses().1, 1);
    }
}
