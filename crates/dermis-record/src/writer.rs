//! Writing a recording, in the thread of the caller. [`super::RecorderHandle`] puts a queue and a thread before it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dermis_device::{Frame, HostStamp};
use dermis_touch::{ReferenceRecord, Touch, TouchEvent};
use mcap::records::{MessageHeader, op};
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};

use super::file::{Destination, destination};
use super::head::{FINISHED, RecordingHead, STOPPED, record};
use super::view::SkinView;
use super::{messages, schema};
use crate::Error;

/// Everything is handed to the operating system this often.
pub(super) const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// The same once so much has come together; large enough to compress well.
pub(super) const CHUNK_BYTES: usize = 1 << 20;

/// What a finished recording holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RecordingSummary {
    /// Frames in it.
    pub frames: u64,
    /// Frames that were offered and did not fit the queue.
    pub dropped: u64,
}

/// The format's writer to wherever the bytes go.
pub(super) type FileWriter = Writer<NoSeek<Box<dyn Destination>>>;

/// Numbers of the channels in the file.
#[derive(Clone, Copy)]
struct Channels {
    frames: u16,
    baselines: u16,
    touches: u16,
    events: u16,
}

/// What viewers draw, and the numbers of its channels.
struct Drawn {
    view: SkinView,
    image: u16,
    points: u16,
    touch_points: u16,
}

/// A recording being written.
///
/// A recorder dropped before [`Recorder::finish`] leaves a readable file under its partial name.
pub struct Recorder {
    name: PathBuf,
    /// None after a failure.
    writer: Option<FileWriter>,
    channels: Channels,
    readings: usize,
    drawn: Option<Drawn>,
    bytes: Vec<u8>,
    message: u32,
    frames: u64,
    /// Of them, those that the operating system has.
    safe_frames: u64,
    flushed: Instant,
    /// Bytes of messages that it does not have yet.
    pending: usize,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Recorder").field("name", &self.name).field("frames", &self.frames).finish_non_exhaustive()
    }
}

impl Recorder {
    /// Starts a recording that will stand at `path` once finished, and until then beside it with `.partial` before the
    /// extension. A device that stands at `path` (a pipe, a terminal) is written to directly.
    ///
    /// # Errors
    /// [`Error::Io`] if either file exists (recordings are never overwritten) or none can be made there,
    /// [`Error::Frames`] for a wrong number of labels.
    pub fn create(path: &Path, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        Self::new(destination(path)?, path.to_owned(), head)
    }

    pub(super) fn new(out: Box<dyn Destination>, name: PathBuf, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        let failed = |error| mcap_error(&name, error);
        let mut writer = new_writer(out).map_err(failed)?;
        let channels = write_head(&mut writer, head).map_err(failed)?;
        Ok(Self {
            name,
            writer: Some(writer),
            channels,
            readings: head.layout.channels(),
            drawn: None,
            bytes: Vec::new(),
            message: 0,
            frames: 0,
            safe_frames: 0,
            flushed: Instant::now(),
            pending: 0,
        })
    }

