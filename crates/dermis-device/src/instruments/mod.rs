//! What instruments write down and send. Of files, one module per format turns bytes into a [`FrameTable`], chosen by
//! name or by looking at the content; of live instruments, one module each ([`wire`], [`lines`], [`floats`]) makes
//! frames of a stream of bytes.

pub mod columns;
mod content;
pub mod csv;
pub mod floats;
pub mod golfball;
pub mod ktc;
pub mod lines;
pub mod npy;
pub mod pyeidors;
pub mod sciospec;
pub mod wire;

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use self::content::NPY_MAGIC;
use crate::{DeviceError, FileSpec, FrameTable};
pub use content::{MOST_BYTES, open_regular, read_bytes};
pub(crate) use content::{foreign, text_of};

/// A file format of frames.
///
/// ```
/// use dermis_device::Format;
///
/// assert_eq!("sciospec".parse::<Format>()?, Format::Sciospec);
/// let message = "xlsx".parse::<Format>().unwrap_err().to_string();
/// assert_eq!(message, "'xlsx': expected one of csv, columns, npy, sciospec, ktc, golfball, pyeidors");
/// # Ok::<(), dermis_device::DeviceError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text, one frame a row: [`csv`].
    Csv,
    /// Text, one frame a column under a row of names: [`columns`].
    Columns,
    /// NumPy array, one frame a row: [`npy`].
    Npy,
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
    pub const ALL: [Self; 7] =
        [Self::Csv, Self::Columns, Self::Npy, Self::Sciospec, Self::Ktc, Self::Golfball, Self::Pyeidors];

    /// The name by which users choose it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Columns => "columns",
            Self::Npy => "npy",
            Self::Sciospec => "sciospec",
            Self::Ktc => "ktc",
            Self::Golfball => "golfball",
            Self::Pyeidors => "pyeidors",
        }
    }

    /// Recognises a format by a file's whole content; a directory is recognised with empty content.
    ///
    /// Text with numbers is told apart by its shape: a head of names over 256 or 2356 rows is golfball or ktc; a head
    /// that starts with `ref`, `reference` or `baseline` is columns; four columns without a head and n(n-3) rows for an
    /// electrode count n are pyeidors; all else is csv.
    ///
    /// # Errors
    /// [`DeviceError::Foreign`] saying what the content looks like.
    pub fn detect(path: &Path, content: &[u8]) -> Result<Self, DeviceError> {
        if path.is_dir() || sciospec::looks_like(path, content) {
            return Ok(Self::Sciospec);
        }
        if content.starts_with(NPY_MAGIC) {
            return Ok(Self::Npy);
        }
        let shape = csv::Shape::of(content, path)?;
        if ktc::looks_like(&shape) {
            Ok(Self::Ktc)
        } else if golfball::looks_like(&shape) {
            Ok(Self::Golfball)
        } else if columns::looks_like(&shape) {
            Ok(Self::Columns)
        } else if pyeidors::looks_like(&shape) {
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

/// Reads the frames that `spec` names, in the given format or the one recognised.
///
/// Where a table with a head of names is read and `spec` chooses frames by name, its frames are taken to be columns.
///
/// # Errors
/// Any [`DeviceError`]; the message names the file and the place in it.
pub fn read(spec: &FileSpec, format: Option<Format>) -> Result<FrameTable, DeviceError> {
    let path = spec.path.as_path();
    if path.is_dir() {
        return match format {
            None | Some(Format::Sciospec) => sciospec::read_directory(path)?.select(&spec.select),
            Some(_) => Err(DeviceError::Foreign {
                file: path.to_owned(),
                expected: "a file",
                found: "a directory, which only the sciospec format reads".to_owned(),
            }),
        };
    }
    let content = read_bytes(path)?;
    let format = match format {
        Some(format) => format,
        None => match Format::detect(path, &content)? {
            Format::Csv if spec.select.names_frames() => Format::Columns,
            detected => detected,
        },
    };
    decode(format, &content, path)?.select(&spec.select)
}

/// Decodes the content of one file; `file` is for messages (and for Sciospec's frame number).
///
/// # Errors
/// Any [`DeviceError`] but [`DeviceError::Io`].
pub fn decode(format: Format, content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    match format {
        Format::Csv => csv::decode(content, file),
        Format::Columns => columns::decode(content, file),
        Format::Npy => npy::decode(content, file)?.into_frames(file),
        Format::Sciospec => sciospec::decode(content, file),
        Format::Ktc => ktc::decode(content, file),
        Format::Golfball => golfball::decode(content, file),
        Format::Pyeidors => pyeidors::decode(content, file),
    }
}
