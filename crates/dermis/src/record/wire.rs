//! Frames and baselines as Protocol Buffers messages, written and read by hand: two flat messages need no generator.
//! Wire format: <https://protobuf.dev/programming-guides/encoding/>.

use dermis_device::Frame;
use dermis_touch::{ReferenceOrigin, ReferenceRecord};

/// Wire types.
const VARINT: u64 = 0;
const FIXED64: u64 = 1;
const LENGTH: u64 = 2;
const FIXED32: u64 = 5;

/// A baseline as recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineEntry {
    /// When and why it was set; the time is on the host's monotonic clock.
    pub record: ReferenceRecord,
    /// The baseline, one value a channel.
    pub values: Vec<f64>,
}

/// Appends a frame.
pub(super) fn push_frame(out: &mut Vec<u8>, frame: &Frame) {
    push_fixed64(out, 1, frame.sequence);
    if let Some(time_ns) = frame.device_time_ns {
        push_fixed64(out, 2, time_ns);
    }
    push_fixed64(out, 3, frame.host_monotonic_ns);
    push_fixed64(out, 4, frame.host_wall_ns);
    push_doubles(out, 5, &frame.values);
    push_doubles(out, 6, &frame.imaginary);
}

/// Reads a frame into `frame`, or returns none if the bytes are no such message; `frame` then holds part of it.
pub(super) fn read_frame(bytes: &[u8], frame: &mut Frame) -> Option<()> {
    frame.clear();
    let mut fields = Fields(bytes);
    while !fields.0.is_empty() {
        match fields.next()? {
            (1, Value::Fixed64(value)) => frame.sequence = value,
            (2, Value::Fixed64(value)) => frame.device_time_ns = Some(value),
            (3, Value::Fixed64(value)) => frame.host_monotonic_ns = value,
            (4, Value::Fixed64(value)) => frame.host_wall_ns = value,
            (5, value) => read_doubles(value, &mut frame.values)?,
            (6, value) => read_doubles(value, &mut frame.imaginary)?,
            _ => {}
        }
    }
    Some(())
}

/// Appends a baseline.
pub(super) fn push_baseline(out: &mut Vec<u8>, record: &ReferenceRecord, values: &[f64]) {
    push_fixed64(out, 1, record.time_ns);
    push_fixed64(out, 2, record.frames as u64);
    push_bytes(out, 3, origin_name(record.origin).as_bytes());
    push_bytes(out, 4, record.reason.as_bytes());
    push_doubles(out, 5, values);
}

/// Reads a baseline, or returns none if the bytes are no such message.
pub(super) fn read_baseline(bytes: &[u8]) -> Option<BaselineEntry> {
    let BaselineEntry { mut record, mut values } = empty_baseline();
    let mut fields = Fields(bytes);
    while !fields.0.is_empty() {
        match fields.next()? {
            (1, Value::Fixed64(value)) => record.time_ns = value,
            (2, Value::Fixed64(value)) => record.frames = usize::try_from(value).ok()?,
            (3, Value::Bytes(name)) => record.origin = *ORIGINS.iter().find(|o| origin_name(**o).as_bytes() == name)?,
            (4, Value::Bytes(reason)) => record.reason = std::str::from_utf8(reason).ok()?.to_owned(),
            (5, value) => read_doubles(value, &mut values)?,
            _ => {}
        }
    }
    Some(BaselineEntry { record, values })
}

/// What absent fields mean.
pub(super) fn empty_baseline() -> BaselineEntry {
    let record = ReferenceRecord { time_ns: 0, frames: 0, origin: ReferenceOrigin::Given, reason: String::new() };
    BaselineEntry { record, values: Vec::new() }
}

const ORIGINS: [ReferenceOrigin; 4] =
    [ReferenceOrigin::Startup, ReferenceOrigin::Tare, ReferenceOrigin::ForcedTare, ReferenceOrigin::Given];

fn origin_name(origin: ReferenceOrigin) -> &'static str {
    match origin {
        ReferenceOrigin::Startup => "startup",
        ReferenceOrigin::Tare => "tare",
        ReferenceOrigin::ForcedTare => "forced-tare",
        ReferenceOrigin::Given => "given",
    }
}

pub(super) fn push_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

pub(super) fn push_tag(out: &mut Vec<u8>, field: u64, wire_type: u64) {
    push_varint(out, field << 3 | wire_type);
}

pub(super) fn push_number(out: &mut Vec<u8>, field: u64, value: u64) {
    push_tag(out, field, VARINT);
    push_varint(out, value);
}

