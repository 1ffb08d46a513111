//! Errors of this crate: what failed, where, the value, and what was expected.

use std::path::PathBuf;

use dermis_learn::LearnError;
use dermis_skin::FileError;
use thiserror::Error;

/// Any failure in this crate.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// An error in a skin file.
    #[error(transparent)]
    Skin(#[from] dermis_skin::Error),
    /// A file that could not be read or written.
    #[error(transparent)]
    Io(#[from] FileError),
    /// A thread could not be started.
    #[error("thread {what}: {source}")]
    Thread {
        /// Purpose of the thread.
        what: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A file with invalid contents.
    #[error("{}: {field}: {reason}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// Line, key or column.
        field: String,
        /// The value found and what was expected.
        reason: String,
    },
    /// Frames that do not match the skin.
    #[error("{what}: expected {expected}, got {got}")]
    Frames {
        /// Description of the frames.
        what: String,
        /// Expected value.
        expected: String,
        /// Actual value.
        got: String,
    },
    /// Frames, or a calibration, of a different skin from the one they are used for.
    #[error(
        "{what}: recorded on skin {got}, used as {expected}{differs}; name the right skin, or insist with --as-skin"
    )]
    OtherSkin {
        /// Description of the file or frames.
        what: String,
        /// The skin they belong to.
        got: String,
        /// The skin they are used for.
        expected: String,
        /// The keys that differ, as the end of a sentence; empty if only fingerprints are known.
        differs: String,
    },
    /// An error in the mesh.
    #[error("mesh of {skin}: {source}")]
    Mesh {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_tomo::mesh::MeshError,
    },
    /// An error in the protocol.
    #[error("protocol of {skin}: {source}")]
    Protocol {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_tomo::eit::ProtocolError,
    },
    /// An error in the forward model.
    #[error("forward model: {0}")]
    Forward(#[from] dermis_tomo::eit::EitError),
    /// An error in coils and conducting elements.
    #[error("coils and elements: {0}")]
    Magnetic(#[from] dermis_mit::MitError),
    /// An error in the inverse operator.
    #[error("inverse operator: {0}")]
    Inverse(#[from] dermis_tomo::inverse::InverseError),
    /// An image could not be scored.
    #[error(transparent)]
    Quality(#[from] dermis_tomo::quality::QualityError),
    /// An error in a reader or source.
    #[error(transparent)]
    Device(#[from] dermis_device::DeviceError),
    /// An error in a calibrated locator.
    #[error("calibration: {0}")]
    Locator(#[from] dermis_touch::locator::LocatorError),
    /// An error in the equations of a layer.
    #[error("equations: {0}")]
    Equations(#[from] dermis_tomo::sparse::SparseError),
    /// An error in networks, their weights and training sets.
    #[error(transparent)]
    Learn(LearnError),
    /// An error in touch extraction.
    #[error("touches: {0}")]
    Touch(#[from] dermis_touch::TouchError),
}

impl From<LearnError> for Error {
    /// A file of a network that could not be read is [`Error::Io`], like any other file.
    fn from(error: LearnError) -> Self {
        match error {
            LearnError::Io { file, source } => Self::Io(FileError { file, source }),
            other => Self::Learn(other),
        }
    }
}
