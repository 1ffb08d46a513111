//! Messages of an MCAP file, in file order.

use std::collections::BTreeMap;
use std::io::{BufReader, Read};
use std::path::Path;

use dermis_device::open_regular;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::collector::Collector;
use crate::Error;
use crate::scan::MOST_BYTES;

/// Hands every message to the collector. Reading stops at damage or at a truncated end, which is noted.
pub(super) fn read(file: &Path, collector: &mut Collector, notes: &mut Vec<String>) -> Result<(), Error> {
    let mut input = BufReader::new(open_regular(file).map_err(Error::io(file))?);
    let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(MOST_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
    let mut channels: BTreeMap<u16, (String, String)> = BTreeMap::new();
    let mut messages = 0_u64;
    let name = || file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    while let Some(event) = reader.next_event() {
        let (kind, data) = match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let count = input.read(reader.insert(wanted)).map_err(Error::io(file))?;
                reader.notify_read(count);
                continue;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => (opcode, data),
            Err(error) if messages == 0 => {
                let reason = format!("expected an MCAP file: {error}");
                return Err(Error::Live(dermis_live::Error::Content {
                    file: file.to_owned(),
                    field: "records".to_owned(),
                    reason,
                }));
            }
            Err(error) => {
                notes.push(format!("{} is damaged after message {messages}: {error}", name()));
                break;
            }
        };
        match (kind, mcap::parse_record(kind, data)) {
            (_, Ok(Record::Schema { header, .. })) => drop(schemas.insert(header.id, header.name)),
            (_, Ok(Record::Channel(channel))) => {
                let kind = schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                // Arrays in another encoding must not be read as CDR.
                let is_cdr = channel.message_encoding == "cdr";
                let kind = if is_cdr { kind } else { format!("{kind} as {}", channel.message_encoding) };
                collector.topic(&channel.topic, &kind);
                channels.insert(channel.id, (channel.topic, kind));
            }
            (op::MESSAGE, Ok(Record::Message { header, data })) => {
                messages += 1;
                let Some((topic, _)) = channels.get(&header.channel_id) else { continue };
                let at_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                if !collector.message(topic, at_ns, &data) {
                    break;
                }
            }
            _ => {}
        }
    }
    Ok(())
}
