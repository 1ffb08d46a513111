//! What pages are told in words, and how they keep up.

use serde::Serialize;

/// An answer to one request.
#[derive(Debug, Serialize)]
pub struct Answer {
    /// Number of the request.
    pub id: u64,
    /// It was done.
    pub ok: bool,
    /// What was done, or why it was not.
    pub text: String,
}

/// Something told to every page.
#[derive(Debug, Clone, Serialize)]
pub struct Notice {
    /// How serious it is.
    pub level: Level,
    /// What happened.
    pub text: String,
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

/// How the pages keep up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct HubStats {
    /// Pages connected.
    pub clients: usize,
    /// Updates published.
    pub published: u64,
    /// Updates overwritten by a newer one before the server sent any: frames beyond the page's rate.
    pub coalesced: u64,
    /// Updates sent to some pages but skipped for a slow one, summed over pages.
    pub dropped: u64,
}
