//! Writes a recording in the caller's thread. [`super::RecorderHandle`] puts a queue and a thread in front of it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use dermis_device::{Frame, HostStamp};
use dermis_touch::{ReferenceRecord, Touch};
use mcap::{Attachment, McapError};

use super::file::{Destination, destination};
use super::head::{FINISHED, RecordingHead, record};
use super::messages::{self, Stamp};
use super::schema;
use super::schema::Schema;
use super::shared_file::{FileWriter, SharedFile, lock, mcap_error, new_writer};
use super::view::SkinView;
use crate::Error;

/// Summary of a finished recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RecordingSummary {
    /// Number of frames.
    pub frames: u64,
    /// Frames that were offered but didn't fit into the queue.
    pub dropped: u64,
}

/// Frame of reference of touches and events: the view's, or else the patch's.
fn frame_of<'a>(drawn: &'a Option<Drawn>, patch: &'a Option<String>) -> &'a str {
    let of_view = drawn.as_ref().map(|drawn| drawn.view.frame_id());
    of_view.or(patch.as_deref()).unwrap_or_default()
}

/// Channel numbers in the file.
#[derive(Clone, Copy)]
struct Channels {
    frames: u16,
    baselines: u16,
    touches: u16,
    events: u16,
}

/// The view for viewers, and its channel numbers.
struct Drawn {
    view: SkinView,
    image: u16,
    points: u16,
    touch_points: u16,
}

/// A recording being written.
///
/// Dropping a recorder before [`Recorder::finish`] leaves a readable file under its partial name.
pub struct Recorder {
    name: PathBuf,
    /// Shared by the recorders of a body's patches.
    file: Arc<Mutex<SharedFile>>,
    /// Name of the patch, if the recording is of a body.
    patch: Option<String>,
    channels: Channels,
    readings: usize,
    drawn: Option<Drawn>,
    bytes: Vec<u8>,
    frames: u64,
    /// How many of them have reached the operating system.
    safe_frames: u64,
    /// Number of flushes of the file when `safe_frames` was last updated.
    handed_out: u64,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Recorder").field("name", &self.name).field("frames", &self.frames).finish_non_exhaustive()
    }
}

impl Recorder {
    /// Starts a recording, which appears at `path` once finished. Until then it has `.partial` before its extension.
    /// A device at `path` (a pipe, a terminal) is written to directly.
    ///
    /// # Errors
    /// An I/O error if either file exists (recordings are never overwritten) or cannot be created; a wrong number of
    /// labels.
    pub fn create(path: &Path, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        Self::new(destination(path)?, path.to_owned(), head)
    }

    pub(super) fn new(out: Box<dyn Destination>, name: PathBuf, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        let mut writer = new_writer(out).map_err(|error| mcap_error(&name, error))?;
        let channels = write_head(&mut writer, head, None).map_err(|error| mcap_error(&name, error))?;
        Ok(Self::of(Arc::new(Mutex::new(SharedFile::new(name, writer))), None, channels, head.layout.channels()))
    }

    /// A recorder for one patch of a body, which writes to the body's file.
    pub(super) fn of_patch(file: Arc<Mutex<SharedFile>>, patch: &str, head: &RecordingHead) -> Result<Self, Error> {
        head.validate()?;
        let channels = lock(&file).attempt(|writer| write_head(writer, head, Some(patch)))?;
        lock(&file).join();
        Ok(Self::of(file, Some(patch.to_owned()), channels, head.layout.channels()))
    }

    fn of(file: Arc<Mutex<SharedFile>>, patch: Option<String>, channels: Channels, readings: usize) -> Self {
        let name = lock(&file).name().to_owned();
        let (drawn, bytes) = (None, Vec::new());
        Self { name, file, patch, channels, readings, drawn, bytes, frames: 0, safe_frames: 0, handed_out: 0 }
    }

    /// Also records images, point clouds and touches for viewers.
    ///
    /// # Errors
    /// An I/O error.
    pub fn with_view(mut self, view: SkinView) -> Result<Self, Error> {
        let mut channels = [0; 3];
        let patch = self.patch.as_deref();
        lock(&self.file).attempt(|writer| {
            for (schema, id) in schema::STANDARD.iter().zip(&mut channels) {
                *id = add_channel(writer, schema, patch)?;
            }
            writer.flush()
        })?;
        let [image, points, touch_points] = channels;
        let view = match patch {
            Some(patch) => view.with_frame_id(patch),
            None => view,
        };
        self.drawn = Some(Drawn { view, image, points, touch_points });
        Ok(self)
    }

    /// The view used for images, if any.
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

    /// Number of frames that have reached the operating system and survive the end of this process.
    #[must_use]
    pub fn safe_frames(&self) -> u64 {
        self.safe_frames
    }

