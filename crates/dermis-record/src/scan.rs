//! A first pass over a recording. It looks only at the kind and length of each record and skips chunks, to find the
//! position of the chunks, the content of metadata and summary, and the point where the file is cut off.
//!
//! A record is an operation code (u8), a length (u64, little-endian) and that many bytes.

use std::collections::BTreeMap;
use std::io::{self, Read, Seek, SeekFrom};

use mcap::MAGIC;
use mcap::records::{Record, Statistics, op};

use super::head::RECORDING;
use super::schema;

/// Longest record, and longest chunk after decompression, that is read into memory.
pub(super) const MOST_BYTES: usize = 64 << 20;

/// Close a run of messages outside chunks at the first message beyond this size.
const RUN_BYTES: u64 = 1 << 20;

/// Bytes before a record's content.
pub(super) const PREFIX: u64 = 9;

/// Position of a chunk record including its prefix, or of a run of messages outside chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ChunkPlace {
    pub offset: u64,
    pub length: u64,
    /// True for consecutive messages outside chunks.
    pub is_run: bool,
}

/// Result of the first pass.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub chunks: Vec<ChunkPlace>,
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Topics of channels outside chunks, that is, from the summary.
    pub topics: BTreeMap<u16, String>,
    pub statistics: Option<Statistics>,
    /// Kind and content of the records outside chunks that describe schemas and channels.
    pub descriptions: Vec<(u8, Vec<u8>)>,
    /// True if the closing record was reached.
    pub whole: bool,
    /// Records outside chunks that could not be parsed.
    pub bad_records: u64,
    /// Bytes after the last complete record.
    pub bytes_cut: u64,
    /// Stated uncompressed size of a chunk that is cut off.
    pub cut_chunk_bytes: u64,
}

impl Outline {
    /// `None` if `input` doesn't start like an MCAP file.
    pub(super) fn read(input: &mut (impl Read + Seek)) -> io::Result<Option<Self>> {
        let end = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let mut magic = [0; MAGIC.len()];
        if end < MAGIC.len() as u64 {
            return Ok(None);
        }
        input.read_exact(&mut magic)?;
        if magic != MAGIC {
            return Ok(None);
        }
        let mut outline = Self::default();
        let mut at = MAGIC.len() as u64;
        while !outline.whole {
            let left = end.saturating_sub(at);
            let Some(length) = outline.record(input, at, left)? else {
                outline.bytes_cut = left;
                break;
            };
            at += length;
        }
        Ok(Some(outline))
    }

    /// Names of the patches in the recording of a body; none in the recording of one skin.
    pub(super) fn patches(&self) -> Vec<&str> {
        let prefix = schema::name_of(RECORDING, Some(""));
        self.metadata.keys().filter_map(|name| name.strip_prefix(&prefix)).collect()
    }

    /// The outline of one patch of a body, as if it had been recorded alone. Without a patch nothing changes.
    ///
    /// # Errors
    /// No patch is named for a recording of a body, the named patch doesn't exist, or the recording isn't of a body.
    pub(super) fn of_patch(mut self, patch: Option<&str>) -> Result<Self, String> {
        let patches = self.patches();
        let (is_body, known) = (!patches.is_empty(), patches.join(", "));
        let Some(patch) = patch else {
            let expected = || format!("the recording of a body: expected a patch of it, FILE/PATCH: {known}");
            return if is_body { Err(expected()) } else { Ok(self) };
        };
        if !patches.contains(&patch) {
            let has = if is_body {
                format!("a patch of the recording: {known}")
            } else {
                "no patch: it is of one skin".into()
            };
            return Err(format!("patch {patch:?}: expected {has}"));
        }
        let suffix = format!("/{patch}");
        let own = |(name, content): (String, BTreeMap<String, String>)| {
            let alone = name.strip_suffix(&suffix).map(str::to_owned);
            // Records about the whole file belong to every patch; those about other patches are dropped.
            alone.or_else(|| (!name.contains('/')).then_some(name)).map(|name| (name, content))
        };
        self.metadata = self.metadata.into_iter().filter_map(own).collect();
        for topic in self.topics.values_mut() {
            *topic = schema::topic_alone(topic, Some(patch));
        }
        Ok(self)
    }

    /// Takes in the record at `at`, of which up to `left` bytes are present, and returns its length; `None` if it is
    /// cut off.
    fn record(&mut self, input: &mut (impl Read + Seek), at: u64, left: u64) -> io::Result<Option<u64>> {
        if left < PREFIX {
            return Ok(None);
        }
        input.seek(SeekFrom::Start(at))?;
        let mut prefix = [0; PREFIX as usize];
        input.read_exact(&mut prefix)?;
        let (kind, length) = (prefix[0], u64::from_le_bytes([1, 2, 3, 4, 5, 6, 7, 8].map(|index| prefix[index])));
        if kind == 0 || length > left - PREFIX {
            if kind == op::CHUNK {
                let mut header = Vec::new();
                input.take(24).read_to_end(&mut header)?;
                self.cut_chunk_bytes = announced_size(&header);
            }
            return Ok(None);
        }
        match kind {
            // Messages outside chunks: runs of them are read like chunks.
            op::MESSAGE => match self.chunks.last_mut() {
                Some(run) if run.is_run && run.offset + run.length == at && run.length < RUN_BYTES => {
                    run.length += PREFIX + length;
                }
                _ => self.chunks.push(ChunkPlace { offset: at, length: PREFIX + length, is_run: true }),
            },
            op::CHUNK => self.chunks.push(ChunkPlace { offset: at, length: PREFIX + length, is_run: false }),
            op::FOOTER => self.whole = true,
            op::METADATA | op::SCHEMA | op::CHANNEL | op::STATISTICS => self.content(input, kind, length)?,
            _ => {}
        }
        Ok(Some(PREFIX + length))
    }

    fn content(&mut self, input: &mut impl Read, kind: u8, length: u64) -> io::Result<()> {
        let Some(length) = usize::try_from(length).ok().filter(|&length| length <= MOST_BYTES) else {
            self.bad_records += 1;
            return Ok(());
        };
        let mut bytes = vec![0; length];
        input.read_exact(&mut bytes)?;
        match mcap::parse_record(kind, &bytes) {
            Ok(Record::Metadata(record)) => drop(self.metadata.insert(record.name, record.metadata)),
            Ok(Record::Channel(channel)) => {
                self.topics.insert(channel.id, channel.topic);
                self.descriptions.push((kind, bytes.clone()));
            }
            Ok(Record::Schema { .. }) => self.descriptions.push((kind, bytes.clone())),
            Ok(Record::Statistics(statistics)) => self.statistics = Some(statistics),
            _ => self.bad_records += 1,
        }
        Ok(())
    }
}

/// The uncompressed size in a chunk's header, the third of its u64 fields, if it is plausible; 0 if even that is cut
/// off.
pub(super) fn announced_size(header: &[u8]) -> u64 {
    let size = header.get(16..24).and_then(|bytes| bytes.try_into().ok()).map_or(0, u64::from_le_bytes);
    if size <= MOST_BYTES as u64 { size } else { 0 }
}
