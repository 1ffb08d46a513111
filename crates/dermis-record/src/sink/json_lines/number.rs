//! Numbers and times as lines of JSON have them.

use std::fmt::{self, Write as _};

/// A number as JSON has it.
pub(super) struct Number(pub(super) f64);

impl fmt::Display for Number {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_finite() { write!(out, "{}", self.0) } else { out.write_str("null") }
    }
}

/// Ends an object with the time since when it has been so.
pub(super) fn push_since(text: &mut String, since_ns: u64) {
    let _ = write!(text, ",\"since_s\":{}.{:09}}}", since_ns / 1_000_000_000, since_ns % 1_000_000_000);
}
