//! NumPy arrays (`.npy`, format versions 1 to 3): reading `f8 f4 i4 i2 u2` of either byte order and either memory
//! order, writing little-endian `f8` and `f4` in C order. The format is that of NumPy Enhancement Proposal 1.

use std::io::{self, Write};
use std::path::Path;

pub use super::content::NPY_MAGIC as MAGIC;
use super::foreign;
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Layout, write_atomic};

const EXPECTED: &str = "a NumPy array (npy, version 1 to 3)";
const MOST_DIMENSIONS: usize = 16;

/// An array of any shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length of each dimension; empty for a single number.
    pub shape: Vec<usize>,
    /// Elements in row-major order, whatever the file's order.
    pub values: Vec<f64>,
}

impl Array {
    /// Frames in rows: one dimension is one frame, two are frames x channels, and three, of which the second is 2,
    /// frames x (real, imaginary) x channels, as `dermis export` writes complex ones.
    ///
    /// # Errors
    /// [`DeviceError::Field`] for another number of dimensions, [`DeviceError::Empty`], [`DeviceError::Infinite`].
    pub fn into_frames(self, file: &Path) -> Result<FrameTable, DeviceError> {
        let count = match self.shape[..] {
            [count] | [_, count] => count,
            [_, 2, count] if count > 0 => {
                let part = |which: usize| -> Vec<f64> {
                    self.values
                        .chunks_exact(2 * count)
                        .flat_map(|frame| &frame[which * count..][..count])
                        .copied()
                        .collect()
                };
                return FrameTable::new(Layout::Channels { count }, part(0), file)?.with_imaginary(part(1));
            }
            _ => {
                let found = shorten(&format!("{:?}", self.shape));
                return Err(DeviceError::field(file, 1, "shape", &found, "(channels,) or (frames, channels)"));
            }
        };
        FrameTable::new(Layout::Channels { count }, self.values, file)
    }
}

/// Reads an array from a file.
///
/// # Errors
/// As [`decode`], and [`DeviceError::Io`].
pub fn read(path: &Path) -> Result<Array, DeviceError> {
    decode(&super::read_bytes(path)?, path)
}

/// Decodes a whole file; `file` is for messages. The shape is compared with the bytes present before anything is
/// allocated for it.
///
/// # Errors
/// [`DeviceError::Foreign`], [`DeviceError::Field`] for an unusable header, [`DeviceError::Length`] if the elements are
/// fewer or more than the shape says.
pub fn decode(content: &[u8], file: &Path) -> Result<Array, DeviceError> {
    let (header, data) = split(content, file)?;
    let header = Header::parse(header, file)?;
    let length = |expected: u64| DeviceError::Length {
        file: file.to_owned(),
        what: "array elements",
        expected,
        found: data.len() as u64,
    };
    let size = header.element.size();
    let bytes = header.shape.iter().try_fold(size, |product, &next| product.checked_mul(next));
    if bytes != Some(data.len()) {
        return Err(length(bytes.map_or(u64::MAX, |bytes| bytes as u64)));
    }
    let stored = data.chunks_exact(size).map(|bytes| header.element.value(bytes, header.big_endian));
    let values = if header.fortran { to_row_major(stored.collect(), &header.shape) } else { stored.collect() };
    Ok(Array { shape: header.shape, values })
}

/// The header's text and the elements' bytes.
fn split<'a>(content: &'a [u8], file: &Path) -> Result<(&'a str, &'a [u8]), DeviceError> {
    let wrong = || foreign(file, EXPECTED, content);
    let truncated = |expected: usize| DeviceError::Length {
        file: file.to_owned(),
        what: "header",
        expected: expected as u64,
        found: content.len() as u64,
    };
    let rest = content.strip_prefix(MAGIC).ok_or_else(wrong)?;
    let &[major, _minor, ref rest @ ..] = rest else { return Err(truncated(MAGIC.len() + 2)) };
    let (length, start) = match (major, rest) {
        (1, &[a, b, ..]) => (u16::from_le_bytes([a, b]) as usize, 2),
        (2 | 3, &[a, b, c, d, ..]) => (u32::from_le_bytes([a, b, c, d]) as usize, 4),
        (1..=3, _) => return Err(truncated(MAGIC.len() + 6)),
        _ => return Err(DeviceError::field(file, 1, "format version", &major.to_string(), "1, 2 or 3")),
    };
    let (header, data) = rest[start..]
        .split_at_checked(length)
        .ok_or_else(|| truncated((MAGIC.len() + 2 + start).saturating_add(length)))?;
    let text = std::str::from_utf8(header);
    let text =
        text.map_err(|_| DeviceError::field(file, 1, "header", "bytes that are not UTF-8", "a Python dictionary"))?;
    Ok((text, data))
}

