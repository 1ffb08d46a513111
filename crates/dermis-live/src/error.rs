//! Errors of this crate: what failed, where, the value, and what was expected.

use std::path::PathBuf;

use thiserror::Error;

/// Why something could not be done.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// From a skin file.
    #[error(transparent)]
    Skin(#[from] dermis_skin::Error),
    /// A file that could not be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A thread could not be started.
    #[error("thread {what}: {source}")]
    Thread {
        /// What it is for.
        what: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file whose contents are not what they should be.
    #[error("{}: {field}: {reason}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// Line, key or column.
        field: String,
        /// Value found and what was expected.
        reason: String,
    },
    /// Frames that do not fit the skin.
    #[error("{what}: expected {expected}, got {got}")]
    Frames {
        /// Which frames.
        what: String,
        /// Expected.
        expected: String,
        /// Found.
        got: String,
    },
    /// Frames, or a calibration, of another skin than the one they are used for.
    #[error(
        "{what}: recorded on skin {got}, used as {expected}{differs}; name the right skin, or insist with --as-skin"
    )]
    OtherSkin {
        /// Which file or frames.
        what: String,
        /// The skin that they are of.
        got: String,
        /// The skin that they are used for.
        expected: String,
        /// The keys that differ, as the end of a sentence; empty where only fingerprints are known.
        differs: String,
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
    /// From the equations of a layer.
    #[error("equations: {0}")]
    Equations(#[from] dermis_tomo::sparse::SparseError),
    /// From networks, their weights and training sets.
    #[error(transparent)]
    Learn(#[from] dermis_learn::LearnError),
    /// From touch extraction.
    #[error("touches: {0}")]
    Touch(#[from] dermis_touch::TouchError),
}
