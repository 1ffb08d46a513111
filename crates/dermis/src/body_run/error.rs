//! Errors of running bodies.

use dermis_lab::Error;

/// Errors of running bodies.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BodyRunError {
    /// A patch could not be started.
    #[error("patch {patch}: {source}")]
    Patch {
        /// Name of the patch.
        patch: String,
        /// The cause.
        source: Error,
    },
    /// A source of joint values could not be opened.
    #[error("joint values from {name}: {source}")]
    Joints {
        /// The source.
        name: String,
        /// Error from the operating system.
        source: std::io::Error,
    },
    /// A recording could not be started.
    #[error(transparent)]
    Recording {
        /// The cause.
        source: dermis_record::Error,
    },
    /// The guard's socket could not be opened.
    #[error("the guard's socket: {source}")]
    Guard {
        /// The cause.
        source: dermis_record::Error,
    },
    /// A server for viewers could not be started.
    #[error("--foxglove: {source}")]
    Foxglove {
        /// The cause.
        source: dermis_record::Error,
    },
    /// The ROS 2 node could not be started.
    #[cfg(feature = "ros2")]
    #[error(transparent)]
    Ros2 {
        /// The cause.
        source: dermis_record::ros2::Ros2Error,
    },
    /// No patch is left to run.
    #[error("{body}: none of its {patches} patches can be started")]
    NoPatch {
        /// Name of the body.
        body: String,
        /// Number of its patches.
        patches: usize,
    },
    /// The operating system refused a thread.
    #[error("a thread for patch {patch}: {source}")]
    Thread {
        /// Name of the patch.
        patch: String,
        /// Error from the operating system.
        source: std::io::Error,
    },
}
