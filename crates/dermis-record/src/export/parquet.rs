//! The subset of Apache Parquet that a table of numbers and words needs: plain encoding, no compression, one page for
//! each column of a row group (<https://github.com/apache/parquet-format>; records use Thrift's compact protocol,
//! <https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md>). The crate `parquet` and its
//! dependencies would take longer to compile than the rest of this crate.

use std::io::{self, Write};

use super::rows::{Cell, Column, Kind, RowWriter};

const MAGIC: &[u8] = b"PAR1";

/// Size of the columns, in bytes, at which a row group is written.
const GROUP_BYTES: usize = 16 << 20;

/// Values of Parquet's enumerations.
mod code {
    pub(super) const INT64: i64 = 2;
    pub(super) const DOUBLE: i64 = 5;
    pub(super) const BYTE_ARRAY: i64 = 6;
    pub(super) const REQUIRED: i64 = 0;
    pub(super) const OPTIONAL: i64 = 1;
    pub(super) const UTF8: i64 = 0;
    pub(super) const UINT_64: i64 = 14;
    pub(super) const PLAIN: i64 = 0;
    pub(super) const RLE: i64 = 3;
    pub(super) const UNCOMPRESSED: i64 = 0;
    pub(super) const DATA_PAGE: i64 = 0;
}

/// One column of the current row group.
#[derive(Default)]
struct Chunk {
    /// Present values, in plain encoding.
    values: Vec<u8>,
    /// For columns with absent values: a flag for each row.
    present: Vec<bool>,
}

/// Position of a column of a finished row group in the file.
struct Place {
    offset: u64,
    bytes: u64,
}

struct Group {
    rows: u64,
    columns: Vec<Place>,
}

pub(super) struct ParquetWriter<'a, W> {
    out: W,
    at: u64,
    columns: &'a [Column],
    chunks: Vec<Chunk>,
    rows: u64,
    groups: Vec<Group>,
}

impl<'a, W: Write> ParquetWriter<'a, W> {
    pub(super) fn new(mut out: W, columns: &'a [Column]) -> io::Result<Self> {
        out.write_all(MAGIC)?;
        let chunks = columns.iter().map(|_| Chunk::default()).collect();
        Ok(Self { out, at: MAGIC.len() as u64, columns, chunks, rows: 0, groups: Vec::new() })
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.at += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    fn end_group(&mut self) -> io::Result<()> {
        if self.rows == 0 {
            return Ok(());
        }
        let mut places = Vec::new();
        for index in 0..self.chunks.len() {
            let chunk = std::mem::take(&mut self.chunks[index]);
            let offset = self.at;
            let levels = if self.columns[index].kind == Kind::Time { levels(&chunk.present) } else { Vec::new() };
            let size = (levels.len() + chunk.values.len()) as i64;
            self.write(&page_header(size, self.rows as i64))?;
            self.write(&levels)?;
            self.write(&chunk.values)?;
            places.push(Place { offset, bytes: self.at - offset });
        }
        self.groups.push(Group { rows: self.rows, columns: places });
        self.rows = 0;
        Ok(())
    }
}

impl<W: Write> RowWriter for ParquetWriter<'_, W> {
    fn row(&mut self, cells: &[Cell]) -> io::Result<()> {
        for (chunk, cell) in self.chunks.iter_mut().zip(cells) {
            match cell {
                Cell::Count(value) => chunk.values.extend(value.to_le_bytes()),
                Cell::Time(value) => {
                    chunk.present.push(value.is_some());
                    chunk.values.extend(value.iter().flat_map(|value| value.to_le_bytes()));
                }
                Cell::Number(value) => chunk.values.extend(value.to_le_bytes()),
                Cell::Text(text) => {
                    chunk.values.extend((text.len() as u32).to_le_bytes());
                    chunk.values.extend(text.as_bytes());
                }
            }
        }
        self.rows += 1;
        let bytes: usize = self.chunks.iter().map(|chunk| chunk.values.len()).sum();
        if bytes >= GROUP_BYTES { self.end_group() } else { Ok(()) }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.end_group()?;
        let footer = footer(self.columns, &self.groups);
        self.write(&footer)?;
        self.write(&(footer.len() as u32).to_le_bytes())?;
        self.write(MAGIC)?;
        self.out.flush()
    }
}

/// Definition levels of 0 and 1: their length in bytes, then runs of equal levels, each as twice the count and the
/// level.
fn levels(present: &[bool]) -> Vec<u8> {
    let mut runs = Vec::new();
    for run in present.chunk_by(|a, b| a == b) {
        push_varint(&mut runs, 2 * run.len() as u64);
        runs.push(u8::from(run[0]));
    }
    [&(runs.len() as u32).to_le_bytes()[..], &runs].concat()
}

/// `PageHeader` of a data page.
fn page_header(bytes: i64, values: i64) -> Vec<u8> {
    let mut page = Struct::default();
    page.i32(1, code::DATA_PAGE);
    page.i32(2, bytes);
    page.i32(3, bytes);
    let mut data = Struct::default();
    data.i32(1, values);
    data.i32(2, code::PLAIN);
    data.i32(3, code::RLE);
    data.i32(4, code::RLE);
    page.nested(5, data);
    page.end()
}

