//! Time limits of a stream.

use std::time::Duration;

/// Time limits and queue size of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamOptions {
    /// Longest wait for the device's first answer.
    pub patience: Duration,
    /// Time without any byte before reconnecting.
    pub silence: Duration,
    /// Time without a complete frame before reconnecting, although bytes or damaged frames arrive.
    pub frame: Duration,
    /// Wait before the second attempt to connect. Doubles with each further attempt.
    pub first_wait: Duration,
    /// Longest wait between attempts.
    pub longest_wait: Duration,
    /// Queue size in frames.
    pub queue: usize,
}

impl Default for StreamOptions {
    /// 5 s, 2 s, 3 s, 0.1 s, 2 s, 256 frames.
    fn default() -> Self {
        Self {
            patience: Duration::from_secs(5),
            silence: Duration::from_secs(2),
            frame: Duration::from_secs(3),
            first_wait: Duration::from_millis(100),
            longest_wait: Duration::from_secs(2),
            queue: 256,
        }
    }
}
