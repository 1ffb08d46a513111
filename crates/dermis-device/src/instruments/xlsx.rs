//! Excel workbooks (`.xlsx`, `.xlsm`). A sheet is read like a text table ([`super::csv`]), with the same headers,
//! times, units and messages. Cell formats identify dates and times of day. Formulas have the value that was last
//! calculated. Line numbers in messages are rows of the sheet.

use std::fmt::Write as _;
use std::io::Cursor;
use std::path::Path;

use calamine::{CellErrorType, DataRef, Reader, Xlsx, XlsxError};
use zip::ZipArchive;

use super::arrays::{self, Named};
use super::content::MOST_BYTES;
use super::{columns, csv};
use crate::error::shorten;
use crate::{DeviceError, FrameTable, ReadOptions};

const EXPECTED: &str = "an Excel workbook (xlsx)";
/// Maximum number of sheets to inspect.
const MOST_SHEETS: usize = 100;

type Book<'a> = Xlsx<Cursor<&'a [u8]>>;

/// Decodes frames from the only sheet that can hold them.
///
/// # Errors
/// [`DeviceError::Foreign`] if it isn't such a workbook, [`DeviceError::Field`] if no sheet or several could hold
/// frames, and the errors of [`super::csv`] with the sheet's name.
pub fn decode(content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(content, file, &ReadOptions::default())
}

pub(super) fn decode_with(content: &[u8], file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let broken =
        |found: String| DeviceError::Foreign { file: file.to_owned(), expected: EXPECTED, found: shorten(&found) };
    // Sheets and strings are unpacked in memory.
    let archive = ZipArchive::new(Cursor::new(content)).map_err(|error| broken(error.to_string()))?;
    let unpacked = archive.decompressed_size().unwrap_or(u128::MAX).min(u64::MAX.into()) as u64;
    if unpacked > MOST_BYTES {
        return Err(DeviceError::TooLarge { file: file.to_owned(), limit: MOST_BYTES, found: unpacked });
    }
    let mut book: Book = Xlsx::new(Cursor::new(content)).map_err(|error| broken(error.to_string()))?;
    let names = book.sheet_names();
    if names.len() > MOST_SHEETS {
        return Err(broken(format!("{} sheets", names.len())));
    }
    if let Some(wanted) = &options.array
        && !names.contains(wanted)
    {
        let expected = format!("one of {}", names.iter().map(|name| shorten(name)).collect::<Vec<_>>().join(", "));
        return Err(DeviceError::field(file, 1, "--array", wanted, expected));
    }
    let (mut tables, mut refused) = (Vec::new(), None);
    for name in names.iter().filter(|name| options.array.as_ref().is_none_or(|wanted| wanted == *name)) {
        let text = match sheet_text(&mut book, name, file) {
            Ok(text) => text,
            Err(Unreadable::Chart) => continue,
            Err(Unreadable::Broken(error)) => return Err(broken(error.to_string())),
            Err(Unreadable::Cell(error)) => {
                refused = refused.or(Some(error.in_part(&format!("sheet {}", shorten(name)))));
                continue;
            }
        };
        let frames = match options.transpose {
            true => columns::decode_with(text.text.as_bytes(), file, options),
            false => csv::decode_with(text.text.as_bytes(), file, options),
        };
        match frames {
            Ok(frames) => tables.push((name, frames)),
            // Empty sheets and notes aren't tables.
            Err(DeviceError::Empty { .. }) => {}
            Err(error) => {
                let error = error.behind_columns(text.first_column).in_part(&format!("sheet {}", shorten(name)));
                refused = refused.or(Some(error));
            }
        }
    }
    let shapes: Vec<Named> = tables
        .iter()
        .map(|(name, frames)| Named { name: (*name).clone(), shape: vec![frames.frames(), frames.channels()] })
        .collect();
    let of_skin = |shape: &Named| options.channels.contains(&shape.shape[1]);
    if let Some(error) = refused
        && !shapes.iter().any(of_skin)
    {
        return Err(error);
    }
    if shapes.is_empty() {
        return Err(DeviceError::Empty { file: file.to_owned() });
    }
    let chosen = arrays::choose(&shapes, file, options)?;
    let (name, frames) = tables.swap_remove(chosen);
    Ok(frames.with_notes(vec![format!("sheet `{}`", shorten(name))]))
}

