//! Element types of NumPy arrays.

/// Types that can be read, for messages.
pub(super) const EXPECTED: &str = "'<' or '>' with f2, f4, f8, c8, c16, i1 to i8, u1 to u8, or |b1";

/// A number type with its byte order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::instruments) struct Element {
    kind: Kind,
    is_big_endian: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    F8,
    F4,
    F2,
    I8,
    I4,
    I2,
    I1,
    U8,
    U4,
    U2,
    U1,
    C16,
    C8,
}

impl Element {
    /// Parses NumPy's name, such as `<f8`.
    pub(in crate::instruments) fn parse(name: &str) -> Option<Self> {
        let (order, kind) = name.split_at_checked(1)?;
        let kind = match kind {
            "f8" => Kind::F8,
            "f4" => Kind::F4,
            "f2" => Kind::F2,
            "i8" => Kind::I8,
            "i4" => Kind::I4,
            "i2" => Kind::I2,
            "i1" => Kind::I1,
            "u8" => Kind::U8,
            "u4" => Kind::U4,
            "u2" => Kind::U2,
            "u1" | "b1" => Kind::U1,
            "c16" => Kind::C16,
            "c8" => Kind::C8,
            _ => return None,
        };
        let has_order = !matches!(kind, Kind::I1 | Kind::U1);
        match (order, has_order) {
            ("<", _) | ("|", false) => Some(Self { kind, is_big_endian: false }),
            (">", _) => Some(Self { kind, is_big_endian: true }),
            _ => None,
        }
    }

    /// Size of an element in bytes.
    pub(in crate::instruments) fn size(self) -> usize {
        match self.kind {
            Kind::C16 => 16,
            Kind::F8 | Kind::I8 | Kind::U8 | Kind::C8 => 8,
            Kind::F4 | Kind::I4 | Kind::U4 => 4,
            Kind::F2 | Kind::I2 | Kind::U2 => 2,
            Kind::I1 | Kind::U1 => 1,
        }
    }

    pub(in crate::instruments) fn is_complex(self) -> bool {
        matches!(self.kind, Kind::C16 | Kind::C8)
    }

    /// Appends the elements in `bytes`, whose length must be a multiple of the element size.
    pub(in crate::instruments) fn decode(self, bytes: &[u8], values: &mut Vec<f64>, imaginary: &mut Vec<f64>) {
        macro_rules! numbers {
            ($number:ty, $size:literal) => {{
                let (raw, _) = bytes.as_chunks::<$size>();
                if self.is_big_endian {
                    values.extend(raw.iter().map(|raw| <$number>::from_be_bytes(*raw) as f64));
                } else {
                    values.extend(raw.iter().map(|raw| <$number>::from_le_bytes(*raw) as f64));
                }
            }};
        }
        macro_rules! pairs {
            ($number:ty, $size:literal) => {{
                let (raw, _) = bytes.as_chunks::<$size>();
                let value = |raw: [u8; $size]| {
                    let number =
                        if self.is_big_endian { <$number>::from_be_bytes(raw) } else { <$number>::from_le_bytes(raw) };
                    f64::from(number)
                };
                values.extend(raw.iter().step_by(2).map(|raw| value(*raw)));
                imaginary.extend(raw.iter().skip(1).step_by(2).map(|raw| value(*raw)));
            }};
        }
        match self.kind {
            Kind::F8 => numbers!(f64, 8),
            Kind::F4 => numbers!(f32, 4),
            Kind::I8 => numbers!(i64, 8),
            Kind::I4 => numbers!(i32, 4),
            Kind::I2 => numbers!(i16, 2),
            Kind::I1 => numbers!(i8, 1),
            Kind::U8 => numbers!(u64, 8),
            Kind::U4 => numbers!(u32, 4),
            Kind::U2 => numbers!(u16, 2),
            Kind::U1 => numbers!(u8, 1),
            Kind::C16 => pairs!(f64, 8),
            Kind::C8 => pairs!(f32, 4),
            Kind::F2 => {
                let (raw, _) = bytes.as_chunks::<2>();
                let bits =
                    |raw: [u8; 2]| if self.is_big_endian { u16::from_be_bytes(raw) } else { u16::from_le_bytes(raw) };
                values.extend(raw.iter().map(|raw| half(bits(*raw))));
            }
        }
    }
}

/// IEEE 754 binary16: a sign, five bits of exponent, ten of fraction.
pub(in crate::instruments) fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction * 2_f64.powi(-24),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        _ => (1024.0 + fraction) * 2_f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}
