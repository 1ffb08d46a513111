//! Numbers as received (little-endian) or in the sender's memory, behind one interface, to avoid copies on either side.

/// A number with a fixed little-endian encoding.
pub trait Scalar: Copy + PartialEq {
    /// Bytes on the line.
    const BYTES: usize;

    /// Decodes exactly [`Scalar::BYTES`] bytes.
    fn from_wire(bytes: &[u8]) -> Self;

    /// Passes the encoded bytes to `put`.
    ///
    /// # Errors
    /// Errors of `put`.
    fn to_wire<E>(self, put: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E>;
}

macro_rules! scalar {
    ($($number:ty),*) => {$(
        impl Scalar for $number {
            const BYTES: usize = size_of::<Self>();

            fn from_wire(bytes: &[u8]) -> Self {
                let mut own = [0; size_of::<Self>()];
                own.copy_from_slice(bytes);
                Self::from_le_bytes(own)
            }

            fn to_wire<E>(self, mut put: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
                put(&self.to_le_bytes())
            }
        }
    )*};
}

scalar!(i16, i32, f32, u32);

/// The four electrodes of a measurement.
impl Scalar for [u8; 4] {
    const BYTES: usize = 4;

    fn from_wire(bytes: &[u8]) -> Self {
        let mut own = [0; 4];
        own.copy_from_slice(bytes);
        own
    }

    fn to_wire<E>(self, mut put: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        put(&self)
    }
}

/// A list of numbers, in memory or as received.
#[derive(Debug, Clone, Copy)]
pub struct List<'a, T>(Held<'a, T>);

#[derive(Debug, Clone, Copy)]
enum Held<'a, T> {
    Memory(&'a [T]),
    /// Always a whole number of elements.
    Wire(&'a [u8]),
}

impl<'a, T: Scalar> List<'a, T> {
    /// A received list; `bytes` must be a whole number of elements.
    pub(crate) fn wire(bytes: &'a [u8]) -> Self {
        debug_assert!(bytes.len().is_multiple_of(T::BYTES));
        Self(Held::Wire(bytes))
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        match self.0 {
            Held::Memory(slice) => slice.len(),
            Held::Wire(bytes) => bytes.len() / T::BYTES,
        }
    }

    /// True if empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One element.
    pub fn get(&self, index: usize) -> Option<T> {
        match self.0 {
            Held::Memory(slice) => slice.get(index).copied(),
            Held::Wire(bytes) => bytes.chunks_exact(T::BYTES).nth(index).map(T::from_wire),
        }
    }

    /// The elements in order.
    pub fn iter(&self) -> impl Iterator<Item = T> + use<'a, T> {
        let (memory, wire): (&[T], &[u8]) = match self.0 {
            Held::Memory(slice) => (slice, &[]),
            Held::Wire(bytes) => (&[], bytes),
        };
        memory.iter().copied().chain(wire.chunks_exact(T::BYTES).map(T::from_wire))
    }
}

impl<'a, T> From<&'a [T]> for List<'a, T> {
    fn from(slice: &'a [T]) -> Self {
        Self(Held::Memory(slice))
    }
}

impl<T: Scalar> PartialEq for List<'_, T> {
    fn eq(&self, other: &Self) -> bool {
        self.iter().eq(other.iter())
    }
}

/// Type of one reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Element {
    /// 16-bit signed, code 0.
    I16,
    /// 32-bit signed, code 1.
    I32,
    /// Single-precision IEEE 754, code 2.
    F32,
}

impl Element {
    /// The code on the line.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The element for a code.
    pub fn from_code(code: u8) -> Option<Self> {
        [Self::I16, Self::I32, Self::F32].into_iter().find(|element| element.code() == code)
    }

    /// Size of one reading, bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::I16 => 2,
            Self::I32 | Self::F32 => 4,
        }
    }
}

/// Readings of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Numbers<'a> {
    /// 16-bit counts.
    I16(List<'a, i16>),
    /// 32-bit counts.
    I32(List<'a, i32>),
    /// Single precision; NaN marks a missing reading.
    F32(List<'a, f32>),
}

impl<'a> Numbers<'a> {
    /// Received readings; `bytes` must be a whole number of elements.
    pub(crate) fn wire(element: Element, bytes: &'a [u8]) -> Self {
        match element {
            Element::I16 => Self::I16(List::wire(bytes)),
            Element::I32 => Self::I32(List::wire(bytes)),
            Element::F32 => Self::F32(List::wire(bytes)),
        }
    }

    /// Type of the readings.
    pub fn element(&self) -> Element {
        match self {
            Self::I16(_) => Element::I16,
            Self::I32(_) => Element::I32,
            Self::F32(_) => Element::F32,
        }
    }

    /// Number of readings.
    pub fn len(&self) -> usize {
        match self {
            Self::I16(list) => list.len(),
            Self::I32(list) => list.len(),
            Self::F32(list) => list.len(),
        }
    }

    /// True if empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Readings times `scale` (volts per count, as stated in the frame).
    pub fn volts(&self, scale: f32) -> impl Iterator<Item = f64> + use<'a> {
        let scale = f64::from(scale);
        let none = (List::from(&[][..]), List::from(&[][..]), List::from(&[][..]));
        let (short, long, float) = match *self {
            Self::I16(list) => (list, none.1, none.2),
            Self::I32(list) => (none.0, list, none.2),
            Self::F32(list) => (none.0, none.1, list),
        };
        let counts = short.iter().map(f64::from).chain(long.iter().map(f64::from));
        counts.chain(float.iter().map(f64::from)).map(move |reading| reading * scale)
    }
}

impl<'a> From<&'a [i16]> for Numbers<'a> {
    fn from(slice: &'a [i16]) -> Self {
        Self::I16(slice.into())
    }
}

impl<'a> From<&'a [i32]> for Numbers<'a> {
    fn from(slice: &'a [i32]) -> Self {
        Self::I32(slice.into())
    }
}

impl<'a> From<&'a [f32]> for Numbers<'a> {
    fn from(slice: &'a [f32]) -> Self {
        Self::F32(slice.into())
    }
}
