//! TCP connections to instruments that listen.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use super::{Connect, Link};

const CONNECT: Duration = Duration::from_secs(1);
const READ: Duration = Duration::from_millis(50);
const WRITE: Duration = Duration::from_secs(1);

/// Connects to `host:port`.
#[derive(Debug, Clone)]
pub struct TcpConnect {
    name: String,
    host: String,
    port: u16,
}

impl TcpConnect {
    /// Connects to a host, given by name or address without brackets.
    pub fn new(name: impl Into<String>, host: impl Into<String>, port: u16) -> Self {
        Self { name: name.into(), host: host.into(), port }
    }
}

impl Connect for TcpConnect {
    fn connect(&mut self) -> io::Result<Box<dyn Link>> {
        let mut last = io::Error::new(ErrorKind::NotFound, "the host has no address");
        for address in (self.host.as_str(), self.port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT) {
                Ok(stream) => {
                    stream.set_read_timeout(Some(READ))?;
                    stream.set_write_timeout(Some(WRITE))?;
                    stream.set_nodelay(true)?;
                    return Ok(Box::new(TcpLink(stream)));
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn name(&self) -> &str {
        &self.name
    }
}

struct TcpLink(TcpStream);

impl Link for TcpLink {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.0.read(buffer) {
            Ok(0) => Err(io::Error::new(ErrorKind::UnexpectedEof, "closed by the device")),
            other => nothing_yet(other),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }
}

/// A timeout or a signal doesn't end the connection.
pub(super) fn nothing_yet(result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
            Ok(0)
        }
        other => other,
    }
}
