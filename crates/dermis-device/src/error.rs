//! What can go wrong between an instrument and a frame. Every variant names the file (or text), the place in it, what
//! stood there and what was expected, so that the message alone is enough to mend the input.

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
        /// What was attempted, as a verb phrase.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
    },
    /// The file is of another kind than the reader's.
    #[error("{}: expected {expected}, found {found}", file.display())]
    Foreign {
        /// File concerned.
        file: PathBuf,
        /// What the reader reads.
        expected: &'static str,
        /// What the content looks like.
        found: String,
    },
    /// The file ends before its own header says it should, or goes on after it.
    #[error("{}: expected {expected} bytes of {what}, found {found}", file.display())]
    Length {
        /// File concerned.
        file: PathBuf,
        /// Part of the file that is too short or too long.
        what: &'static str,
        /// Bytes announced.
        expected: u64,
        /// Bytes present.
        found: u64,
    },
    /// A line has another number of cells than the first.
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
    /// A line has more cells than any frame.
    #[error("{}:{line}: expected at most {limit} values in a line, found {found}", file.display())]
    Wide {
        /// File concerned.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Most cells.
        limit: usize,
        /// Cells in this line.
        found: usize,
    },
    /// A cell is no number, or is infinite.
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
        /// What the reader needs there.
        expected: &'static str,
    },
    /// A named field of a header has an unusable value.
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
        /// What the reader needs there.
        expected: String,
    },
    /// A source that was running can yield no further frame.
    #[error("{name}: {reason}")]
    SourceFailed {
        /// Name of the source.
        name: String,
        /// What happened.
        reason: String,
    },
    /// A device did not do what it was asked.
    #[error("{order}: {reason}")]
    Refused {
        /// What was asked.
        order: String,
        /// Why it was not done.
        reason: String,
    },
    /// A number of things (rows, channels, frames) differs from what it must be.
    #[error("{}: expected {expected} {what}, found {found}", file.display())]
    Count {
        /// File concerned.
        file: PathBuf,
        /// What was counted.
        what: &'static str,
        /// Number needed.
        expected: usize,
        /// Number present.
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
    /// A table has as many rows as the skin has channels, and another number of columns.
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
    /// The file holds no frame.
    #[error("{}: expected at least one frame, found none", file.display())]
    Empty {
        /// File concerned.
        file: PathBuf,
    },
    /// The file is larger than the readers take.
    #[error("{}: expected at most {limit} bytes, found {found}", file.display())]
    TooLarge {
        /// File concerned.
        file: PathBuf,
        /// Most bytes read.
        limit: u64,
        /// Bytes present.
        found: u64,
    },
    /// A frame was asked for that the file does not have.
    #[error("{}: no single frame '{item}'; expected {available}", file.display())]
    Selection {
        /// File concerned.
        file: PathBuf,
        /// The item of the selection that could not be resolved.
        item: String,
        /// Frames that exist.
        available: String,
    },
    /// A recording is to be played at its own times but carries none, or a rate is unusable.
    #[error("{}: cannot play: expected {expected}, found {found}", file.display())]
    Pacing {
        /// File concerned.
        file: PathBuf,
        /// What playing needs.
        expected: &'static str,
        /// What there is.
        found: String,
    },
    /// Text that selects a source, a file or frames is malformed.
    #[error("'{text}': expected {expected}")]
    Selector {
        /// The text, shortened.
        text: String,
        /// What was expected, with an example.
        expected: String,
    },
}

impl DeviceError {
    /// Wraps an operating-system error with the file and the attempted action.
    pub(crate) fn io(file: &Path, action: &'static str, source: io::Error) -> Self {
        Self::Io { file: file.to_owned(), action, source }
    }

    /// The same of a part of its file, `book.xlsx, sheet Frames`.
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

    /// Shifts the column in the message: the table starts this many columns into the sheet.
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

/// Text made fit for a message: control characters escaped, at most 40 characters.
pub(crate) fn shorten(text: &str) -> String {
    const MOST: usize = 40;
    let mut short: String = text.chars().take(MOST).flat_map(char::escape_debug).collect();
    if text.chars().nth(MOST).is_some() {
        short.push_str("...");
    }
    short
}
