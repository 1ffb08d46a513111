//! Writing a recording, in the thread of the caller. [`super::RecorderHandle`] puts a queue and a thread before it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dermis_device::{Frame, HostStamp};
use dermis_touch::{ReferenceRecord, Touch, TouchEvent};
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};

use super::head::{FINISHED, RecordingHead, record};
use super::{schema, wire};
use crate::Error;
use crate::sink::json_lines::push_touches;

/// Everything is handed to the operating system this often.
pub(super) const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// A chunk is closed at this size even before its time; large enough to compress well.
const CHUNK_BYTES: u64 = 1 << 20;

/// What a finished recording holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RecordingSummary {
    /// Frames in it.
    pub frames: u64,
    /// Frames that were offered and did not fit the queue.
    pub dropped: u64,
}

/// Where the bytes go.
pub(super) trait Destination: Write + Send {
    /// Makes everything durable and gives it its final name.
    fn complete(self: Box<Self>) -> io::Result<()>;
}

/// Numbers of the channels in the file.
#[derive(Clone, Copy)]
struct Channels {
    frames: u16,
    baselines: u16,
    touches: u16,
    events: u16,
}

/// A recording being written.
///
/// A recorder dropped before [`Recorder::finish`] leaves a readable file under its partial name.
pub struct Recorder {
    name: PathBuf,
    /// None after a failure.
    writer: Option<Writer<NoSeek<Box<dyn Destination>>>>,
    channels: Channels,
    readings: usize,
    bytes: Vec<u8>,
    text: String,
    message: u32,
    frames: u64,
    flushed: Instant,
    pending: bool,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Recorder").field("name", &self.name).field("frames", &self.frames).finish_non_exhaustive()
    }
}

impl Recorder {
    /// Starts a recording that will stand at `path` once finished, and until then beside it with `.partial` before the
    /// extension.
    ///
    /// # Errors
    /// [`Error::Io`] if either file exists (recordings are never overwritten) or none can be made there,
    /// [`Error::Frames`] for a wrong number of labels.
    pub fn create(path: &Path, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        Self::new(Box::new(PartialFile::create(path)?), path.to_owned(), head)
    }

    pub(super) fn new(out: Box<dyn Destination>, name: PathBuf, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        let failed = |error| mcap_error(&name, error);
        // Chunks are built in memory and written whole, so that a killed writer leaves no half chunk but the last.
        let options = WriteOptions::new()
            .library(concat!("dermis ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true)
            .chunk_size(Some(CHUNK_BYTES))
            .compression(Some(Compression::Zstd))
            .compression_level(1)
            .compression_threads(0);
        let mut writer = options.create(NoSeek::new(out)).map_err(failed)?;
        let channels = write_head(&mut writer, head).map_err(failed)?;
        Ok(Self {
            name,
            writer: Some(writer),
            channels,
            readings: head.layout.channels(),
            bytes: Vec::new(),
            text: String::new(),
            message: 0,
            frames: 0,
            flushed: Instant::now(),
            pending: false,
        })
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
        self.bytes.clear();
        wire::push_frame(&mut self.bytes, frame);
        self.write(self.channels.frames, frame.host_wall_ns)?;
        self.frames += 1;
        Ok(())
    }

    /// Writes a baseline that came into use at `wall_ns`, with its reason.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_baseline(&mut self, wall_ns: u64, record: &ReferenceRecord, values: &[f64]) -> Result<(), Error> {
        self.bytes.clear();
        wire::push_baseline(&mut self.bytes, record, values);
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
        let mut text = std::mem::take(&mut self.text);
        text.clear();
        push_touches(&mut text, sequence, time_ns, touches, events);
        let result = self.write_touches_json(wall_ns, &text);
        self.text = text;
        result
    }

    pub(super) fn write_touches_json(&mut self, wall_ns: u64, json: &str) -> Result<(), Error> {
        self.bytes.clear();
        self.bytes.extend_from_slice(json.as_bytes());
        self.write(self.channels.touches, wall_ns)
    }

    /// Writes that something happened.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_event(&mut self, wall_ns: u64, event: &str, detail: &str) -> Result<(), Error> {
        let text = serde_json::json!({ "event": event, "detail": detail }).to_string();
        self.bytes.clear();
        self.bytes.extend_from_slice(text.as_bytes());
        self.write(self.channels.events, wall_ns)
    }

