//! Errors of skin files: where, the key, the value, and what was expected.

use std::path::PathBuf;

use thiserror::Error;

/// Why a skin file could not be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// A skin file could not be understood; the message shows the place.
    #[error("{file}: {message}")]
    SkinFile {
        /// The file, or `built-in skin NAME`.
        file: String,
        /// What is wrong, with line and column.
        message: String,
    },
    /// A skin file of an earlier version of the format.
    #[error("{file}: written for an earlier version of dermis: {}; `dermis skins upgrade {file}` rewrites it", moved.join("; "))]
    OldFormat {
        /// The file.
        file: String,
        /// Which keys have moved, and where to.
        moved: Vec<String>,
    },
    /// A field of a skin file holds a value that makes no sense.
    #[error("{file}: {field} = {value}: expected {expected}")]
    SkinField {
        /// The file, or `built-in skin NAME`.
        file: String,
        /// Dotted name of the field.
        field: String,
        /// Its value.
        value: String,
        /// What was expected.
        expected: String,
    },
    /// More memory or time than may be used, known from the sizes before anything is built.
    #[error("{skin}: {what} takes {needed}; expected at most {limit}: {change}, or allow it with --memory {memory}")]
    Budget {
        /// Name of the skin.
        skin: String,
        /// What would be built.
        what: &'static str,
        /// Memory and time, and what drives them.
        needed: String,
        /// The key to change.
        change: String,
        /// What may be used.
        limit: String,
        /// What would do.
        memory: String,
    },
    /// No such built-in skin and no such file.
    #[error("skin {name:?}: no file of that name and no built-in skin; built-in are {known}")]
    UnknownSkin {
        /// What was asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// A file that could not be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: std::io::Error,
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
    /// From coils.
    #[error("coils of {skin}: {source}")]
    Coils {
        /// Name of the skin.
        skin: String,
        /// The cause.
        source: dermis_mit::MitError,
    },
}
