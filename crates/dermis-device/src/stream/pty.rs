//! A pseudo-terminal: a serial line of this machine, at whose other end a program stands instead of a board.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};

use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// The board's end of a pseudo-terminal. Nothing here blocks: without bytes, or without room for them, reading and
/// writing end with [`ErrorKind::WouldBlock`], and while nobody has the other end open with
/// [`ErrorKind::NotConnected`].
#[derive(Debug)]
pub struct Pty {
    master: File,
    path: String,
}

impl Pty {
    /// A new one.
    ///
    /// # Errors
    /// What the system says.
    pub fn open() -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        fcntl_setfl(&master, fcntl_getfl(&master)? | OFlags::NONBLOCK)?;
        let path = ptsname(&master, Vec::new())?.into_string();
        let path = path.map_err(|_| io::Error::new(ErrorKind::InvalidData, "the terminal's path is no text"))?;
        // Before the other end has been open once, the system would not say that nobody is there.
        drop(open(path.as_str(), OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?);
        Ok(Self { master: File::from(master), path })
    }

    /// The path at which programs open the other end, as a serial port.
    pub fn path(&self) -> &str {
        &self.path
    }
}

/// The system's error while nobody has the other end open.
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
