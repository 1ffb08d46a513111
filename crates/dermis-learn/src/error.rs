//! Errors of this crate: the failure, its place, the value and what was expected.

use std::path::PathBuf;

use thiserror::Error;

/// Reasons why a network, its weights or a training set cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LearnError {
    /// A file that could not be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// A file with invalid contents.
    #[error("{}: {field}: {reason}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// Key, tensor or place.
        field: String,
        /// Value found and what was expected.
        reason: String,
    },
    /// An invalid value.
    #[error("{what} = {value}: expected {expected}")]
    Value {
        /// Name of the value.
        what: &'static str,
        /// Its value.
        value: String,
        /// Expected values.
        expected: String,
    },
    /// Two sizes that should match differ.
    #[error("{what}: expected {expected} values, got {got}")]
    Size {
        /// The items counted.
        what: &'static str,
        /// Expected count.
        expected: usize,
        /// Found count.
        got: usize,
    },
    /// A model made for another skin.
    #[error("{}: the model is for skin {model} ({model_print}), not for {skin} ({skin_print}); train one for it", file.display())]
    OtherSkin {
        /// The model's card.
        file: PathBuf,
        /// Skin that the model was made for.
        model: String,
        /// Fingerprint of that skin, abbreviated.
        model_print: String,
        /// The current skin.
        skin: String,
        /// Fingerprint of the current skin, abbreviated.
        skin_print: String,
    },
}

impl LearnError {
    pub(crate) fn io(file: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.into();
        move |source| Self::Io { file, source }
    }

    pub(crate) fn content(file: impl Into<PathBuf>, field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Content { file: file.into(), field: field.into(), reason: reason.into() }
    }
}
