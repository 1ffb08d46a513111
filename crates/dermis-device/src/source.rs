//! Where frames come from. A source blocks until a frame is there or a time has passed; nothing above it polls, and
//! nothing above it knows whether a file, a port, a socket or a twin is behind it.

use std::time::Duration;

use crate::{DeviceError, Frame, Layout};

/// Anything that yields frames in order of time.
///
/// A transport reads bytes, a decoder cuts them into frames, and a source joins the two. Implementations own whatever
/// thread or port they need and stamp each frame with [`crate::HostStamp::now`] at its first byte.
pub trait Source: Send {
    /// Readings in every frame.
    fn channels(&self) -> usize {
        self.layout().channels()
    }

    /// Which reading stands at which channel.
    fn layout(&self) -> &Layout;

    /// Name for messages: a file, a port, an address.
    fn name(&self) -> &str;

    /// Waits at most `timeout` for the next frame and refills `frame` with it.
    ///
    /// `frame` is changed only when [`SourceEvent::Frame`] is returned. A frame that cannot be decoded is counted
    /// in [`Counters::bad`] and skipped.
    ///
    /// # Errors
    /// When the source can yield no further frame, for instance because a port has gone.
    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError>;

    /// What has come and what was lost since the source was opened.
    fn counters(&self) -> Counters;

    /// Why no frames come, in words, where that is known: a device that does not answer, a connection that was lost.
    fn problem(&self) -> Option<String> {
        None
    }

    /// What could not be read of a file, in words, once it has ended; `None` where nothing is missing.
    fn incomplete(&self) -> Option<String> {
        None
    }
}

/// What [`Source::next_frame`] came back with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SourceEvent {
    /// A frame was written.
    Frame,
    /// The time passed without one.
    Idle,
    /// There will be no more.
    End,
}

/// Frames delivered and lost by a source.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames handed out.
    pub frames: u64,
    /// Frames that the device numbered and that never arrived.
    pub lost: u64,
    /// Frames that arrived damaged and were skipped.
    pub bad: u64,
}
