//! A bounded queue and a thread in front of a [`Recorder`] or another [`LiveWriter`], so that a slow or full disk, or
//! a slow viewer, never delays the pipeline. Frames that don't fit are dropped and counted, and errors are kept until
//! someone asks for them.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded, select};
use dermis_device::{Frame, leave_real_time};
use dermis_skin::FileError;
use dermis_touch::ReferenceRecord;

use super::live_writer::{BaselineNews, LiveWriter, TouchBatch};
use super::shared_file::FLUSH_INTERVAL;
use super::view::SkinView;
use super::writer::{Recorder, RecordingSummary};
use crate::Error;
use dermis_live::skin_frame::SkinFrame;

/// Room for baselines and events, which are rare, in addition to frames and touches.
const RARE: usize = 64;

/// Images that may wait. They can be recomputed from the recording, so skipping one is no loss.
const IMAGES: usize = 16;

/// Status of a recording in progress.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecorderStatus {
    /// Frames encoded. Those of the last half second may still be in memory.
    pub written: u64,
    /// Frames that were offered but not recorded because the queue was full or the recording has stopped. In the
    /// latter case this includes frames that were still in memory.
    pub dropped: u64,
    /// The error that stopped the recording, if any.
    pub error: Option<String>,
}

/// Content of the queue.
enum Item {
    Frame(Frame),
    Touches(TouchBatch),
    Image { wall_ns: u64, image: Vec<f32> },
    Baseline(BaselineNews),
    Event { wall_ns: u64, event: String, detail: String, values: Vec<f64> },
}

/// Counts shared with the writing thread.
#[derive(Default)]
struct Shared {
    offered: AtomicU64,
    refused: Arc<AtomicU64>,
    written: AtomicU64,
    safe: AtomicU64,
    error: OnceLock<String>,
}

/// A recording written by a separate thread.
///
/// Offering a frame copies it into reused memory and never waits. Dropping the handle finishes the recording like
/// [`RecorderHandle::finish`], except that errors go to the log.
pub struct RecorderHandle {
    items: Option<Sender<Item>>,
    free_frames: Receiver<Frame>,
    free_touches: Receiver<TouchBatch>,
    free_images: Receiver<Vec<f32>>,
    view: Option<SkinView>,
    /// Time of the next image, on the frames' clock.
    image_due_ns: u64,
    shared: Arc<Shared>,
    stop: RecordingStop,
    thread: Option<JoinHandle<Result<RecordingSummary, Error>>>,
}

/// Ends a recording from any thread, even if the pipeline is stuck: the queue is written and the file completed. Frames
/// offered after that are refused.
#[derive(Clone, Debug)]
pub struct RecordingStop {
    ask: Sender<()>,
    /// Closed once the recording has ended.
    ended: Receiver<()>,
}

impl RecordingStop {
    /// Asks for the end without waiting for it.
    pub fn ask(&self) {
        // One request is enough.
        let _ = self.ask.try_send(());
    }

    /// Waits for the end, at most `most`; returns false if it hasn't come by then.
    pub fn wait(&self, most: Duration) -> bool {
        !matches!(self.ended.recv_timeout(most), Err(RecvTimeoutError::Timeout))
    }

    /// True if the recording has ended.
    pub fn has_ended(&self) -> bool {
        self.wait(Duration::ZERO)
    }
}

impl std::fmt::Debug for RecorderHandle {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("RecorderHandle").field("status", &self.status()).finish_non_exhaustive()
    }
}

impl RecorderHandle {
    /// Starts the thread. `capacity` frames, at least 1, can wait: a second's worth bridges a disk's usual pauses.
    ///
    /// # Errors
    /// An I/O error if the operating system refuses a thread.
    pub fn spawn(recorder: Recorder, capacity: usize) -> Result<Self, Error> {
        let name = recorder.path().display().to_string();
        Self::spawn_writer(recorder, &name, capacity)
    }

