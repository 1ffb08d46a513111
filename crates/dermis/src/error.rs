//! The error of this crate. Every function of the facade, and of the crates behind it, fails with an error that `?`
//! turns into it.

use dermis_body::Error as BodyError;
use dermis_device::DeviceError;
use dermis_lab::Error as LabError;
use dermis_lab::twin_commands::CommandRefused;
use dermis_learn::LearnError;
use dermis_live::Error as LiveError;
use dermis_mit::MitError;
use dermis_record::Error as RecordError;
use dermis_skin::{Error as SkinError, FileError};
use dermis_tomo::eit::{EitError, ProtocolError};
use dermis_tomo::inverse::InverseError;
use dermis_tomo::mesh::MeshError;
use dermis_tomo::quality::QualityError;
use dermis_touch::{LocatorError, TouchError};
use dermis_twin::TwinError;
use thiserror::Error;

/// An error of this crate. Its message names the file, field or value, and what was expected.
///
/// ```
/// use dermis::{Error, Skin};
///
/// fn open() -> Result<Skin, Error> {
///     Ok(Skin::open("no-such-skin")?)
/// }
///
/// let error = open().unwrap_err();
/// assert!(matches!(error, Error::Skin(_)));
/// assert!(error.to_string().contains("no-such-skin"), "{error}");
/// ```
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// From a skin file.
    #[error(transparent)]
    Skin(#[from] SkinError),
    /// From an instrument, a file of frames or another source.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// From preparing a skin, from the pipeline, or from a calibration.
    #[error(transparent)]
    Live(LiveError),
    /// From a recording or another sink.
    #[error(transparent)]
    Record(RecordError),
    /// From offline work: design, doctor, images of files, training sets.
    #[error(transparent)]
    Lab(LabError),
    /// From a twin, or a press that its skin can't carry.
    #[error("twin: {0}")]
    Twin(#[from] TwinError),
    /// A command that the twin can't queue.
    #[error(transparent)]
    Command(#[from] CommandRefused),
    /// From a body file or its robot.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// From a network, its weights or a training set.
    #[error(transparent)]
    Learn(LearnError),
    /// From contacts and tracks.
    #[error("touches: {0}")]
    Touch(#[from] TouchError),
    /// From a locator of touches.
    #[error("calibration: {0}")]
    Locator(#[from] LocatorError),
    /// From a mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// From a measuring protocol.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// From a forward model.
    #[error("forward model: {0}")]
    Forward(#[from] EitError),
    /// From an inverse operator.
    #[error("inverse operator: {0}")]
    Inverse(#[from] InverseError),
    /// An image that can't be scored.
    #[error(transparent)]
    Quality(#[from] QualityError),
    /// From coils and conducting elements.
    #[error("coils and elements: {0}")]
    Magnetic(#[from] MitError),
    /// A file that could not be read or written.
    #[error(transparent)]
    Io(#[from] FileError),
    /// An argument out of range.
    #[error("{what}: expected {expected}, got {got}")]
    Value {
        /// Name of the argument.
        what: &'static str,
        /// Expected values.
        expected: &'static str,
        /// The value.
        got: String,
    },
    /// A command for a twin, given to another source.
    #[error("{name} can't be pressed by a command; expected a session whose source is a twin")]
    NotATwin {
        /// Name of the source.
        name: String,
    },
    /// A patch of a body could not be started.
    #[error("patch {patch}: {source}")]
    Patch {
        /// Name of the patch.
        patch: String,
        /// The cause.
        source: Box<Error>,
    },
    /// A source of joint values could not be opened.
    #[error("joint values from {name}: {source}")]
    Joints {
        /// The source.
        name: String,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// The guard's socket could not be opened.
    #[error("the guard's socket: {source}")]
    Guard {
        /// The cause.
        source: RecordError,
    },
    /// The server for Foxglove could not be started.
    #[error("--foxglove: {source}")]
    Foxglove {
        /// The cause.
        source: RecordError,
    },
    /// The ROS 2 node could not be started.
    #[cfg(feature = "ros2")]
    #[error(transparent)]
    Ros2(#[from] dermis_record::ros2::Ros2Error),
    /// No patch of a body is left to run.
    #[error("{body}: no patch can be started, of {patches}")]
    NoPatch {
        /// Name of the body.
        body: String,
        /// Number of its patches.
        patches: usize,
    },
    /// The operating system refused a thread.
    #[error("a thread for {what}: {source}")]
    Thread {
        /// Purpose of the thread.
        what: String,
        /// Error from the operating system.
        source: std::io::Error,
    },
}

impl From<LearnError> for Error {
    fn from(error: LearnError) -> Self {
        LiveError::from(error).into()
    }
}

impl From<LiveError> for Error {
    /// Errors of lower crates become their own variant, whichever crate passed them on.
    fn from(error: LiveError) -> Self {
        match error {
            LiveError::Skin(error) => Self::Skin(error),
            LiveError::Device(error) => Self::Device(error),
            LiveError::Learn(error) => Self::Learn(error),
            LiveError::Touch(error) => Self::Touch(error),
            LiveError::Locator(error) => Self::Locator(error),
            LiveError::Forward(error) => Self::Forward(error),
            LiveError::Inverse(error) => Self::Inverse(error),
            LiveError::Quality(error) => Self::Quality(error),
            LiveError::Magnetic(error) => Self::Magnetic(error),
            LiveError::Io(error) => Self::Io(error),
            other => Self::Live(other),
        }
    }
}

impl From<RecordError> for Error {
    fn from(error: RecordError) -> Self {
        match error {
            RecordError::Live(error) => error.into(),
            other => Self::Record(other),
        }
    }
}

impl From<LabError> for Error {
    fn from(error: LabError) -> Self {
        match error {
            LabError::Live(error) => error.into(),
            LabError::Record(error) => error.into(),
            LabError::Twin(error) => Self::Twin(error),
            other => Self::Lab(other),
        }
    }
}
