//! The file of one recorder, or of all recorders of a body's patches, which take turns writing to it. It is complete
//! once all of them have finished.

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

/// Interval for handing everything to the operating system.
pub(super) const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// Amount of data that triggers this earlier; large enough to compress well.
pub(super) const CHUNK_BYTES: usize = 1 << 20;

/// The format's writer, for any destination.
pub(super) type FileWriter = Writer<NoSeek<Box<dyn Destination>>>;

/// A file being written.
pub(super) struct SharedFile {
    name: PathBuf,
    /// `None` after a failure.
    writer: Option<FileWriter>,
    message: u32,
    flushed: Instant,
    /// Bytes of messages not yet handed to the operating system.
    pending: usize,
    /// Number of flushes to the operating system.
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

    /// Number of flushes to the operating system.
    pub fn handed_out(&self) -> u64 {
        self.handed_out
    }

    /// Writes a message; returns true if it was followed by a flush.
    ///
    /// # Errors
    /// An I/O error; nothing can be written after it.
    pub fn write(&mut self, channel_id: u16, wall_ns: u64, message: &[u8]) -> Result<bool, Error> {
        let header = MessageHeader { channel_id, sequence: self.message, log_time: wall_ns, publish_time: wall_ns };
        self.message = self.message.wrapping_add(1);
        self.attempt(|writer| writer.write_to_known_channel(&header, message))?;
        self.pending += message.len();
        self.flush_if_due()
    }

    /// Flushes the written data if half a second has passed or enough has accumulated; returns true if it did.
    ///
    /// # Errors
    /// As for [`SharedFile::write`].
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

    /// Registers that a writer has finished and writes `end` to the file. For the last writer, returns the
    /// destination to be completed.
    ///
    /// # Errors
    /// As for [`SharedFile::write`].
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

    /// Runs a step. After a failure the writer is disabled without writing anything more.
    ///
    /// # Errors
    /// As for [`SharedFile::write`].
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

/// Locks the file, even after a panic elsewhere, since what was written remains valid.
pub(super) fn lock(file: &Mutex<SharedFile>) -> MutexGuard<'_, SharedFile> {
    file.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A writer of recordings. Chunks are built in memory and written complete, so that a killed writer leaves at most
/// one half chunk, the last. Chunks are ended explicitly rather than by size, so that it is known which messages have
/// left this process.
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

/// A metadata record with the reason why a recording stopped, as bytes, because the format's own writer is unusable
/// after an error.
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
