//! Errors between an instrument and a frame. Every variant names the file (or text), the place in it, what was found
//! and what was expected, so that the message alone is enough to fix the input.

use std::io;
use std::path::{Path, PathBuf};

/// Failure to read, select, decode or write frames.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The operating system refused an operation on a file.
    #[error("{}: cannot {action}: {source}", file.display())]
    Io {
        /// File or directory concerned.
        file: PathBuf,
        /// The attempted action, as a verb phrase.
        action: &'static str,
        /// The operating system's error.
        source: io::Error,
    },
    /// The file is not of the kind that the reader expects.
    #[error("{}: expected {expected}, found {found}", file.display())]
    Foreign {
        /// File concerned.
        file: PathBuf,
        /// Content that the reader accepts.
        expected: &'static str,
        /// Description of the content.
        found: String,
    },
    /// The file is shorter or longer than its header says.
    #[error("{}: expected {expected} bytes of {what}, found {found}", file.display())]
    Length {
        /// File concerned.
        file: PathBuf,
        /// The part of the file with the wrong length.
        what: &'static str,
        /// Number of bytes according to the header.
        expected: u64,
        /// Number of bytes present.
        found: u64,
    },
    /// A line has a different number of cells than the first one.
    #[error("{}:{line}: expected {expected} values as in the other rows, found {found}", file.display())]
    Ragged {
        /// File concerned.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Cells in the first row.
        expected: usize,
        /// Cells in this row.
        found: usize,
    },
    /// A line has more cells than any frame could have.
    #[error("{}:{line}: expected at most {limit} values in a line, found {found}", file.display())]
    Wide {
        /// File concerned.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Maximum number of cells in a line.
        limit: usize,
        /// Cells in this line.
        found: usize,
    },
    /// A cell is not a number, or is infinite.
    #[error("{}:{line}: column {column}: expected {expected}, found '{found}'", file.display())]
    Cell {
        /// File concerned.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// The cell's text, shortened.
        found: String,
        /// Content that the reader expects in this cell.
        expected: &'static str,
    },
    /// A named header field has an unusable value.
    #[error("{}:{line}: {field}: expected {expected}, found '{found}'", file.display())]
    Field {
        /// File concerned.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Name of the field.
        field: &'static str,
        /// The field's text, shortened.
        found: String,
        /// Value that the reader expects in this field.
        expected: String,
    },
    /// A running source can't deliver any more frames.
    #[error("{name}: {reason}")]
    SourceFailed {
        /// Name of the source.
        name: String,
        /// Reason for the failure.
        reason: String,
    },
    /// A device didn't carry out an order.
    #[error("{order}: {reason}")]
    Refused {
        /// The order.
        order: String,
        /// Reason for the refusal.
        reason: String,
    },
    /// The number of rows, channels, frames or the like is wrong.
    #[error("{}: expected {expected} {what}, found {found}", file.display())]
    Count {
        /// File concerned.
        file: PathBuf,
        /// The items that were counted.
        what: &'static str,
        /// Expected number.
        expected: usize,
        /// Actual number.
        found: usize,
    },
    /// A value in a table of frames is infinite.
    #[error("{}: frame {frame}, channel {channel}: expected a finite value or NaN, found {found}", file.display())]
    Infinite {
        /// File concerned.
        file: PathBuf,
        /// Frame index, from 0.
        frame: usize,
        /// Channel index, from 0.
        channel: usize,
        /// The value.
        found: f64,
    },
    /// A table's row count, but not its column count, equals the skin's number of channels.
    #[error(
        "{}: {frames} frames of {channels} readings, and the skin has {frames} channels: transposed? --transpose \
         (transpose=True in Python) reads frames from columns",
        file.display()
    )]
    Transposed {
        /// File concerned.
        file: PathBuf,
        /// Rows.
        frames: usize,
        /// Columns.
        channels: usize,
    },
    /// The file contains no frames.
    #[error("{}: expected at least one frame, found none", file.display())]
    Empty {
        /// File concerned.
        file: PathBuf,
    },
    /// The file is too large to read.
    #[error("{}: expected at most {limit} bytes, found {found}", file.display())]
    TooLarge {
        /// File concerned.
        file: PathBuf,
        /// Maximum number of bytes.
        limit: u64,
        /// Size of the file in bytes.
        found: u64,
    },
    /// The selection asks for a frame that the file doesn't have.
    #[error("{}: no single frame '{item}'; expected {available}", file.display())]
    Selection {
        /// File concerned.
        file: PathBuf,
        /// The item of the selection that could not be resolved.
        item: String,
        /// Frames that exist.
        available: String,
    },
    /// A recording without times can't be played at its recorded pace, or the rate is unusable.
    #[error("{}: cannot play: expected {expected}, found {found}", file.display())]
    Pacing {
        /// File concerned.
        file: PathBuf,
        /// Requirement for playback.
        expected: &'static str,
        /// Actual times or rate.
        found: String,
    },
    /// The text of a source, file or frame selection is malformed.
    #[error("'{text}': expected {expected}")]
    Selector {
        /// The text, shortened.
        text: String,
        /// Expected form, with an example.
        expected: String,
    },
}

impl DeviceError {
    /// Wraps an operating-system error with the file and the attempted action.
    pub(crate) fn io(file: &Path, action: &'static str, source: io::Error) -> Self {
        Self::Io { file: file.to_owned(), action, source }
    }

    /// Adds the name of a part to the file in the message: `book.xlsx, sheet Frames`.
    pub(crate) fn in_part(mut self, part: &str) -> Self {
        if let Self::Foreign { file, .. }
        | Self::Length { file, .. }
        | Self::Ragged { file, .. }
        | Self::Wide { file, .. }
        | Self::Cell { file, .. }
        | Self::Field { file, .. }
        | Self::Count { file, .. }
        | Self::Infinite { file, .. }
        | Self::Transposed { file, .. }
        | Self::Empty { file } = &mut self
        {
            file.as_mut_os_string().push(format!(", {part}"));
        }
        self
    }

    /// Shifts the column in the message, for a table that starts this many columns into the sheet.
    pub(crate) fn behind_columns(mut self, columns: usize) -> Self {
        if let Self::Cell { column, .. } = &mut self {
            *column += columns;
        }
        self
    }

    /// A malformed selector text.
    pub(crate) fn selector(text: &str, expected: impl Into<String>) -> Self {
        Self::Selector { text: shorten(text), expected: expected.into() }
    }

    /// A malformed header field.
    pub(crate) fn field(
        file: &Path,
        line: usize,
        field: &'static str,
        found: &str,
        expected: impl Into<String>,
    ) -> Self {
        Self::Field { file: file.to_owned(), line, field, found: shorten(found), expected: expected.into() }
    }
}

/// Shortens text to 40 characters for a message and escapes control characters.
pub(crate) fn shorten(text: &str) -> String {
    const MOST: usize = 40;
    let mut short: String = text.chars().take(MOST).flat_map(char::escape_debug).collect();
    if text.chars().nth(MOST).is_some() {
        short.push_str("...");
    }
    short
}
