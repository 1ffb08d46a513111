//! Instruments that send the readings of frame after frame as little-endian single-precision numbers and nothing else,
//! as programs on a Red Pitaya do over TCP. Where a frame ends is known from the number of channels alone, so that this
//! is for connections that lose no bytes and begin with a frame's first reading. A sender that pauses between frames
//! and stops within one is caught by that: the connection is made anew, as nothing tells where the next frame begins.
//!
//! A sender may put a header before each frame, which tells where frames begin, how many are missing and whether one is
//! whole: the letters `DRMF`, the number of channels and the number of the frame as `u16`, the CRC-32 of the readings
//! as `u32`. Whether there are headers is known from the first four bytes of a connection.

use std::time::Duration;

use crate::stream::{Dialogue, Inbox};
use crate::{HostStamp, Layout};

/// Raw frames of `f32`, as a [`Dialogue`].
#[derive(Debug)]
pub struct Floats {
    channels: usize,
    part: Vec<u8>,
    begun: Option<HostStamp>,
    sequence: u64,
    pauses: Pauses,
    form: Form,
    /// Number in the last frame's header.
    last: Option<u16>,
    /// Damaged frames since then.
    damaged: u64,
}

/// What a connection's frames look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// Nothing has come yet that would tell.
    Unknown,
    /// Readings and nothing else.
    Bare,
    /// A header before the readings of each frame.
    Headed,
}

/// What a frame with a header begins with; as a reading it would be 13140.57, and the first of all.
const MAGIC: [u8; 4] = *b"DRMF";
/// Bytes of a header: the above, number of channels and number of the frame as `u16`, CRC-32 of the readings as `u32`.
const HEADER: usize = 12;

/// Where bytes begin again after a pause: at the beginning of a frame, if all is well.
#[derive(Debug, Default)]
struct Pauses {
    /// When the last bytes came, monotonic nanoseconds.
    last_ns: Option<u64>,
    /// Pauses in a row after which a frame began.
    aligned: u32,
    /// Pauses in a row at one and the same place within frames.
    astray: (usize, u32),
}

/// Bytes that are this far apart were sent apart, nanoseconds.
const PAUSE_NS: u64 = 5_000_000;
/// So many pauses show where a sender makes them.
const TELLING: u32 = 4;
/// So many at one place within frames show that frames begin there.
const CERTAIN: u32 = 16;

impl Pauses {
    /// Bytes came at a time, while so many of a frame were there.
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
                "a frame stopped after {part} of {size} bytes, and what follows would be shifted by as many"
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

    /// Frames without anything between.
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

    /// Frames with a header each: what fails its check costs the frames it touches and no other.
    fn headed(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox) -> Result<(), String> {
        let size = HEADER + 4 * self.channels;
        let mut stamp = self.begun.take().unwrap_or(at);
        self.part.extend_from_slice(bytes);
        let mut from = 0;
        loop {
            let rest = &self.part[from..];
            // A header that has not come whole yet is one as far as it goes.
            let seen = rest.len().min(MAGIC.len());
            if rest[..seen] != MAGIC[..seen] {
                from += self.passed_over(from, "bytes between frames belong to none", inbox);
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

    /// Counts what stands where a frame should begin as damaged, and says where the next one may begin.
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

/// Hands on the readings of a frame.
fn take(inbox: &mut Inbox, sequence: u64, stamp: HostStamp, bytes: &[u8]) {
    inbox.take(|frame| {
        frame.clear();
        frame.sequence = sequence;
        frame.stamp(stamp);
        let readings = bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
        // An infinite reading is an overflow of the sender's: missing, as NaN is.
        frame.values.extend(readings.map(|value| if value.is_finite() { value } else { f64::NAN }));
    });
}

impl Dialogue for Floats {
    fn open(&mut self, _send: &mut Vec<u8>) {
        self.part.clear();
        self.begun = None;
        self.pauses = Pauses::default();
        // A new connection begins as its sender wishes, and numbers of another one tell nothing.
        (self.form, self.last, self.damaged) = (Form::Unknown, None, 0);
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, _send: &mut Vec<u8>) -> Result<(), String> {
        if self.form == Form::Unknown {
            self.part.extend_from_slice(bytes);
            let seen = self.part.len().min(MAGIC.len());
            self.form = match (self.part[..seen] == MAGIC[..seen], seen == MAGIC.len()) {
                (true, true) => Form::Headed,
                (false, _) => Form::Bare,
                // Nobody stops within the first four bytes for long.
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
    fn frames_are_cut_by_their_number_of_channels_whatever_the_pieces() {
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
    fn half_a_frame_before_a_pause_ends_the_connection_and_shifts_nothing() {
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
    fn frames_with_headers_are_found_whatever_is_missing_or_stands_between() {
        let mut bytes = Vec::new();
        for number in 0..40_u16 {
            let frame = headed(number.wrapping_add(65_530), [f32::from(number), 0.5]);
            match number {
                // It stops early, it never comes, garbage before it, a reading that is spoilt.
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
    fn a_header_for_other_channels_gives_no_frames_and_says_why() {
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
