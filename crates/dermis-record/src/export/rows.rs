//! Rows of typed cells, and the writer that turns them into CSV (RFC 4180: a cell with a comma, a quote or a line end
//! is quoted, and quotes in it are doubled).

use std::io::{self, Write};

/// Type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Count,
    /// Nanoseconds that may be absent.
    Time,
    Number,
    Text,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Column {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cell {
    Count(u64),
    Time(Option<u64>),
    Number(f64),
    Text(String),
}

/// Receives the rows of a table.
pub(super) trait RowWriter {
    /// Takes a row with one cell per column.
    fn row(&mut self, cells: &[Cell]) -> io::Result<()>;

    /// Writes whatever is left.
    fn finish(&mut self) -> io::Result<()>;
}

pub(super) struct CsvWriter<W> {
    out: W,
}

impl<W: Write> CsvWriter<W> {
    pub(super) fn new(mut out: W, columns: &[Column]) -> io::Result<Self> {
        let names: Vec<String> = columns.iter().map(|column| quoted(&column.name)).collect();
        writeln!(out, "{}", names.join(","))?;
        Ok(Self { out })
    }
}

impl<W: Write> RowWriter for CsvWriter<W> {
    fn row(&mut self, cells: &[Cell]) -> io::Result<()> {
        for (index, cell) in cells.iter().enumerate() {
            if index > 0 {
                self.out.write_all(b",")?;
            }
            match cell {
                Cell::Count(value) | Cell::Time(Some(value)) => write!(self.out, "{value}")?,
                Cell::Time(None) => {}
                Cell::Number(value) => write!(self.out, "{value}")?,
                Cell::Text(text) => self.out.write_all(quoted(text).as_bytes())?,
            }
        }
        self.out.write_all(b"\n")
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_need_it_are_quoted() {
        let column = |name: &str, kind| Column { name: name.to_owned(), kind };
        let columns = [column("n", Kind::Count), column("1-2, \"a\"", Kind::Number), column("t", Kind::Time)];
        let mut bytes = Vec::new();
        let mut writer = CsvWriter::new(&mut bytes, &columns).unwrap();
        writer.row(&[Cell::Count(1), Cell::Number(0.1), Cell::Time(None)]).unwrap();
        writer.row(&[Cell::Count(2), Cell::Number(f64::NAN), Cell::Time(Some(u64::MAX))]).unwrap();
        writer.finish().unwrap();
        let expected = "n,\"1-2, \"\"a\"\"\",t\n1,0.1,\n2,NaN,18446744073709551615\n";
        assert_eq!(String::from_utf8(bytes).unwrap(), expected);
    }
}
