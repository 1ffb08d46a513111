//! Options for reading a file of frames when detection isn't enough.

use crate::{Format, FrameSelect};

/// Options for reading a file of frames. By default everything is detected.
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
    /// The format; detected if `None`.
    pub format: Option<Format>,
    /// Columns of a table that hold readings: names, indices from 0, half-open ranges.
    pub columns: FrameSelect,
    /// Number of lines to skip at the start of a text.
    pub skip_rows: usize,
    /// Name of an array in an archive (npz, mat), of a sheet in a workbook, or of a topic in a bag.
    pub array: Option<String>,
    /// Read frames from columns.
    pub transpose: bool,
    /// Possible numbers of readings in a frame, with the skin's channels first; empty if there is no skin. They
    /// resolve ambiguities (frames wrapped over rows, a column that counts, real and imaginary parts), and reveal
    /// transposed files.
    pub channels: Vec<usize>,
    /// Frequency of a sweep in hertz, or two frequencies to subtract.
    pub frequencies_hz: Frequencies,
}

/// Frequency of a sweep to read.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Frequencies {
    /// The only one.
    #[default]
    Only,
    /// The one closest to this value, within 1 %.
    One(f64),
    /// Readings at the first frequency minus those at the second.
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
    /// Sets the possible numbers of readings in a frame.
    #[must_use]
    pub fn with_channels(self, channels: impl IntoIterator<Item = usize>) -> Self {
        Self { channels: channels.into_iter().collect(), ..self }
    }

    /// True if the number of rows fits a frame and the number of columns doesn't.
    pub(crate) fn looks_transposed(&self, rows: usize, columns: usize) -> bool {
        !self.transpose && self.channels.contains(&rows) && !self.channels.contains(&columns)
    }
}
