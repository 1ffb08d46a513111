//! MATLAB files of versions 5 to 7 (`save -v6` and `save -v7`, SciPy's `savemat`, Octave). Reads real and complex
//! numeric arrays of every class. Arrays in structures get names such as `vi.meas`. Version 7.3 is a different format,
//! HDF5; such files are refused with advice on conversion.
//!
//! The format is described in MathWorks' "MAT-File Format", chapter on version 5. A file is a header of 128 bytes
//! followed by elements. Each element has a tag with type and length, followed by data. An array is an element made of
//! elements: flags, dimensions, name, real parts, imaginary parts. A compressed element is a zlib stream of one
//! element. Files are read twice, first for the names and then for the chosen arrays, so neither a file nor its
//! uncompressed content is in memory as a whole.

use std::io::{self, BufReader, Read};
use std::path::Path;

use flate2::read::ZlibDecoder;

use super::arrays::{self, MOST_ARRAYS, Named};
use super::content::{describe, open_regular};
use super::npy::{Arranged, Array, Element, MOST_DIMENSIONS, MOST_ELEMENTS};
use crate::error::shorten;
use crate::{DeviceError, FrameTable, ReadOptions};

/// Bytes before the first element.
const HEADER: usize = 128;
const EXPECTED: &str = "a MATLAB file of version 5 to 7";
/// Maximum nesting depth of structures to search.
const DEEPEST: usize = 4;
/// Maximum bytes for a name or for all field names. MATLAB allows 63 characters and a few thousand fields.
const MOST_NAME: u64 = 1 << 16;
/// Maximum compression ratio (zlib's manual), with a margin for short streams.
const MOST_UNPACKED: u64 = 1032;

/// Element types.
const INT8: u32 = 1;
const INT32: u32 = 5;
const UINT32: u32 = 6;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Array classes that hold numbers: double, single and the integers.
const NUMERIC: std::ops::RangeInclusive<u8> = 6..=15;
const STRUCTURE: u8 = 2;
/// Class with a different element layout: tables, strings and other objects.
const OPAQUE: u8 = 17;

/// Opens the file from its beginning.
type Open<'a> = &'a dyn Fn() -> io::Result<Box<dyn Read + 'a>>;

/// Decodes frames from the only array that can hold them. A vector is one frame, and a matrix is frames x channels.
/// With more dimensions, all but the first make up a frame.
///
/// # Errors
/// [`DeviceError::Foreign`] if it isn't such a file or has no numeric array, [`DeviceError::Field`] if several arrays
/// could hold frames, [`DeviceError::Length`] for a truncated file, and errors in the array itself.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    frames(&|| Ok(Box::new(content)), content.len() as u64, file, options)
}

/// Recognises a MATLAB file by the version and byte-order mark at the end of its header.
pub(super) fn looks_like(content: &[u8]) -> bool {
    matches!(content.get(124..128), Some([0, 1, b'I', b'M'] | [1, 0, b'M', b'I']))
}

/// As [`looks_like`], for a path.
pub(super) fn is_mat(path: &Path) -> bool {
    let mut first = [0; HEADER];
    open_regular(path).and_then(|mut file| file.read_exact(&mut first)).is_ok_and(|()| looks_like(&first))
}

/// Reads frames from a file. Only the numbers are held in memory.
pub(super) fn read_frames(path: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let failed = |error| DeviceError::io(path, "read", error);
    let length = open_regular(path).and_then(|file| file.metadata()).map_err(failed)?.len();
    let open = || -> io::Result<Box<dyn Read>> { Ok(Box::new(BufReader::with_capacity(1 << 16, open_regular(path)?))) };
    frames(&open, length, path, options)
}

fn frames(open: Open, length: u64, file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let mut walk = Walk::default();
    walk.file(open, length, file)?;
    let Walk { found, others, .. } = walk;
    let named: Vec<Named> = found.iter().map(|found| found.named.clone()).collect();
    if named.is_empty() || options.array.as_ref().is_some_and(|wanted| others.iter().any(|(name, _)| name == wanted)) {
        let other = |(name, what): &(String, &str)| format!("{} ({what})", shorten(name));
        let held = others.iter().take(6).map(other).collect::<Vec<_>>().join(", ");
        let found = if held.is_empty() { "a MATLAB file without arrays".to_owned() } else { held };
        return Err(DeviceError::Foreign { file: file.to_owned(), expected: "an array of numbers", found });
    }
    let chosen = arrays::choose(&named, file, options)?;
    let read = |which: usize| {
        let mut walk = Walk { wanted: Some(found[which].place), ..Walk::default() };
        walk.file(open, length, file)?;
        walk.array.ok_or_else(|| DeviceError::Empty { file: file.to_owned() })
    };
    let frames = arrays::with_notes(read(chosen)?.into_frames_with(file, options)?, &named, chosen);
    match arrays::clock(&named, chosen, frames.frames()) {
        Some(clock) => arrays::with_times(frames, &named[clock], &read(clock)?.values),
        None => Ok(frames),
    }
}

