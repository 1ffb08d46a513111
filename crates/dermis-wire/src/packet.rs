//! Size, version and checksum of packets.

/// Version of the format supported by this crate.
pub const VERSION: u8 = 1;
/// Maximum size of a packet before stuffing, bytes, including header and checksum.
pub const MOST_PACKET: usize = 65_536;
/// Maximum length of a text in a message, bytes.
pub const MOST_TEXT: usize = 255;
/// Size of header and checksum around a payload, bytes.
pub(crate) const FRAMING: usize = 6;

/// Maximum number of bytes on the line for a packet of `packet` bytes, including both delimiters.
pub const fn encoded_len(packet: usize) -> usize {
    packet + packet.div_ceil(254) + 3
}

/// CRC-32 as in Ethernet, zlib and PNG: polynomial 0x04C11DB7, reflected, with initial value and final exclusive-or
/// of all ones.
pub(crate) const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// CRC-32 as in every packet; the same as in Ethernet, zlib and PNG.
///
/// ```
/// assert_eq!(dermis_wire::checksum(b"123456789"), 0xCBF4_3926);
/// ```
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}
