//! How a file of frames is read, where guessing is not enough.

use crate::{Format, FrameSelect};

/// How a file of frames is read. The default guesses everything.
///
/// ```
/// use dermis_device::{Format, FrameSelect, ReadOptions, decode_with};
///
/// let text = b"made by a logger\nt;a;b;temperature\n0;1,5;2,5;21\n1;1,6;2,6;21\n";
/// let columns: FrameSelect = "a,b".parse()?;
/// let table = decode_with(Format::Csv, text, "log.csv".as_ref(), &ReadOptions { columns, ..ReadOptions::default() })?;
/// assert_eq!(table.row(0), Some([1.5, 2.5].as_slice()));
/// assert!(table.understood().contains("decimal commas"));
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ReadOptions {
    /// The format; recognised where `None`.
    pub format: Option<Format>,
    /// Columns of a table that hold readings: names, indices from 0, half-open ranges.
    pub columns: FrameSelect,
    /// Lines at the beginning of a text that are passed over.
    pub skip_rows: usize,
    /// Array of an archive (npz, mat), sheet of a workbook, or topic of a bag.
    pub array: Option<String>,
    /// Frames stand in columns.
    pub transpose: bool,
    /// Readings that a frame may have, the skin's channels first; empty where there is no skin. They settle what a file
    /// leaves open (frames wrapped over rows, a column that counts, real and imaginary parts), and let a transposed
    /// file be noticed.
    pub channels: Vec<usize>,
    /// Frequency of a sweep in hertz, or two, whose difference is taken.
    pub frequencies_hz: Frequencies,
}

/// Which frequency of a sweep is read.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Frequencies {
    /// The only one.
    #[default]
    Only,
    /// The one nearest to this, within 1 %.
    One(f64),
    /// Readings at the first less those at the second.
    Difference(f64, f64),
}

// Frequencies come from text and are never NaN.
impl Eq for Frequencies {}

impl From<Option<Format>> for ReadOptions {
    fn from(format: Option<Format>) -> Self {
        Self { format, ..Self::default() }
    }
}

impl ReadOptions {
    /// The same for frames of a skin that may have so many readings.
    #[must_use]
    pub fn with_channels(self, channels: impl IntoIterator<Item = usize>) -> Self {
        Self { channels: channels.into_iter().collect(), ..self }
    }

    /// Rows are as many as a frame should have readings, and columns are not.
    pub(crate) fn looks_transposed(&self, rows: usize, columns: usize) -> bool {
        !self.transpose && self.channels.contains(&rows) && !self.channels.contains(&columns)
    }
}