    /// Like [`RecorderHandle::spawn`], for any writer; `name` is only used in messages.
    pub(super) fn spawn_writer(mut recorder: impl LiveWriter, name: &str, capacity: usize) -> Result<Self, Error> {
        let capacity = capacity.max(1);
        let (items, queue) = bounded(2 * capacity + IMAGES + RARE);
        let (return_frame, free_frames) = bounded(capacity);
        let (return_touches, free_touches) = bounded(capacity);
        let (return_image, free_images) = bounded(IMAGES);
        for _ in 0..capacity {
            // The channels were made with room for exactly these.
            let _ = return_frame.try_send(Frame::default());
            let _ = return_touches.try_send(TouchBatch::default());
        }
        for _ in 0..IMAGES {
            let _ = return_image.try_send(Vec::new());
        }
        let view = recorder.view().cloned();
        let shared = Arc::new(Shared::default());
        recorder.watch(&shared.refused);
        let (ask, asked) = bounded(1);
        let (ending, ended) = bounded(0);
        let stop = RecordingStop { ask: ask.clone(), ended };
        let shared_there = shared.clone();
        let writer = WriterThread {
            recorder,
            queue,
            return_frame,
            return_touches,
            return_image,
            asked,
            _ask: ask,
            shared: shared_there,
        };
        let thread = thread::Builder::new().name("dermis-recorder".to_owned()).spawn(move || {
            leave_real_time();
            let result = writer.run();
            drop::<Sender<()>>(ending);
            result
        });
        let thread = Some(thread.map_err(Error::io(name))?);
        let image_due_ns = 0;
        Ok(Self {
            items: Some(items),
            free_frames,
            free_touches,
            free_images,
            view,
            image_due_ns,
            shared,
            stop,
            thread,
        })
    }

    /// Queues a raw frame; returns false if it is dropped because the queue is full or the recording has stopped.
    pub fn offer(&self, frame: &Frame) -> bool {
        self.shared.offered.fetch_add(1, Ordering::Relaxed);
        let queued = self.free_frames.try_recv().is_ok_and(|mut copy| {
            copy.clone_from(frame);
            self.send(Item::Frame(copy))
        });
        if !queued {
            self.shared.refused.fetch_add(1, Ordering::Relaxed);
        }
        queued
    }

    /// Queues the results of a frame: its touches, if it has any or one ended, and its image, if one is due at
    /// `time_ns` on the frames' clock. Results that don't fit are left out, since they can be recomputed from the
    /// frame.
    pub fn offer_results(&mut self, output: &SkinFrame<'_>, time_ns: u64) {
        let wall_ns = output.wall_ns;
        if TouchBatch::is_due(output)
            && let Ok(mut batch) = self.free_touches.try_recv()
        {
            batch.fill(output);
            self.send(Item::Touches(batch));
        }
        let Some(view) = &self.view else { return };
        // A clock that is set back must not stop the images.
        let due = time_ns >= self.image_due_ns || time_ns.saturating_add(view.period_ns()) < self.image_due_ns;
        if due
            && output.image.iter().any(|value| value.is_finite())
            && let Ok(mut image) = self.free_images.try_recv()
        {
            self.image_due_ns = time_ns.saturating_add(view.period_ns());
            image.clear();
            image.extend_from_slice(&output.image);
            self.send(Item::Image { wall_ns, image });
        }
    }

    /// Queues a baseline that came into use at `wall_ns`, with the noise of its channels and the lambda of its images,
    /// if known; returns false if it is dropped.
    pub fn offer_baseline(
        &self,
        wall_ns: u64,
        record: &ReferenceRecord,
        values: &[f64],
        noise_std: &[f64],
        hyperparameter: Option<f64>,
    ) -> bool {
        let (values, noise_std) = (values.to_vec(), noise_std.to_vec());
        self.send(Item::Baseline(BaselineNews { wall_ns, record: record.clone(), values, noise_std, hyperparameter }))
    }