    /// Hands what was written to the operating system, if half a second has passed since that was last done. Writing does
    /// this by itself; call it when nothing is written for longer.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn flush_if_due(&mut self) -> Result<(), Error> {
        if self.pending && self.flushed.elapsed() >= FLUSH_INTERVAL {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Error> {
        self.attempt(|writer| writer.flush())?;
        self.flushed = Instant::now();
        self.pending = false;
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
        let header = MessageHeader { channel_id, sequence: self.message, log_time: wall_ns, publish_time: wall_ns };
        self.message = self.message.wrapping_add(1);
        let bytes = std::mem::take(&mut self.bytes);
        let result = self.attempt(|writer| writer.write_to_known_channel(&header, &bytes));
        self.bytes = bytes;
        result?;
        self.pending = true;
        self.flush_if_due()
    }

    /// Runs a step; after a failure the writer is put out of use without writing anything more.
    fn attempt(
        &mut self,
        step: impl FnOnce(&mut Writer<NoSeek<Box<dyn Destination>>>) -> Result<(), McapError>,
    ) -> Result<(), Error> {
        let stopped = || Error::io(&self.name)(io::Error::other("the recording has stopped after an earlier error"));
        let writer = self.writer.as_mut().ok_or_else(stopped)?;
        step(writer).map_err(|error| {
            drop(self.writer.take().map(Writer::into_inner));
            mcap_error(&self.name, error)
        })
    }
}

/// Writes metadata, the skin and the channels, and hands them out at once: they are what a reader needs most.
fn write_head<W: Write + io::Seek>(writer: &mut Writer<W>, head: &RecordingHead) -> Result<Channels, McapError> {
    for record in head.metadata() {
        writer.write_metadata(&record)?;
    }
    let now_ns = HostStamp::now().wall_ns;
    writer.attach(&Attachment {
        log_time: now_ns,
        create_time: now_ns,
        name: "skin.toml".to_owned(),
        media_type: "application/toml".to_owned(),
        data: Cow::Borrowed(head.skin_toml.as_bytes()),
    })?;
    let descriptor = schema::descriptor_set();
    let mut add = |topic: &str, name: &str, encoding: &str, data: &[u8], message_encoding: &str| {
        let id = writer.add_schema(name, encoding, data)?;
        writer.add_channel(id, topic, message_encoding, &BTreeMap::new())
    };
    let channels = Channels {
        frames: add(schema::FRAMES, "dermis.Frame", "protobuf", &descriptor, "protobuf")?,
        baselines: add(schema::BASELINES, "dermis.Baseline", "protobuf", &descriptor, "protobuf")?,
        touches: add(schema::TOUCHES, "dermis.Touches", "jsonschema", schema::TOUCHES_JSON.as_bytes(), "json")?,
        events: add(schema::EVENTS, "dermis.Event", "jsonschema", schema::EVENT_JSON.as_bytes(), "json")?,
    };
    writer.flush()?;
    Ok(channels)
}

fn mcap_error(name: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(error) => Error::io(name)(error),
        other => Error::io(name)(io::Error::other(other)),
    }
}

/// A file under its partial name.
struct PartialFile {
    out: BufWriter<File>,
    partial: PathBuf,
    target: PathBuf,
}

impl PartialFile {
    fn create(path: &Path) -> Result<Self, Error> {
        let partial = partial_name(path).ok_or_else(|| Error::io(path)(io::ErrorKind::IsADirectory.into()))?;
        if path.exists() {
            let reason = io::Error::new(io::ErrorKind::AlreadyExists, "exists, and recordings are never overwritten");
            return Err(Error::io(path)(reason));
        }
        let file = OpenOptions::new().write(true).create_new(true).open(&partial).map_err(Error::io(&partial))?;
        Ok(Self { out: BufWriter::new(file), partial, target: path.to_owned() })
    }
}

/// `a/press.mcap` becomes `a/press.partial.mcap`.
pub(super) fn partial_name(path: &Path) -> Option<PathBuf> {
    let mut name = OsString::from(path.file_stem()?);
    name.push(".partial");
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    Some(path.with_file_name(name))
}

impl Write for PartialFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl Destination for PartialFile {
    fn complete(mut self: Box<Self>) -> io::Result<()> {
        self.out.flush()?;
        self.out.get_ref().sync_all()?;
        fs::rename(&self.partial, &self.target)?;
        crate::sink::sync_directory(&self.target);
        Ok(())
    }
}
