//! Instruments that send frame after frame as little-endian `f32` readings and nothing else, as programs on a Red
//! Pitaya do over TCP. Only the number of channels tells where a frame ends, so the connection must lose no bytes and
//! must start at a frame's first reading. If a sender normally pauses between frames but stops within one, the
//! connection is reopened, because the start of the next frame is unknown.
//!
//! A sender may put a header before each frame. It marks where frames begin, and reveals missing and damaged frames.
//! The header consists of the letters `DRMF`, the number of channels and the frame number as `u16`, and the CRC-32 of
//! the readings as `u32`. A connection's first four bytes show whether it uses headers.

use std::time::Duration;

use crate::stream::{Dialogue, Inbox};
use crate::{HostStamp, Layout};

/// Raw `f32` frames as a [`Dialogue`].
#[derive(Debug)]
pub struct Floats {
    channels: usize,
    part: Vec<u8>,
    begun: Option<HostStamp>,
    sequence: u64,
    pauses: Pauses,
    form: Form,
    /// Frame number in the last header.
    last: Option<u16>,
    /// Number of damaged frames since the last header.
    damaged: u64,
}

/// Format of a connection's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// Not enough bytes yet to tell.
    Unknown,
    /// Only readings.
    Bare,
    /// A header before every frame.
    Headed,
}

/// Start of a header. As the very first reading of a connection it would be 13140.57.
const MAGIC: [u8; 4] = *b"DRMF";
/// Header size in bytes: magic, number of channels and frame number as `u16`, CRC-32 of the readings as `u32`.
const HEADER: usize = 12;

/// Tracks where bytes resume after pauses. Normally that is at the start of a frame.
#[derive(Debug, Default)]
struct Pauses {
    /// Arrival of the last bytes, monotonic nanoseconds.
    last_ns: Option<u64>,
    /// Number of pauses in a row that ended with the start of a frame.
    aligned: u32,
    /// Position within frames, and number of pauses in a row at that position.
    astray: (usize, u32),
}

/// Gap between bytes that counts as a pause in sending, nanoseconds.
const PAUSE_NS: u64 = 5_000_000;
/// Number of pauses between frames after which a pause within one is an error.
const TELLING: u32 = 4;
/// Number of pauses at one position within frames that shows a shift of frame boundaries.
const CERTAIN: u32 = 16;

impl Pauses {
    /// Records that bytes arrived when `part` of a frame's `size` bytes had been received.
    fn heard(&mut self, at: HostStamp, part: usize, size: usize) -> Result<(), String> {
        let last = self.last_ns.replace(at.monotonic_ns);
        if last.is_none_or(|last| at.monotonic_ns.saturating_sub(last) < PAUSE_NS) {
            return Ok(());
        }
        if part == 0 {
            (self.aligned, self.astray) = (self.aligned.saturating_add(1), (0, 0));
            return Ok(());
        }
        self.astray = if self.astray.0 == part { (part, self.astray.1 + 1) } else { (part, 1) };
        if self.aligned >= TELLING || self.astray.1 >= CERTAIN {
            return Err(format!(
                "a frame stopped after {part} of {size} bytes, so everything after it would be shifted"
            ));
        }
        Ok(())
    }
}

impl Floats {
    /// Frames of `channels` readings.
    pub fn new(channels: usize) -> Self {
        Self {
            channels: channels.max(1),
            part: Vec::new(),
            begun: None,
            sequence: 0,
            pauses: Pauses::default(),
            form: Form::Unknown,
            last: None,
            damaged: 0,
        }
    }

    /// Handles frames without headers.
    fn bare(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox) -> Result<(), String> {
        let size = 4 * self.channels;
        if let Err(reason) = self.pauses.heard(at, self.part.len(), size) {
            inbox.bad_because(reason.clone());
            return Err(reason);
        }
        let mut stamp = self.begun.take().unwrap_or(at);
        let mut rest = bytes;
        while !rest.is_empty() {
            let (piece, after) = rest.split_at(rest.len().min(size - self.part.len()));
            self.part.extend_from_slice(piece);
            rest = after;
            if self.part.len() == size {
                take(inbox, self.sequence, stamp, &self.part);
                self.sequence += 1;
                self.part.clear();
                stamp = at;
            }
        }
        self.begun = (!self.part.is_empty()).then_some(stamp);
        Ok(())
    }

