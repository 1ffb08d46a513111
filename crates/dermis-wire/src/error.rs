//! What can be wrong with a packet.

use crate::{Kind, MOST_PACKET, MOST_TEXT, VERSION};

/// A packet that could not be read or written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The bytes between two delimiters are no byte stuffing.
    #[error("expected a byte-stuffed packet, found {found} bytes that are none")]
    Stuffing {
        /// Bytes between the delimiters.
        found: usize,
    },
    /// A packet shorter than header and checksum.
    #[error("expected a packet of at least 6 bytes, found {found}")]
    Short {
        /// Bytes of the packet.
        found: usize,
    },
    /// A packet that does not fit into the receiver's or sender's buffer, or beyond [`MOST_PACKET`].
    #[error("expected a packet that fits into {limit} bytes (never more than {MOST_PACKET} before stuffing)")]
    Long {
        /// Bytes there is room for.
        limit: usize,
    },
    /// The checksum does not match.
    #[error("expected CRC-32 {expected:08x}, found {found:08x}")]
    Checksum {
        /// Checksum of the bytes received.
        expected: u32,
        /// Checksum sent with them.
        found: u32,
    },
    /// A version that this crate does not speak.
    #[error("expected version {VERSION} of the wire, found {found}")]
    Version {
        /// Version of the packet.
        found: u8,
    },
    /// A kind of message that version 1 does not have.
    #[error("expected a known kind of message, found {found:#04x}")]
    UnknownKind {
        /// The kind's code.
        found: u8,
    },
    /// A payload that is shorter or longer than its fields.
    #[error("{kind:?}: expected {expected} payload bytes, found {found}")]
    Length {
        /// Kind of message.
        kind: Kind,
        /// Bytes that its fields take, as far as they could be read.
        expected: usize,
        /// Bytes present.
        found: usize,
    },
    /// A field with a code that version 1 does not have.
    #[error("{kind:?}: {field}: unknown code {found}")]
    Code {
        /// Kind of message.
        kind: Kind,
        /// The field.
        field: &'static str,
        /// What stood there.
        found: u32,
    },
    /// A text that is not UTF-8 or longer than [`MOST_TEXT`] bytes.
    #[error("{kind:?}: {field}: expected UTF-8 of at most {MOST_TEXT} bytes")]
    Text {
        /// Kind of message.
        kind: Kind,
        /// The field.
        field: &'static str,
    },
    /// Lists of one frame that differ in length or element, or too many elements.
    #[error("{kind:?}: {field}: expected {expected} elements, found {found}")]
    Count {
        /// Kind of message.
        kind: Kind,
        /// The field.
        field: &'static str,
        /// Elements needed, or the most there may be.
        expected: usize,
        /// Elements present.
        found: usize,
    },
}
