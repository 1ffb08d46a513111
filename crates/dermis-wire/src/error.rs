//! Errors in packets.

use crate::{Kind, MOST_PACKET, MOST_TEXT, VERSION};

/// A packet that could not be read or written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The bytes between two delimiters are not valid byte stuffing.
    #[error("expected a byte-stuffed packet, found {found} bytes that are not one")]
    Stuffing {
        /// Bytes between the delimiters.
        found: usize,
    },
    /// The packet is shorter than header and checksum.
    #[error("expected a packet of at least 6 bytes, found {found}")]
    Short {
        /// Bytes of the packet.
        found: usize,
    },
    /// The packet does not fit into the receiver's or sender's buffer, or is longer than [`MOST_PACKET`].
    #[error("expected a packet that fits into {limit} bytes (never more than {MOST_PACKET} before stuffing)")]
    Long {
        /// Size limit, bytes.
        limit: usize,
    },
    /// The checksum does not match.
    #[error("expected CRC-32 {expected:08x}, found {found:08x}")]
    Checksum {
        /// Checksum of the bytes received.
        expected: u32,
        /// Checksum received.
        found: u32,
    },
    /// This crate does not support the packet's version.
    #[error("expected version {VERSION} of the wire, found {found}")]
    Version {
        /// Version of the packet.
        found: u8,
    },
    /// Version 1 has no such kind of message.
    #[error("expected a known kind of message, found {found:#04x}")]
    UnknownKind {
        /// The kind's code.
        found: u8,
    },
    /// The payload is shorter or longer than its fields.
    #[error("{kind:?}: expected {expected} payload bytes, found {found}")]
    Length {
        /// Kind of message.
        kind: Kind,
        /// Bytes needed by its fields, as far as they could be read.
        expected: usize,
        /// Bytes present.
        found: usize,
    },
    /// Version 1 has no such code for this field.
    #[error("{kind:?}: {field}: unknown code {found}")]
    Code {
        /// Kind of message.
        kind: Kind,
        /// The field.
        field: &'static str,
        /// The code found.
        found: u32,
    },
    /// The text is not UTF-8 or is longer than [`MOST_TEXT`] bytes.
    #[error("{kind:?}: {field}: expected UTF-8 of at most {MOST_TEXT} bytes")]
    Text {
        /// Kind of message.
        kind: Kind,
        /// The field.
        field: &'static str,
    },
    /// The lists of one frame differ in length or element type, or there are too many elements.
    #[error("{kind:?}: {field}: expected {expected} elements, found {found}")]
    Count {
        /// Kind of message.
        kind: Kind,
        /// The field.
        field: &'static str,
        /// Number of elements needed, or the maximum.
        expected: usize,
        /// Number of elements present.
        found: usize,
    },
}
