//! Instruments that send the readings of frame after frame as little-endian single-precision numbers and nothing else, as
//! programs on a Red Pitaya do over TCP. Where a frame ends is known from the number of channels alone, so that this is for
//! connections that lose no bytes and begin with a frame's first reading.

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
}

impl Floats {
    /// Frames of `channels` readings.
    pub fn new(channels: usize) -> Self {
        Self { channels: channels.max(1), part: Vec::new(), begun: None, sequence: 0 }
    }
}

impl Dialogue for Floats {
    fn open(&mut self, _send: &mut Vec<u8>) {
        self.part.clear();
        self.begun = None;
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, _send: &mut Vec<u8>) -> Result<(), String> {
        let size = 4 * self.channels;
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
