//! Bytes to messages, in whatever pieces the bytes come.

use crate::cobs::unstuff;
use crate::message::Message;
use crate::{WireError, parse};

/// What a decoder has seen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DecoderCounters {
    /// Messages handed out.
    pub messages: u64,
    /// Packets that were damaged, too long, or of an unknown version or kind.
    pub bad: u64,
}

/// Cuts a stream of bytes into packets and packets into messages.
///
/// Memory is what the caller gave: an array in firmware, a vector on a host. It must hold a packet as stuffed
/// ([`encoded_len`](crate::encoded_len)); a longer one is reported once and skipped. Whatever bytes come, every packet
/// that is whole and stands between two delimiters is found: after garbage, the next delimiter starts afresh.
#[derive(Debug, Clone)]
pub struct Decoder<B> {
    buffer: B,
    held: usize,
    /// The buffer's content has been handed out.
    done: bool,
    overflow: bool,
    counters: DecoderCounters,
}

impl<B: AsRef<[u8]> + AsMut<[u8]>> Decoder<B> {
    /// A decoder that keeps packets in `buffer`.
    pub fn new(buffer: B) -> Self {
        Self { buffer, held: 0, done: false, overflow: false, counters: DecoderCounters::default() }
    }

    /// Takes bytes from the front of `bytes` up to the end of the next packet: its message, or what is wrong with it.
    /// `None` when all bytes are taken and no packet has ended; call until then.
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
            // Two delimiters in a row hold nothing between them.
            if self.held > 0 || self.overflow {
                break;
            }
        }
        Some(self.finish())
    }

    /// True while part of a packet is held.
    pub fn is_mid_packet(&self) -> bool {
        !self.done && (self.held > 0 || self.overflow)
    }

    /// Forgets a packet of which only a part has come, as after a new connection.
    pub fn reset(&mut self) {
        self.held = 0;
        self.done = false;
        self.overflow = false;
    }

    /// What has been seen.
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