/// Index of the element in the file that contains an array, and number of numeric arrays before it in that element.
type Place = (usize, usize);

/// A numeric array and its place.
struct Found {
    place: Place,
    named: Named,
}

/// One pass through a file, for the names or for one chosen array.
#[derive(Default)]
struct Walk {
    wanted: Option<Place>,
    /// Place of the next numeric array.
    place: Place,
    found: Vec<Found>,
    /// Name and kind of variables without numbers.
    others: Vec<(String, &'static str)>,
    /// The chosen array.
    array: Option<Array>,
}

impl Walk {
    fn file(&mut self, open: Open, length: u64, file: &Path) -> Result<(), DeviceError> {
        let failed = |error| DeviceError::io(file, "read", error);
        let mut read = open().map_err(failed)?;
        let mut input = Input { read: &mut *read, left: length, is_big: false, file };
        let mut header = [0; HEADER];
        if length < HEADER as u64 || input.fill(&mut header).is_err() || !looks_like(&header) {
            let found = describe(&header).to_owned();
            return Err(DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found });
        }
        input.is_big = &header[126..] == b"MI";
        let mut element = 0;
        while input.left > 0 {
            if element == MOST_ARRAYS {
                let found = format!("more than {MOST_ARRAYS} arrays");
                return Err(DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found });
            }
            let Tag { kind, bytes, .. } = input.tag()?;
            let rest = input.enter(bytes)?;
            self.place = (element, 0);
            match kind {
                _ if self.wanted.is_some_and(|(wanted, _)| wanted != element) => {}
                MATRIX => self.array(&mut input, None, 0)?,
                COMPRESSED => self.unpacked(&mut input)?,
                // Other elements contain no arrays.
                _ => {}
            }
            input.leave(rest)?;
            element += 1;
        }
        Ok(())
    }

    fn unpacked(&mut self, input: &mut Input) -> Result<(), DeviceError> {
        let (packed, file, is_big) = (input.left, input.file, input.is_big);
        let mut unpacked = ZlibDecoder::new(Read::take(&mut *input.read, packed));
        let most = packed.saturating_mul(MOST_UNPACKED).saturating_add(1 << 12);
        let mut inner = Input { read: &mut unpacked, left: most, is_big, file };
        let Tag { kind, bytes, .. } = inner.tag()?;
        if kind == MATRIX {
            let rest = inner.enter(bytes)?;
            self.array(&mut inner, None, 0)?;
            // Read to the end, where the checksum is. When only names are needed, that would take too long.
            if self.wanted.is_some() {
                inner.leave(rest)?;
                let more = io::copy(&mut unpacked.by_ref().take(1), &mut io::sink());
                more.map_err(|error| DeviceError::io(file, "unpack", error))?;
            }
        }
        // The stream may not have been read to its end.
        let taken = packed - unpacked.into_inner().limit();
        input.left -= taken;
        Ok(())
    }

    /// Reads one array. Arrays in structures get their `name` from the caller.
    fn array(&mut self, input: &mut Input, name: Option<String>, depth: usize) -> Result<(), DeviceError> {
        if input.left == 0 {
            return Ok(());
        }
        let Some(head) = input.head()? else { return Ok(()) };
        let name = name.unwrap_or(head.name);
        let count = head.shape.iter().try_fold(1_u64, |product, next| product.checked_mul(*next as u64));
        match head.class {
            class if NUMERIC.contains(&class) => {
                let place = self.place;
                self.place.1 += 1;
                if self.wanted == Some(place) {
                    self.array = Some(input.numbers(&head.shape, count, head.is_complex)?);
                } else if self.wanted.is_none() {
                    self.found.push(Found { place, named: Named { name, shape: without_ones(head.shape) } });
                }
            }
            STRUCTURE if depth < DEEPEST && count == Some(1) => {
                for field in input.field_names()? {
                    let Tag { kind, bytes, .. } = input.tag()?;
                    let rest = input.enter(bytes)?;
                    if kind == MATRIX {
                        self.array(input, Some(format!("{name}.{field}")), depth + 1)?;
                    }
                    input.leave(rest)?;
                }
            }
            class => self.others.push((name, class_name(class))),
        }
        Ok(())
    }
}

