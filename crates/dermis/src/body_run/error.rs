//! Errors of running bodies.

use dermis_lab::Error;

/// Errors of running bodies.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BodyRunError {
    /// A patch that cannot be started.
    #[error("patch {patch}: {source}")]
    Patch {
        /// Its name.
        patch: String,
        /// The problem.
        source: Error,
    },
    /// A source of joint values that cannot be opened.
    #[error("joint values from {name}: {source}")]
    Joints {
        /// The source.
        name: String,
        /// The system's message.
        source: std::io::Error,
    },
    /// A recording that cannot be started.
    #[error(transparent)]
    Recording {
        /// The problem.
        source: dermis_record::Error,
    },
    /// No patch is left to run.
    #[error("{body}: none of its {patches} patches can be started")]
    NoPatch {
        /// Name of the body.
        body: String,
        /// How many it has.
        patches: usize,
    },
    /// A thread that the system does not give.
    #[error("a thread for patch {patch}: {source}")]
    Thread {
        /// Its name.
        patch: String,
        /// The system's message.
        source: std::io::Error,
    },
}
