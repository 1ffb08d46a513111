//! Turns bytes into messages, in whatever pieces the bytes arrive.

use crate::cobs::unstuff;
use crate::message::Message;
use crate::{WireError, parse};

/// Counters of a decoder.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DecoderCounters {
    /// Messages returned.
    pub messages: u64,
    /// Packets that were damaged, too long, or had an unknown version or kind.
    pub bad: u64,
}

/// Splits a stream of bytes into packets and decodes them into messages.
///
/// The caller provides the memory: an array in firmware, a vector on a host. It must hold a stuffed packet
/// ([`encoded_len`](crate::encoded_len)); a longer packet is reported once and skipped. Every intact packet between
/// two delimiters is found, whatever else is in the stream: after garbage, the next delimiter starts over.
#[derive(Debug, Clone)]
pub struct Decoder<B> {
    buffer: B,
    held: usize,
    /// The buffered packet has been returned.
    done: bool,
    overflow: bool,
    counters: DecoderCounters,
}

impl<B: AsRef<[u8]> + AsMut<[u8]>> Decoder<B> {
    /// A decoder that stores packets in `buffer`.
    pub fn new(buffer: B) -> Self {
        Self { buffer, held: 0, done: false, overflow: false, counters: DecoderCounters::default() }
    }

    /// Consumes bytes from the front of `bytes` up to the end of the next packet and returns its message or error.
    /// Returns `None` once all bytes are consumed without completing a packet; call it until then.
    pub fn feed(&mut self, bytes: &mut &[u8]) -> Option<Result<Message<'_>, WireError>> {
        if self.done {
            self.reset();
        }
        loop {
            let end = bytes.iter().position(|byte| *byte == 0);
            let (part, rest) = bytes.split_at(end.unwrap_or(bytes.len()));
            self.keep(part);
            *bytes = rest;
            end?;
            *bytes = &rest[1..];
            // Two consecutive delimiters have nothing between them.
            if self.held > 0 || self.overflow {
                break;
            }
        }
        Some(self.finish())
    }

    /// True while part of a packet is buffered.
    pub fn is_mid_packet(&self) -> bool {
        !self.done && (self.held > 0 || self.overflow)
    }

    /// Discards an incomplete packet, for instance after a new connection.
    pub fn reset(&mut self) {
        self.held = 0;
        self.done = false;
        self.overflow = false;
    }

    /// The counters.
    pub fn counters(&self) -> DecoderCounters {
        self.counters
    }

    fn keep(&mut self, part: &[u8]) {
        let room = self.buffer.as_mut().get_mut(self.held..self.held + part.len());
        match room {
            Some(room) if !self.overflow => {
                room.copy_from_slice(part);
                self.held += part.len();
            }
            _ => self.overflow = true,
        }
    }

    fn finish(&mut self) -> Result<Message<'_>, WireError> {
        self.done = true;
        let (held, limit) = (self.held, self.buffer.as_ref().len());
        let result = if self.overflow {
            Err(WireError::Long { limit })
        } else {
            let packet = &mut self.buffer.as_mut()[..held];
            unstuff(packet).ok_or(WireError::Stuffing { found: held })
        };
        let result = result.and_then(|length| parse::message(&self.buffer.as_ref()[..length]));
        match result {
            Ok(_) => self.counters.messages += 1,
            Err(_) => self.counters.bad += 1,
        }
        result
    }
}
