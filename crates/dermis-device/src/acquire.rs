//! Acquisition: a thread that reads a source into a bounded queue. When the pipeline is too slow, frames are dropped
//! and counted, never queued without bound; copies of a frame, which have its number, are left out and counted; a
//! source that fails ends the queue with its error.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::{DeviceError, Frame, Layout, Source, SourceEvent};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, bounded};

/// How long the thread waits for a frame before it looks whether it should stop.
const PATIENCE: Duration = Duration::from_millis(50);

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    dropped: AtomicU64,
    lost: AtomicU64,
    bad: AtomicU64,
    repeated: AtomicU64,
    /// Why no frames come.
    problem: Mutex<Option<String>>,
    /// What could not be read of a file that has ended.
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

/// A text that no panic leaves half written.
fn text(shared: &Mutex<Option<String>>) -> MutexGuard<'_, Option<String>> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A source being read by a thread of its own.
#[derive(Debug)]
pub struct Acquisition {
    frames: Receiver<Frame>,
    free: Sender<Frame>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Result<(), DeviceError>>>,
    layout: Layout,
    name: String,
}

/// What became of the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AcquisitionCounters {
    /// Dropped here, because the pipeline was too slow.
    pub dropped: u64,
    /// Lost before they came here.
    pub lost: u64,
    /// Damaged on the way.
    pub bad: u64,
    /// Copies of the frame before, with its number, that were left out. Nothing is lost with them.
    pub repeated: u64,
}

impl AcquisitionCounters {
    /// Frames that did not make it, for whatever reason; copies are not among them.
    pub fn total(&self) -> u64 {
        self.dropped + self.lost + self.bad
    }
}

/// What [`Acquisition::next`] came back with.
#[derive(Debug)]
pub enum Next {
    /// A frame; give it back with [`Acquisition::recycle`].
    Frame(Frame),
    /// None within the time.
    Idle,
    /// There will be no more.
    End,
}

impl Acquisition {
    /// Starts reading into a queue of `capacity` frames. With `wait` a full queue holds the source up instead of
    /// dropping frames: right for recordings, wrong for instruments.
    pub fn spawn(mut source: Box<dyn Source>, capacity: usize, wait: bool) -> Self {
        let capacity = capacity.max(2);
        let (filled, frames) = bounded(capacity);
        let (free, empty) = bounded(capacity + 2);
        let channels = source.channels();
        for _ in 0..capacity + 2 {
            // The queue was made for as many.
            let _ = free.try_send(Frame::with_capacity(channels));
        }
        let shared = Arc::new(Shared::default());
        let (layout, name) = (source.layout().clone(), source.name().to_string());
        let watched = shared.clone();
        let thread = std::thread::spawn(move || read(source.as_mut(), &filled, &empty, &watched, wait));
        Self { frames, free, shared, thread: Some(thread), layout, name }
    }

    /// Layout of the frames.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Name of the source.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The next frame, waiting at most `timeout`.
    ///
    /// # Errors
    /// What ended the source, once.
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

    /// Gives a frame's memory back.
    pub fn recycle(&self, frame: Frame) {
        // A full queue of free frames only means that one is not needed.
        let _ = self.free.try_send(frame);
    }

    /// Frames that wait for the pipeline now.
    pub fn waiting(&self) -> usize {
        self.frames.len()
    }

    /// Frames dropped and lost so far.
    pub fn counters(&self) -> AcquisitionCounters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        AcquisitionCounters {
            dropped: read(&self.shared.dropped),
            lost: read(&self.shared.lost),
            bad: read(&self.shared.bad),
            repeated: read(&self.shared.repeated),
        }
    }

    /// Why no frames come now, in words, where the source knows.
    pub fn problem(&self) -> Option<String> {
        self.shared.problem().clone()
    }

    /// What could not be read of a file, in words, once it has ended.
    pub fn incomplete(&self) -> Option<String> {
        self.shared.incomplete().clone()
    }

    fn join(&mut self) -> Result<(), DeviceError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            // The thread's panic has been printed by the runtime; for the reader the source has ended.
            Some(Err(_)) | None => Ok(()),
        }
    }
}

impl Drop for Acquisition {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        // A thread that waits for room must find the queue emptied.
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
