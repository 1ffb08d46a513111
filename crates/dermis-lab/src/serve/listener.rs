//! Where hosts of a served twin come in: a socket, or a pseudo-terminal. Neither ever waits.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::WireDevice;
#[cfg(unix)]
use dermis_device::stream::Pty;

/// A host that takes nothing for so long has gone.
const PATIENCE: Duration = Duration::from_secs(5);
/// A host that says nothing at all for so long is none.
const MUTE: Duration = Duration::from_secs(5);
/// A host that asks for no frames may be silent for so long.
const IDLE: Duration = Duration::from_secs(60);
/// Hosts at a socket at once.
const MOST_HOSTS: usize = 8;
/// Bytes taken at once.
const CHUNK: usize = 4096;

/// Where hosts come in.
#[derive(Debug)]
pub enum Door {
    /// A socket; hosts connect, a few at a time.
    Tcp(TcpListener),
    /// A pseudo-terminal; whoever opens its other end and speaks is the host.
    #[cfg(unix)]
    Pty(Pty),
}

impl Door {
    /// A socket that listens.
    ///
    /// # Errors
    /// What the system says.
    pub fn tcp(listener: TcpListener) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        Ok(Self::Tcp(listener))
    }

    /// A host that has come; where so many are here already that there is no room, it is sent away.
    pub(super) fn knock(&mut self, here: usize) -> io::Result<Option<Host>> {
        match self {
            Self::Tcp(listener) => match listener.accept() {
                Ok((_, from)) if here >= MOST_HOSTS => {
                    tracing::warn!("{from} was sent away: {MOST_HOSTS} hosts are connected");
                    Ok(None)
                }
                Ok((stream, from)) => {
                    tracing::debug!("{from} has connected");
                    stream.set_nonblocking(true)?;
                    stream.set_nodelay(true)?;
                    Ok(Some(Host::new(Some(stream), Vec::new())))
                }
                // Whoever knocked has gone again, or nobody did.
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

/// The connected host.
#[derive(Debug)]
pub(super) struct Host {
    /// Its own connection; none where the door is the line.
    stream: Option<TcpStream>,
    /// What it said before it was taken for a host.
    said: Vec<u8>,
    /// Bytes not sent yet.
    waiting: Vec<u8>,
    /// When it last took any.
    took: Instant,
    /// When it last said anything; none before its first word.
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

    /// Whether it holds a place for nothing: it has never said a word, or none for long and takes no frames.
    pub(super) fn is_mute(&self, device: &WireDevice) -> bool {
        let mute = match self.spoke {
            None => self.since.elapsed() > MUTE,
            Some(spoke) => !device.wants_frames() && spoke.elapsed() > IDLE,
        };
        if mute {
            tracing::warn!("a host was sent away: it said nothing for {:.0} s", self.since.elapsed().as_secs_f64());
        }
        mute
    }

    /// Bytes that it has not taken yet.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Hears and answers; false when the host has gone.
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

    /// Sends what `fill` appends, as far as the host takes it.
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

/// Something to read and write.
trait Line: Read + Write {}

impl<T: Read + Write> Line for T {}
