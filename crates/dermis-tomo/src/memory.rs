//! Memory limit of the solvers, in bytes: one limit for the process, which every solver checks before it starts.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};

use thiserror::Error;

/// Default limit: 8 GB.
const UNTOLD_BYTES: u64 = 8_000_000_000;

static LIMIT: AtomicU64 = AtomicU64::new(UNTOLD_BYTES);

/// Limits every solver of this process to this many bytes.
pub fn set_limit(bytes: u64) {
    LIMIT.store(bytes.max(1), Ordering::Relaxed);
}

/// The limit, bytes.
pub fn limit() -> u64 {
    LIMIT.load(Ordering::Relaxed)
}

/// A solver would need more memory than allowed.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{what} needs about {}, more than the {} that may be used; allow more with --memory, or make it smaller", Bytes(*needed_bytes), Bytes(*limit_bytes))]
pub struct OutOfMemory {
    /// The problem to solve, with its size.
    pub what: String,
    /// Approximate memory needed, bytes.
    pub needed_bytes: f64,
    /// Limit, bytes.
    pub limit_bytes: f64,
}

/// Refuses a computation that needs more memory than allowed. `what` is called only in that case.
///
/// # Errors
/// [`OutOfMemory`].
pub fn check(needed_bytes: f64, what: impl FnOnce() -> String) -> Result<(), OutOfMemory> {
    let limit_bytes = limit() as f64;
    if needed_bytes <= limit_bytes {
        return Ok(());
    }
    Err(OutOfMemory { what: what(), needed_bytes, limit_bytes })
}

/// Allocates zeros. If the system refuses the memory, that is an error instead of the end of the process.
///
/// # Errors
/// [`OutOfMemory`].
pub fn zeros(count: usize, what: impl Fn() -> String) -> Result<Vec<f64>, OutOfMemory> {
    let needed_bytes = 8.0 * count as f64;
    check(needed_bytes, &what)?;
    let mut values = Vec::new();
    let refused = |_| OutOfMemory { what: what(), needed_bytes, limit_bytes: limit() as f64 };
    values.try_reserve_exact(count).map_err(refused)?;
    values.resize(count, 0.0);
    Ok(values)
}

/// Bytes, for display.
struct Bytes(f64);

impl fmt::Display for Bytes {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            b if b >= 1e12 => write!(out, "{:.1} TB", b / 1e12),
            b if b >= 1e9 => write!(out, "{:.1} GB", b / 1e9),
            b => write!(out, "{:.0} MB", (b / 1e6).max(1.0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oversized_requests_are_refused_with_both_sizes_and_without_allocating() {
        let error = zeros(1 << 50, || "a factor".into()).unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with("a factor needs about 9007.2 TB, more than the "), "{text}");
        assert_eq!(zeros(3, || "a factor".into()), Ok(vec![0.0; 3]));
    }
}
