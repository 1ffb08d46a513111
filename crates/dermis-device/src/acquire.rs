//! Acquisition: a thread reads a source into a bounded queue. When the pipeline is too slow, frames are dropped and
//! counted, never queued without bound. Copies of a frame, with the same number, are skipped and counted. When a
//! source fails, its error ends the queue.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::{DeviceError, Frame, Layout, RealTime, Source, SourceEvent};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, bounded};

/// How long the thread waits for a frame between checks of the stop flag.
const PATIENCE: Duration = Duration::from_millis(50);

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    dropped: AtomicU64,
    lost: AtomicU64,
    bad: AtomicU64,
    repeated: AtomicU64,
    /// Reason why no frames arrive.
    problem: Mutex<Option<String>>,
    /// Description of the unreadable part of a finished file.
    incomplete: Mutex<Option<String>>,
}

impl Shared {
    fn problem(&self) -> MutexGuard<'_, Option<String>> {
        text(&self.problem)
    }

    fn incomplete(&self) -> MutexGuard<'_, Option<String>> {
        text(&self.incomplete)
    }
}

/// A plain string, which a panic can't leave half-written.
fn text(shared: &Mutex<Option<String>>) -> MutexGuard<'_, Option<String>> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A source that a separate thread reads.
#[derive(Debug)]
pub struct Acquisition {
    frames: Receiver<Frame>,
    free: Sender<Frame>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<(), DeviceError>>>,
    is_instrument: bool,
    layout: Layout,
    name: String,
}

/// Counts of frames that were not delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AcquisitionCounters {
    /// Dropped here because the pipeline was too slow.
    pub dropped: u64,
    /// Lost before they arrived here.
    pub lost: u64,
    /// Arrived damaged.
    pub bad: u64,
    /// Skipped copies of the preceding frame, with the same number. They are no loss.
    pub repeated: u64,
}

impl AcquisitionCounters {
    /// Number of dropped, lost and bad frames. Copies aren't included.
    pub fn total(&self) -> u64 {
        self.dropped + self.lost + self.bad
    }
}

/// Result of [`Acquisition::next`].
#[derive(Debug)]
pub enum Next {
    /// A frame; give it back with [`Acquisition::recycle`].
    Frame(Frame),
    /// No frame within the timeout.
    Idle,
    /// No more frames will follow.
    End,
}

impl Acquisition {
    /// Starts reading into a queue of `capacity` frames. With `wait`, a full queue blocks the source instead of
    /// dropping frames. That is right for recordings and wrong for instruments.
    pub fn spawn(mut source: Box<dyn Source>, capacity: usize, wait: bool) -> Self {
        let capacity = capacity.max(2);
        let (filled, frames) = bounded(capacity);
        let (free, empty) = bounded(capacity + 2);
        let channels = source.channels();
        for _ in 0..capacity + 2 {
            // The queue has room for all of them.
            let _ = free.try_send(Frame::with_capacity(channels));
        }
        let shared = Arc::new(Shared::default());
        let (layout, name, is_instrument) =
            (source.layout().clone(), source.name().to_string(), source.is_instrument());
        let watched = shared.clone();
        let thread = std::thread::spawn(move || {
            let _real_time = is_instrument.then(RealTime::request);
            read(source.as_mut(), &filled, &empty, &watched, wait)
        });
        Self { frames, free, shared, thread: Some(thread), is_instrument, layout, name }
    }

    /// Layout of the frames.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Name of the source.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// As for [`Source::is_instrument`].
    pub fn is_instrument(&self) -> bool {
        self.is_instrument
    }

    /// Returns the next frame, after waiting at most `timeout`.
    ///
    /// # Errors
    /// The error that ended the source, once.
    pub fn next(&mut self, timeout: Duration) -> Result<Next, DeviceError> {
        match self.frames.recv_timeout(timeout) {
            Ok(frame) => Ok(Next::Frame(frame)),
            Err(RecvTimeoutError::Timeout) => Ok(Next::Idle),
            Err(RecvTimeoutError::Disconnected) => {
                self.join()?;
                Ok(Next::End)
            }
        }
    }

    /// Returns a frame's memory for reuse.
    pub fn recycle(&self, frame: Frame) {
        // If the queue of free frames is full, this one isn't needed.
        let _ = self.free.try_send(frame);
    }

    /// Number of frames in the queue.
    pub fn waiting(&self) -> usize {
        self.frames.len()
    }

    /// Numbers of dropped, lost, bad and repeated frames.
    pub fn counters(&self) -> AcquisitionCounters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        AcquisitionCounters {
            dropped: read(&self.shared.dropped),
            lost: read(&self.shared.lost),
            bad: read(&self.shared.bad),
            repeated: read(&self.shared.repeated),
        }
    }

    /// Reason why no frames arrive, in words, if the source knows it.
    pub fn problem(&self) -> Option<String> {
        self.shared.problem().clone()
    }

    /// Description of the unreadable part of a file, in words, once the file has ended.
    pub fn incomplete(&self) -> Option<String> {
        self.shared.incomplete().clone()
    }

    fn join(&mut self) -> Result<(), DeviceError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            // The runtime has printed the thread's panic; for the reader the source has ended.
            Some(Err(_)) | None => Ok(()),
        }
    }
}

impl Drop for Acquisition {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // A thread waiting for room must find the queue empty.
        while self.frames.try_recv().is_ok() {}
        let _ = self.join();
    }
}

fn read(
    source: &mut dyn Source,
    filled: &Sender<Frame>,
    empty: &Receiver<Frame>,
    shared: &Shared,
    wait: bool,
) -> Result<(), DeviceError> {
    let mut spare: Option<Frame> = None;
    let mut last: Option<u64> = None;
    let mut troubled = false;
    while !shared.stop.load(Ordering::Relaxed) {
        let mut frame = match spare.take() {
            Some(frame) => frame,
            None => match empty.try_recv() {
                Ok(frame) => frame,
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => Frame::with_capacity(source.channels()),
            },
        };
        let event = source.next_frame(&mut frame, PATIENCE)?;
        let counters = source.counters();
        shared.lost.store(counters.lost, Ordering::Relaxed);
        shared.bad.store(counters.bad, Ordering::Relaxed);
        match event {
            SourceEvent::Idle => {
                spare = Some(frame);
                troubled = true;
                *shared.problem() = source.problem();
            }
            SourceEvent::End => {
                *shared.incomplete() = source.incomplete();
                return Ok(());
            }
            SourceEvent::Frame if last == Some(frame.sequence) => {
                shared.repeated.fetch_add(1, Ordering::Relaxed);
                spare = Some(frame);
            }
            SourceEvent::Frame => {
                last = Some(frame.sequence);
                if std::mem::take(&mut troubled) {
                    *shared.problem() = None;
                }
                let mut pending = frame;
                loop {
                    match filled.try_send(pending) {
                        Ok(()) => break,
                        Err(error) if wait && error.is_full() && !shared.stop.load(Ordering::Relaxed) => {
                            pending = error.into_inner();
                            std::thread::sleep(Duration::from_micros(200));
                        }
                        Err(error) => {
                            shared.dropped.fetch_add(1, Ordering::Relaxed);
                            spare = Some(error.into_inner());
                            break;
                        }
                    }
                }
            }
        }
    }
    Ok(())
}
