//! What instruments write down and send. Of files, one module per format turns bytes into a [`FrameTable`], chosen by
//! name or by looking at the content; of live instruments, one module each ([`wire`], [`lines`], [`floats`]) makes
//! frames of a stream of bytes.

mod arrays;
pub mod columns;
mod content;
pub mod csv;
pub mod floats;
pub mod golfball;
pub mod ktc;
pub mod lines;
pub mod log;
pub mod mat;
pub mod npy;
pub mod npz;
mod number_line;
#[cfg(feature = "parquet")]
pub mod parquet;
pub mod pyeidors;
pub mod sciospec;
mod text;
mod times;
pub mod wire;
#[cfg(feature = "excel")]
pub mod xlsx;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use self::content::{NPY_MAGIC, PARQUET_MAGIC, ZIP_MAGIC};
use crate::{DeviceError, FileSpec, FrameTable, ReadOptions};
pub use content::{MOST_BYTES, open_regular, read_bytes};
pub(crate) use content::{foreign, text_of};
pub use times::mend as mend_times;

/// The entry by which a ZIP archive is known for a workbook of Excel.
const WORKBOOK: &str = "xl/workbook.xml";

/// A file format of frames.
///
/// ```
/// use dermis_device::Format;
///
/// assert_eq!("sciospec".parse::<Format>()?, Format::Sciospec);
/// let message = "toml".parse::<Format>().unwrap_err().to_string();
/// assert_eq!(message, "'toml': expected one of csv, lines, columns, npy, npz, mat, xlsx, parquet, sciospec, ktc, golfball, \
///     pyeidors");
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text, one frame a row: [`csv`].
    Csv,
    /// Text whose lines hold the numbers of a frame among labels, times and brackets: [`log`].
    Lines,
    /// Text, one frame a column under a row of names: [`columns`].
    Columns,
    /// NumPy array, one frame a row: [`npy`].
    Npy,
    /// Archive of NumPy arrays, of which one holds the frames: [`npz`].
    Npz,
    /// MATLAB file of arrays, of which one holds the frames: [`mat`].
    Mat,
    /// Excel workbook, of which one sheet holds the frames; with the feature `excel`.
    Xlsx,
    /// Parquet file, one frame a row; with the feature `parquet`.
    Parquet,
    /// Sciospec `.eit`, one frame a file: [`sciospec`].
    Sciospec,
    /// Columns of the Kuopio Tomography Challenge's 2356 readings: [`ktc`].
    Ktc,
    /// Columns of 16 x 16 magnitudes: [`golfball`].
    Golfball,
    /// A reference and a target frame as four columns of complex parts: [`pyeidors`].
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

    /// The name by which users choose it.
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

    /// Recognises a format by a file's whole content; a directory is recognised with empty content.
    ///
    /// Text with numbers is told apart by its shape: a header that starts with `ref`, `reference` or `baseline` is
    /// golfball over 256 rows, ktc over 2356, and columns otherwise; four columns without a header and n(n-3) rows for an
    /// electrode count n that look like two frames are pyeidors; numbers behind labels or in brackets are lines; all else
    /// is csv.
    ///
    /// # Errors
    /// [`DeviceError::Foreign`] saying what the content looks like.
    pub fn detect(path: &Path, content: &[u8]) -> Result<Self, DeviceError> {
        Self::detect_with(path, content, &ReadOptions::default())
    }

    fn detect_with(path: &Path, content: &[u8], options: &ReadOptions) -> Result<Self, DeviceError> {
        if path.is_dir() || sciospec::looks_like(path, content) {
            return Ok(Self::Sciospec);
        }
        if content.starts_with(NPY_MAGIC) {
            return Ok(Self::Npy);
        }
        if content.starts_with(ZIP_MAGIC) && npz::looks_like(content) {
            return Ok(Self::Npz);
        }
        if content.starts_with(ZIP_MAGIC) && npz::holds(content, WORKBOOK) {
            return Ok(Self::Xlsx);
        }
        if mat::looks_like(content) {
            return Ok(Self::Mat);
        }
        if content.starts_with(PARQUET_MAGIC) {
            return Ok(Self::Parquet);
        }
        let Some(shape) = csv::Shape::with(content, path, options)? else { return Ok(Self::Lines) };
        let is_frame = options.channels.contains(&shape.columns);
        if is_frame || options.skip_rows > 0 {
            Ok(Self::Csv)
        } else if ktc::looks_like(&shape) {
            Ok(Self::Ktc)
        } else if golfball::looks_like(&shape) {
            Ok(Self::Golfball)
        } else if columns::looks_like(&shape) {
            Ok(Self::Columns)
        } else if pyeidors::looks_like(&shape)
            && csv::parse(content, path).is_ok_and(|table| pyeidors::holds_two_frames(&table))
        {
            Ok(Self::Pyeidors)
        } else {
            Ok(Self::Csv)
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

/// Reads the frames that `spec` names, as the options say: a [`ReadOptions`], or just a format or `None`.
///
/// Where a table with a header of names is read and `spec` chooses frames by name, its frames are taken to be columns.
///
/// # Errors
/// Any [`DeviceError`]; the message names the file and the place in it.
pub fn read(spec: &FileSpec, options: impl Into<ReadOptions>) -> Result<FrameTable, DeviceError> {
    let (path, options): (&Path, ReadOptions) = (&spec.path, options.into());
    if path.is_dir() {
        return match options.format {
            None | Some(Format::Sciospec) => sciospec::read_directory_with(path, &options)?.select(&spec.select),
            Some(_) => Err(DeviceError::Foreign {
                file: path.to_owned(),
                expected: "a file",
                found: "a directory, which only the sciospec format reads".to_owned(),
            }),
        };
    }
    if matches!(options.format, None | Some(Format::Npy)) && npy::is_npy(path) {
        return npy::read_frames(path, &options)?.select(&spec.select);
    }
    if matches!(options.format, None | Some(Format::Npz)) && npz::is_npz(path) {
        return npz::read_frames(path, &options)?.select(&spec.select);
    }
    if matches!(options.format, None | Some(Format::Mat)) && mat::is_mat(path) {
        return mat::read_frames(path, &options)?.select(&spec.select);
    }
    #[cfg(feature = "parquet")]
    if matches!(options.format, None | Some(Format::Parquet)) && parquet::is_parquet(path) {
        return parquet::read_frames(path, &options)?.select(&spec.select);
    }
    let content = read_bytes(path)?;
    let format = match options.format {
        Some(format) => format,
        None => match Format::detect_with(path, &content, &options)? {
            Format::Csv if spec.select.names_frames() => Format::Columns,
            detected => detected,
        },
    };
    decode_with(format, &content, path, &options)?.select(&spec.select)
}

/// Decodes the content of one file; `file` is for messages (and for Sciospec's frame number).
///
/// # Errors
/// Any [`DeviceError`] but [`DeviceError::Io`].
pub fn decode(format: Format, content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(format, content, file, &ReadOptions::default())
}

/// As [`decode`], as the options say.
///
/// # Errors
/// As [`decode`].
pub fn decode_with(
    format: Format,
    content: &[u8],
    file: &Path,
    options: &ReadOptions,
) -> Result<FrameTable, DeviceError> {
    match format {
        Format::Csv if options.transpose => columns::decode_with(content, file, options),
        Format::Csv => csv::decode_with(content, file, options),
        Format::Lines => log::decode_with(content, file, options),
        Format::Columns => columns::decode_with(content, file, options),
        Format::Npy => npy::decode(content, file)?.into_frames_with(file, options),
        Format::Npz => npz::decode_with(content, file, options),
        Format::Mat => mat::decode_with(content, file, options),
        #[cfg(feature = "excel")]
        Format::Xlsx => xlsx::decode_with(content, file, options),
        #[cfg(not(feature = "excel"))]
        Format::Xlsx => Err(foreign(file, "another format: this dermis was built without Excel", content)),
        #[cfg(feature = "parquet")]
        Format::Parquet => parquet::decode_with(content, file, options),
        #[cfg(not(feature = "parquet"))]
        Format::Parquet => Err(foreign(file, "another format: this dermis was built without Parquet", content)),
        Format::Sciospec => sciospec::decode_with(content, file, options),
        Format::Ktc => ktc::decode(content, file),
        Format::Golfball => golfball::decode(content, file),
        Format::Pyeidors => pyeidors::decode(content, file),
    }
}
