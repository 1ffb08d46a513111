//! The bytes exchanged by an instrument and its host: packets with a CRC-32, stuffed with COBS so that a zero byte
//! marks their ends, carrying a handshake, commands and frames of readings. The chapter on the wire in the book
//! specifies every byte, with test vectors.
//!
//! Nothing here opens a port, reads a clock or allocates: [`encode`] writes into the caller's buffer, and [`Decoder`]
//! accepts bytes in whatever pieces they arrive. Firmware and host share the code.
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
mod packet;
mod parse;

pub use command::{Command, NO_ELECTRODE, Reply, ReplyStatus, Request};
pub use decoder::{Decoder, DecoderCounters};
pub use encode::encode;
pub use error::WireError;
pub use list::{Element, List, Numbers, Scalar};
pub use message::{Describe, Features, Frame, Hello, Kind, Message, Part, Status};
pub use packet::{MOST_PACKET, MOST_TEXT, VERSION, checksum, encoded_len};
