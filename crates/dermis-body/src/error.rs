//! Errors of bodies, with file, line, value and expected value.

use std::path::PathBuf;

use dermis_skin::FileError;
use thiserror::Error;

/// Errors of bodies.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that could not be read.
    #[error(transparent)]
    Io(#[from] FileError),
    /// A body file that isn't TOML, or has unknown or missing keys; the message shows the place.
    #[error("{}: {message}", file.display())]
    BodyFile {
        /// The file.
        file: PathBuf,
        /// The fault, with line and column.
        message: String,
    },
    /// A key in a body file has an invalid value.
    #[error("{}, line {line}: {field} = {value}: expected {expected}", file.display())]
    BodyField {
        /// The file.
        file: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// Dotted name of the key.
        field: String,
        /// Its value.
        value: String,
        /// The expected value.
        expected: String,
    },
    /// A URDF file that doesn't describe a robot.
    #[error("{}, line {line}: {message}", file.display())]
    Urdf {
        /// The file.
        file: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// The fault, and the expected content.
        message: String,
    },
    /// The skin of a patch.
    #[error("{}, line {line}: patch {patch}: {source}", file.display())]
    Skin {
        /// The body file.
        file: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// Name of the patch.
        patch: String,
        /// The cause.
        source: dermis_skin::Error,
    },
    /// Invalid joint values.
    #[error("joint values: {message}")]
    Joints {
        /// The fault, and the expected content.
        message: String,
    },
}

/// Names as a list for people; beyond the twelfth only their number.
pub(crate) fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    const MOST: usize = 12;
    let all: Vec<&str> = names.collect();
    let shown = all[..all.len().min(MOST)].join(", ");
    match all.len().saturating_sub(MOST) {
        0 if all.is_empty() => "none".to_owned(),
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}
