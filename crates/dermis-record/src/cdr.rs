//! Classic CDR, little-endian, as ROS 2 stores it in recordings (OMG DDS-RTPS 2.5, section 10; OMG CORBA 3.3 part 2,
//! section 9.3). Four bytes identify the encoding. After them every number is aligned to a multiple of its size,
//! counted from the end of those four; strings and sequences start with their length.
//!
//! Written by hand because live frames go through reused memory, and readings must survive bit for bit. The tests
//! compare with an independent implementation.

/// CDR_LE, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A message being written into reused memory.
pub(super) struct CdrWriter<'a> {
    out: &'a mut Vec<u8>,
}

impl<'a> CdrWriter<'a> {
    /// Clears `out` and starts a message.
    pub(super) fn new(out: &'a mut Vec<u8>) -> Self {
        out.clear();
        out.extend_from_slice(&ENCAPSULATION);
        Self { out }
    }

    fn align(&mut self, size: usize) {
        let length = self.out.len() - ENCAPSULATION.len();
        self.out.resize(ENCAPSULATION.len() + length.next_multiple_of(size), 0);
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.out.push(value);
    }

    pub(super) fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    pub(super) fn i32(&mut self, value: i32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    pub(super) fn u64(&mut self, value: u64) {
        self.align(8);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    #[cfg(feature = "ros2")]
    pub(super) fn f32(&mut self, value: f32) {
        self.u32(value.to_bits());
    }

    /// A sequence's length; its elements follow.
    pub(super) fn length(&mut self, length: usize) {
        // No sequence here comes near four billion elements.
        self.u32(u32::try_from(length).unwrap_or(u32::MAX));
    }

    /// `builtin_interfaces/Time`: nanoseconds since 1970-01-01 UTC.
    pub(super) fn time(&mut self, wall_ns: u64) {
        // The standard's type ends in 2038.
        self.i32(i32::try_from(wall_ns / 1_000_000_000).unwrap_or(i32::MAX));
        self.u32((wall_ns % 1_000_000_000) as u32);
    }

    /// `std_msgs/Header`.
    pub(super) fn header(&mut self, wall_ns: u64, frame_id: &str) {
        self.time(wall_ns);
        self.string(frame_id);
    }

    pub(super) fn string(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.out.extend_from_slice(text.as_bytes());
        self.out.push(0);
    }

    pub(super) fn doubles(&mut self, values: &[f64]) {
        self.length(values.len());
        if !values.is_empty() {
            self.align(8);
            self.out.extend(values.iter().flat_map(|value| value.to_bits().to_le_bytes()));
        }
    }

    pub(super) fn u64s(&mut self, values: &[u64]) {
        self.length(values.len());
        if !values.is_empty() {
            self.align(8);
            self.out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
    }

    /// A `uint8[]` of `length` bytes, which `fill` appends.
    pub(super) fn bytes(&mut self, length: usize, fill: impl FnOnce(&mut Vec<u8>)) {
        self.length(length);
        fill(self.out);
    }
}

/// The unread rest of a message. Every getter returns `None` if the message is too short or malformed.
pub(super) struct CdrReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> CdrReader<'a> {
    /// `None` for another byte order or encoding.
    pub(super) fn new(message: &'a [u8]) -> Option<Self> {
        let (encapsulation, bytes) = message.split_first_chunk::<4>()?;
        (encapsulation[..2] == ENCAPSULATION[..2]).then_some(Self { bytes, at: 0 })
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(length)?;
        let taken = self.bytes.get(self.at..end)?;
        self.at = end;
        Some(taken)
    }

    fn aligned<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.at = self.at.next_multiple_of(N);
        self.take(N)?.try_into().ok()
    }

    pub(super) fn bool(&mut self) -> Option<bool> {
        self.take(1).map(|byte| byte[0] != 0)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.aligned().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.aligned().map(u64::from_le_bytes)
    }

    pub(super) fn f64(&mut self) -> Option<f64> {
        self.u64().map(f64::from_bits)
    }

    /// True if all bytes have been read.
    pub(super) fn is_at_end(&self) -> bool {
        self.at >= self.bytes.len()
    }

    /// A sequence's length, checked against the bytes that remain at `least` bytes per element.
    pub(super) fn length(&mut self, least: usize) -> Option<usize> {
        let length = usize::try_from(self.u32()?).ok()?;
        (length.checked_mul(least)? <= self.bytes.len() - self.at).then_some(length)
    }

    pub(super) fn string(&mut self) -> Option<&'a str> {
        let length = self.length(1)?;
        let (end, text) = self.take(length)?.split_last()?;
        if *end == 0 { std::str::from_utf8(text).ok() } else { None }
    }