    /// Also takes images, point clouds and touches as viewers draw them.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn with_view(mut self, view: SkinView) -> Result<Self, Error> {
        let mut channels = [0; 3];
        self.attempt(|writer| {
            for (schema, id) in schema::STANDARD.iter().zip(&mut channels) {
                *id = add_channel(writer, schema)?;
            }
            writer.flush()
        })?;
        let [image, points, touch_points] = channels;
        self.drawn = Some(Drawn { view, image, points, touch_points });
        Ok(self)
    }

    /// The view that images are drawn in, if any.
    #[must_use]
    pub fn view(&self) -> Option<&SkinView> {
        self.drawn.as_ref().map(|drawn| &drawn.view)
    }

    /// The final name.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.name
    }

    /// Frames written.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames that the operating system has: those survive the end of this process.
    #[must_use]
    pub fn safe_frames(&self) -> u64 {
        self.safe_frames
    }

    /// Writes a raw frame.
    ///
    /// # Errors
    /// [`Error::Frames`] for another number of readings than the layout's, [`Error::Io`]; nothing can be written after
    /// the latter.
    pub fn write_frame(&mut self, frame: &Frame) -> Result<(), Error> {
        let (real, imaginary) = (frame.values.len(), frame.imaginary.len());
        if real != self.readings || (imaginary != 0 && imaginary != real) {
            return Err(Error::Frames {
                what: format!("frame {} to record", frame.sequence),
                expected: format!("{} readings", self.readings),
                got: format!("{real} real and {imaginary} imaginary parts"),
            });
        }
        messages::write_frame(&mut self.bytes, frame);
        // Counted first, for writing may hand it out at once.
        self.frames += 1;
        self.write(self.channels.frames, frame.host_wall_ns)
    }

    /// Writes a baseline that came into use at `wall_ns`, with its reason.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_baseline(
        &mut self,
        wall_ns: u64,
        record: &ReferenceRecord,
        values: &[f64],
        noise_std: &[f64],
    ) -> Result<(), Error> {
        messages::write_baseline(&mut self.bytes, record, values, noise_std);
        self.write(self.channels.baselines, wall_ns)
    }

    /// Writes the touches of frame `sequence`; those that ended in it stand in `events`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_touches(
        &mut self,
        wall_ns: u64,
        sequence: u64,
        time_ns: u64,
        touches: &[Touch],
        events: &[TouchEvent],
    ) -> Result<(), Error> {
        messages::write_touches(&mut self.bytes, sequence, time_ns, touches, events);
        self.write(self.channels.touches, wall_ns)
    }

    /// Writes touches that were made into a message elsewhere.
    pub(super) fn write_touches_message(&mut self, wall_ns: u64, message: &[u8]) -> Result<(), Error> {
        self.write_message(self.channels.touches, wall_ns, message)
    }

    /// Writes a frame's image, row-major with `NaN` outside the skin, as an image and as a point cloud. Without a view
    /// this does nothing.
    ///
    /// # Errors
    /// [`Error::Frames`] for another number of pixels than the view's, [`Error::Io`].
    pub fn write_image(&mut self, wall_ns: u64, image: &[f32]) -> Result<(), Error> {
        let Some(drawn) = &self.drawn else { return Ok(()) };
        if image.len() != drawn.view.pixels() {
            return Err(Error::Frames {
                what: "image to record".to_owned(),
                expected: format!("{} pixels", drawn.view.pixels()),
                got: image.len().to_string(),
            });
        }
        drawn.view.write_image(&mut self.bytes, wall_ns, image);
        self.write(drawn.image, wall_ns)?;
        let Some(drawn) = &self.drawn else { return Ok(()) };
        drawn.view.write_points(&mut self.bytes, wall_ns, image);
        self.write(drawn.points, wall_ns)
    }

    /// Writes touches as points in space. Without a view this does nothing.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_touch_points(&mut self, wall_ns: u64, touches: &[Touch]) -> Result<(), Error> {
        let Some(drawn) = &self.drawn else { return Ok(()) };
        drawn.view.write_touch_points(&mut self.bytes, wall_ns, touches);
        self.write(drawn.touch_points, wall_ns)
    }

    /// As [`Recorder::write_touch_points`], from a message made elsewhere.
    pub(super) fn write_touch_points_message(&mut self, wall_ns: u64, message: &[u8]) -> Result<(), Error> {
        let Some(drawn) = &self.drawn else { return Ok(()) };
        self.write_message(drawn.touch_points, wall_ns, message)
    }

    /// Writes that something happened before the next frame: in a word, for people, and the numbers that belong to it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_event(&mut self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> Result<(), Error> {
        messages::write_event(&mut self.bytes, event, detail, values);
        self.write(self.channels.events, wall_ns)
    }

    /// Hands what was written to the operating system, if half a second has passed since that was last done. Writing
    /// does this by itself; call it when nothing is written for longer.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn flush_if_due(&mut self) -> Result<(), Error> {
        let due = self.pending >= CHUNK_BYTES || self.flushed.elapsed() >= FLUSH_INTERVAL;
        if self.pending > 0 && due {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Error> {
        self.attempt(|writer| writer.flush())?;
        self.flushed = Instant::now();
        self.pending = 0;
        self.safe_frames = self.frames;
        Ok(())
    }

    /// Ends the recording and gives it its final name. `dropped` frames are noted in it as missing.
    ///
    /// # Errors
    /// [`Error::Io`]; what was written so far stays under the partial name.
    pub fn finish(mut self, dropped: u64) -> Result<RecordingSummary, Error> {
        let summary = RecordingSummary { frames: self.frames, dropped };
        let end = record(FINISHED, [("frames", self.frames.to_string()), ("dropped", dropped.to_string())]);
        self.attempt(|writer| {
            writer.write_metadata(&end)?;
            writer.finish().map(|_| ())
        })?;
        let Some(writer) = self.writer.take() else { return Ok(summary) };
        writer.into_inner().into_inner().complete().map_err(Error::io(self.name))?;
        Ok(summary)
    }

    /// Writes `self.bytes` as a message.
    fn write(&mut self, channel_id: u16, wall_ns: u64) -> Result<(), Error> {
        let bytes = std::mem::take(&mut self.bytes);
        let result = self.write_message(channel_id, wall_ns, &bytes);
        self.bytes = bytes;
        result
    }

    fn write_message(&mut self, channel_id: u16, wall_ns: u64, message: &[u8]) -> Result<(), Error> {
        let header = MessageHeader { channel_id, sequence: self.message, log_time: wall_ns, publish_time: wall_ns };
        self.message = self.message.wrapping_add(1);
        self.attempt(|writer| writer.write_to_known_channel(&header, message))?;
        self.pending += message.len();
        self.flush_if_due()
    }

    /// Runs a step; after a failure the writer is put out of use without writing anything more.
    fn attempt(&mut self, step: impl FnOnce(&mut FileWriter) -> Result<(), McapError>) -> Result<(), Error> {
        let stopped = || Error::io(&self.name)(io::Error::other("the recording has stopped after an earlier error"));
        let writer = self.writer.as_mut().ok_or_else(stopped)?;
        step(writer).map_err(|error| {
            let error = mcap_error(&self.name, error);
            if let Some(writer) = self.writer.take() {
                writer.into_inner().into_inner().abandon(&stopped_note(&error.to_string()));
            }
            error
        })
    }
}