pub(super) fn push_bytes(out: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    push_tag(out, field, LENGTH);
    push_varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

fn push_fixed64(out: &mut Vec<u8>, field: u64, value: u64) {
    push_tag(out, field, FIXED64);
    out.extend_from_slice(&value.to_le_bytes());
}

/// A packed list; an empty one is not written.
fn push_doubles(out: &mut Vec<u8>, field: u64, values: &[f64]) {
    if values.is_empty() {
        return;
    }
    push_tag(out, field, LENGTH);
    push_varint(out, size_of_val(values) as u64);
    out.extend(values.iter().flat_map(|value| value.to_bits().to_le_bytes()));
}

/// A field's value, as far as the wire type tells.
enum Value<'a> {
    Varint,
    Fixed64(u64),
    Bytes(&'a [u8]),
    Fixed32,
}

/// What is left of a message.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    /// The next field's number and value, or none where the bytes are malformed.
    fn next(&mut self) -> Option<(u64, Value<'a>)> {
        let tag = self.varint()?;
        let value = match tag & 7 {
            VARINT => self.varint().map(|_| Value::Varint)?,
            FIXED64 => Value::Fixed64(u64::from_le_bytes(self.take(8)?.try_into().ok()?)),
            LENGTH => {
                let length = usize::try_from(self.varint()?).ok()?;
                Value::Bytes(self.take(length)?)
            }
            FIXED32 => self.take(4).map(|_| Value::Fixed32)?,
            _ => return None,
        };
        Some((tag >> 3, value))
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = *self.take(1)?.first()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }
}

/// Appends a list of doubles, packed or (as parsers must accept) one by one.
fn read_doubles(value: Value<'_>, to: &mut Vec<f64>) -> Option<()> {
    match value {
        Value::Fixed64(bits) => to.push(f64::from_bits(bits)),
        Value::Bytes(bytes) if bytes.len().is_multiple_of(8) => {
            to.extend(bytes.as_chunks::<8>().0.iter().map(|bytes| f64::from_bits(u64::from_le_bytes(*bytes))));
        }
        _ => return None,
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bits(frame: &Frame) -> (u64, Option<u64>, u64, u64, Vec<u64>, Vec<u64>) {
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect();
        let Frame { sequence, device_time_ns, host_monotonic_ns, host_wall_ns, values, imaginary, .. } = frame;
        (*sequence, *device_time_ns, *host_monotonic_ns, *host_wall_ns, bits(values), bits(imaginary))
    }

    proptest! {
        #[test]
        fn frames_come_back_bit_for_bit(
            sequence: u64, device_time_ns: Option<u64>, host_monotonic_ns: u64, host_wall_ns: u64,
            values: Vec<u64>, imaginary: Vec<u64>,
        ) {
            let values = values.into_iter().map(f64::from_bits).collect();
            let imaginary = imaginary.into_iter().map(f64::from_bits).collect();
            let plain = Frame::default();
            let frame =
                Frame { sequence, device_time_ns, host_monotonic_ns, host_wall_ns, values, imaginary, ..plain };
            let mut bytes = Vec::new();
            push_frame(&mut bytes, &frame);
            let mut found = Frame { imaginary: vec![5.0], device_time_ns: Some(1), ..Frame::default() };
            prop_assert!(read_frame(&bytes, &mut found).is_some());
            prop_assert_eq!(bits(&found), bits(&frame));
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes: Vec<u8>) {
            let _ = read_frame(&bytes, &mut Frame::default());
            let _ = read_baseline(&bytes);
        }
    }

    #[test]
    fn baselines_come_back_with_origin_and_reason() {
        for origin in ORIGINS {
            let record = ReferenceRecord { time_ns: 7, frames: 32, origin, reason: "drift \u{2192} 0".to_owned() };
            let mut bytes = Vec::new();
            push_baseline(&mut bytes, &record, &[0.1, -0.0]);
            assert_eq!(read_baseline(&bytes), Some(BaselineEntry { record, values: vec![0.1, -0.0] }));
        }
    }

    #[test]
    fn unknown_fields_are_passed_over_and_cut_messages_refused() {
        let frame = Frame { sequence: 3, values: vec![1.0, 2.0], ..Frame::default() };
        let mut bytes = Vec::new();
        push_number(&mut bytes, 100, u64::MAX);
        push_bytes(&mut bytes, 101, b"later");
        push_frame(&mut bytes, &frame);
        let mut found = Frame::default();
        assert!(read_frame(&bytes, &mut found).is_some());
        assert_eq!(found, frame);
        assert!(read_frame(&bytes[..bytes.len() - 1], &mut found).is_none());
    }
}