/// Kinds of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Element {
    F8,
    F4,
    I4,
    I2,
    U2,
}

impl Element {
    fn size(self) -> usize {
        match self {
            Self::F8 => 8,
            Self::F4 | Self::I4 => 4,
            Self::I2 | Self::U2 => 2,
        }
    }

    /// The number in `bytes`, of which there are [`Self::size`].
    fn value(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut raw = [0; 8];
        for (to, from) in raw.iter_mut().zip(bytes) {
            *to = *from;
        }
        if big_endian {
            raw[..self.size()].reverse();
        }
        let bits = u64::from_le_bytes(raw);
        match self {
            Self::F8 => f64::from_bits(bits),
            Self::F4 => f32::from_bits(bits as u32).into(),
            Self::I4 => (bits as u32 as i32).into(),
            Self::I2 => (bits as u16 as i16).into(),
            Self::U2 => (bits as u16).into(),
        }
    }
}

struct Header {
    element: Element,
    big_endian: bool,
    fortran: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Parses the Python dictionary `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`.
    fn parse(text: &str, file: &Path) -> Result<Self, DeviceError> {
        let entry = |name: &'static str, expected: &str| {
            value_of(text, name).ok_or_else(|| DeviceError::field(file, 1, name, text, expected))
        };
        const TYPES: &str = "'<' or '>' with f8, f4, i4, i2 or u2";
        let descr = entry("descr", TYPES)?;
        let quoted = descr.get(1..4).filter(|_| descr.starts_with(['\'', '"']) && descr.get(4..5) == descr.get(..1));
        let (order, kind) = quoted.and_then(|quoted| quoted.split_at_checked(1)).unwrap_or_default();
        let element = match kind {
            "f8" => Some(Element::F8),
            "f4" => Some(Element::F4),
            "i4" => Some(Element::I4),
            "i2" => Some(Element::I2),
            "u2" => Some(Element::U2),
            _ => None,
        };
        let (Some(element), "<" | ">") = (element, order) else {
            return Err(DeviceError::field(file, 1, "descr", descr.split(',').next().unwrap_or(descr), TYPES));
        };
        let order_text = entry("fortran_order", "True or False")?;
        let fortran = match (order_text.starts_with("True"), order_text.starts_with("False")) {
            (true, _) => true,
            (_, true) => false,
            _ => return Err(DeviceError::field(file, 1, "fortran_order", order_text, "True or False")),
        };
        let shape_text = entry("shape", "a tuple of lengths")?;
        let shape = parse_shape(shape_text)
            .ok_or_else(|| DeviceError::field(file, 1, "shape", shape_text, "a tuple of at most 16 lengths"))?;
        Ok(Self { element, big_endian: order == ">", fortran, shape })
    }
}

/// Text that follows `'name':` in a Python dictionary.
fn value_of<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let at = [format!("'{name}'"), format!("\"{name}\"")].iter().find_map(|key| Some(text.find(key)? + key.len()))?;
    Some(text[at..].trim_start().strip_prefix(':')?.trim_start())
}

fn parse_shape(text: &str) -> Option<Vec<usize>> {
    let (inside, _) = text.strip_prefix('(')?.split_once(')')?;
    let inside = inside.trim();
    if inside.is_empty() {
        return Some(Vec::new());
    }
    let lengths = inside.strip_suffix(',').unwrap_or(inside).split(',');
    let shape: Vec<usize> =
        lengths.take(MOST_DIMENSIONS + 1).map(|length| length.trim().parse().ok()).collect::<Option<_>>()?;
    (shape.len() <= MOST_DIMENSIONS).then_some(shape)
}

/// Elements stored with the first index fastest, rearranged so that the last one is.
fn to_row_major(stored: Vec<f64>, shape: &[usize]) -> Vec<f64> {
    let mut index = vec![0; shape.len()];
    let mut strides = Vec::with_capacity(shape.len());
    let mut stride = 1;
    for &length in shape {
        strides.push(stride);
        stride *= length;
    }
    let mut values = Vec::with_capacity(stored.len());
    for _ in 0..stored.len() {
        values.push(stored[index.iter().zip(&strides).map(|(index, stride)| index * stride).sum::<usize>()]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            if index[axis] < shape[axis] {
                break;
            }
            index[axis] = 0;
        }
    }
    values
}