fn class_name(class: u8) -> &'static str {
    match class {
        1 => "cells",
        STRUCTURE => "structures",
        4 => "text",
        5 => "a sparse array",
        _ => "an object",
    }
}

/// Removes the extra dimension of MATLAB's vectors.
fn without_ones(shape: Vec<usize>) -> Vec<usize> {
    match shape[..] {
        [1, count] | [count, 1] => vec![count],
        _ => shape,
    }
}

/// Type and length of an element.
struct Tag {
    kind: u32,
    bytes: u64,
    /// Bytes of padding to a multiple of eight.
    padding: u64,
}

struct Head {
    class: u8,
    is_complex: bool,
    shape: Vec<usize>,
    name: String,
}

/// The bytes of a file or of one element.
struct Input<'a> {
    read: &'a mut dyn Read,
    /// Bytes left in the current element.
    left: u64,
    is_big: bool,
    file: &'a Path,
}

impl Input<'_> {
    /// Limits the input to the next `bytes` bytes. Pass the result to [`Self::leave`] to restore the rest.
    fn enter(&mut self, bytes: u64) -> Result<u64, DeviceError> {
        let rest = self.left.checked_sub(bytes).ok_or_else(|| self.too_short(bytes))?;
        self.left = bytes;
        Ok(rest)
    }

    fn leave(&mut self, rest: u64) -> Result<(), DeviceError> {
        self.skip(self.left)?;
        self.left = rest;
        Ok(())
    }

    fn too_short(&self, expected: u64) -> DeviceError {
        DeviceError::Length { file: self.file.to_owned(), what: "an array", expected, found: self.left }
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), DeviceError> {
        let length = bytes.len() as u64;
        self.left = self.left.checked_sub(length).ok_or_else(|| self.too_short(length))?;
        self.read.read_exact(bytes).map_err(|error| DeviceError::io(self.file, "read an array", error))
    }

    fn skip(&mut self, bytes: u64) -> Result<(), DeviceError> {
        self.left = self.left.checked_sub(bytes).ok_or_else(|| self.too_short(bytes))?;
        let skipped = io::copy(&mut Read::take(&mut *self.read, bytes), &mut io::sink());
        let skipped = skipped.map_err(|error| DeviceError::io(self.file, "read an array", error))?;
        if skipped == bytes {
            return Ok(());
        }
        Err(DeviceError::Length { file: self.file.to_owned(), what: "an array", expected: bytes, found: skipped })
    }

    fn word(&mut self) -> Result<u32, DeviceError> {
        let mut raw = [0; 4];
        self.fill(&mut raw)?;
        Ok(if self.is_big { u32::from_be_bytes(raw) } else { u32::from_le_bytes(raw) })
    }

    fn tag(&mut self) -> Result<Tag, DeviceError> {
        let first = self.word()?;
        // Up to four bytes of data are inside the tag.
        if first >> 16 != 0 {
            let bytes = u64::from(first >> 16);
            return if bytes <= 4 {
                Ok(Tag { kind: first & 0xffff, bytes, padding: 4 - bytes })
            } else {
                Err(self.broken("an element's tag", &format!("{first:#x}"), "at most 4 bytes"))
            };
        }
        let bytes = u64::from(self.word()?);
        Ok(Tag { kind: first, bytes, padding: bytes.wrapping_neg() % 8 })
    }

    fn broken(&self, field: &'static str, found: &str, expected: &str) -> DeviceError {
        DeviceError::field(self.file, 1, field, found, expected)
    }

    /// The data of a short element, without padding.
    fn short(&mut self, field: &'static str, kinds: &[u32], most: u64) -> Result<Vec<u8>, DeviceError> {
        let tag = self.tag()?;
        if !kinds.contains(&tag.kind) || tag.bytes > most {
            let found = format!("type {} of {} bytes", tag.kind, tag.bytes);
            return Err(self.broken(field, &found, &format!("type {} of at most {most} bytes", kinds[0])));
        }
        let mut bytes = vec![0; tag.bytes as usize];
        self.fill(&mut bytes)?;
        self.skip(tag.padding.min(self.left))?;
        Ok(bytes)
    }

    /// Reads everything before an array's numbers. `None` for objects with a different layout.
    fn head(&mut self) -> Result<Option<Head>, DeviceError> {
        let number = |raw: &[u8; 4], is_big| if is_big { u32::from_be_bytes(*raw) } else { u32::from_le_bytes(*raw) };
        let flags = self.short("array flags", &[UINT32], 8)?;
        let flags = flags.first_chunk().map_or(0, |raw| number(raw, self.is_big));
        let class = (flags & 0xff) as u8;
        if class == OPAQUE {
            return Ok(None);
        }
        let lengths = self.short("array lengths", &[INT32], 4 * MOST_DIMENSIONS as u64)?;
        let (lengths, _) = lengths.as_chunks();
        let shape: Vec<usize> = lengths.iter().map(|raw| number(raw, self.is_big) as usize).collect();
        if shape.len() < 2 || shape.iter().any(|length| *length > i32::MAX as usize) {
            return Err(self.broken("array lengths", &format!("{shape:?}"), "two or more, none negative"));
        }
        let name = self.short("array name", &[INT8, 16, 2], MOST_NAME)?;
        let name = String::from_utf8_lossy(&name).into_owned();
        Ok(Some(Head { class, is_complex: flags & 0x800 != 0, shape, name }))
    }

    fn field_names(&mut self) -> Result<Vec<String>, DeviceError> {
        let length = self.short("length of field names", &[INT32], 4)?;
        let length = length
            .first_chunk()
            .map_or(0, |raw| (if self.is_big { u32::from_be_bytes(*raw) } else { u32::from_le_bytes(*raw) }) as usize);
        let names = self.short("field names", &[INT8], MOST_NAME)?;
        if length == 0 {
            return if names.is_empty() {
                Ok(Vec::new())
            } else {
                Err(self.broken("length of field names", "0", "at least 1"))
            };
        }
        let name = |raw: &[u8]| String::from_utf8_lossy(raw).trim_end_matches('\0').to_owned();
        Ok(names.chunks(length).map(name).collect())
    }

    /// The numbers of an array, row-major.
    fn numbers(&mut self, shape: &[usize], count: Option<u64>, is_complex: bool) -> Result<Array, DeviceError> {
        let Some(count) = count.filter(|count| *count <= MOST_ELEMENTS) else {
            let (limit, found) = (8 * MOST_ELEMENTS, count.map_or(u64::MAX, |count| count.saturating_mul(8)));
            return Err(DeviceError::TooLarge { file: self.file.to_owned(), limit, found });
        };
        let values = self.part(shape, count)?;
        let imaginary = if is_complex { Some(self.part(shape, count)?) } else { None };
        Ok(Array { shape: without_ones(shape.to_vec()), values, imaginary })
    }

    fn part(&mut self, shape: &[usize], count: u64) -> Result<Vec<f64>, DeviceError> {
        let tag = self.tag()?;
        let name = match tag.kind {
            INT8 => "i1",
            2 => "u1",
            3 => "i2",
            4 => "u2",
            INT32 => "i4",
            UINT32 => "u4",
            7 => "f4",
            9 => "f8",
            12 => "i8",
            13 => "u8",
            other => return Err(self.broken("type of numbers", &other.to_string(), "1 to 7, 9, 12 or 13")),
        };
        let order = if self.is_big { ">" } else { "<" };
        let Some(element) = Element::parse(&format!("{order}{name}")) else {
            return Err(self.broken("type of numbers", name, "a number"));
        };
        let expected = count * element.size() as u64;
        if tag.bytes != expected || tag.bytes > self.left {
            let found = tag.bytes.min(self.left);
            return Err(DeviceError::Length { file: self.file.to_owned(), what: "array elements", expected, found });
        }
        let mut values = Arranged::new(shape, count as usize, true);
        let mut buffer = vec![0; 1 << 16];
        let mut left = expected;
        while left > 0 {
            let part = &mut buffer[..left.min(1 << 16) as usize];
            self.fill(part)?;
            values.take(element, part, None);
            left -= part.len() as u64;
        }
        self.skip(tag.padding.min(self.left))?;
        Ok(values.into_values())
    }
}
