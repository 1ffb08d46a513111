//! What connects to a device, and what is said over the connection.

use std::io;
use std::time::Duration;

use super::Inbox;
use crate::{HostStamp, Layout};

/// A connection to a device.
pub trait Link: Send {
    /// Waits at most a tenth of a second for bytes; 0 where none came.
    ///
    /// # Errors
    /// When the connection has ended, by whichever side.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;

    /// Sends all bytes, or fails within a second or so.
    ///
    /// # Errors
    /// When the connection has ended or the device takes nothing.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
}

/// Makes connections to one device.
pub trait Connect: Send {
    /// Connects, or fails within a few seconds.
    ///
    /// # Errors
    /// Whatever the system says.
    fn connect(&mut self) -> io::Result<Box<dyn Link>>;

    /// What the user called the device.
    fn name(&self) -> &str;
}

/// What is said over a connection: bytes in, frames and bytes out. It knows no port and reads no clock, so that it is
/// tested without either.
pub trait Dialogue: Send {
    /// A connection has been made. Bytes to send go to `send`.
    fn open(&mut self, send: &mut Vec<u8>);

    /// Bytes have come, the first of them at `at`.
    ///
    /// # Errors
    /// Why this connection is of no use, in plain words.
    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String>;

    /// Time has passed: `open_for` since the connection was made.
    ///
    /// # Errors
    /// Why this connection is of no use, in plain words.
    fn tick(&mut self, open_for: Duration, send: &mut Vec<u8>) -> Result<(), String>;

    /// The connection is about to be closed by this side.
    fn close(&mut self, send: &mut Vec<u8>);

    /// Which reading stands at which channel, once that is known.
    fn layout(&self) -> Option<Layout>;

    /// Whether all that comes is frames, so that any byte is owed one.
    fn is_frames_only(&self) -> bool {
        false
    }

    /// What the device says that it is, once that is known.
    fn identity(&self) -> Option<String> {
        None
    }
}
