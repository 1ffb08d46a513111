//! Reads a recording, complete or damaged. Every chunk's checksum is verified before its content is used; unreadable
//! parts are skipped and counted.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use dermis_device::{Frame, open_regular};
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::head::{FINISHED, RecordingHead, STOPPED};
use super::scan::{ChunkPlace, MOST_BYTES, Outline, PREFIX, announced_size};
use super::shared_file::CHUNK_BYTES;
use super::{BaselineEntry, EventEntry, TouchesEntry, messages, schema};
use crate::Error;

/// Upper bound on our chunks: the size at which one is closed, and one more message.
const MOST_CHUNK_BYTES: u64 = 2 * CHUNK_BYTES as u64;

/// A message's header: channel (u16), sequence (u32), log and publish time (u64 each).
const MESSAGE_HEADER: usize = 22;

/// One entry of a recording, in the order of writing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Entry<'a> {
    /// A raw frame.
    Frame(&'a Frame),
    /// A baseline came into use.
    Baseline {
        /// Wall clock, nanoseconds since 1970-01-01 UTC.
        wall_ns: u64,
        /// The baseline and its reason.
        entry: &'a BaselineEntry,
    },
    /// Touches of a frame.
    Touches {
        /// Wall clock, nanoseconds since 1970-01-01 UTC.
        wall_ns: u64,
        /// The frame's number and its touches.
        entry: &'a TouchesEntry,
    },
    /// An event happened.
    Event {
        /// Wall clock, nanoseconds since 1970-01-01 UTC.
        wall_ns: u64,
        /// The event.
        entry: &'a EventEntry,
    },
}

/// Number of frames that a damaged recording lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LostFrames {
    /// Exactly this many, since the recording's own statistics survived.
    Exactly(u64),
    /// Unknown, because the recording's end is missing. The field estimates how many fit into the damaged chunks.
    Unknown {
        /// Frames that fit into the damaged chunks, by their stated sizes.
        in_damaged_chunks: u64,
    },
}

/// Unreadable parts of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Damage {
    /// True if the recording was not finished, or its end is missing.
    pub cut_off: bool,
    /// Bytes in damaged chunks and after the last complete record.
    pub bytes: u64,
    /// Chunks that fail their checksum or cannot be decompressed.
    pub chunks: u64,
    /// Single messages or records that are malformed, or whose channel has no description.
    pub messages: u64,
    /// Missing frames, final once every entry has been read; until then, frames not yet read count as missing.
    pub frames: LostFrames,
}

impl Damage {
    /// Nothing is missing.
    pub const NONE: Self = Self { cut_off: false, bytes: 0, chunks: 0, messages: 0, frames: LostFrames::Exactly(0) };

    /// True if nothing is missing.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }
}

impl fmt::Display for Damage {
    /// Describes what is missing: "2 damaged chunks, 5120 bytes unreadable, 40 frames missing".
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = |count: u64, what: &str| (count > 0).then(|| format!("{count} {what}"));
        let parts = [
            self.cut_off.then(|| "its end is missing".to_owned()),
            counted(self.chunks, "damaged chunks"),
            counted(self.messages, "malformed messages"),
            counted(self.bytes, "bytes unreadable"),
            match self.frames {
                LostFrames::Exactly(count) => counted(count, "frames missing"),
                LostFrames::Unknown { in_damaged_chunks: 0 } => None,
                LostFrames::Unknown { in_damaged_chunks } => {
                    Some(format!("at most {in_damaged_chunks} frames missing"))
                }
            },
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        out.write_str(if parts.is_empty() { "nothing is missing" } else { "" })?;
        out.write_str(&parts.join(", "))
    }
}

/// A recording being read.
///
/// Only one chunk, about a megabyte, is in memory at a time. A file that is still being written opens like a
/// truncated one.
pub struct Recording<R = BufReader<File>> {
    input: R,
    path: PathBuf,
    head: RecordingHead,
    /// The patch to read, in a body's recording.
    patch: Option<String>,
    outline: Outline,
    topics: BTreeMap<u16, String>,
    next_chunk: usize,
    chunk: Option<LinearReader>,
    /// Stated size of the open chunk after decompression.
    announced_bytes: u64,
    memory: Memory,
    tally: Tally,
    /// Messages read since the last rewind, by channel.
    counts: BTreeMap<u16, u64>,
}

/// The last entry read, by kind.
#[derive(Debug, Default)]
struct Memory {
    frame: Frame,
    baseline: BaselineEntry,
    touches: TouchesEntry,
    event: EventEntry,
}

