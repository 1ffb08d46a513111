//! Listens for readers and keeps the heartbeat.

use std::io::{self, ErrorKind};
use std::net::TcpListener;
#[cfg(unix)]
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use dermis_device::HostStamp;
use dermis_skin::FileError;
use dermis_touch::guard::GuardReport;

use super::address::GuardAddress;
use super::board::Board;
use super::reader::Stream;
use crate::Error;

/// A guard's socket. Dropping it tells its readers to stop, and disconnects them.
#[derive(Debug)]
pub struct GuardSocket {
    address: GuardAddress,
    board: Arc<Mutex<Board>>,
    stop: Arc<(Mutex<bool>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

/// Publishes the verdicts on one patch.
#[derive(Clone, Debug)]
pub struct GuardPublisher {
    board: Arc<Mutex<Board>>,
    patch: usize,
}

impl GuardPublisher {
    /// Publishes the verdict on a frame. Waits for no reader.
    pub fn publish(&self, sequence: u64, report: GuardReport) {
        lock(&self.board).publish(self.patch, sequence, report, now_ns());
    }

    /// Publishes that the patch will have no more frames: `stop` from now on.
    pub fn end(&self) {
        lock(&self.board).end(self.patch, now_ns());
    }
}

impl GuardSocket {
    /// Listens at an address. Each patch has a name and its report before the first frame.
    ///
    /// # Errors
    /// The address is in use or not available, or a thread cannot be started.
    pub fn open(address: &GuardAddress, patches: &[(String, GuardReport)]) -> Result<Self, Error> {
        let failed = |source| {
            Error::Live(dermis_live::Error::Io(FileError { file: PathBuf::from(address.to_string()), source }))
        };
        let (listener, address) = Listener::open(address).map_err(failed)?;
        let board = Arc::new(Mutex::new(Board::new(patches, now_ns())));
        let stop = Arc::new((Mutex::new(false), Condvar::new()));
        let (told, stopped) = (board.clone(), stop.clone());
        let thread = std::thread::Builder::new().name("dermis-guard".to_owned());
        let thread = thread.spawn(move || serve(&listener, &told, &stopped)).map_err(failed)?;
        Ok(Self { address, board, stop, thread: Some(thread) })
    }

    /// The address, with the actual port.
    pub fn address(&self) -> &GuardAddress {
        &self.address
    }

    /// The publisher of a patch, by its index.
    pub fn publisher(&self, patch: usize) -> GuardPublisher {
        GuardPublisher { board: self.board.clone(), patch }
    }
}

impl Drop for GuardSocket {
    fn drop(&mut self) {
        let (stop, told) = &*self.stop;
        *lock(stop) = true;
        told.notify_all();
        if let Some(thread) = self.thread.take() {
            // The thread does not panic.
            let _ = thread.join();
        }
        lock(&self.board).close(now_ns());
        if let GuardAddress::Unix(path) = &self.address {
            // Another process may have removed it already.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Accepts readers and sends heartbeats until told to stop.
fn serve(listener: &Listener, board: &Mutex<Board>, stop: &(Mutex<bool>, Condvar)) {
    let (is_stopped, told) = stop;
    let mut stopped = lock(is_stopped);
    while !*stopped {
        // One per heartbeat, so that accepting never delays the verdicts.
        if let Ok(stream) = listener.accept() {
            lock(board).add(stream, now_ns());
        }
        let wait = Duration::from_nanos(lock(board).tick(now_ns()));
        (stopped, _) = told.wait_timeout(stopped, wait).unwrap_or_else(PoisonError::into_inner);
    }
}

/// A socket that readers connect to; accepting never waits.
#[derive(Debug)]
enum Listener {
    Tcp(TcpListener),
    #[cfg(unix)]
    Unix(UnixListener),
}

impl Listener {
    fn open(address: &GuardAddress) -> io::Result<(Self, GuardAddress)> {
        match address {
            GuardAddress::Tcp(address) => {
                let listener = TcpListener::bind(address)?;
                listener.set_nonblocking(true)?;
                let taken = GuardAddress::Tcp(listener.local_addr()?);
                Ok((Self::Tcp(listener), taken))
            }
            #[cfg(unix)]
            GuardAddress::Unix(path) => {
                let listener = match UnixListener::bind(path) {
                    // Left behind by a killed process: nothing listens there.
                    Err(error) if error.kind() == ErrorKind::AddrInUse && is_abandoned(path) => {
                        std::fs::remove_file(path)?;
                        UnixListener::bind(path)?
                    }
                    bound => bound?,
                };
                listener.set_nonblocking(true)?;
                Ok((Self::Unix(listener), address.clone()))
            }
            #[cfg(not(unix))]
            GuardAddress::Unix(_) => Err(ErrorKind::Unsupported.into()),
        }
    }

    fn accept(&self) -> io::Result<Stream> {
        match self {
            Self::Tcp(listener) => {
                let (stream, _) = listener.accept()?;
                stream.set_nonblocking(true)?;
                stream.set_nodelay(true)?;
                Ok(Stream::Tcp(stream))
            }
            #[cfg(unix)]
            Self::Unix(listener) => {
                let (stream, _) = listener.accept()?;
                stream.set_nonblocking(true)?;
                Ok(Stream::Unix(stream))
            }
        }
    }
}

/// True if the path is a socket that refuses connections.
#[cfg(unix)]
fn is_abandoned(path: &std::path::Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    let is_socket = std::fs::symlink_metadata(path).is_ok_and(|found| found.file_type().is_socket());
    is_socket && UnixStream::connect(path).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused)
}

fn now_ns() -> u64 {
    HostStamp::now().monotonic_ns
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
