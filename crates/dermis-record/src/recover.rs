//! Rebuilds a complete recording from a broken one. Every chunk with a valid checksum is copied message by message,
//! including topics unknown to dermis, and index and summary are recreated.

use std::collections::BTreeMap;
use std::io::BufReader;
use std::path::Path;

use dermis_device::open_regular;
use mcap::McapError;
use mcap::records::{MessageHeader, Metadata, Record, op};
use mcap::sans_io::linear_reader::LinearReadEvent;

use super::file::whole_file;
use super::head::{FINISHED, record};
use super::scan::Outline;
use super::shared_file::{FileWriter, mcap_error, new_writer};
use super::writer::attach_all;
use super::{Damage, Recording, reader};
use crate::Error;

/// Name of the metadata record that names the source of a recovered recording.
const RECOVERED: &str = "dermis.recovered";

/// Result of a recovery.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recovered {
    /// Frames in the new recording.
    pub frames: u64,
    /// Messages in the new recording, including frames.
    pub messages: u64,
    /// Parts of the old recording that could not be read.
    pub damage: Damage,
    /// The error that stopped the old recording, if it was noted: [`Recording::stopped`].
    pub stopped: Option<String>,
}

/// Writes a complete recording to `to` from the readable parts of `from`, which is not changed.
///
/// # Errors
/// As for [`Recording::open`], and an I/O error if `to` exists or cannot be written. Recordings of bodies are refused.
pub fn recover(from: &Path, to: &Path) -> Result<Recovered, Error> {
    refuse_bodies(from)?;
    let mut recording = Recording::open(from)?;
    let mut frames = 0;
    while let Some(entry) = recording.next_entry()? {
        frames += u64::from(matches!(entry, super::Entry::Frame(_)));
    }
    let damage = recording.damage();
    let mut input = BufReader::new(open_regular(from).map_err(Error::io(from))?);
    let outline = Outline::read(&mut input).map_err(Error::io(from))?.unwrap_or_default();
    let failed = |error| mcap_error(to, error);
    let writer = new_writer(whole_file(to)?).map_err(failed)?;
    let mut copy = Copy { writer, outline: &outline, schemas: BTreeMap::new(), channels: BTreeMap::new(), messages: 0 };
    copy.head(&recording).map_err(failed)?;
    for place in &outline.chunks {
        let chunk = reader::read_chunk(&mut input, *place).map_err(Error::io(from))?;
        if let Some((chunk, _)) = chunk {
            copy.chunk(chunk).map_err(failed)?;
        }
    }
    let messages = copy.messages;
    let mut end = record(FINISHED, [("frames", frames.to_string())]);
    let dropped = recording.frames_dropped();
    end.metadata.extend(dropped.map(|count| ("dropped".to_owned(), count.to_string())));
    let source = from.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let entries = [("from", source), ("bytes", damage.bytes.to_string()), ("chunks", damage.chunks.to_string())];
    copy.writer.write_metadata(&record(RECOVERED, entries)).map_err(failed)?;
    copy.writer.write_metadata(&end).map_err(failed)?;
    copy.writer.finish().map_err(failed)?;
    copy.writer.into_inner().into_inner().complete().map_err(Error::io(to))?;
    Ok(Recovered { frames, messages, damage, stopped: recording.stopped().map(str::to_owned) })
}

/// Refuses the recording of a body, or one patch of it.
fn refuse_bodies(from: &Path) -> Result<(), Error> {
    let of_body = reader::of_body(from);
    let file = of_body.as_ref().map_or(from, |(file, _)| file);
    let mut input = BufReader::new(open_regular(file).map_err(Error::io(file))?);
    let outline = Outline::read(&mut input).map_err(Error::io(file))?.unwrap_or_default();
    let patches = outline.patches().join(", ");
    if patches.is_empty() {
        return Ok(());
    }
    let reason = format!("the recording of a body: expected one of a single skin; FILE/PATCH reads a patch: {patches}");
    Err(dermis_live::Error::Content { file: file.to_path_buf(), field: "metadata".to_owned(), reason }.into())
}

/// A copy in progress. Schemas and channels get new numbers.
struct Copy<'a> {
    writer: FileWriter,
    outline: &'a Outline,
    schemas: BTreeMap<u16, u16>,
    channels: BTreeMap<u16, u16>,
    messages: u64,
}

impl Copy<'_> {
    /// Copies metadata and attachments, and the schemas and channels known from the summary.
    fn head(&mut self, recording: &Recording) -> Result<(), McapError> {
        for (name, metadata) in self.outline.metadata.iter().filter(|(name, _)| name.as_str() != FINISHED) {
            self.writer.write_metadata(&Metadata { name: name.clone(), metadata: metadata.clone() })?;
        }
        attach_all(&mut self.writer, recording.head(), None)?;
        let outline = self.outline;
        for (kind, bytes) in &outline.descriptions {
            self.describe(*kind, bytes)?;
        }
        self.writer.flush()
    }

    /// Copies one chunk. Its checksum is verified before anything is used; a chunk that fails is skipped.
    fn chunk(&mut self, mut chunk: mcap::sans_io::linear_reader::LinearReader) -> Result<(), McapError> {
        loop {
            match chunk.next_event() {
                None | Some(Err(_)) => break,
                Some(Ok(LinearReadEvent::ReadRequest(_))) => chunk.notify_read(0),
                Some(Ok(LinearReadEvent::Record { opcode: op::MESSAGE, data })) => self.message(data)?,
                Some(Ok(LinearReadEvent::Record { opcode, data })) => self.describe(opcode, data)?,
            }
        }
        self.writer.flush()
    }

    /// Copies a schema or a channel.
    fn describe(&mut self, kind: u8, data: &[u8]) -> Result<(), McapError> {
        match mcap::parse_record(kind, data) {
            Ok(Record::Schema { header, data }) => {
                self.schemas.insert(header.id, self.writer.add_schema(&header.name, &header.encoding, &data)?);
            }
            Ok(Record::Channel(channel)) => {
                let schema = self.schemas.get(&channel.schema_id).copied().unwrap_or(0);
                let (topic, encoding) = (&channel.topic, &channel.message_encoding);
                let id = self.writer.add_channel(schema, topic, encoding, &channel.metadata)?;
                self.channels.insert(channel.id, id);
            }
            _ => {}
        }
        Ok(())
    }

    fn message(&mut self, data: &[u8]) -> Result<(), McapError> {
        let Ok(Record::Message { header, data }) = mcap::parse_record(op::MESSAGE, data) else { return Ok(()) };
        // A message without a description has been counted as damage.
        let Some(&channel_id) = self.channels.get(&header.channel_id) else { return Ok(()) };
        self.messages += 1;
        self.writer.write_to_known_channel(&MessageHeader { channel_id, ..header }, &data)
    }
}