/// Numbers that can be written.
pub trait Number: Copy {
    /// NumPy's name of the little-endian type.
    const DESCR: &'static str;

    /// Writes the little-endian bytes.
    ///
    /// # Errors
    /// Those of `out`.
    fn write_to(self, out: &mut dyn Write) -> io::Result<()>;
}

impl Number for f64 {
    const DESCR: &'static str = "<f8";

    fn write_to(self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&self.to_le_bytes())
    }
}

impl Number for f32 {
    const DESCR: &'static str = "<f4";

    fn write_to(self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&self.to_le_bytes())
    }
}

impl Number for u8 {
    const DESCR: &'static str = "|u1";

    fn write_to(self, out: &mut dyn Write) -> io::Result<()> {
        out.write_all(&[self])
    }
}

/// Writes everything that stands before the elements, padded so that these are aligned; for writers that stream the
/// elements themselves, with [`Number::write_to`], inside [`write_atomic`].
///
/// # Errors
/// Those of `out`, and `InvalidInput` for a shape too long for version 1 (thousands of dimensions).
pub fn write_header<T: Number>(out: &mut dyn Write, shape: &[usize]) -> io::Result<()> {
    const ALIGNMENT: usize = 64;
    let lengths: String = shape.iter().map(|length| format!("{length}, ")).collect();
    let lengths = if shape.len() == 1 { lengths.trim_end() } else { lengths.trim_end_matches(", ") };
    let mut header = format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({lengths}), }}", T::DESCR);
    let before = MAGIC.len() + 4;
    let padded = (before + header.len() + 1).next_multiple_of(ALIGNMENT) - before;
    header.extend(std::iter::repeat_n(' ', padded - header.len() - 1));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(|_| io::ErrorKind::InvalidInput)?;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())
}

/// Writes row-major `values` of the given shape; nothing stands at `path` unless it is whole.
///
/// # Errors
/// [`DeviceError::Count`] if the shape holds another number of values, [`DeviceError::Io`].
pub fn write_f64(path: &Path, shape: &[usize], values: &[f64]) -> Result<(), DeviceError> {
    write_array(path, shape, values)
}

/// As [`write_f64`] in single precision.
///
/// # Errors
/// As [`write_f64`].
pub fn write_f32(path: &Path, shape: &[usize], values: &[f32]) -> Result<(), DeviceError> {
    write_array(path, shape, values)
}

/// As [`write_f64`] in bytes (labels).
///
/// # Errors
/// As [`write_f64`].
pub fn write_u8(path: &Path, shape: &[usize], values: &[u8]) -> Result<(), DeviceError> {
    write_array(path, shape, values)
}