    /// Replaces the content of `to`.
    pub(super) fn doubles(&mut self, to: &mut Vec<f64>) -> Option<()> {
        to.clear();
        to.extend(self.eights()?.iter().map(|bytes| f64::from_bits(u64::from_le_bytes(*bytes))));
        Some(())
    }

    /// Replaces the content of `to`.
    pub(super) fn u64s(&mut self, to: &mut Vec<u64>) -> Option<()> {
        to.clear();
        to.extend(self.eights()?.iter().map(|bytes| u64::from_le_bytes(*bytes)));
        Some(())
    }

    /// A sequence of eight-byte elements.
    fn eights(&mut self) -> Option<&'a [[u8; 8]]> {
        Some(self.elements(8)?.as_chunks::<8>().0)
    }

    /// The bytes of a sequence whose elements have `size` bytes each.
    pub(super) fn elements(&mut self, size: usize) -> Option<&'a [u8]> {
        let length = self.length(size)?;
        if length > 0 {
            self.at = self.at.next_multiple_of(size);
        }
        self.take(size.checked_mul(length)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde::{Deserialize, Serialize};

    /// Every kind of value, in an order that needs padding before most of them.
    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Mixture {
        flag: bool,
        text: String,
        seconds: i32,
        small: u8,
        number: u64,
        none: Vec<f64>,
        byte: u8,
        doubles: Vec<f64>,
        bytes: Vec<u8>,
        last: f64,
    }

    fn write(from: &Mixture) -> Vec<u8> {
        let mut out = vec![9; 3];
        let mut cdr = CdrWriter::new(&mut out);
        cdr.bool(from.flag);
        cdr.string(&from.text);
        cdr.i32(from.seconds);
        cdr.u8(from.small);
        cdr.u64(from.number);
        cdr.doubles(&from.none);
        cdr.u8(from.byte);
        cdr.doubles(&from.doubles);
        cdr.bytes(from.bytes.len(), |out| out.extend_from_slice(&from.bytes));
        cdr.f64(from.last);
        out
    }

    proptest! {
        #[test]
        fn another_implementation_writes_and_reads_the_same_bytes(
            flag: bool, text in "[a-z\u{e4}]{0,9}", seconds: i32, small: u8, number: u64,
            doubles in prop::collection::vec(-1e9..1e9, 0..5), bytes: Vec<u8>,
        ) {
            let last = 0.1 * f64::from(small);
            let mixture = Mixture { flag, text, seconds, small, number, none: Vec::new(), byte: 7, doubles, bytes, last };
            let written = write(&mixture);
            let theirs = cdr_encoding::to_vec::<_, byteorder::LittleEndian>(&mixture).unwrap();
            prop_assert_eq!(&written[4..], &theirs[..]);
            let read = cdr_encoding::from_bytes::<Mixture, byteorder::LittleEndian>(&written[4..]);
            prop_assert_eq!(read.unwrap().0, mixture);
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes: Vec<u8>) {
            let message = [&ENCAPSULATION[..], &bytes].concat();
            let mut cdr = CdrReader::new(&message).unwrap();
            let _ = (cdr.bool(), cdr.string(), cdr.u64(), cdr.doubles(&mut Vec::new()), cdr.u32());
        }
    }

    #[test]
    fn impossible_lengths_are_refused() {
        let message = [0, 1, 0, 0, 255, 255, 255, 255, 1, 2, 3];
        assert_eq!(CdrReader::new(&message).unwrap().string(), None);
        assert_eq!(CdrReader::new(&message).unwrap().doubles(&mut Vec::new()), None);
        assert!(CdrReader::new(&[0, 0, 0, 0, 1]).is_none(), "big-endian");
        assert!(CdrReader::new(&[0, 1, 0]).is_none());
    }
}