/// `FileMetaData`.
fn footer(columns: &[Column], groups: &[Group]) -> Vec<u8> {
    let mut root = Struct::default();
    root.text(4, "schema");
    root.i32(5, columns.len() as i64);
    let mut schema = vec![root.end()];
    schema.extend(columns.iter().map(schema_element));
    let mut file = Struct::default();
    file.i32(1, 1);
    file.list(2, STRUCT, &schema);
    file.i64(3, groups.iter().map(|group| group.rows as i64).sum());
    let groups: Vec<Vec<u8>> = groups.iter().map(|group| row_group(columns, group)).collect();
    file.list(4, STRUCT, &groups);
    file.text(6, concat!("dermis version ", env!("CARGO_PKG_VERSION")));
    file.end()
}

fn physical_type(kind: Kind) -> i64 {
    match kind {
        Kind::Count | Kind::Time => code::INT64,
        Kind::Number => code::DOUBLE,
        Kind::Text => code::BYTE_ARRAY,
    }
}

/// `SchemaElement`.
fn schema_element(column: &Column) -> Vec<u8> {
    let mut element = Struct::default();
    element.i32(1, physical_type(column.kind));
    element.i32(3, if column.kind == Kind::Time { code::OPTIONAL } else { code::REQUIRED });
    element.text(4, &column.name);
    match column.kind {
        Kind::Count | Kind::Time => element.i32(6, code::UINT_64),
        Kind::Text => element.i32(6, code::UTF8),
        Kind::Number => {}
    }
    element.end()
}

/// `RowGroup`.
fn row_group(columns: &[Column], group: &Group) -> Vec<u8> {
    let chunk = |(column, place): (&Column, &Place)| {
        let mut data = Struct::default();
        data.i32(1, physical_type(column.kind));
        data.list(2, I32, &[varint(zigzag(code::PLAIN)), varint(zigzag(code::RLE))]);
        data.list(3, BINARY, &[text(&column.name)]);
        data.i32(4, code::UNCOMPRESSED);
        data.i64(5, group.rows as i64);
        data.i64(6, place.bytes as i64);
        data.i64(7, place.bytes as i64);
        data.i64(9, place.offset as i64);
        let mut chunk = Struct::default();
        chunk.i64(2, place.offset as i64);
        chunk.nested(3, data);
        chunk.end()
    };
    let chunks: Vec<Vec<u8>> = columns.iter().zip(&group.columns).map(chunk).collect();
    let mut row_group = Struct::default();
    row_group.list(1, STRUCT, &chunks);
    row_group.i64(2, group.columns.iter().map(|place| place.bytes as i64).sum());
    row_group.i64(3, group.rows as i64);
    row_group.end()
}

/// Types of Thrift's compact protocol.
const I32: u8 = 5;
const I64: u8 = 6;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const STRUCT: u8 = 12;

/// A Thrift structure, whose fields must be given in the order of their numbers.
#[derive(Default)]
struct Struct {
    bytes: Vec<u8>,
    last_field: u8,
}

impl Struct {
    fn field(&mut self, number: u8, kind: u8) {
        // Field numbers here are never more than 15 apart.
        self.bytes.push((number - self.last_field) << 4 | kind);
        self.last_field = number;
    }

    fn i32(&mut self, number: u8, value: i64) {
        self.field(number, I32);
        push_varint(&mut self.bytes, zigzag(value));
    }

    fn i64(&mut self, number: u8, value: i64) {
        self.field(number, I64);
        push_varint(&mut self.bytes, zigzag(value));
    }

    fn text(&mut self, number: u8, value: &str) {
        self.field(number, BINARY);
        self.bytes.extend(text(value));
    }

    fn nested(&mut self, number: u8, value: Struct) {
        self.field(number, STRUCT);
        self.bytes.extend(value.end());
    }

    fn list(&mut self, number: u8, kind: u8, elements: &[Vec<u8>]) {
        self.field(number, LIST);
        if elements.len() < 15 {
            self.bytes.push((elements.len() as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            push_varint(&mut self.bytes, elements.len() as u64);
        }
        elements.iter().for_each(|element| self.bytes.extend(element));
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

fn text(value: &str) -> Vec<u8> {
    let mut bytes = varint(value.len() as u64);
    bytes.extend(value.as_bytes());
    bytes
}

fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

fn varint(value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    push_varint(&mut bytes, value);
    bytes
}

fn push_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Worked out by hand from the two specifications.
    #[test]
    fn a_page_is_its_header_levels_and_values() {
        let columns = [Column { name: "t".to_owned(), kind: Kind::Time }];
        let mut bytes = Vec::new();
        let mut writer = ParquetWriter::new(&mut bytes, &columns).unwrap();
        for value in [Some(1), None, None] {
            writer.row(&[Cell::Time(value)]).unwrap();
        }
        writer.finish().unwrap();
        // Type 0, 16 bytes twice (zigzag 32), 3 values (6), plain, levels as runs (zigzag 6).
        let header = [0x15, 0, 0x15, 32, 0x15, 32, 0x2c, 0x15, 6, 0x15, 0, 0x15, 6, 0x15, 6, 0, 0];
        let levels = [4, 0, 0, 0, 2, 1, 4, 0];
        let expected = [MAGIC, &header, &levels, &1_u64.to_le_bytes()].concat();
        assert_eq!(bytes[..expected.len()], expected);
        let end = bytes.len() - 8;
        let footer = u32::from_le_bytes(bytes[end..end + 4].try_into().unwrap()) as usize;
        assert_eq!(expected.len() + footer, end);
        assert_eq!(&bytes[end + 4..], MAGIC);
    }
}
