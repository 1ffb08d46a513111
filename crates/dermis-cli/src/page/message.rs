//! What pages are told in words.

use serde::Serialize;

/// An answer to one request.
#[derive(Debug, Serialize)]
pub(super) struct Answer {
    pub(super) id: u64,
    pub(super) ok: bool,
    pub(super) text: String,
}

/// Something told to every page.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Notice {
    pub(super) level: Level,
    pub(super) text: String,
}

/// How serious a notice is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Something happened as it should.
    Info,
    /// Something needs attention.
    Warning,
    /// Something failed, or data was lost.
    Error,
}
