//! Sources of frames. A source blocks until a frame arrives or a timeout expires. Code above it doesn't poll, and
//! doesn't know whether the frames come from a file, a port, a socket or a twin.

use std::time::Duration;

use crate::{DeviceError, Frame, Layout};

/// A source of frames in order of time.
///
/// A transport reads bytes, a decoder splits them into frames, and a source combines the two. Implementations own any
/// threads or ports that they need, and stamp each frame with [`crate::HostStamp::now`] at its first byte.
pub trait Source: Send {
    /// Number of readings in a frame.
    fn channels(&self) -> usize {
        self.layout().channels()
    }

    /// Assignment of readings to channels.
    fn layout(&self) -> &Layout;

    /// Name for messages: a file, a port, an address.
    fn name(&self) -> &str;

    /// Waits at most `timeout` for the next frame and refills `frame` with it.
    ///
    /// `frame` is changed only when [`SourceEvent::Frame`] is returned. A frame that cannot be decoded is counted
    /// in [`Counters::bad`] and skipped.
    ///
    /// # Errors
    /// If the source can't deliver any more frames, for instance because a port is gone.
    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError>;

    /// Numbers of delivered, lost and bad frames since the source was opened.
    fn counters(&self) -> Counters;

    /// True if frames come from hardware as it measures. The threads that take them to touches then ask for
    /// real-time priority.
    fn is_instrument(&self) -> bool {
        false
    }

    /// Reason why no frames arrive, in words, if known: a device that doesn't answer, or a lost connection.
    fn problem(&self) -> Option<String> {
        None
    }

    /// Description of the unreadable part of a file, in words, once the file has ended. `None` if nothing is missing.
    fn incomplete(&self) -> Option<String> {
        None
    }
}

/// Result of [`Source::next_frame`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SourceEvent {
    /// A frame was written.
    Frame,
    /// No frame within the timeout.
    Idle,
    /// No more frames will follow.
    End,
}

/// Frames delivered and lost by a source.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames delivered.
    pub frames: u64,
    /// Frames that the device numbered but that never arrived.
    pub lost: u64,
    /// Frames that arrived damaged and were skipped.
    pub bad: u64,
}
