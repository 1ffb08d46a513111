//! A bounded queue and a thread before a [`Recorder`], so that a slow or full disk never holds up the pipeline: what
//! does not fit is dropped and counted, and what goes wrong is kept until someone asks.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded, select};
use dermis_device::Frame;
use dermis_touch::{ReferenceRecord, TouchEvent};

use super::messages;
use super::shared_file::FLUSH_INTERVAL;
use super::view::SkinView;
use super::writer::{Recorder, RecordingSummary};
use crate::Error;
use dermis_live::output::Output;

/// Room for baselines and events beside frames and touches; they are rare.
const RARE: usize = 64;

/// Images that may wait; they are made from what is recorded anyway, and one left out is no loss.
const IMAGES: usize = 16;

/// How a recording in progress is doing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecorderStatus {
    /// Frames encoded. The last half second of them may still be in memory.
    pub written: u64,
    /// Frames that were offered and are not recorded: the queue was full, or the recording has stopped. Then those that
    /// were still in memory are among them.
    pub dropped: u64,
    /// Why the recording has stopped, if it has.
    pub error: Option<String>,
}

/// What waits in the queue.
enum Item {
    Frame(Frame),
    Touches { wall_ns: u64, message: Vec<u8> },
    TouchPoints { wall_ns: u64, message: Vec<u8> },
    Image { wall_ns: u64, image: Vec<f32> },
    Baseline { wall_ns: u64, record: ReferenceRecord, values: Vec<f64>, noise_std: Vec<f64> },
    Event { wall_ns: u64, event: String, detail: String, values: Vec<f64> },
}

/// Counts shared with the writing thread.
#[derive(Default)]
struct Shared {
    offered: AtomicU64,
    refused: AtomicU64,
    written: AtomicU64,
    safe: AtomicU64,
    error: OnceLock<String>,
}

/// A recording that is written by a thread of its own.
///
/// Offering a frame copies it into memory that is kept and never waits. Dropping the handle finishes the recording as
/// [`RecorderHandle::finish`] does, only that an error then goes to the log.
pub struct RecorderHandle {
    items: Option<Sender<Item>>,
    free_frames: Receiver<Frame>,
    free_messages: Receiver<Vec<u8>>,
    free_images: Receiver<Vec<f32>>,
    view: Option<SkinView>,
    /// When the next image is due, on the frames' clock.
    image_due_ns: u64,
    shared: Arc<Shared>,
    stop: RecordingStop,
    thread: Option<JoinHandle<Result<RecordingSummary, Error>>>,
}

/// Ends a recording from anywhere, also where whoever records is stuck: what is queued is written and the file made
/// whole. What is offered after that is refused.
#[derive(Clone, Debug)]
pub struct RecordingStop {
    ask: Sender<()>,
    /// Closed once the recording has ended.
    ended: Receiver<()>,
}

impl RecordingStop {
    /// Asks for the end and does not wait for it.
    pub fn ask(&self) {
        // One wish is enough.
        let _ = self.ask.try_send(());
    }

    /// Waits at most so long for the end; false where it has not come.
    pub fn wait(&self, most: Duration) -> bool {
        !matches!(self.ended.recv_timeout(most), Err(RecvTimeoutError::Timeout))
    }

    /// Whether the recording has ended.
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
    /// [`Error::Io`] if the system gives no thread.
    pub fn spawn(recorder: Recorder, capacity: usize) -> Result<Self, Error> {
        let capacity = capacity.max(1);
        let (items, queue) = bounded(3 * capacity + IMAGES + RARE);
        let (return_frame, free_frames) = bounded(capacity);
        let (return_message, free_messages) = bounded(2 * capacity);
        let (return_image, free_images) = bounded(IMAGES);
        for _ in 0..capacity {
            // The channels were made with room for exactly these.
            let _ = return_frame.try_send(Frame::default());
            let _ = return_message.try_send(Vec::new());
            let _ = return_message.try_send(Vec::new());
        }
        for _ in 0..IMAGES {
            let _ = return_image.try_send(Vec::new());
        }
        let view = recorder.view().cloned();
        let shared = Arc::new(Shared::default());
        let path = recorder.path().to_owned();
        let (ask, asked) = bounded(1);
        let (ending, ended) = bounded(0);
        let stop = RecordingStop { ask: ask.clone(), ended };
        let shared_there = shared.clone();
        let writer = WriterThread {
            recorder,
            queue,
            return_frame,
            return_message,
            return_image,
            asked,
            _ask: ask,
            shared: shared_there,
        };
        let thread = thread::Builder::new().name("dermis-recorder".to_owned()).spawn(move || {
            let result = writer.run();
            drop::<Sender<()>>(ending);
            result
        });
        let thread = Some(thread.map_err(Error::io(path))?);
        let image_due_ns = 0;
        Ok(Self {
            items: Some(items),
            free_frames,
            free_messages,
            free_images,
            view,
            image_due_ns,
            shared,
            stop,
            thread,
        })
    }

    /// Queues a raw frame; false if it is dropped because the queue is full or the recording has stopped.
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

