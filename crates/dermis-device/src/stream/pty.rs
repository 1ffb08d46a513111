//! A pseudo-terminal: a serial line within this machine, with a program in place of the board.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};

use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// The board's end of a pseudo-terminal. Nothing here blocks. Reading and writing fail with [`ErrorKind::WouldBlock`]
/// if there are no bytes or no room for them, and with [`ErrorKind::NotConnected`] while the other end isn't open.
#[derive(Debug)]
pub struct Pty {
    master: File,
    path: String,
}

impl Pty {
    /// Opens a new pseudo-terminal.
    ///
    /// # Errors
    /// The operating system's errors.
    pub fn open() -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
        let path = ptsname(&master, Vec::new())?.into_string();
        let path = path.map_err(|_| io::Error::new(ErrorKind::InvalidData, "the terminal's path is not UTF-8"))?;
        // The system only reports a missing peer after the other end has been open once.
        drop(open(path.as_str(), OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?);
        Ok(Self { master: File::from(master), path })
    }

    /// Path of the other end, which programs open as a serial port.
    pub fn path(&self) -> &str {
        &self.path
    }
}

/// Translates the system's error for an unopened other end.
fn told(result: io::Result<usize>) -> io::Result<usize> {
    let is_alone = |error: &io::Error| error.raw_os_error() == Some(rustix::io::Errno::IO.raw_os_error());
    match result {
        Err(error) if is_alone(&error) => Err(ErrorKind::NotConnected.into()),
        other => other,
    }
}

impl Read for Pty {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        told(self.master.read(buffer))
    }
}

impl Write for Pty {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        told(self.master.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
