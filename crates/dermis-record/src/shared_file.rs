//! The file behind one recorder, or behind those of a body's patches, which write into it in turn. It is whole once all
//! of them have finished.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata, op};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions, Writer};

use super::file::Destination;
use super::head::STOPPED;
use crate::Error;

/// Everything is handed to the operating system this often.
pub(super) const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// The same once so much has come together; large enough to compress well.
pub(super) const CHUNK_BYTES: usize = 1 << 20;

/// The format's writer to wherever the bytes go.
pub(super) type FileWriter = Writer<NoSeek<Box<dyn Destination>>>;

/// A file being written.
pub(super) struct SharedFile {
    name: PathBuf,
    /// None after a failure.
    writer: Option<FileWriter>,
    message: u32,
    flushed: Instant,
    /// Bytes of messages that the operating system does not have yet.
    pending: usize,
    /// How often it was given all of them.
    handed_out: u64,
    /// Number of writers that haven't finished.
    writers: usize,
}

impl SharedFile {
    /// A file with one writer.
    pub fn new(name: PathBuf, writer: FileWriter) -> Self {
        let (writer, flushed) = (Some(writer), Instant::now());
        Self { name, writer, message: 0, flushed, pending: 0, handed_out: 0, writers: 1 }
    }

    /// Adds a writer.
    pub fn join(&mut self) {
        self.writers += 1;
    }

    /// The final name.
    pub fn name(&self) -> &Path {
        &self.name
    }

    /// How often everything was handed to the operating system.
    pub fn handed_out(&self) -> u64 {
        self.handed_out
    }

    /// Writes a message; true where everything was handed out after it.
    ///
    /// # Errors
    /// [`Error::Io`]; nothing can be written after it.
    pub fn write(&mut self, channel_id: u16, wall_ns: u64, message: &[u8]) -> Result<bool, Error> {
        let header = MessageHeader { channel_id, sequence: self.message, log_time: wall_ns, publish_time: wall_ns };
        self.message = self.message.wrapping_add(1);
        self.attempt(|writer| writer.write_to_known_channel(&header, message))?;
        self.pending += message.len();
        self.flush_if_due()
    }

    /// Hands out what was written, if half a second has passed since or much has come together; true where it did.
    ///
    /// # Errors
    /// As [`SharedFile::write`].
    pub fn flush_if_due(&mut self) -> Result<bool, Error> {
        let due = self.pending >= CHUNK_BYTES || self.flushed.elapsed() >= FLUSH_INTERVAL;
        if self.pending == 0 || !due {
            return Ok(false);
        }
        self.attempt(|writer| writer.flush())?;
        self.flushed = Instant::now();
        self.pending = 0;
        self.handed_out += 1;
        Ok(true)
    }

    /// A writer has finished; `end` says so in the file. The last writer gets the destination, to complete it.
    ///
    /// # Errors
    /// As [`SharedFile::write`].
    pub fn finish(&mut self, end: &Metadata) -> Result<Option<Box<dyn Destination>>, Error> {
        let is_last = self.writers <= 1;
        self.attempt(|writer| {
            writer.write_metadata(end)?;
            if is_last { writer.finish().map(|_| ()) } else { writer.flush() }
        })?;
        self.writers -= 1;
        self.handed_out += 1;
        Ok(if is_last { self.writer.take().map(|writer| writer.into_inner().into_inner()) } else { None })
    }

    /// Runs a step; after a failure the writer is put out of use without writing anything more.
    ///
    /// # Errors
    /// As [`SharedFile::write`].
    pub fn attempt<T>(&mut self, step: impl FnOnce(&mut FileWriter) -> Result<T, McapError>) -> Result<T, Error> {
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

/// The file, also after a panic elsewhere: what was written stands.
pub(super) fn lock(file: &Mutex<SharedFile>) -> MutexGuard<'_, SharedFile> {
    file.lock().unwrap_or_else(PoisonError::into_inner)
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
