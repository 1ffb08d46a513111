use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};

use super::*;
use crate::read_frames;
use dermis_device::FileSpec;

/// A `Float64MultiArray` without dimensions.
fn message(values: &[f64]) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    // No dimensions, no offset, and the count. The numbers are aligned to eight bytes, counted after the first four.
    bytes.extend([0_u32, 0, values.len() as u32, 0].into_iter().flat_map(u32::to_le_bytes));
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// An MCAP file of frames `[n, 10 n]` at 50 frames/s, with a second topic.
fn file(options: WriteOptions, numbers: std::ops::Range<u64>) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema("std_msgs/msg/Float64MultiArray", "ros2msg", b"float64[] data").unwrap();
    let text = writer.add_schema("std_msgs/msg/String", "ros2msg", b"string data").unwrap();
    let frames = writer.add_channel(schema, "/eit/voltages", "cdr", &BTreeMap::new()).unwrap();
    let log = writer.add_channel(text, "/log", "cdr", &BTreeMap::new()).unwrap();
    for number in numbers {
        let at = 1_700_000_000_000_000_000 + 20_000_000 * number;
        let header = |channel_id| MessageHeader { channel_id, sequence: 0, log_time: at, publish_time: at };
        let values = [number as f64, 10.0 * number as f64];
        writer.write_to_known_channel(&header(frames), &message(&values)).unwrap();
        writer.write_to_known_channel(&header(log), b"\0\x01\0\0\x02\0\0\0a\0").unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn plain() -> WriteOptions {
    WriteOptions::new().compression(None)
}

#[test]
fn a_split_bag_is_read_in_the_order_of_its_metadata_and_of_time() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("b.mcap"), file(plain(), 0..3)).unwrap();
    fs::write(folder.path().join("a.mcap"), file(plain(), 3..5)).unwrap();
    let listing = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - b.mcap\n    - a.mcap\n  files: []\n";
    fs::write(folder.path().join("metadata.yaml"), listing).unwrap();
    let spec = FileSpec::all(folder.path());
    let table = read_frames(&spec, None).unwrap();
    assert_eq!((table.frames(), table.channels()), (5, 2));
    assert_eq!(table.row(4), Some([4.0, 40.0].as_slice()));
    assert!((table.times_s().unwrap()[4] - 0.08).abs() < 1e-9);
    assert_eq!(table.wall_ns().unwrap()[1], 1_700_000_000_020_000_000);
    assert!(table.understood().contains("/eit/voltages"), "{}", table.understood());
    // One of its files is missing.
    fs::remove_file(folder.path().join("a.mcap")).unwrap();
    assert!(read_frames(&spec, None).unwrap_err().to_string().contains("a.mcap"));
}

#[test]
fn every_way_of_writing_an_mcap_file_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for options in [
        plain(),
        plain().use_chunks(false),
        WriteOptions::new().compression(Some(Compression::Lz4)),
        WriteOptions::new().compression(Some(Compression::Zstd)),
    ] {
        fs::write(&path, file(options, 0..40)).unwrap();
        let table = read_frames(&FileSpec::all(&path), None).unwrap();
        assert_eq!((table.frames(), table.row(39)), (40, Some([39.0, 390.0].as_slice())));
    }
}

#[test]
fn topics_are_asked_for_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(&path, file(plain(), 0..4)).unwrap();
    let read = |topic: &str| {
        let options = ReadOptions { array: Some(topic.to_owned()), ..ReadOptions::default() };
        read_frames(&FileSpec::all(&path), options)
    };
    assert_eq!(read("/eit/voltages").unwrap().frames(), 4);
    let unknown = read("/eit").unwrap_err().to_string();
    assert!(unknown.contains("it has /eit/voltages (std_msgs/msg/Float64MultiArray, 4 messages)"), "{unknown}");
    assert!(read("/log").unwrap_err().to_string().contains("is std_msgs/msg/String"));
}

#[cfg(feature = "sqlite")]
#[test]
fn a_bag_in_sqlite_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag_0.db3");
    let database = rusqlite::Connection::open(&path).unwrap();
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
             INSERT INTO topics VALUES (1, '/v', 'std_msgs/msg/Float64MultiArray', 'cdr');",
        )
        .unwrap();
    for number in [2_i64, 0, 1] {
        let data = message(&[number as f64, 0.5]);
        let values = (20_000_000 * number, data);
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?1, ?2)", values).unwrap();
    }
    drop(database);
    for path in [path.as_path(), folder.path()] {
        let table = read_frames(&FileSpec::all(path), None).unwrap();
        assert_eq!(table.values(), [0.0, 0.5, 1.0, 0.5, 2.0, 0.5]);
    }
}