/// Totals of what has been read, and of what could not be, since the last rewind.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    frames: u64,
    bytes: u64,
    chunks: u64,
    messages: u64,
    frame_bytes: u64,
    damaged_chunk_bytes: u64,
}

/// Kinds of entries; their content is in the recording's own memory.
enum Kind {
    Frame,
    Baseline,
    Touches,
    Event,
    Other,
}

/// Result of a step within a chunk.
enum Step {
    Entry(Kind, u64),
    Skipped,
    ChunkEnd,
    ChunkDamaged,
}

impl<R> std::fmt::Debug for Recording<R> {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Recording").field("path", &self.path).field("head", &self.head).finish_non_exhaustive()
    }
}

impl Recording {
    /// Opens a recording, finished or not. Chunks are read only when entries are requested.
    ///
    /// # Errors
    /// An I/O error; a file that is not MCAP, was not written by dermis, or was cut off before its skin.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let (place, patch) = of_body(path).map_or((path, None), |(place, patch)| (place, Some(patch)));
        let file = open_regular(place).map_err(Error::io(path))?;
        Recording::read_head(BufReader::new(file), path.to_path_buf(), patch)
    }
}

impl<R: Read + Seek> Recording<R> {
    /// Reads a recording from any seekable input; `name` is only used in messages.
    ///
    /// # Errors
    /// As for [`Recording::open`].
    pub fn from_reader(input: R, name: impl Into<PathBuf>) -> Result<Self, Error> {
        Self::read_head(input, name.into(), None)
    }

    fn read_head(mut input: R, path: PathBuf, patch: Option<String>) -> Result<Self, Error> {
        let content = |field: String, reason: String| {
            Error::Live(dermis_live::Error::Content { file: path.clone(), field, reason })
        };
        let outline = Outline::read(&mut input).map_err(Error::io(&path))?;
        let outline = outline.ok_or_else(|| {
            content("byte 0".to_owned(), "expected an MCAP recording, found another beginning".to_owned())
        })?;
        let outline = outline.of_patch(patch.as_deref()).map_err(|reason| content("metadata".to_owned(), reason))?;
        let head = RecordingHead::from_metadata(&outline.metadata);
        let head = head.map_err(|(field, reason)| content(field, reason))?;
        Ok(Self {
            input,
            path,
            head,
            patch,
            topics: outline.topics.clone(),
            outline,
            next_chunk: 0,
            chunk: None,
            announced_bytes: 0,
            memory: Memory::default(),
            counts: BTreeMap::new(),
            tally: Tally::default(),
        })
    }

    /// The path of the file, or the given name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Skin, channel layout, labels and source.
    pub fn head(&self) -> &RecordingHead {
        &self.head
    }

    /// The skin file's text at the time of recording.
    pub fn skin_toml(&self) -> &str {
        &self.head.skin_toml
    }

    /// Number of frames, as stated at the recording's end; `None` if the end is missing.
    pub fn frames_written(&self) -> Option<u64> {
        let statistics = self.outline.statistics.as_ref()?;
        let (channel, _) = self.outline.topics.iter().find(|(_, topic)| *topic == schema::FRAMES)?;
        Some(statistics.channel_message_counts.get(channel).copied().unwrap_or(0))
    }

    /// Frames dropped while recording because the disk was too slow; `None` if the end is missing.
    pub fn frames_dropped(&self) -> Option<u64> {
        self.outline.metadata.get(FINISHED)?.get("dropped")?.parse().ok()
    }

    /// The error that stopped the recording early, if it could still be noted, such as a full disk. A recording that
    /// was killed has no such note.
    pub fn stopped(&self) -> Option<&str> {
        self.outline.metadata.get(STOPPED)?.get("reason").map(String::as_str)
    }

    /// The parts that could not be read so far; final once every entry has been read.
    pub fn damage(&self) -> Damage {
        let tally = &self.tally;
        let frames = match self.frames_written() {
            Some(written) => LostFrames::Exactly(written.saturating_sub(tally.frames)),
            None => {
                // Assume the usual bound for a chunk that is cut off in or before its size field.
                let cut = match (self.outline.bytes_cut, self.outline.cut_chunk_bytes) {
                    (0, _) => 0,
                    (_, 0) => MOST_CHUNK_BYTES,
                    (_, announced) => announced,
                };
                let announced = tally.damaged_chunk_bytes.saturating_add(cut);
                let in_damaged_chunks = announced.checked_div(tally.frame_bytes).unwrap_or(0);
                LostFrames::Unknown { in_damaged_chunks }
            }
        };
        Damage {
            cut_off: !self.outline.whole,
            bytes: tally.bytes.saturating_add(self.outline.bytes_cut),
            chunks: tally.chunks,
            messages: tally.messages.saturating_add(self.outline.bad_records),
            frames,
        }
    }

