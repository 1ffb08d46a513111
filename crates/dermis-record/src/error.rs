//! Errors of this crate: each gives the failed operation, the place, the value found and the value expected.

use std::path::PathBuf;

use dermis_skin::FileError;
use thiserror::Error;

/// An error of this crate. Files and frames are refused with the errors of `dermis-live`.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or frames that can't be used, or an error of preparing a skin or of the live pipeline.
    #[error(transparent)]
    Live(#[from] dermis_live::Error),
    /// A server that could not be started.
    #[error("cannot listen on {address}: {source}{advice}")]
    Listen {
        /// The address.
        address: String,
        /// Error from the operating system.
        source: std::io::Error,
        /// Advice after a semicolon, or nothing.
        advice: &'static str,
    },
}

impl Error {
    pub(crate) fn io(file: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.into();
        move |source| Self::Live(dermis_live::Error::Io(FileError { file, source }))
    }
}

impl From<dermis_skin::Error> for Error {
    fn from(error: dermis_skin::Error) -> Self {
        Self::Live(error.into())
    }
}

impl From<dermis_device::DeviceError> for Error {
    fn from(error: dermis_device::DeviceError) -> Self {
        Self::Live(error.into())
    }
}

impl From<dermis_touch::TouchError> for Error {
    fn from(error: dermis_touch::TouchError) -> Self {
        Self::Live(error.into())
    }
}
