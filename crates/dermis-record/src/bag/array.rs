//! Messages that hold an array of numbers: `std_msgs/msg/Float64MultiArray` and its relatives, as CDR.

use crate::cdr::CdrReader;

/// A type of `std_msgs` arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ArrayKind {
    size: usize,
    is_float: bool,
    is_signed: bool,
}

impl ArrayKind {
    /// The accepted types, in words.
    pub(super) const EXPECTED: &'static str =
        "std_msgs/msg/Float64MultiArray, Float32MultiArray, or an Int or UInt MultiArray";

    /// The kind for a message type, in the spelling of ROS 1 or ROS 2.
    pub(super) fn of(kind: &str) -> Option<Self> {
        let name = kind.strip_prefix("std_msgs/msg/").or_else(|| kind.strip_prefix("std_msgs/"))?;
        let number = name.strip_suffix("MultiArray")?;
        let float = |size| Self { size, is_float: true, is_signed: true };
        let whole = |size, is_signed| Self { size, is_float: false, is_signed };
        Some(match number {
            "Float64" => float(8),
            "Float32" => float(4),
            "Int64" => whole(8, true),
            "Int32" => whole(4, true),
            "Int16" => whole(2, true),
            "Int8" => whole(1, true),
            "UInt64" => whole(8, false),
            "UInt32" => whole(4, false),
            "UInt16" => whole(2, false),
            "UInt8" | "Byte" => whole(1, false),
            _ => return None,
        })
    }

    /// The numbers in a message; `None` if it is malformed. They follow `layout` (dimensions and an offset).
    pub(super) fn read(self, message: &[u8]) -> Option<Vec<f64>> {
        let mut cdr = CdrReader::new(message)?;
        for _ in 0..cdr.length(12)? {
            cdr.string()?;
            cdr.u32()?;
            cdr.u32()?;
        }
        let offset = usize::try_from(cdr.u32()?).ok()?;
        let bytes = cdr.elements(self.size)?;
        let numbers: Vec<f64> = bytes.chunks_exact(self.size).map(|raw| self.number(raw)).collect();
        numbers.get(offset..).map(<[f64]>::to_vec)
    }

    fn number(self, raw: &[u8]) -> f64 {
        let mut wide = [0; 8];
        wide[..raw.len()].copy_from_slice(raw);
        let bits = u64::from_le_bytes(wide);
        let unused = 64 - 8 * self.size as u32;
        match (self.is_float, self.size, self.is_signed) {
            (true, 8, _) => f64::from_bits(bits),
            (true, ..) => f32::from_bits(bits as u32).into(),
            (false, _, true) => ((bits << unused) as i64 >> unused) as f64,
            (false, _, false) => bits as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Serialize;

    #[derive(Serialize)]
    struct Dimension {
        label: &'static str,
        size: u32,
        stride: u32,
    }

    #[derive(Serialize)]
    struct Message<T> {
        dimensions: Vec<Dimension>,
        offset: u32,
        data: Vec<T>,
    }

    fn written<T: Serialize>(data: Vec<T>, offset: u32) -> Vec<u8> {
        let dimensions = vec![Dimension { label: "channels", size: data.len() as u32, stride: 1 }];
        let body = cdr_encoding::to_vec::<_, byteorder::LittleEndian>(&Message { dimensions, offset, data }).unwrap();
        [&[0, 1, 0, 0], &body[..]].concat()
    }

    #[test]
    fn arrays_of_every_kind_equal_those_of_another_implementation() {
        let read = |kind: &str, message: Vec<u8>| ArrayKind::of(kind).unwrap().read(&message).unwrap();
        assert_eq!(read("std_msgs/msg/Float64MultiArray", written(vec![0.1, -2.0], 0)), [0.1, -2.0]);
        assert_eq!(read("std_msgs/msg/Float32MultiArray", written(vec![0.5_f32, -2.0], 1)), [-2.0]);
        assert_eq!(read("std_msgs/Int16MultiArray", written(vec![-3_i16, 300], 0)), [-3.0, 300.0]);
        assert_eq!(read("std_msgs/msg/Int64MultiArray", written(vec![-3_i64], 0)), [-3.0]);
        assert_eq!(read("std_msgs/msg/UInt32MultiArray", written(vec![u32::MAX], 0)), [f64::from(u32::MAX)]);
        assert_eq!(ArrayKind::of("sensor_msgs/msg/Image"), None);
        let whole = written(vec![0.1], 0);
        for length in 0..whole.len() {
            assert_eq!(ArrayKind::of("std_msgs/msg/Float64MultiArray").unwrap().read(&whole[..length]), None);
        }
    }
}
