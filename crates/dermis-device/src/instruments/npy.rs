//! NumPy arrays (`.npy`, format versions 1 to 3; NumPy Enhancement Proposal 1). Reads integers, floats and complex
//! numbers of every size except the extended ones, in either byte order and either memory order. Writes little-endian
//! `f8`, `f4` and `u1` in C order.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;

pub use super::content::NPY_MAGIC as MAGIC;
use super::content::{MOST_BYTES, describe, open_regular};
use crate::{DeviceError, FrameTable, ReadOptions, write_atomic};

mod arranged;
mod element;
mod frames;

pub(super) use arranged::Arranged;
pub(super) use element::{Element, half};

const EXPECTED: &str = "a NumPy array (npy, version 1 to 3)";
pub(super) const MOST_DIMENSIONS: usize = 16;
/// Maximum number of elements: they take 2 GiB of memory.
pub(super) const MOST_ELEMENTS: u64 = MOST_BYTES / 4;
/// Longest header in bytes. Record arrays list their field names there.
const MOST_HEADER: usize = 1 << 20;

/// An array of any shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length of each dimension; empty for a single number.
    pub shape: Vec<usize>,
    /// Elements in row-major order, whatever the file's order; real parts if complex.
    pub values: Vec<f64>,
    /// Imaginary parts of a complex array.
    pub imaginary: Option<Vec<f64>>,
}

/// True if a file begins like a NumPy array.
pub(super) fn is_npy(path: &Path) -> bool {
    let mut first = [0; MAGIC.len()];
    open_regular(path).and_then(|mut file| file.read_exact(&mut first)).is_ok_and(|()| first == MAGIC)
}

/// Reads frames from a file. Only the numbers are held in memory.
pub(super) fn read_frames(path: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    read(path)?.into_frames_with(path, options)
}

