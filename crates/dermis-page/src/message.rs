//! Text messages to pages, and statistics on how well pages keep up.

use serde::Serialize;

/// An answer to one request.
#[derive(Debug, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Answer {
    /// Number of the request.
    pub id: u64,
    /// True if it was carried out.
    pub ok: bool,
    /// The result, or the reason for a refusal.
    pub text: String,
}

/// A notice to every page.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Notice {
    /// Severity.
    pub level: Level,
    /// The message.
    pub text: String,
}

/// Severity of a notice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Normal operation.
    Info,
    /// Something that needs attention.
    Warning,
    /// A failure, or lost data.
    Error,
}

/// Statistics on how well the pages keep up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct HubStats {
    /// Pages connected.
    pub clients: usize,
    /// Updates published.
    pub published: u64,
    /// Updates overwritten by a newer one before the server sent any, because frames exceed the page's rate.
    pub coalesced: u64,
    /// Updates sent to some pages but skipped for a slow one, summed over pages.
    pub dropped: u64,
}