    /// Goes back to the first entry.
    pub fn rewind(&mut self) {
        self.next_chunk = 0;
        self.chunk = None;
        self.tally = Tally::default();
        self.counts.clear();
    }

    /// Number of messages read so far, by topic, including topics unknown to dermis but not messages without a
    /// description.
    pub fn counts(&self) -> BTreeMap<&str, u64> {
        let named =
            self.counts.iter().filter_map(|(channel, count)| Some((self.topics.get(channel)?.as_str(), *count)));
        let mut counts = BTreeMap::new();
        named.for_each(|(topic, count)| *counts.entry(topic).or_default() += count);
        counts
    }

    /// The next entry, or `None` after the last readable one.
    ///
    /// # Errors
    /// An I/O error if reading fails. Damage is not an error; it is counted in [`Recording::damage`].
    pub fn next_entry(&mut self) -> Result<Option<Entry<'_>>, Error> {
        let kind = self.advance().map_err(|error| Error::io(&self.path)(error))?;
        Ok(kind.map(|(kind, wall_ns)| match kind {
            Kind::Baseline => Entry::Baseline { wall_ns, entry: &self.memory.baseline },
            Kind::Touches => Entry::Touches { wall_ns, entry: &self.memory.touches },
            Kind::Event | Kind::Other => Entry::Event { wall_ns, entry: &self.memory.event },
            Kind::Frame => Entry::Frame(&self.memory.frame),
        }))
    }

    /// Reads the next frame into `frame`, skipping other entries; returns false after the last.
    ///
    /// # Errors
    /// As for [`Recording::next_entry`].
    pub fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, Error> {
        self.try_next_frame(frame).map_err(|error| Error::io(&self.path)(error))
    }

    pub(super) fn try_next_frame(&mut self, frame: &mut Frame) -> io::Result<bool> {
        while let Some((kind, _)) = self.advance()? {
            if matches!(kind, Kind::Frame) {
                std::mem::swap(frame, &mut self.memory.frame);
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The next frame, in the recording's own memory, skipping other entries.
    pub(super) fn next_frame_peek(&mut self) -> Result<Option<&Frame>, Error> {
        while let Some((kind, _)) = self.advance().map_err(|error| Error::io(&self.path)(error))? {
            if matches!(kind, Kind::Frame) {
                return Ok(Some(&self.memory.frame));
            }
        }
        Ok(None)
    }

    /// The frames from here on.
    pub fn frames(&mut self) -> impl Iterator<Item = Result<Frame, Error>> {
        std::iter::from_fn(move || {
            let mut frame = Frame::default();
            self.next_frame(&mut frame).map(|there| there.then_some(frame)).transpose()
        })
    }

    /// Advances to the next entry and decodes it into `self`.
    fn advance(&mut self) -> io::Result<Option<(Kind, u64)>> {
        loop {
            if self.chunk.is_none() && !self.open_chunk()? {
                return Ok(None);
            }
            match self.step() {
                Step::Entry(kind, wall_ns) => return Ok(Some((kind, wall_ns))),
                Step::Skipped => {}
                Step::ChunkEnd => self.chunk = None,
                Step::ChunkDamaged => {
                    self.chunk = None;
                    let place = self.outline.chunks[self.next_chunk - 1];
                    self.count_damaged(place, self.announced_bytes);
                }
            }
        }
    }

    /// Reads the next chunk's bytes; returns false after the last.
    fn open_chunk(&mut self) -> io::Result<bool> {
        while let Some(&place) = self.outline.chunks.get(self.next_chunk) {
            self.next_chunk += 1;
            let Some((reader, announced_bytes)) = read_chunk(&mut self.input, place)? else {
                self.count_damaged(place, 0);
                continue;
            };
            self.announced_bytes = announced_bytes;
            self.chunk = Some(reader);
            return Ok(true);
        }
        Ok(false)
    }

    fn count_damaged(&mut self, place: ChunkPlace, announced_bytes: u64) {
        self.tally.chunks += 1;
        self.tally.bytes = self.tally.bytes.saturating_add(place.length);
        // The stated size of a damaged chunk may be damaged itself.
        let most = announced_bytes.max(MOST_CHUNK_BYTES);
        self.tally.damaged_chunk_bytes = self.tally.damaged_chunk_bytes.saturating_add(most);
    }

    /// Takes one record from the open chunk.
    fn step(&mut self) -> Step {
        let Some(reader) = self.chunk.as_mut() else { return Step::ChunkEnd };
        let (opcode, data) = match reader.next_event() {
            None => return Step::ChunkEnd,
            Some(Err(_)) => return Step::ChunkDamaged,
            Some(Ok(LinearReadEvent::ReadRequest(_))) => {
                // The reader already has all bytes. Told that there are no more, it ends cleanly if the chunk was
                // complete.
                reader.notify_read(0);
                return Step::Skipped;
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => (opcode, data),
        };
        match opcode {
            op::CHANNEL => match mcap::parse_record(opcode, data) {
                Ok(Record::Channel(channel)) => {
                    let topic = schema::topic_alone(&channel.topic, self.patch.as_deref());
                    self.topics.insert(channel.id, topic);
                }
                _ => self.tally.messages += 1,
            },
            op::MESSAGE => {
                if let Some(channel) = data.first_chunk::<2>() {
                    *self.counts.entry(u16::from_le_bytes(*channel)).or_default() += 1;
                }
                match decode(data, &self.topics, self.head.layout.channels(), &mut self.memory) {
                    Some((Kind::Other, _)) => {}
                    Some((kind, wall_ns)) => {
                        if matches!(kind, Kind::Frame) {
                            self.tally.frames += 1;
                            let bytes = PREFIX + data.len() as u64;
                            let least = self.tally.frame_bytes;
                            self.tally.frame_bytes = if least == 0 { bytes } else { least.min(bytes) };
                        }
                        return Step::Entry(kind, wall_ns);
                    }
                    None => self.tally.messages += 1,
                }
            }
            _ => {}
        }
        Step::Skipped
    }
}

/// Splits a path that continues beyond a file, `arm.mcap/PATCH`, into the recording of a body and the name of a
/// patch.
pub(super) fn of_body(path: &Path) -> Option<(&Path, String)> {
    let place = path.parent().filter(|place| place.is_file())?;
    Some((place, path.file_name()?.to_str()?.to_owned()))
}

/// A reader with all bytes of a chunk, and the chunk's stated size after decompression; `None` if the chunk is too
/// large to be one of ours.
pub(super) fn read_chunk(input: &mut (impl Read + Seek), place: ChunkPlace) -> io::Result<Option<(LinearReader, u64)>> {
    let Some(length) = usize::try_from(place.length).ok().filter(|&length| length <= MOST_BYTES) else {
        return Ok(None);
    };
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(MOST_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    input.seek(SeekFrom::Start(place.offset))?;
    let buffer = reader.insert(length);
    input.read_exact(&mut buffer[..length])?;
    let announced_bytes = if place.is_run { place.length } else { announced_size(&buffer[PREFIX as usize..length]) };
    reader.notify_read(length);
    Ok(Some((reader, announced_bytes)))
}

/// Decodes a message into the memory for its kind; `None` if it is malformed or its channel has no description.
fn decode(data: &[u8], topics: &BTreeMap<u16, String>, channels: usize, memory: &mut Memory) -> Option<(Kind, u64)> {
    let (header, body) = data.split_at_checked(MESSAGE_HEADER)?;
    let channel = u16::from_le_bytes([header[0], header[1]]);
    let wall_ns = u64::from_le_bytes(header[6..14].try_into().ok()?);
    let kind = match topics.get(&channel)?.as_str() {
        schema::FRAMES => {
            let frame = &mut memory.frame;
            messages::read_frame(body, frame)?;
            let complex = frame.imaginary.is_empty() || frame.imaginary.len() == channels;
            (frame.values.len() == channels && complex).then_some(Kind::Frame)?
        }
        schema::BASELINES => {
            memory.baseline = messages::read_baseline(body)?;
            Kind::Baseline
        }
        schema::TOUCHES => {
            memory.touches = messages::read_touches(body)?;
            Kind::Touches
        }
        schema::EVENTS => {
            memory.event = messages::read_event(body)?;
            Kind::Event
        }
        _ => Kind::Other,
    };
    Some((kind, wall_ns))
}
