//! Files of a data set: frames as CSV or NPY, and the presses behind them.

use std::io::Write;
use std::path::{Path, PathBuf};

use dermis_device::instruments::npy;
use dermis_twin::mechanics::Indenter;

use crate::Error;

/// Consecutive frames, with their imaginary parts if they have any.
#[derive(Default)]
pub(super) struct Rows {
    pub values: Vec<f64>,
    pub imaginary: Vec<f64>,
}

#[derive(Clone, Copy)]
pub(super) enum Format {
    Csv,
    Npy,
}

impl Format {
    pub fn of(path: &Path) -> Result<Self, UnknownFormat> {
        match path.extension().and_then(|extension| extension.to_str()).map(str::to_lowercase).as_deref() {
            Some("csv") => Ok(Self::Csv),
            Some("npy") => Ok(Self::Npy),
            _ => Err(UnknownFormat(path.to_path_buf())),
        }
    }

    pub fn write(self, path: &Path, channels: usize, rows: &Rows, complex: bool) -> Result<(), Error> {
        match (self, complex) {
            (Self::Npy, false) => npy::write_f64(path, &[rows.values.len() / channels, channels], &rows.values)?,
            (Self::Npy, true) => {
                return Err(Error::Live(dermis_live::Error::Frames {
                    what: path.display().to_string(),
                    expected: "a name that ends in .csv: readings of this skin are complex".into(),
                    got: ".npy".into(),
                }));
            }
            (Self::Csv, _) => dermis_device::write_atomic(path, |out| write_csv(out, channels, rows, complex))?,
        }
        Ok(())
    }
}

/// A file whose name doesn't tell its format.
#[derive(Clone, Debug)]
pub(super) struct UnknownFormat(PathBuf);

impl From<UnknownFormat> for Error {
    fn from(UnknownFormat(path): UnknownFormat) -> Self {
        let expected = "a name that ends in .csv or .npy".to_string();
        Error::Live(dermis_live::Error::Frames {
            what: "file of frames".into(),
            expected,
            got: path.display().to_string(),
        })
    }
}

/// Writes one row per frame, without header. Complex readings are written as real and imaginary part.
fn write_csv(out: &mut dyn Write, channels: usize, rows: &Rows, complex: bool) -> std::io::Result<()> {
    for (k, frame) in rows.values.chunks_exact(channels).enumerate() {
        for (channel, value) in frame.iter().enumerate() {
            let comma = if channel == 0 { "" } else { "," };
            if complex {
                let imaginary = rows.imaginary[k * channels + channel];
                let sign = if imaginary.is_sign_negative() { '-' } else { '+' };
                write!(out, "{comma}{value:e}{sign}{:e}j", imaginary.abs())?;
            } else {
                write!(out, "{comma}{value:e}")?;
            }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Writes one row per touch with its frame number from 0. If all presses are single, the file also serves as a
/// table of poke positions.
pub(super) fn write_truth(path: &Path, presses: &[Vec<Indenter>], repeats: usize) -> Result<(), Error> {
    dermis_device::write_atomic(path, |out| {
        writeln!(out, "frame,x_m,y_m,force_n,radius_m,pressure_pa")?;
        for (k, group) in presses.iter().enumerate() {
            for repeat in 0..repeats {
                for indenter in group {
                    let ([x, y], pressure_pa) = (indenter.centre_m, indenter.pressure_pa());
                    let (area, radius) = (indenter.shape.area_m2(), indenter.shape.equal_area_radius_m());
                    let frame = k * repeats + repeat;
                    writeln!(out, "{frame},{x},{y},{},{radius},{pressure_pa}", pressure_pa * area)?;
                }
            }
        }
        Ok(())
    })?;
    Ok(())
}