    /// Handles frames with headers. A failed check only costs the frames that it affects.
    fn headed(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox) -> Result<(), String> {
        let size = HEADER + 4 * self.channels;
        let mut stamp = self.begun.take().unwrap_or(at);
        self.part.extend_from_slice(bytes);
        let mut from = 0;
        loop {
            let rest = &self.part[from..];
            // Compare only the bytes of the magic that have arrived.
            let seen = rest.len().min(MAGIC.len());
            if rest[..seen] != MAGIC[..seen] {
                from += self.passed_over(from, "unexpected bytes between frames", inbox);
                stamp = at;
                continue;
            }
            if rest.len() >= 6 && usize::from(u16::from_le_bytes([rest[4], rest[5]])) != self.channels {
                let count = u16::from_le_bytes([rest[4], rest[5]]);
                from += self.passed_over(from, &format!("a header says {count} channels"), inbox);
                continue;
            }
            if rest.len() < size {
                break;
            }
            let number = u16::from_le_bytes([rest[6], rest[7]]);
            let checksum = u32::from_le_bytes([rest[8], rest[9], rest[10], rest[11]]);
            if dermis_wire::checksum(&rest[HEADER..size]) != checksum {
                from += self.passed_over(from, "a frame fails its checksum", inbox);
                continue;
            }
            let step = self.last.map_or(1, |last| number.wrapping_sub(last));
            if step == 0 {
                inbox.bad_because("a frame came twice".to_owned());
            } else {
                let missing = u64::from(step) - 1;
                inbox.lost(missing.saturating_sub(self.damaged));
                (self.last, self.damaged) = (Some(number), 0);
                self.sequence += missing;
                take(inbox, self.sequence, stamp, &rest[HEADER..size]);
                self.sequence += 1;
            }
            from += size;
            stamp = at;
        }
        self.part.drain(..from);
        self.begun = (!self.part.is_empty()).then_some(stamp);
        Ok(())
    }

    /// Counts a damaged frame, and returns the offset to the next possible start of a frame.
    fn passed_over(&mut self, from: usize, reason: &str, inbox: &mut Inbox) -> usize {
        self.damaged += 1;
        inbox.bad_because(reason.to_owned());
        let rest = &self.part[from..];
        let begins = |k: &usize| {
            let seen = (rest.len() - k).min(MAGIC.len());
            rest[*k..*k + seen] == MAGIC[..seen]
        };
        (1..rest.len()).find(begins).unwrap_or(rest.len())
    }
}

/// Delivers a frame's readings.
fn take(inbox: &mut Inbox, sequence: u64, stamp: HostStamp, bytes: &[u8]) {
    inbox.take(|frame| {
        frame.clear();
        frame.sequence = sequence;
        frame.stamp(stamp);
        let readings = bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        // An infinite reading is an overflow at the sender: mark it as missing.
        frame.values.extend(readings.map(|value| if value.is_finite() { value } else { f64::NAN }));
    });
}

impl Dialogue for Floats {
    fn open(&mut self, _send: &mut Vec<u8>) {
        self.part.clear();
        self.begun = None;
        self.pauses = Pauses::default();
        // The format and the numbering may change with a new connection.
        (self.form, self.last, self.damaged) = (Form::Unknown, None, 0);
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, _send: &mut Vec<u8>) -> Result<(), String> {
        if self.form == Form::Unknown {
            self.part.extend_from_slice(bytes);
            let seen = self.part.len().min(MAGIC.len());
            self.form = match (self.part[..seen] == MAGIC[..seen], seen == MAGIC.len()) {
                (true, true) => Form::Headed,
                (false, _) => Form::Bare,
                // Wait for the rest of the first four bytes.
                (true, false) => {
                    self.begun.get_or_insert(at);
                    return Ok(());
                }
            };
            let first = std::mem::take(&mut self.part);
            return match self.form {
                Form::Headed => self.headed(&first, at, inbox),
                _ => self.bare(&first, at, inbox),
            };
        }
        match self.form {
            Form::Headed => self.headed(bytes, at, inbox),
            _ => self.bare(bytes, at, inbox),
        }
    }

    fn tick(&mut self, _open_for: Duration, _send: &mut Vec<u8>) -> Result<(), String> {
        Ok(())
    }

    fn close(&mut self, _send: &mut Vec<u8>) {}

    fn is_frames_only(&self) -> bool {
        true
    }

