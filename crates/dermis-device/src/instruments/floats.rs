//! Instruments that send the readings of frame after frame as little-endian single-precision numbers and nothing else, as
//! programs on a Red Pitaya do over TCP. Where a frame ends is known from the number of channels alone, so that this is for
//! connections that lose no bytes and begin with a frame's first reading. A sender that pauses between frames and stops within
//! one is caught by that: the connection is made anew, as nothing tells where the next frame begins.

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
}

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
        Self { channels: channels.max(1), part: Vec::new(), begun: None, sequence: 0, pauses: Pauses::default() }
    }
}

impl Dialogue for Floats {
    fn open(&mut self, _send: &mut Vec<u8>) {
        self.part.clear();
        self.begun = None;
        self.pauses = Pauses::default();
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, _send: &mut Vec<u8>) -> Result<(), String> {
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
                let (sequence, part) = (self.sequence, &self.part);
                self.sequence += 1;
                inbox.take(|frame| {
                    frame.clear();
                    frame.sequence = sequence;
                    frame.stamp(stamp);
                    let readings =
                        part.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
                    // An infinite reading is an overflow of the sender's: missing, as NaN is.
                    frame.values.extend(readings.map(|value| if value.is_finite() { value } else { f64::NAN }));
                });
                self.part.clear();
                stamp = at;
            }
        }
        self.begun = (!self.part.is_empty()).then_some(stamp);
        Ok(())
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
