//! Formats of tables, and the writers that make them.

use std::io::{self, Write};
use std::path::Path;
use std::str::FromStr;

use super::parquet::ParquetWriter;
use super::rows::{Column, CsvWriter, RowWriter};
use crate::Damage;

/// Format of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableFormat {
    /// Comma-separated text with a header line.
    Csv,
    /// The readings of frames only: frames x channels of 8-byte floats, or, for complex instruments, frames x 2 x
    /// channels with real parts before imaginary ones.
    Npy,
    /// Apache Parquet with typed columns, uncompressed.
    Parquet,
}

impl TableFormat {
    /// The format that a file name ends in; CSV for any other ending.
    pub fn of_name(path: &Path) -> Self {
        let ends_in = |ending: &str| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(ending));
        match () {
            () if ends_in("npy") => Self::Npy,
            () if ends_in("parquet") => Self::Parquet,
            () => Self::Csv,
        }
    }
}

impl FromStr for TableFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "csv" => Ok(Self::Csv),
            "npy" => Ok(Self::Npy),
            "parquet" => Ok(Self::Parquet),
            _ => Err("expected csv, npy or parquet".to_owned()),
        }
    }
}

/// Summary of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exported {
    /// Number of rows.
    pub rows: u64,
    /// Number of columns; for an array, values per row.
    pub columns: usize,
    /// Parts of the recording that could not be read.
    pub damage: Damage,
}

/// Writer of a table; arrays have their own.
pub(super) fn row_writer<'a>(
    out: impl Write + 'a,
    columns: &'a [Column],
    format: TableFormat,
) -> io::Result<Box<dyn RowWriter + 'a>> {
    Ok(match format {
        TableFormat::Parquet => Box::new(ParquetWriter::new(out, columns)?),
        TableFormat::Csv | TableFormat::Npy => Box::new(CsvWriter::new(out, columns)?),
    })
}
