//! Live instruments. A separate thread reads the port, and a sans-I/O [`Dialogue`] turns the bytes into frames. A
//! dead, silent or foreign device only costs its frames. Lost connections are retried at increasing intervals.

mod inbox;
mod link;
#[cfg(unix)]
mod pty;
mod session;
mod tcp;

#[cfg(feature = "serial")]
mod serial;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

pub use inbox::Inbox;
use inbox::Shared;
pub use link::{Connect, Dialogue, Link};
#[cfg(unix)]
pub use pty::Pty;
#[cfg(feature = "serial")]
pub use serial::{Port, SerialConnect, ports};
pub use session::StreamOptions;
pub use tcp::TcpConnect;

use crate::{Counters, DeviceError, Frame, Layout, RealTime, Source, SourceEvent};

/// A live instrument as a [`Source`].
///
/// [`Source::next_frame`] never waits longer than its timeout, whatever the device does. [`Counters::lost`] includes
/// numbered frames that never arrived, and frames dropped because the queue was full. After a device reset it also
/// includes an estimate from the frame rate for the time without frames.
///
/// A stream begins with the first call of [`Source::next_frame`]. Until then, 32 frames are kept. If the device sends
/// more while the host is starting up, the stream begins with the next frame, and no earlier frame counts as lost.
#[derive(Debug)]
pub struct StreamSource {
    name: String,
    layout: Layout,
    frames: Receiver<Frame>,
    spare: SyncSender<Frame>,
    shared: Arc<Shared>,
    ended: Receiver<()>,
    delivered: u64,
    /// Lost and bad frames before the stream began.
    before: (u64, u64),
}

impl StreamSource {
    /// Connects, and waits for the device to report its number of channels.
    ///
    /// # Errors
    /// [`DeviceError::SourceFailed`] with the last reason if that takes longer than [`StreamOptions::patience`].
    pub fn open(
        connect: Box<dyn Connect>,
        dialogue: Box<dyn Dialogue>,
        options: StreamOptions,
    ) -> Result<Self, DeviceError> {
        let name = connect.name().to_owned();
        let (inbox, frames, spare) = Inbox::new(options.queue);
        let shared = inbox.shared();
        shared.set_early(true);
        let (ending, ended) = sync_channel(1);
        let failed = |reason: String| DeviceError::SourceFailed { name: name.clone(), reason };
        thread::Builder::new()
            .name(format!("read {name}"))
            .spawn(move || {
                let _real_time = RealTime::request();
                session::run(connect, dialogue, inbox, options);
                // The source may be gone already.
                let _ = ending.try_send(());
            })
            .map_err(|error| failed(format!("no thread to read it: {error}")))?;
        match shared.wait_for_layout(Instant::now() + options.patience) {
            Ok(layout) => Ok(Self { name, layout, frames, spare, shared, ended, delivered: 0, before: (0, 0) }),
            Err(reason) => {
                shared.stop();
                Err(failed(reason))
            }
        }
    }

    /// Handles the first request for a frame. If frames have been discarded, those still in the queue precede a gap
    /// and are skipped.
    fn begin(&mut self) {
        if self.shared.overflowed_unasked() {
            while let Ok(frame) = self.frames.try_recv() {
                let _ = self.spare.try_send(frame);
            }
            self.before = self.shared.losses();
        }
        self.shared.set_early(false);
    }

    /// The device's description of itself.
    pub fn identity(&self) -> Option<String> {
        self.shared.identity()
    }

    /// Number of connections made, including the first.
    pub fn connections(&self) -> u64 {
        self.shared.connections()
    }
}

impl Source for StreamSource {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn is_instrument(&self) -> bool {
        true
    }

    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError> {
        if self.shared.is_early() {
            self.begin();
        }
        match self.frames.recv_timeout(timeout) {
            Ok(mut next) => {
                std::mem::swap(frame, &mut next);
                // If the queue of spare frames is full, this one isn't needed.
                let _ = self.spare.try_send(next);
                self.delivered += 1;
                Ok(SourceEvent::Frame)
            }
            Err(RecvTimeoutError::Timeout) => Ok(SourceEvent::Idle),
            Err(RecvTimeoutError::Disconnected) => {
                let reason = self.shared.problem().unwrap_or_else(|| "its reader has ended".to_owned());
                Err(DeviceError::SourceFailed { name: self.name.clone(), reason })
            }
        }
    }

    fn counters(&self) -> Counters {
        let (lost, bad) = self.shared.losses();
        Counters { frames: self.delivered, lost: lost - self.before.0, bad: bad - self.before.1 }
    }

    fn problem(&self) -> Option<String> {
        self.shared.problem()
    }
}

/// How long dropping a source waits for its thread to close the port.
const GOODBYE: Duration = Duration::from_millis(500);

impl Drop for StreamSource {
    fn drop(&mut self) {
        self.shared.stop();
        // A thread that hangs in a system call (for instance in name resolution) ends by itself later.
        let _ = self.ended.recv_timeout(GOODBYE);
    }
}