fn write_array<T: Number>(path: &Path, shape: &[usize], values: &[T]) -> Result<(), DeviceError> {
    let expected = shape.iter().fold(1, |product: usize, &length| product.saturating_mul(length));
    if expected != values.len() {
        let what = "values to write, as the shape says";
        return Err(DeviceError::Count { file: path.to_owned(), what, expected, found: values.len() });
    }
    write_atomic(path, |out| {
        write_header::<T>(out, shape)?;
        values.iter().try_for_each(|value| value.write_to(out))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of the given version, as NumPy writes it.
    fn made(version: u8, descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
        let mut content = MAGIC.to_vec();
        content.extend([version, 0]);
        match version {
            1 => content.extend((header.len() as u16).to_le_bytes()),
            _ => content.extend((header.len() as u32).to_le_bytes()),
        }
        content.extend(header.as_bytes());
        content.extend(data);
        content
    }

    fn decoded(content: &[u8]) -> Result<Array, DeviceError> {
        decode(content, Path::new("a.npy"))
    }

    #[test]
    fn every_type_byte_order_and_version() {
        let numbers = [1.0, -2.0, 300.0];
        type Encode = fn(f64) -> Vec<u8>;
        let kinds: [(&str, Encode); 9] = [
            ("<f8", |x| x.to_le_bytes().into()),
            (">f8", |x| x.to_be_bytes().into()),
            ("<f4", |x| (x as f32).to_le_bytes().into()),
            (">f4", |x| (x as f32).to_be_bytes().into()),
            ("<i4", |x| (x as i32).to_le_bytes().into()),
            (">i4", |x| (x as i32).to_be_bytes().into()),
            ("<i2", |x| (x as i16).to_le_bytes().into()),
            (">i2", |x| (x as i16).to_be_bytes().into()),
            ("<u2", |x| (x.abs() as u16).to_le_bytes().into()),
        ];
        for version in 1..=3 {
            for (descr, encode) in kinds {
                let data: Vec<u8> = numbers.into_iter().flat_map(encode).collect();
                let array = decoded(&made(version, descr, "False", "(3,)", &data)).unwrap();
                let expected = if descr == "<u2" { numbers.map(f64::abs) } else { numbers };
                assert_eq!((array.shape, array.values), (vec![3], expected.to_vec()), "{descr} {version}");
            }
        }
    }

    #[test]
    fn fortran_order_is_rearranged() {
        let data: Vec<u8> = (0..24_i16).flat_map(i16::to_le_bytes).collect();
        let array = decoded(&made(1, "<i2", "True", "(2, 3, 4)", &data)).unwrap();
        for i in 0..2 {
            for j in 0..3 {
                for k in 0..4 {
                    assert_eq!(array.values[(i * 3 + j) * 4 + k], (i + 2 * (j + 3 * k)) as f64);
                }
            }
        }
    }

    #[test]
    fn one_dimension_is_one_frame() {
        let data: Vec<u8> = (0..6_i16).flat_map(i16::to_le_bytes).collect();
        let file = Path::new("a.npy");
        let frames = |shape| decoded(&made(1, "<i2", "False", shape, &data)).unwrap().into_frames(file);
        assert_eq!(frames("(6,)").unwrap().frames(), 1);
        assert_eq!(frames("(3, 2)").unwrap().row(2), Some([4.0, 5.0].as_slice()));
        let message = frames("(1, 3, 2)").unwrap_err().to_string();
        assert!(message.contains("shape: expected (channels,) or (frames, channels), found '[1, 3, 2]'"), "{message}");
    }

    #[test]
    fn announced_sizes_are_checked_before_they_are_believed() {
        for (shape, expected) in [
            ("(3,)", "expected 24 bytes of array elements, found 16"),
            ("(1,)", "expected 8 bytes"),
            ("(1000000000000, 4)", "expected 32000000000000 bytes"),
            ("(18446744073709551615, 18446744073709551615)", "array elements, found 16"),
            ("(99999999999999999999,)", "shape: expected a tuple of at most 16 lengths"),
            ("(1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,2)", "at most 16 lengths"),
            ("(-2,)", "a tuple of"),
            ("2", "a tuple of"),
        ] {
            let message = decoded(&made(1, "<f8", "False", shape, &[0; 16])).unwrap_err().to_string();
            assert!(message.contains(expected), "{shape}: {message}");
        }
        let mut long = made(2, "<f8", "False", "(2,)", &[0; 16]);
        long[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(decoded(&long).unwrap_err().to_string().contains("expected 4294967307 bytes of header"));
    }

    #[test]
    fn unusable_headers_name_the_entry() {
        for (content, expected) in [
            (made(1, "<c16", "False", "(1,)", &[0; 16]), "descr: expected '<' or '>' with f8"),
            (made(1, "|O", "False", "(1,)", &[0; 8]), "descr"),
            (made(1, "<f8", "Maybe", "(1,)", &[0; 8]), "fortran_order: expected True or False, found 'Maybe"),
            (made(9, "<f8", "False", "(1,)", &[0; 8]), "format version: expected 1, 2 or 3, found '9'"),
            (b"1,2,3\n".to_vec(), "expected a NumPy array (npy, version 1 to 3), found other text"),
            (MAGIC.to_vec(), "bytes of header"),
        ] {
            let message = decoded(&content).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn what_is_written_reads_back_the_same() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.npy");
        for shape in [vec![], vec![6], vec![2, 3], vec![1, 2, 3], vec![0, 4]] {
            let values: Vec<f64> = (0..shape.iter().product::<usize>()).map(|i| i as f64 / 3.0).collect();
            write_f64(&path, &shape, &values).unwrap();
            assert_eq!(std::fs::read(&path).unwrap().len() % 8, 0);
            assert_eq!(read(&path).unwrap(), Array { shape, values });
        }
        write_f32(&path, &[2], &[f32::NAN, 0.1]).unwrap();
        let array = read(&path).unwrap();
        assert!(array.values[0].is_nan() && array.values[1] == f64::from(0.1_f32));
        assert!(write_f64(&path, &[3], &[0.0]).is_err());
        assert_eq!(read(&path).unwrap().values.len(), 2, "a refused write must leave the old file");
    }
}
