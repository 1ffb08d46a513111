//! Errors of skin files: the place, the key, the value and what was expected.

use std::path::PathBuf;

use thiserror::Error;

/// A file that could not be read or written.
#[derive(Debug, Error)]
#[error("{}: {source}", file.display())]
pub struct FileError {
    /// The file.
    pub file: PathBuf,
    /// The operating system's error.
    pub source: std::io::Error,
}

/// Reasons why a skin file cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A skin file could not be parsed; the message shows the place.
    #[error("{file}: {message}")]
    SkinFile {
        /// The file, or `built-in skin NAME`.
        file: String,
        /// The problem, with line and column.
        message: String,
    },
    /// A field of a skin file holds a value that is out of range or inconsistent.
    #[error("{file}: {field} = {value}: expected {expected}")]
    SkinField {
        /// The file, or `built-in skin NAME`.
        file: String,
        /// Dotted name of the field.
        field: String,
        /// Its value.
        value: String,
        /// Expected values.
        expected: String,
    },
    /// More memory or time needed than allowed, known from the sizes before anything is built.
    #[error("{skin}: {what} takes {needed}; expected at most {limit}: {change}, or allow it with --memory {memory}")]
    Budget {
        /// Name of the skin.
        skin: String,
        /// The part that would be built.
        what: &'static str,
        /// Memory and time needed, and the largest contribution.
        needed: String,
        /// The key to change.
        change: String,
        /// The limit.
        limit: String,
        /// Memory limit that would suffice.
        memory: String,
    },
    /// No such built-in skin and no such file.
    #[error("skin {name:?}: no file of that name and no built-in skin; built-in are {known}")]
    UnknownSkin {
        /// The name asked for.
        name: String,
        /// The known names.
        known: String,
    },
    /// A file that could not be read or written.
    #[error(transparent)]
    Io(#[from] FileError),
    /// Error from the mesh.
    #[error("mesh of {skin}: {source}")]
    Mesh {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_tomo::mesh::MeshError,
    },
    /// Error from the protocol.
    #[error("protocol of {skin}: {source}")]
    Protocol {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_tomo::eit::ProtocolError,
    },
    /// Error from coils.
    #[error("coils of {skin}: {source}")]
    Coils {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_mit::MitError,
    },
}