    fn layout(&self) -> Option<Layout> {
        Some(Layout::Channels { count: self.channels })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_split_by_channel_count_for_any_chunking() {
        let sent: Vec<f32> = (0..12).map(|i| i as f32 * 0.5 - 1.0).collect();
        let bytes: Vec<u8> = sent.iter().flat_map(|value| value.to_le_bytes()).collect();
        for size in 1..bytes.len() {
            let mut floats = Floats::new(3);
            let (mut inbox, out, _spare) = Inbox::new(8);
            floats.open(&mut Vec::new());
            for piece in bytes.chunks(size) {
                floats.receive(piece, HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
            }
            let received: Vec<f64> = out.try_iter().flat_map(|frame| frame.values).collect();
            assert!(received.iter().copied().eq(sent.iter().map(|value| f64::from(*value))), "pieces of {size}");
        }
    }

    #[test]
    fn half_a_frame_before_a_pause_ends_the_connection_without_a_shift() {
        let mut floats = Floats::new(2);
        let (mut inbox, out, _spare) = Inbox::new(64);
        let mut at = HostStamp::now();
        floats.open(&mut Vec::new());
        let mut send = |floats: &mut Floats, bytes: &[u8]| {
            at.monotonic_ns += 20_000_000;
            floats.receive(bytes, at, &mut inbox, &mut Vec::new())
        };
        let frame = [1.0f32.to_le_bytes(), 2.0f32.to_le_bytes()].concat();
        for _ in 0..6 {
            send(&mut floats, &frame).unwrap();
        }
        send(&mut floats, &frame[..4]).unwrap();
        let error = send(&mut floats, &frame).unwrap_err();
        assert!(error.starts_with("a frame stopped after 4 of 8 bytes"), "{error}");
        floats.open(&mut Vec::new());
        send(&mut floats, &frame).unwrap();
        assert_eq!(inbox.losses().1, 1);
        assert!(out.try_iter().all(|frame| frame.values == [1.0, 2.0]));
    }

    #[test]
    fn a_sender_that_is_shifted_from_the_beginning_is_caught() {
        let mut floats = Floats::new(2);
        let (mut inbox, _out, _spare) = Inbox::new(64);
        let mut at = HostStamp::now();
        floats.open(&mut Vec::new());
        floats.receive(&[0; 4], at, &mut inbox, &mut Vec::new()).unwrap();
        let caught = (0..40).find(|_| {
            at.monotonic_ns += 20_000_000;
            floats.receive(&[0; 8], at, &mut inbox, &mut Vec::new()).is_err()
        });
        assert_eq!(caught, Some(15));
    }

    /// A frame of two readings with its header.
    fn headed(number: u16, values: [f32; 2]) -> Vec<u8> {
        let readings = values.map(f32::to_le_bytes).concat();
        let checksum = dermis_wire::checksum(&readings);
        let (channels, number) = (2_u16.to_le_bytes(), number.to_le_bytes());
        [&MAGIC[..], &channels, &number, &checksum.to_le_bytes(), &readings].concat()
    }

    #[test]
    fn frames_with_headers_are_found_despite_gaps_and_garbage() {
        let mut bytes = Vec::new();
        for number in 0..40_u16 {
            let frame = headed(number.wrapping_add(65_530), [f32::from(number), 0.5]);
            match number {
                // Truncated frame, missing frame, garbage before a frame, damaged reading.
                7 => bytes.extend_from_slice(&frame[..17]),
                12 => {}
                20 => bytes.extend_from_slice(&[b"DRDRMx".as_slice(), &frame].concat()),
                25 => bytes.extend_from_slice(&[&frame[..14], &[0xff], &frame[15..]].concat()),
                _ => bytes.extend_from_slice(&frame),
            }
        }
        let expected: Vec<(u64, f64)> =
            (0..40_u64).filter(|n| ![7, 12, 25].contains(n)).map(|n| (n, n as f64)).collect();
        for size in 1..bytes.len() {
            let mut floats = Floats::new(2);
            let (mut inbox, out, _spare) = Inbox::new(64);
            floats.open(&mut Vec::new());
            for piece in bytes.chunks(size) {
                floats.receive(piece, HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
            }
            let received: Vec<(u64, f64)> = out.try_iter().map(|frame| (frame.sequence, frame.values[0])).collect();
            assert_eq!(received, expected, "pieces of {size}");
            let (lost, bad) = inbox.losses();
            assert_eq!(lost, 1, "pieces of {size}");
            assert!((3..12).contains(&bad), "pieces of {size}: {bad} damaged");
        }
    }

    #[test]
    fn a_header_for_other_channels_gives_no_frames_but_a_reason() {
        let mut floats = Floats::new(3);
        let (mut inbox, out, _spare) = Inbox::new(8);
        floats.open(&mut Vec::new());
        for number in 0..4 {
            floats.receive(&headed(number, [1.0, 2.0]), HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
        }
        assert_eq!(out.try_iter().count(), 0);
        assert!(inbox.losses().1 >= 4);
    }

    #[test]
    fn a_new_connection_begins_with_a_new_frame() {
        let mut floats = Floats::new(1);
        let (mut inbox, out, _spare) = Inbox::new(8);
        let mut take = |floats: &mut Floats, bytes: &[u8]| {
            floats.receive(bytes, HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
        };
        take(&mut floats, &[1, 2, 3]);
        floats.open(&mut Vec::new());
        take(&mut floats, &2.5f32.to_le_bytes());
        take(&mut floats, &f32::INFINITY.to_le_bytes());
        let received: Vec<f64> = out.try_iter().flat_map(|frame| frame.values).collect();
        assert!(received.len() == 2 && received[0] == 2.5 && received[1].is_nan(), "{received:?}");
    }
}