    /// Queues an event before the next frame: its name, a description and its numbers. Returns false if it is
    /// dropped.
    pub fn offer_event(&self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> bool {
        let (event, detail, values) = (event.to_owned(), detail.to_owned(), values.to_vec());
        self.send(Item::Event { wall_ns, event, detail, values })
    }

    /// Numbers of frames written and lost.
    #[must_use]
    pub fn status(&self) -> RecorderStatus {
        let error = self.shared.error.get().cloned();
        RecorderStatus {
            written: self.shared.written.load(Ordering::Relaxed),
            dropped: self.shared.dropped(error.is_some()),
            error,
        }
    }

    /// Returns a function that gives the numbers of saved and lost frames after [`RecorderHandle::finish`], even if the
    /// recording failed.
    pub(super) fn watch(&self) -> impl FnOnce() -> (u64, u64) + use<> {
        let shared = self.shared.clone();
        move || (shared.safe.load(Ordering::Relaxed), shared.dropped(true))
    }

    /// A handle that ends the recording from elsewhere.
    pub fn stop(&self) -> RecordingStop {
        self.stop.clone()
    }

    /// Writes the queue, ends the recording and gives it its final name.
    ///
    /// # Errors
    /// The error that stopped the recording, if one did.
    pub fn finish(mut self) -> Result<RecordingSummary, Error> {
        self.join().unwrap_or_else(|| Ok(RecordingSummary::default()))
    }

    fn send(&self, item: Item) -> bool {
        let Some(items) = &self.items else { return false };
        match items.try_send(item) {
            Ok(()) => true,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
        }
    }

    /// Joins the thread, once.
    fn join(&mut self) -> Option<Result<RecordingSummary, Error>> {
        self.items = None;
        let result = self.thread.take()?.join();
        Some(result.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    }
}

impl Drop for RecorderHandle {
    fn drop(&mut self) {
        if thread::panicking() {
            self.items = None;
            return;
        }
        if let Some(Err(error)) = self.join() {
            tracing::error!("recording lost: {error}");
        }
    }
}

impl Shared {
    /// Frames lost. Once the recording has stopped, this includes those in the queue.
    fn dropped(&self, stopped: bool) -> u64 {
        if stopped {
            let safe = self.safe.load(Ordering::Relaxed);
            return self.offered.load(Ordering::Relaxed).saturating_sub(safe);
        }
        self.refused.load(Ordering::Relaxed)
    }
}

/// State of the writing thread.
struct WriterThread<W> {
    recorder: W,
    queue: Receiver<Item>,
    return_frame: Sender<Frame>,
    return_touches: Sender<TouchBatch>,
    return_image: Sender<Vec<f32>>,
    /// Requests to end the recording, and a sender that keeps the channel open.
    asked: Receiver<()>,
    _ask: Sender<()>,
    shared: Arc<Shared>,
}

impl<W: LiveWriter> WriterThread<W> {
    fn run(mut self) -> Result<RecordingSummary, Error> {
        let shared = self.shared.clone();
        let drained = self.drain();
        let [frames, safe] = self.recorder.taken_and_safe();
        shared.safe.store(safe, Ordering::Relaxed);
        let result = drained.and_then(|()| self.recorder.finish(shared.dropped(false)));
        // A file whose name was taken meanwhile is complete under its partial name.
        if let Err(Error::Live(dermis_live::Error::Io(FileError { source, .. }))) = &result
            && source.kind() == std::io::ErrorKind::AlreadyExists
        {
            shared.safe.store(frames, Ordering::Relaxed);
        }
        // Close the queue first, so that anyone who sees the error is refused from then on.
        drop(self.queue);
        if let Err(error) = &result {
            let _ = shared.error.set(error.to_string());
        }
        result
    }

    /// Writes until the handle hangs up or someone asks for the end.
    fn drain(&mut self) -> Result<(), Error> {
        loop {
            let item = select! {
                recv(self.queue) -> item => item.map(Some),
                recv(self.asked) -> _ => {
                    while let Ok(item) = self.queue.try_recv() {
                        self.write(item)?;
                    }
                    return Ok(());
                }
                default(FLUSH_INTERVAL) => Ok(None),
            };
            match item {
                Ok(Some(item)) => self.write(item)?,
                Ok(None) => self.recorder.rest()?,
                Err(_) => return Ok(()),
            }
        }
    }

    fn write(&mut self, item: Item) -> Result<(), Error> {
        match item {
            Item::Frame(frame) => {
                self.recorder.frame(&frame)?;
                self.shared.written.fetch_add(1, Ordering::Relaxed);
                let _ = self.return_frame.try_send(frame);
            }
            Item::Touches(batch) => {
                self.recorder.touches(&batch)?;
                let _ = self.return_touches.try_send(batch);
            }
            Item::Image { wall_ns, image } => {
                self.recorder.image(wall_ns, &image)?;
                let _ = self.return_image.try_send(image);
            }
            Item::Baseline(baseline) => self.recorder.baseline(&baseline)?,
            Item::Event { wall_ns, event, detail, values } => {
                self.recorder.event(wall_ns, &event, &detail, &values)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{self, Write};
    use std::path::PathBuf;
    use std::sync::Mutex;

    use dermis_device::Layout;

    use super::super::file::Destination;
    use super::super::{Recorder, Recording, RecordingHead};
    use super::*;

    /// A disk with limited space that can be made to hang.
    #[derive(Clone)]
    struct Disk {
        room: usize,
        content: Arc<Mutex<Vec<u8>>>,
        complete: Arc<OnceLock<()>>,
    }

    impl Disk {
        fn new(room: usize) -> Self {
            Self { room, content: Arc::default(), complete: Arc::default() }
        }

        fn recorder(&self, channels: usize) -> Recorder {
            let head = RecordingHead::new("name = \"a\"\n", Layout::Channels { count: channels }, "test");
            Recorder::new(Box::new(self.clone()), PathBuf::from("disk.mcap"), &head).unwrap()
        }

        fn sequences(&self) -> Vec<u64> {
            let content = self.content.lock().unwrap().clone();
            let mut recording = Recording::from_reader(io::Cursor::new(content), "disk.mcap").unwrap();
            recording.frames().map(|frame| frame.unwrap().sequence).collect()
        }
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut content = self.content.lock().unwrap();
            let fits = bytes.len().min(self.room - content.len());
            if fits == 0 && !bytes.is_empty() {
                return Err(io::ErrorKind::StorageFull.into());
            }
            content.extend_from_slice(&bytes[..fits]);
            Ok(fits)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Destination for Disk {
        fn complete(self: Box<Self>) -> io::Result<()> {
            let _ = self.complete.set(());
            Ok(())
        }
    }

    fn frame(sequence: u64, channels: usize) -> Frame {
        // Random digits that don't compress, so that chunks fill up.
        let mut state = sequence.wrapping_add(1);
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64
        };
        Frame { sequence, values: (0..channels).map(|_| next()).collect(), ..Frame::default() }
    }

    #[test]
    fn rows_that_fit_are_written_and_the_file_completed() {
        let disk = Disk::new(1 << 24);
        let handle = RecorderHandle::spawn(disk.recorder(3), 100).unwrap();
        assert!((0..100).all(|sequence| handle.offer(&frame(sequence, 3))));
        assert_eq!(handle.finish().unwrap(), RecordingSummary { frames: 100, dropped: 0 });
        assert!(disk.complete.get().is_some());
        assert_eq!(disk.sequences(), (0..100).collect::<Vec<_>>());
    }

    #[test]
    fn a_disk_that_hangs_costs_frames_and_not_time() {
        let disk = Disk::new(1 << 26);
        let recorder = disk.recorder(1000);
        let handle = RecorderHandle::spawn(recorder, 4).unwrap();
        let held = disk.content.lock().unwrap();
        // More than fits into a chunk and the queue together; if an offer waited, this would never end.
        let kept = (0..1000).filter(|&sequence| handle.offer(&frame(sequence, 1000))).count() as u64;
        assert!(kept < 1000);
        assert_eq!(handle.status().dropped, 1000 - kept);
        drop(held);
        let summary = handle.finish().unwrap();
        assert_eq!(summary, RecordingSummary { frames: kept, dropped: 1000 - kept });
        assert_eq!(disk.sequences().len() as u64, kept);
    }

    #[test]
    fn a_full_disk_stops_the_recording_and_not_the_caller() {
        let disk = Disk::new(200_000);
        let handle = RecorderHandle::spawn(disk.recorder(1000), 1000).unwrap();
        for sequence in 0..1000 {
            let _ = handle.offer(&frame(sequence, 1000));
        }
        let error = loop {
            if let Some(error) = handle.status().error {
                break error;
            }
            handle.offer(&frame(1000, 1000));
            thread::yield_now();
        };
        assert!(error.starts_with("disk.mcap: "), "{error}");
        assert!(!handle.offer(&frame(1001, 1000)), "a stopped recording takes no frame");
        let status = handle.status();
        assert!(status.dropped > 0 && status.written < 1000);
        assert_eq!(handle.finish().unwrap_err().to_string(), error);
        assert!(disk.complete.get().is_none(), "a failed recording must not get its name");
    }
}