    /// Writes a raw frame.
    ///
    /// # Errors
    /// An error if the number of readings differs from the layout's; an I/O error, after which nothing can
    /// be written.
    pub fn write_frame(&mut self, frame: &Frame) -> Result<(), Error> {
        let (real, imaginary) = (frame.values.len(), frame.imaginary.len());
        if real != self.readings || (imaginary != 0 && imaginary != real) {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("frame {} to record", frame.sequence),
                expected: format!("{} readings", self.readings),
                got: format!("{real} real and {imaginary} imaginary parts"),
            }));
        }
        messages::write_frame(&mut self.bytes, frame);
        self.count_safe();
        // Count it first, because writing may flush it at once.
        self.frames += 1;
        self.write(self.channels.frames, frame.host_wall_ns)
    }

    /// Writes a baseline that came into use at `wall_ns`, with its reason.
    ///
    /// # Errors
    /// An I/O error.
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

    /// Writes the touches of frame `sequence`; those that ended in it are in `ended`.
    ///
    /// # Errors
    /// An I/O error.
    pub fn write_touches(
        &mut self,
        wall_ns: u64,
        sequence: u64,
        time_ns: u64,
        touches: &[Touch],
        ended: &[Touch],
    ) -> Result<(), Error> {
        let stamp = Stamp { wall_ns, frame_id: frame_of(&self.drawn, &self.patch) };
        messages::write_touches(&mut self.bytes, stamp, sequence, time_ns, touches, ended);
        self.write(self.channels.touches, wall_ns)
    }

    /// Writes a frame's image, row-major with `NaN` outside the skin, as an image and as a point cloud. Without a
    /// view this does nothing.
    ///
    /// # Errors
    /// An error if the number of pixels differs from the view's; an I/O error.
    pub fn write_image(&mut self, wall_ns: u64, image: &[f32]) -> Result<(), Error> {
        let Some(drawn) = &self.drawn else { return Ok(()) };
        if image.len() != drawn.view.pixels() {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: "image to record".to_owned(),
                expected: format!("{} pixels", drawn.view.pixels()),
                got: image.len().to_string(),
            }));
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
    /// An I/O error.
    pub fn write_touch_points(&mut self, wall_ns: u64, touches: &[Touch]) -> Result<(), Error> {
        let Some(drawn) = &self.drawn else { return Ok(()) };
        drawn.view.write_touch_points(&mut self.bytes, wall_ns, touches);
        self.write(drawn.touch_points, wall_ns)
    }

    /// Writes an event that happened before the next frame: its name, a description and its numbers.
    ///
    /// # Errors
    /// An I/O error.
    pub fn write_event(&mut self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> Result<(), Error> {
        let stamp = Stamp { wall_ns, frame_id: frame_of(&self.drawn, &self.patch) };
        messages::write_event(&mut self.bytes, stamp, event, detail, values);
        self.write(self.channels.events, wall_ns)
    }

    /// Flushes the written data to the operating system if half a second has passed since the last flush. Writing does
    /// this too; call it when nothing has been written for that long.
    ///
    /// # Errors
    /// An I/O error.
    pub fn flush_if_due(&mut self) -> Result<(), Error> {
        if lock(&self.file).flush_if_due()? {
            self.all_safe();
        }
        Ok(())
    }

    /// Frames written before the last flush are safe, even if another recorder flushed the file.
    fn count_safe(&mut self) {
        if lock(&self.file).handed_out() != self.handed_out {
            self.all_safe();
        }
    }

    fn all_safe(&mut self) {
        self.handed_out = lock(&self.file).handed_out();
        self.safe_frames = self.frames;
    }

    /// Ends the recording and gives it its final name. `dropped` frames are recorded as missing.
    ///
    /// # Errors
    /// An I/O error; data already written stay under the partial name.
    pub fn finish(mut self, dropped: u64) -> Result<RecordingSummary, Error> {
        let summary = RecordingSummary { frames: self.frames, dropped };
        let entries = [("frames", self.frames.to_string()), ("dropped", dropped.to_string())];
        let end = record(&schema::name_of(FINISHED, self.patch.as_deref()), entries);
        let finished = lock(&self.file).finish(&end)?;
        finished.map_or(Ok(()), |out| out.complete().map_err(Error::io(&self.name)))?;
        self.all_safe();
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
        let is_handed_out = lock(&self.file).write(channel_id, wall_ns, message)?;
        if is_handed_out {
            self.all_safe();
        }
        Ok(())
    }
}

/// Writes metadata, the skin and the channels, and flushes them at once, because a reader needs them most.
fn write_head(writer: &mut FileWriter, head: &RecordingHead, patch: Option<&str>) -> Result<Channels, McapError> {
    for mut record in head.metadata() {
        record.name = schema::name_of(&record.name, patch);
        writer.write_metadata(&record)?;
    }
    attach_all(writer, head, patch)?;
    let [frames, baselines, touches, events] = &schema::OWN;
    let channels = Channels {
        frames: add_channel(writer, frames, patch)?,
        baselines: add_channel(writer, baselines, patch)?,
        touches: add_channel(writer, touches, patch)?,
        events: add_channel(writer, events, patch)?,
    };
    writer.flush()?;
    Ok(channels)
}

/// Attaches the skin file and the calibrations.
pub(super) fn attach_all(writer: &mut FileWriter, head: &RecordingHead, patch: Option<&str>) -> Result<(), McapError> {
    let now_ns = HostStamp::now().wall_ns;
    for (name, media_type, text) in head.attachments() {
        writer.attach(&Attachment {
            log_time: now_ns,
            create_time: now_ns,
            name: patch.map_or_else(|| name.to_owned(), |patch| format!("{patch}/{name}")),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })?;
    }
    Ok(())
}

pub(super) fn add_channel(writer: &mut FileWriter, schema: &Schema, patch: Option<&str>) -> Result<u16, McapError> {
    let id = writer.add_schema(schema.name, "ros2msg", schema.text().as_bytes())?;
    writer.add_channel(id, &schema::topic_of(schema.topic, patch), "cdr", &BTreeMap::new())
}
