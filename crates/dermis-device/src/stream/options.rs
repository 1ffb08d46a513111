//! Times of a stream.

use std::time::Duration;

/// How long a stream waits for what.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamOptions {
    /// For the first answer of the device.
    pub patience: Duration,
    /// Without a byte before the connection is made anew.
    pub silence: Duration,
    /// Without a whole frame, although bytes or damaged frames came, before the connection is made anew.
    pub frame: Duration,
    /// Before the second attempt to connect; doubled with every further one.
    pub first_wait: Duration,
    /// At most, between attempts.
    pub longest_wait: Duration,
    /// Frames that may wait for the reader.
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
