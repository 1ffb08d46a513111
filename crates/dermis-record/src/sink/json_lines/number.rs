//! Numbers and times in JSON notation.

use std::fmt::{self, Write as _};

/// A number in JSON notation; `null` if it is not finite.
pub(super) struct Number(pub(super) f64);

impl fmt::Display for Number {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_finite() { write!(out, "{}", self.0) } else { out.write_str("null") }
    }
}

/// Closes an object with the time at which its state began.
pub(super) fn push_since(text: &mut String, since_ns: u64) {
    let _ = write!(text, ",\"since_s\":{}.{:09}}}", since_ns / 1_000_000_000, since_ns % 1_000_000_000);
}
