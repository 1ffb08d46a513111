//! File formats for frames, with their names.

use std::fmt;
use std::str::FromStr;

use crate::DeviceError;

/// A file format of frames.
///
/// ```
/// use dermis_device::Format;
///
/// assert_eq!("sciospec".parse::<Format>()?, Format::Sciospec);
/// let message = "toml".parse::<Format>().unwrap_err().to_string();
/// let expected = "'toml': expected one of csv, lines, columns, npy, npz, mat, xlsx, parquet, sciospec, ktc, \
///     golfball, pyeidors";
/// assert_eq!(message, expected);
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text, one frame per row: [`csv`](crate::instruments::csv).
    Csv,
    /// Text lines with a frame's numbers among labels, times and brackets: [`log`](crate::instruments::log).
    Lines,
    /// Text, one frame per column below a row of names: [`columns`](crate::instruments::columns).
    Columns,
    /// NumPy array, one frame per row: [`npy`](crate::instruments::npy).
    Npy,
    /// Archive of NumPy arrays, with the frames in one of them: [`npz`](crate::instruments::npz).
    Npz,
    /// MATLAB file, with the frames in one of its arrays: [`mat`](crate::instruments::mat).
    Mat,
    /// Excel workbook, with the frames on one of its sheets; requires the feature `excel`.
    Xlsx,
    /// Parquet file, one frame per row; requires the feature `parquet`.
    Parquet,
    /// Sciospec `.eit`, one frame per file: [`sciospec`](crate::instruments::sciospec).
    Sciospec,
    /// Columns of the Kuopio Tomography Challenge's 2356 readings: [`ktc`](crate::instruments::ktc).
    Ktc,
    /// Columns of 16 x 16 magnitudes: [`golfball`](crate::instruments::golfball).
    Golfball,
    /// A reference and a target frame as four columns of complex parts: [`pyeidors`](crate::instruments::pyeidors).
    Pyeidors,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 12] = [
        Self::Csv,
        Self::Lines,
        Self::Columns,
        Self::Npy,
        Self::Npz,
        Self::Mat,
        Self::Xlsx,
        Self::Parquet,
        Self::Sciospec,
        Self::Ktc,
        Self::Golfball,
        Self::Pyeidors,
    ];

    /// The name that users type.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Lines => "lines",
            Self::Columns => "columns",
            Self::Npy => "npy",
            Self::Npz => "npz",
            Self::Mat => "mat",
            Self::Xlsx => "xlsx",
            Self::Parquet => "parquet",
            Self::Sciospec => "sciospec",
            Self::Ktc => "ktc",
            Self::Golfball => "golfball",
            Self::Pyeidors => "pyeidors",
        }
    }
}

impl FromStr for Format {
    type Err = DeviceError;

    fn from_str(text: &str) -> Result<Self, DeviceError> {
        Self::ALL
            .into_iter()
            .find(|format| format.name() == text)
            .ok_or_else(|| DeviceError::selector(text, format!("one of {}", Self::ALL.map(Self::name).join(", "))))
    }
}

impl fmt::Display for Format {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}
