//! Live instruments: a thread of its own reads the port, a sans-I/O [`Dialogue`] makes frames of the bytes, and a dead,
//! silent or foreign device costs nothing but its frames. Connections that end are made again, ever more slowly.

mod falling;
mod inbox;
mod link;
mod options;
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
pub use options::StreamOptions;
#[cfg(unix)]
pub use pty::Pty;
#[cfg(feature = "serial")]
pub use serial::{Port, SerialConnect, ports};
pub use tcp::TcpConnect;

use crate::{Counters, DeviceError, Frame, Layout, Source, SourceEvent};

/// A live instrument as a [`Source`].
///
/// [`Source::next_frame`] never waits longer than it is told, whatever the device does. [`Counters::lost`] holds frames
/// that the device numbered and that never came, frames that found the queue full, and, after a reset of the device, as
/// many as its rate says it would have sent meanwhile.
///
/// A stream begins with the first call of [`Source::next_frame`]: of what a device sends while its host still makes
/// ready, 32 frames wait; where there were more, the stream begins with the next frame, and nothing before that was
/// lost.
#[derive(Debug)]
pub struct StreamSource {
    name: String,
    layout: Layout,
    frames: Receiver<Frame>,
    spare: SyncSender<Frame>,
    shared: Arc<Shared>,
    ended: Receiver<()>,
    delivered: u64,
    /// Losses before the stream began, lost and bad.
    before: (u64, u64),
}

impl StreamSource {
    /// Connects and waits until the device has said how many channels it has.
    ///
    /// # Errors
    /// [`DeviceError::SourceFailed`] where that has not happened within [`StreamOptions::patience`], with the last
    /// reason.
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
                session::run(connect, dialogue, inbox, options);
                // Nobody waits for it if the source has gone already.
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

    /// The first frame is asked for. Where more came by now than were kept, those stand before a gap and are passed
    /// over.
    fn begin(&mut self) {
        if self.shared.overflowed_unasked() {
            while let Ok(frame) = self.frames.try_recv() {
                let _ = self.spare.try_send(frame);
            }
            self.before = self.shared.losses();
        }
        self.shared.set_early(false);
    }

    /// What the device says that it is.
    pub fn identity(&self) -> Option<String> {
        self.shared.identity()
    }

    /// Connections made so far, the first one included.
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

    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError> {
        if self.shared.is_early() {
            self.begin();
        }
        match self.frames.recv_timeout(timeout) {
            Ok(mut next) => {
                std::mem::swap(frame, &mut next);
                // A full queue of spare frames only means that one is not needed.
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

/// How long a source that is dropped waits for its thread to close the port.
const GOODBYE: Duration = Duration::from_millis(500);

impl Drop for StreamSource {
    fn drop(&mut self) {
        self.shared.stop();
        // A thread that hangs in the system (a name that is not resolved) ends by itself later.
        let _ = self.ended.recv_timeout(GOODBYE);
    }
}