    /// Queues what was made of a frame: its touches, if there are any or one ended, and its image, if one is due at
    /// `time_ns` on the frames' clock. What does not fit is left out: it can be made again from the frame.
    pub fn offer_results(&mut self, output: &Output<'_>, time_ns: u64) {
        let wall_ns = output.wall_ns;
        let ended = output.events.iter().any(|event| matches!(event, TouchEvent::End(_)));
        if ended || !output.touches.is_empty() {
            if let Ok(mut message) = self.free_messages.try_recv() {
                messages::write_touches(&mut message, output.sequence, output.time_ns, output.touches, output.events);
                self.send(Item::Touches { wall_ns, message });
            }
            if let Some(view) = &self.view
                && let Ok(mut message) = self.free_messages.try_recv()
            {
                view.write_touch_points(&mut message, wall_ns, output.touches);
                self.send(Item::TouchPoints { wall_ns, message });
            }
        }
        let Some(view) = &self.view else { return };
        // A clock that was set back does not end the images.
        let due = time_ns >= self.image_due_ns || time_ns.saturating_add(view.period_ns()) < self.image_due_ns;
        if due
            && output.image.iter().any(|value| value.is_finite())
            && let Ok(mut image) = self.free_images.try_recv()
        {
            self.image_due_ns = time_ns.saturating_add(view.period_ns());
            image.clear();
            image.extend_from_slice(output.image);
            self.send(Item::Image { wall_ns, image });
        }
    }

    /// Queues a baseline that came into use at `wall_ns`, with the noise of its channels; false if it is dropped.
    pub fn offer_baseline(&self, wall_ns: u64, record: &ReferenceRecord, values: &[f64], noise_std: &[f64]) -> bool {
        let (values, noise_std) = (values.to_vec(), noise_std.to_vec());
        self.send(Item::Baseline { wall_ns, record: record.clone(), values, noise_std })
    }

    /// Queues that something happened before the next frame: in a word, for people, and the numbers that belong to it;
    /// false if it is dropped.
    pub fn offer_event(&self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> bool {
        let (event, detail, values) = (event.to_owned(), detail.to_owned(), values.to_vec());
        self.send(Item::Event { wall_ns, event, detail, values })
    }

    /// What has been written and lost.
    #[must_use]
    pub fn status(&self) -> RecorderStatus {
        let error = self.shared.error.get().cloned();
        RecorderStatus {
            written: self.shared.written.load(Ordering::Relaxed),
            dropped: self.shared.dropped(error.is_some()),
            error,
        }
    }

    /// Frames saved and lost of a recording that has failed, to be asked after [`RecorderHandle::finish`].
    pub(super) fn watch(&self) -> impl FnOnce() -> (u64, u64) + use<> {
        let shared = self.shared.clone();
        move || (shared.safe.load(Ordering::Relaxed), shared.dropped(true))
    }

    /// What ends the recording from elsewhere.
    pub fn stop(&self) -> RecordingStop {
        self.stop.clone()
    }

    /// Writes what is queued, ends the recording and gives it its final name.
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

    /// Waits for the thread, once.
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
    /// Frames lost; once the recording has stopped, those in the queue are.
    fn dropped(&self, stopped: bool) -> u64 {
        if stopped {
            let safe = self.safe.load(Ordering::Relaxed);
            return self.offered.load(Ordering::Relaxed).saturating_sub(safe);
        }
        self.refused.load(Ordering::Relaxed)
    }
}

/// The thread's belongings.
struct WriterThread {
    recorder: Recorder,
    queue: Receiver<Item>,
    return_frame: Sender<Frame>,
    return_message: Sender<Vec<u8>>,
    return_image: Sender<Vec<f32>>,
    /// Wishes that the recording may end, and what keeps that queue open.
    asked: Receiver<()>,
    _ask: Sender<()>,
    shared: Arc<Shared>,
}

impl WriterThread {
    fn run(mut self) -> Result<RecordingSummary, Error> {
        let shared = self.shared.clone();
        let drained = self.drain();
        shared.safe.store(self.recorder.safe_frames(), Ordering::Relaxed);
        let frames = self.recorder.frames();
        let result = drained.and_then(|()| self.recorder.finish(shared.dropped(false)));
        // One whose name was taken meanwhile stands whole under its partial name.
        if let Err(Error::Io { source, .. }) = &result
            && source.kind() == std::io::ErrorKind::AlreadyExists
        {
            shared.safe.store(frames, Ordering::Relaxed);
        }
        // Whoever sees the error is refused from then on.
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
                Ok(None) => self.recorder.flush_if_due()?,
                Err(_) => return Ok(()),
            }
        }
    }

    fn write(&mut self, item: Item) -> Result<(), Error> {
        match item {
            Item::Frame(frame) => {
                self.recorder.write_frame(&frame)?;
                self.shared.written.fetch_add(1, Ordering::Relaxed);
                let _ = self.return_frame.try_send(frame);
            }
            Item::Touches { wall_ns, message } => {
                self.recorder.write_touches_message(wall_ns, &message)?;
                let _ = self.return_message.try_send(message);
            }
            Item::TouchPoints { wall_ns, message } => {
                self.recorder.write_touch_points_message(wall_ns, &message)?;
                let _ = self.return_message.try_send(message);
            }
            Item::Image { wall_ns, image } => {
                self.recorder.write_image(wall_ns, &image)?;
                let _ = self.return_image.try_send(image);
            }
            Item::Baseline { wall_ns, record, values, noise_std } => {
                self.recorder.write_baseline(wall_ns, &record, &values, &noise_std)?;
            }
            Item::Event { wall_ns, event, detail, values } => {
                self.recorder.write_event(wall_ns, &event, &detail, &values)?;
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

    /// A disk with room for a number of bytes, which can be held up.
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
        // Digits that do not compress, so that chunks fill.
        let mut state = sequence.wrapping_add(1);
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64
        };
        Frame { sequence, values: (0..channels).map(|_| next()).collect(), ..Frame::default() }
    }

    #[test]
    fn what_fits_is_written_and_the_file_completed() {
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
        // More than a chunk and the queue together hold; were an offer to wait, this would never end.
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