/// Reason why a sheet yields no text.
enum Unreadable {
    /// It isn't a worksheet.
    Chart,
    Broken(XlsxError),
    Cell(DeviceError),
}

impl From<XlsxError> for Unreadable {
    fn from(error: XlsxError) -> Self {
        match error {
            XlsxError::NotAWorksheet(_) => Self::Chart,
            other => Self::Broken(other),
        }
    }
}

/// A sheet as text: one line per row, tabs between cells, starting at the first column in use.
struct SheetText {
    text: String,
    first_column: usize,
}

fn sheet_text(book: &mut Book, name: &str, file: &Path) -> Result<SheetText, Unreadable> {
    let mut cells = book.worksheet_cells_reader(name)?;
    // The first column in use is only known at the end. The tabs before it are removed then.
    let (mut text, mut row, mut column, mut first_column) = (String::new(), 0_u32, 0_u32, u32::MAX);
    while let Some(cell) = cells.next_cell_with_formula_metadata()? {
        let (to_row, to_column) = cell.pos;
        let mut found = String::new();
        let place = |found: &str, expected| DeviceError::Cell {
            file: file.to_owned(),
            line: to_row as usize + 1,
            column: to_column as usize + 1,
            found: shorten(found),
            expected,
        };
        match (&cell.value, cell.formula) {
            (DataRef::Empty, None) => continue,
            (DataRef::Empty, Some(_)) => {
                let expected = "a value: a formula that has not been calculated; open the file in Excel and save it";
                return Err(Unreadable::Cell(place("", expected)));
            }
            (DataRef::Error(CellErrorType::NA | CellErrorType::Null), _) => found.push_str("nan"),
            (DataRef::Error(error), _) => {
                return Err(Unreadable::Cell(place(&error.to_string(), "a number, or #N/A for a missing reading")));
            }
            (value, _) => write_value(&mut found, value),
        }
        let is_back = to_row < row || (to_row == row && to_column < column);
        let gap = u64::from(to_row.abs_diff(row)) + u64::from(to_column);
        if is_back || text.len() as u64 + gap > MOST_BYTES {
            return Err(Unreadable::Cell(place(&found, "cells from left to right and from the top, 1 GiB in all")));
        }
        for _ in row..to_row {
            text.push('\n');
            column = 0;
        }
        for _ in column..to_column {
            text.push('\t');
        }
        (row, column) = (to_row, to_column);
        if !found.is_empty() {
            first_column = first_column.min(to_column);
        }
        // Tabs and quotes in a cell would be taken for separators and quotes of the table.
        text.extend(found.chars().map(|c| if matches!(c, '\t' | '\n' | '\r' | '"') { ' ' } else { c }));
    }
    let first_column = if first_column == u32::MAX { 0 } else { first_column as usize };
    if first_column > 0 {
        let before = "\t".repeat(first_column);
        text = text.split('\n').map(|line| line.strip_prefix(&before).unwrap_or(line)).collect::<Vec<_>>().join("\n");
    }
    Ok(SheetText { text, first_column })
}

fn write_value(out: &mut String, value: &DataRef) {
    // Writing to a string cannot fail.
    let _ = match value {
        DataRef::Int(value) => write!(out, "{value}"),
        // Write integers without an exponent: a header may count the columns.
        DataRef::Float(value) if value.fract() == 0.0 && value.abs() < 1e15 => write!(out, "{value}"),
        DataRef::Float(value) => write!(out, "{value:e}"),
        DataRef::String(text) | DataRef::DateTimeIso(text) | DataRef::DurationIso(text) => write!(out, "{text}"),
        DataRef::SharedString(text) => write!(out, "{text}"),
        DataRef::Bool(value) => write!(out, "{value}"),
        DataRef::DateTime(moment) => {
            let (year, month, day, hour, minute, second, milli) = moment.to_ymd_hms_milli();
            if moment.as_f64() >= 1.0 {
                let _ = write!(out, "{year:04}-{month:02}-{day:02} ");
            }
            write!(out, "{hour:02}:{minute:02}:{second:02}.{milli:03}")
        }
        DataRef::Error(_) | DataRef::Empty => Ok(()),
    };
}
