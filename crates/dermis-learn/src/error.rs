//! Errors of this crate: what failed, where, the value, and what was expected.

use std::path::PathBuf;

use thiserror::Error;

/// Why a network, its weights or a training set could not be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LearnError {
    /// A file that could not be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file whose contents are not what they should be.
    #[error("{}: {field}: {reason}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// Key, tensor or place.
        field: String,
        /// Value found and what was expected.
        reason: String,
    },
    /// A value that makes no sense where it stands.
    #[error("{what} = {value}: expected {expected}")]
    Value {
        /// What it is.
        what: &'static str,
        /// Its value.
        value: String,
        /// What was expected.
        expected: String,
    },
    /// Two things that belong together have different sizes.
    #[error("{what}: expected {expected} values, got {got}")]
    Size {
        /// What was counted.
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
        /// Skin of the model.
        model: String,
        /// Its fingerprint, abbreviated.
        model_print: String,
        /// The skin at hand.
        skin: String,
        /// Its fingerprint, abbreviated.
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
