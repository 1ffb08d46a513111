//! The bytes that an instrument and its host exchange: packets with a CRC-32, stuffed with COBS so that a zero byte marks
//! their ends, carrying a handshake, commands and frames of readings. The chapter on the wire in the book specifies every
//! byte, with test vectors.
//!
//! Nothing here opens a port, reads a clock or allocates: [`encode`] writes into a buffer of the caller's, [`Decoder`]
//! takes bytes in whatever pieces they come. Firmware and host share it.
//!
//! ```
//! use dermis_wire::{Decoder, Frame, List, Message, Numbers, Status, encode};
//!
//! let readings = [1200i16, -7, 0];
//! let frame = Frame {
//!     sequence: 7,
//!     device_time_ns: 20_000_000,
//!     status: Status::default(),
//!     gain: 0,
//!     scale: 1e-6,
//!     values: Numbers::from(&readings[..]),
//!     imaginary: None,
//!     channel_times_ns: None,
//! };
//! let mut buffer = [0; 64];
//! let bytes = encode(&Message::Frame(frame), &mut buffer)?;
//!
//! let mut decoder = Decoder::new([0; 64]);
//! let mut noisy: &[u8] = &[b"garbage".as_slice(), &*bytes].concat();
//! assert!(decoder.feed(&mut noisy).is_some_and(|first| first.is_err()));
//! let Some(Ok(Message::Frame(received))) = decoder.feed(&mut noisy) else { panic!("no frame") };
//! assert_eq!(received.values.volts(received.scale).nth(1), Some(-7.0 * 1e-6f32 as f64));
//! assert_eq!(received, frame);
//! # Ok::<(), dermis_wire::WireError>(())
//! ```

#![no_std]

mod cobs;
mod command;
mod decoder;
mod encode;
mod error;
mod list;
mod message;
mod parse;

pub use command::{Command, NO_ELECTRODE, Reply, ReplyStatus, Request};
pub use decoder::{Decoder, DecoderCounters};
pub use encode::encode;
pub use error::WireError;
pub use list::{Element, List, Numbers, Scalar};
pub use message::{Describe, Features, Frame, Hello, Kind, Message, Part, Status};

/// Version of the format that this crate speaks.
pub const VERSION: u8 = 1;

/// Most bytes of a packet before stuffing, header and checksum included.
pub const MOST_PACKET: usize = 65_536;

/// Most bytes of a text in a message.
pub const MOST_TEXT: usize = 255;

/// Bytes of header and checksum round a payload.
pub(crate) const FRAMING: usize = 6;

/// Bytes that a packet of `packet` bytes takes at most on the line, both delimiters included.
pub const fn encoded_len(packet: usize) -> usize {
    packet + packet.div_ceil(254) + 3
}

/// CRC-32 as in Ethernet, zlib and PNG: polynomial 0x04C11DB7, reflected, initial value and final exclusive-or all ones.
pub(crate) const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
