//! Accepts hosts of a served twin on a socket or a pseudo-terminal. No call ever blocks.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::WireDevice;
#[cfg(unix)]
use dermis_device::stream::Pty;

/// Drop a host that has accepted no data for this long.
const PATIENCE: Duration = Duration::from_secs(5);
/// Drop a host that hasn't sent a single byte for this long.
const MUTE: Duration = Duration::from_secs(5);
/// Drop a silent host that requests no frames after this time.
const IDLE: Duration = Duration::from_secs(60);
/// Maximum number of hosts on a socket at once.
const MOST_HOSTS: usize = 8;
/// Bytes per read.
const CHUNK: usize = 4096;

/// The socket or terminal to which hosts connect.
#[derive(Debug)]
pub enum Door {
    /// A socket; several hosts may connect.
    Tcp(TcpListener),
    /// A pseudo-terminal; the program that opens its other end and speaks first is the host.
    #[cfg(unix)]
    Pty(Pty),
}

impl Door {
    /// A listening socket.
    ///
    /// # Errors
    /// The error from the operating system.
    pub fn tcp(listener: TcpListener) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        Ok(Self::Tcp(listener))
    }

    /// Returns a newly connected host, if any. If all places are taken, the connection is closed.
    pub(super) fn knock(&mut self, here: usize) -> io::Result<Option<Host>> {
        match self {
            Self::Tcp(listener) => match listener.accept() {
                Ok((_, from)) if here >= MOST_HOSTS => {
                    tracing::warn!("{from} was refused: {MOST_HOSTS} hosts are connected");
                    Ok(None)
                }
                Ok((stream, from)) => {
                    tracing::debug!("{from} has connected");
                    stream.set_nonblocking(true)?;
                    stream.set_nodelay(true)?;
                    Ok(Some(Host::new(Some(stream), Vec::new())))
                }
                // Nobody connected, or the connection was aborted again.
                Err(error) if is_passing(error.kind()) || error.kind() == ErrorKind::ConnectionAborted => Ok(None),
                Err(error) => Err(error),
            },
            #[cfg(unix)]
            Self::Pty(_) if here > 0 => Ok(None),
            #[cfg(unix)]
            Self::Pty(pty) => {
                let mut buffer = [0; CHUNK];
                match pty.read(&mut buffer) {
                    Ok(count) => Ok((count > 0).then(|| Host::new(None, buffer[..count].to_vec()))),
                    Err(error) if is_passing(error.kind()) || error.kind() == ErrorKind::NotConnected => Ok(None),
                    Err(error) => Err(error),
                }
            }
        }
    }
}

fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::TimedOut)
}

/// A connected host.
#[derive(Debug)]
pub(super) struct Host {
    /// Its own connection; `None` if it talks through the pseudo-terminal.
    stream: Option<TcpStream>,
    /// Bytes received before the host was accepted.
    said: Vec<u8>,
    /// Bytes not yet sent.
    waiting: Vec<u8>,
    /// Time of the last successful write.
    took: Instant,
    /// Time of the last received byte; `None` before the first.
    spoke: Option<Instant>,
    since: Instant,
    gone: bool,
}

impl Host {
    fn new(stream: Option<TcpStream>, said: Vec<u8>) -> Self {
        let now = Instant::now();
        let spoke = (!said.is_empty()).then_some(now);
        Self { stream, said, waiting: Vec::new(), took: now, spoke, since: now, gone: false }
    }

    /// True if the host should be disconnected: it has never sent anything, or it has long been silent and takes no
    /// frames.
    pub(super) fn is_mute(&self, device: &WireDevice) -> bool {
        let mute = match self.spoke {
            None => self.since.elapsed() > MUTE,
            Some(spoke) => !device.wants_frames() && spoke.elapsed() > IDLE,
        };
        if mute {
            tracing::warn!("a host was disconnected: it sent nothing for {:.0} s", self.since.elapsed().as_secs_f64());
        }
        mute
    }

    /// Number of bytes not yet sent.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Reads from the host and answers it; returns false once the host has gone.
    pub(super) fn serve(&mut self, door: &mut Door, device: &mut WireDevice) -> bool {
        device.receive(&std::mem::take(&mut self.said), &mut self.waiting);
        let mut buffer = [0; CHUNK];
        match self.line(door).map(|line| line.read(&mut buffer)) {
            Some(Ok(count)) if count > 0 => {
                self.spoke = Some(Instant::now());
                device.receive(&buffer[..count], &mut self.waiting);
            }
            Some(Err(error)) if is_passing(error.kind()) => {}
            _ => self.gone = true,
        }
        self.flush(door);
        !self.gone
    }

    /// Sends the bytes that `fill` appends, as far as the host accepts them.
    pub(super) fn send(&mut self, door: &mut Door, fill: impl FnOnce(&mut Vec<u8>)) {
        fill(&mut self.waiting);
        self.flush(door);
    }

    fn line<'l>(&'l mut self, door: &'l mut Door) -> Option<&'l mut dyn Line> {
        match (&mut self.stream, door) {
            (Some(stream), _) => Some(stream),
            #[cfg(unix)]
            (None, Door::Pty(pty)) => Some(pty),
            (None, Door::Tcp(_)) => None,
        }
    }

    fn flush(&mut self, door: &mut Door) {
        if self.waiting.is_empty() {
            self.took = Instant::now();
            return;
        }
        let waiting = std::mem::take(&mut self.waiting);
        let written = self.line(door).map(|line| line.write(&waiting));
        self.waiting = waiting;
        match written {
            Some(Ok(count)) => {
                self.waiting.drain(..count);
                self.took = Instant::now();
            }
            Some(Err(error)) if is_passing(error.kind()) => self.gone |= self.took.elapsed() > PATIENCE,
            _ => self.gone = true,
        }
    }
}

/// A stream that can be read and written.
trait Line: Read + Write {}

impl<T: Read + Write> Line for T {}
