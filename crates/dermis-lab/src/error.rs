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
    /// From a recording or another sink.
    #[error(transparent)]
    Record(#[from] dermis_record::Error),
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
    /// A thread could not be started.
    #[error("thread {what}: {source}")]
    Thread {
        /// Purpose of the thread.
        what: &'static str,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// The caller cancelled the work.
    #[error("interrupted")]
    Interrupted,
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
    /// From the mesh.
    #[error("mesh of {skin}: {source}")]
    Mesh {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_tomo::mesh::MeshError,
    },
    /// From the protocol.
    #[error("protocol of {skin}: {source}")]
    Protocol {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_tomo::eit::ProtocolError,
    },
    /// From the forward model.
    #[error("forward model: {0}")]
    Forward(#[from] dermis_tomo::eit::EitError),
    /// From coils and conducting elements.
    #[error("coils and elements: {0}")]
    Magnetic(#[from] dermis_mit::MitError),
    /// From the inverse operator.
    #[error("inverse operator: {0}")]
    Inverse(#[from] dermis_tomo::inverse::InverseError),
    /// An image could not be scored.
    #[error(transparent)]
    Quality(#[from] dermis_tomo::quality::QualityError),
    /// From a reader or source.
    #[error(transparent)]
    Device(#[from] dermis_device::DeviceError),
    /// From a calibrated locator.
    #[error("calibration: {0}")]
    Locator(#[from] dermis_touch::locator::LocatorError),
    /// From a twin.
    #[error("twin: {0}")]
    Twin(#[from] dermis_twin::TwinError),
    /// From networks, their weights and training sets.
    #[error(transparent)]
    Learn(#[from] dermis_learn::LearnError),
    /// From touch extraction.
    #[error("touches: {0}")]
    Touch(#[from] dermis_touch::TouchError),
}
