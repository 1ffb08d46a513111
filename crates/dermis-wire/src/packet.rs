//! Size, version and checksum of packets.

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

/// CRC-32 as in Ethernet, zlib and PNG: polynomial 0x04C11DB7, reflected, initial value and final exclusive-or all
/// ones.
pub(crate) const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

/// CRC-32 of bytes, as every packet carries it: that of Ethernet, zlib and PNG.
///
/// ```
/// assert_eq!(dermis_wire::checksum(b"123456789"), 0xCBF4_3926);
/// ```
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}
