//! Messages of a bag in SQLite: the tables `topics` and `messages` of `rosbag2_storage_sqlite3`.

use std::path::Path;

use rusqlite::{Connection, OpenFlags};

use super::collector::Collector;
use crate::Error;

/// Hands every message to the collector, ordered by time.
pub(super) fn read(file: &Path, collector: &mut Collector) -> Result<(), Error> {
    let failed = |error: rusqlite::Error| {
        Error::Live(dermis_live::Error::Content {
            file: file.to_owned(),
            field: "bag".to_owned(),
            reason: format!("expected the tables topics and messages of a ROS 2 bag: {error}"),
        })
    };
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(file, flags).map_err(failed)?;
    let mut topics = database.prepare("SELECT name, type, serialization_format FROM topics").map_err(failed)?;
    let mut rows = topics.query([]).map_err(failed)?;
    while let Some(row) = rows.next().map_err(failed)? {
        let column = |index| row.get::<_, String>(index).map_err(failed);
        let (name, kind, format) = (column(0)?, column(1)?, column(2)?);
        let kind = if format == "cdr" { kind } else { format!("{kind} as {format}") };
        collector.topic(&name, &kind);
    }
    let query = "SELECT topics.name, messages.timestamp, messages.data FROM messages \
                 JOIN topics ON messages.topic_id = topics.id ORDER BY messages.timestamp";
    let mut messages = database.prepare(query).map_err(failed)?;
    let mut rows = messages.query([]).map_err(failed)?;
    while let Some(row) = rows.next().map_err(failed)? {
        let topic: String = row.get(0).map_err(failed)?;
        let at_ns: i64 = row.get(1).map_err(failed)?;
        let data = row.get_ref(2).map_err(failed)?;
        let Ok(data) = data.as_blob() else { continue };
        if !collector.message(&topic, at_ns, data) {
            break;
        }
    }
    Ok(())
}
