//! Traits for connections to devices, and for the conversations over them.

use std::io;
use std::time::Duration;

use super::Inbox;
use crate::{HostStamp, Layout};

/// A connection to a device.
pub trait Link: Send {
    /// Waits up to a tenth of a second for bytes. Returns 0 if none arrive.
    ///
    /// # Errors
    /// If either side has closed the connection.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize>;

    /// Sends all bytes, or fails within about a second.
    ///
    /// # Errors
    /// If the connection has ended or the device accepts no bytes.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;
}

/// Opens connections to a device.
pub trait Connect: Send {
    /// Connects, or fails within a few seconds.
    ///
    /// # Errors
    /// The operating system's errors.
    fn connect(&mut self) -> io::Result<Box<dyn Link>>;

    /// The user's name for the device.
    fn name(&self) -> &str;
}

/// A conversation over a connection: takes bytes, produces frames and bytes. It knows no port and reads no clock, so
/// it can be tested without either.
pub trait Dialogue: Send {
    /// Begins a new connection. Bytes to send are appended to `send`.
    fn open(&mut self, send: &mut Vec<u8>);

    /// Handles received bytes. The first of them arrived at `at`.
    ///
    /// # Errors
    /// The reason why this connection is unusable, in plain words.
    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String>;

    /// Called regularly. `open_for` is the time since the connection was made.
    ///
    /// # Errors
    /// The reason why this connection is unusable, in plain words.
    fn tick(&mut self, open_for: Duration, send: &mut Vec<u8>) -> Result<(), String>;

    /// Called before this side closes the connection.
    fn close(&mut self, send: &mut Vec<u8>);

    /// Order of the readings in a frame, once known.
    fn layout(&self) -> Option<Layout>;

    /// True if the device sends nothing but frames, so that all bytes belong to frames.
    fn is_frames_only(&self) -> bool {
        false
    }

    /// The device's description of itself, once known.
    fn identity(&self) -> Option<String> {
        None
    }
}