/// A writer of recordings. Chunks are built in memory and written whole, so that a killed writer leaves no half chunk
/// but the last. They are ended by whoever writes and not by size, so that it is known which messages are out of this
/// process's hands.
pub(super) fn new_writer(out: Box<dyn Destination>) -> Result<FileWriter, McapError> {
    let options = WriteOptions::new()
        .profile("ros2")
        .library(concat!("dermis ", env!("CARGO_PKG_VERSION")))
        .disable_seeking(true)
        .chunk_size(None)
        .compression(Some(Compression::Zstd))
        .compression_level(1)
        .compression_threads(0);
    options.create(NoSeek::new(out))
}

/// Writes metadata, the skin and the channels, and hands them out at once: they are what a reader needs most.
fn write_head(writer: &mut FileWriter, head: &RecordingHead) -> Result<Channels, McapError> {
    for record in head.metadata() {
        writer.write_metadata(&record)?;
    }
    attach_all(writer, head)?;
    let [frames, baselines, touches, events] = &schema::OWN;
    let channels = Channels {
        frames: add_channel(writer, frames)?,
        baselines: add_channel(writer, baselines)?,
        touches: add_channel(writer, touches)?,
        events: add_channel(writer, events)?,
    };
    writer.flush()?;
    Ok(channels)
}

/// Attaches the skin file and the calibrations.
pub(super) fn attach_all(writer: &mut FileWriter, head: &RecordingHead) -> Result<(), McapError> {
    let now_ns = HostStamp::now().wall_ns;
    for (name, media_type, text) in head.attachments() {
        writer.attach(&Attachment {
            log_time: now_ns,
            create_time: now_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })?;
    }
    Ok(())
}

fn add_channel(writer: &mut FileWriter, schema: &schema::Schema) -> Result<u16, McapError> {
    let id = writer.add_schema(schema.name, "ros2msg", schema.text().as_bytes())?;
    writer.add_channel(id, schema.topic, "cdr", &BTreeMap::new())
}

/// A metadata record that says why a recording stopped, as bytes: the format's own writer is of no use after an error.
fn stopped_note(reason: &str) -> Vec<u8> {
    let text = |out: &mut Vec<u8>, text: &str| {
        out.extend_from_slice(&(text.len() as u32).to_le_bytes());
        out.extend_from_slice(text.as_bytes());
    };
    let (mut content, mut entries) = (Vec::new(), Vec::new());
    text(&mut entries, "reason");
    text(&mut entries, reason);
    text(&mut content, STOPPED);
    content.extend_from_slice(&(entries.len() as u32).to_le_bytes());
    content.extend_from_slice(&entries);
    let mut note = vec![op::METADATA];
    note.extend_from_slice(&(content.len() as u64).to_le_bytes());
    note.extend_from_slice(&content);
    note
}

pub(super) fn mcap_error(name: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(error) => Error::io(name)(error),
        other => Error::io(name)(io::Error::other(other)),
    }
}
