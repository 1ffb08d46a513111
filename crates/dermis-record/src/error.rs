//! Errors of this crate: each gives the failed operation, the place, the value found and the value expected.

use std::path::PathBuf;

use thiserror::Error;

/// An error of this crate.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// From preparing a skin, or from the live pipeline.
    #[error(transparent)]
    Live(#[from] dermis_live::Error),
    /// From a skin file.
    #[error(transparent)]
    Skin(#[from] dermis_skin::Error),
    /// A file that could not be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// A file with invalid content.
    #[error("{}: {field}: {reason}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// Line, key or column.
        field: String,
        /// The value found and the value expected.
        reason: String,
    },
    /// Frames that do not fit the skin.
    #[error("{what}: expected {expected}, got {got}")]
    Frames {
        /// Description of the frames.
        what: String,
        /// Expected.
        expected: String,
        /// Found.
        got: String,
    },
    /// From a reader or source.
    #[error(transparent)]
    Device(#[from] dermis_device::DeviceError),
    /// A server that could not be started.
    #[error("cannot listen on {address}: {source}{advice}")]
    Listen {
        /// The address.
        address: String,
        /// Error from the operating system.
        source: std::io::Error,
        /// What to do, after a semicolon, or nothing.
        advice: &'static str,
    },
    /// From touch extraction.
    #[error("touches: {0}")]
    Touch(#[from] dermis_touch::TouchError),
}

impl Error {
    pub(crate) fn io(file: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.into();
        move |source| Self::Io { file, source }
    }
}
