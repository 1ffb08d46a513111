//! Serves a twin to the process itself, for commands that talk to instruments but are given a twin.

use std::net::{Ipv4Addr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

use dermis_device::{Instrument, SourceSelector};

use super::Door;
use super::server::{device_info, serve};
use crate::Error;
use crate::twin_source::TwinSource;
use dermis_skin::{FileError, Skin};

/// A twin behind a loopback socket; stops when dropped.
#[derive(Debug)]
pub struct Background {
    selector: SourceSelector,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Background {
    /// Starts serving the twin of a skin.
    ///
    /// # Errors
    /// The skin has no twin, or the operating system refuses a socket.
    pub fn start(skin: &Skin) -> Result<Self, Error> {
        let failed = |source| Error::Live(dermis_live::Error::Io(FileError { file: "loopback socket".into(), source }));
        let (twin, _) = TwinSource::new(skin)?;
        let info = device_info(skin)?;
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(failed)?;
        let port = listener.local_addr().map_err(failed)?.port();
        let mut door = Door::tcp(listener).map_err(failed)?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            if let Err(error) = serve(&mut door, twin, info, None, &stopped) {
                tracing::error!("{error}");
            }
        });
        let host = Ipv4Addr::LOCALHOST.to_string();
        let selector = SourceSelector::Tcp { host, port, instrument: Instrument::Wire };
        Ok(Self { selector, stop, thread: Some(thread) })
    }

    /// The selector that reaches the twin.
    pub fn selector(&self) -> &SourceSelector {
        &self.selector
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // The runtime has already printed its panic.
            let _ = thread.join();
        }
    }
}
