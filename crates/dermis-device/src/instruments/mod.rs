//! Formats of files and live instruments. For files, one module per format turns bytes into a [`FrameTable`]; the
//! format is given or recognised from the content. For live instruments, one module each ([`wire`], [`lines`],
//! [`floats`]) turns a byte stream into frames.

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
#[cfg_attr(target_family = "wasm", path = "npz_absent.rs")]
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

use std::path::Path;

use self::content::{NPY_MAGIC, PARQUET_MAGIC, ZIP_MAGIC};
use crate::{DeviceError, FileSpec, Format, FrameTable, ReadOptions};
pub use content::{MOST_BYTES, open_regular, read_bytes};
pub(crate) use content::{foreign, text_of};
pub use times::mend as mend_times;

/// The entry that marks a ZIP archive as an Excel workbook.
const WORKBOOK: &str = "xl/workbook.xml";

impl Format {
    /// Recognises a format from a file's whole content. For a directory, pass empty content.
    ///
    /// Text with numbers is recognised by its shape. With a header that starts with `ref`, `reference` or `baseline`,
    /// it is golfball if it has 256 rows, ktc with 2356, and columns otherwise. It is pyeidors if it has four columns,
    /// no header, n(n-3) rows for some electrode count n, and numbers that look like two frames. Numbers behind labels
    /// or in brackets are lines. All other text is csv.
    ///
    /// # Errors
    /// [`DeviceError::Foreign`] with a description of the content.
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

/// Reads the frames that `spec` selects. `options` are [`ReadOptions`], or just a format or `None`.
///
/// If `spec` selects frames by name and the table has a header of names, frames are read from columns.
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

/// Decodes one file's content; `file` is used in messages (and for Sciospec's frame number).
///
/// # Errors
/// Any [`DeviceError`] except [`DeviceError::Io`].
pub fn decode(format: Format, content: &[u8], file: &Path) -> Result<FrameTable, DeviceError> {
    decode_with(format, content, file, &ReadOptions::default())
}

/// As [`decode`], with options.
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