/// Reads an array from a file.
///
/// # Errors
/// As [`decode`], and [`DeviceError::Io`].
pub fn read(path: &Path) -> Result<Array, DeviceError> {
    let failed = |error| DeviceError::io(path, "read", error);
    let file: File = open_regular(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    read_from(&mut BufReader::with_capacity(1 << 16, file), length, path)
}

/// Decodes a whole file; `file` is only used in messages. The shape is checked against the number of bytes before
/// memory is allocated.
///
/// # Errors
/// [`DeviceError::Foreign`], [`DeviceError::Field`] for an unusable header, [`DeviceError::Length`] if the number of
/// elements doesn't match the shape.
pub fn decode(content: &[u8], file: &Path) -> Result<Array, DeviceError> {
    read_from(&mut &content[..], content.len() as u64, file)
}

/// Reads an array of `length` bytes including its header.
pub(super) fn read_from(input: &mut dyn Read, length: u64, file: &Path) -> Result<Array, DeviceError> {
    let (header, start) = Header::read(input, length, file)?;
    let size = header.element.size() as u64;
    let count = header.shape.iter().try_fold(1_u64, |product, &next| product.checked_mul(next as u64));
    let bytes = count.and_then(|count| count.checked_mul(size));
    let found = length.saturating_sub(start);
    if bytes != Some(found) {
        let (what, expected) = ("array elements", bytes.unwrap_or(u64::MAX));
        return Err(DeviceError::Length { file: file.to_owned(), what, expected, found });
    }
    if count.is_none_or(|count| count > MOST_ELEMENTS) {
        let (limit, found) = (8 * MOST_ELEMENTS, count.map_or(u64::MAX, |count| count.saturating_mul(8)));
        return Err(DeviceError::TooLarge { file: file.to_owned(), limit, found });
    }
    let count = count.unwrap_or(0) as usize;
    let mut values = Arranged::new(&header.shape, count, header.fortran);
    let mut imaginary = header.element.is_complex().then(|| Arranged::new(&header.shape, count, header.fortran));
    // A multiple of every element size.
    let mut buffer = vec![0; 1 << 16];
    let mut left = found;
    while left > 0 {
        let part = &mut buffer[..left.min(1 << 16) as usize];
        input.read_exact(part).map_err(|error| DeviceError::io(file, "read", error))?;
        values.take(header.element, part, imaginary.as_mut());
        left -= part.len() as u64;
    }
    let imaginary = imaginary.map(Arranged::into_values);
    Ok(Array { values: values.into_values(), imaginary, shape: header.shape })
}

pub(super) struct Header {
    element: Element,
    fortran: bool,
    pub(super) shape: Vec<usize>,
}

impl Header {
    /// Reads the header. Also returns the position of the first element.
    pub(super) fn read(input: &mut dyn Read, length: u64, file: &Path) -> Result<(Self, u64), DeviceError> {
        let failed = |error| DeviceError::io(file, "read", error);
        let truncated =
            |expected: u64| DeviceError::Length { file: file.to_owned(), what: "header", expected, found: length };
        let mut start = Vec::new();
        Read::take(&mut *input, MAGIC.len() as u64).read_to_end(&mut start).map_err(failed)?;
        if start != MAGIC {
            Read::take(&mut *input, 4096).read_to_end(&mut start).map_err(failed)?;
            let found = describe(&start).to_owned();
            return Err(DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found });
        }
        let mut take = |count: usize, announced: u64| {
            let mut bytes = vec![0; count];
            match input.read_exact(&mut bytes) {
                Ok(()) => Ok(bytes),
                Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Err(truncated(announced)),
                Err(error) => Err(failed(error)),
            }
        };
        let major = take(2, MAGIC.len() as u64 + 2)?[0];
        let width = match major {
            1 => 2,
            2 | 3 => 4,
            _ => return Err(DeviceError::field(file, 1, "format version", &major.to_string(), "1, 2 or 3")),
        };
        let mut announced = [0; 4];
        announced[..width].copy_from_slice(&take(width, MAGIC.len() as u64 + 6)?);
        let size = u32::from_le_bytes(announced) as usize;
        let before = (MAGIC.len() + 2 + width) as u64;
        if size as u64 > length.saturating_sub(before) {
            return Err(truncated(before + size as u64));
        }
        if size > MOST_HEADER {
            return Err(DeviceError::field(file, 1, "header", &format!("{size} bytes"), "a header of at most 1 MiB"));
        }
        let text = String::from_utf8(take(size, before + size as u64)?);
        let text =
            text.map_err(|_| DeviceError::field(file, 1, "header", "bytes that are not UTF-8", "a Python dictionary"))?;
        Ok((Self::parse(&text, file)?, before + size as u64))
    }

    /// Parses the Python dictionary `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4), }`.
    fn parse(text: &str, file: &Path) -> Result<Self, DeviceError> {
        let entry = |name: &'static str, expected: &str| {
            value_of(text, name).ok_or_else(|| DeviceError::field(file, 1, name, text, expected))
        };
        let descr = entry("descr", element::EXPECTED)?;
        let wrong = |expected: &str| {
            Err(DeviceError::field(file, 1, "descr", descr.split(", '").next().unwrap_or(descr), expected))
        };
        if descr.starts_with('[') {
            return wrong("an array of plain numbers; save one field of the records, array['field']");
        }
        let quoted = descr.get(1..).and_then(|rest| rest.split(['\'', '"']).next()).unwrap_or_default();
        if quoted.ends_with('O') {
            return wrong("an array of plain numbers; objects are not unpickled, save numpy.asarray(array, float)");
        }
        let Some(element) = Element::parse(quoted).filter(|_| descr.starts_with(['\'', '"'])) else {
            return wrong(element::EXPECTED);
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
        Ok(Self { element, fortran, shape })
    }
}

/// The text after `'name':` in a Python dictionary.
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

/// A number type that can be written.
pub trait Number: Copy {
    /// NumPy's name of the little-endian type.
    const DESCR: &'static str;

    /// Writes the little-endian bytes.
    ///
    /// # Errors
    /// The errors of `out`.
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

/// Writes everything before the elements, padded to align them. For writers that stream the elements themselves with
/// [`Number::write_to`] inside [`write_atomic`].
///
/// # Errors
/// The errors of `out`, and `InvalidInput` for a shape too long for version 1 (thousands of dimensions).
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

/// Writes row-major `values` of the given shape. `path` never holds an incomplete file.
///
/// # Errors
/// [`DeviceError::Count`] if the number of values doesn't match the shape, [`DeviceError::Io`].
pub fn write_f64(path: &Path, shape: &[usize], values: &[f64]) -> Result<(), DeviceError> {
    write_array(path, shape, values)
}

/// As [`write_f64`], in single precision.
///
/// # Errors
/// As [`write_f64`].
pub fn write_f32(path: &Path, shape: &[usize], values: &[f32]) -> Result<(), DeviceError> {
    write_array(path, shape, values)
}

/// As [`write_f64`], as bytes (for labels).
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
mod tests;
