//! Errors of this crate: each gives the failed operation, the place, the value found and the value expected.

use thiserror::Error;

/// An error of this crate. Files, frames and arguments are refused with the errors of `dermis-live`.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A file, frames or an argument that can't be used, or an error of preparing a skin or of the live pipeline.
    #[error(transparent)]
    Live(#[from] dermis_live::Error),
    /// From a recording or another sink.
    #[error(transparent)]
    Record(#[from] dermis_record::Error),
    /// From a twin.
    #[error("twin: {0}")]
    Twin(#[from] dermis_twin::TwinError),
    /// The caller cancelled the work.
    #[error("interrupted")]
    Interrupted,
}

/// Conversions from errors that `dermis-live` has a variant for.
macro_rules! by_live {
    ($($error:ty),* $(,)?) => {$(
        impl From<$error> for Error {
            fn from(error: $error) -> Self {
                Self::Live(error.into())
            }
        }
    )*};
}

by_live!(
    dermis_device::DeviceError,
    dermis_learn::LearnError,
    dermis_mit::MitError,
    dermis_skin::Error,
    dermis_tomo::eit::EitError,
    dermis_tomo::inverse::InverseError,
    dermis_tomo::quality::QualityError,
    dermis_touch::TouchError,
    dermis_touch::locator::LocatorError,
);
