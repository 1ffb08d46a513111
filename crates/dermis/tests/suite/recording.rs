//! Recordings: readings come back bit for bit, damage is survived and counted, names are safe.

use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::time::Duration;

use dermis_device::{Counters, Frame, Layout, Pacing, Repeat, Source, SourceEvent};
use dermis_record::{
    BaselineEntry, Entry, EventEntry, LostFrames, Recorder, Recording, RecordingHead, RecordingSummary, Replay, recover,
};
use dermis_touch::{ReferenceOrigin, ReferenceRecord};
use proptest::prelude::*;

const SKIN: &str = "name = \"test\" # \u{3b4}\nmodality = \"eit\"\n";
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

fn head() -> RecordingHead {
    let layout = Layout::SingleEnded { electrodes: 3, stimulations: vec![(0, 1)] };
    let mut head = RecordingHead::new(SKIN, layout, "twin:t");
    head.labels = ["a, \"b\"", "c", "\u{b5}V"].map(str::to_owned).to_vec();
    head
}

/// Frame n: odd readings, a device time in every second frame, imaginary parts in every third, and every eleventh
/// number missing.
fn frame(n: u64) -> Frame {
    let values = vec![f64::from_bits(0x7ff8_0000_dead_beef + n), -0.0, (n as f64).sin()];
    Frame {
        sequence: n + n / 10,
        device_time_ns: n.is_multiple_of(2).then_some(n * 7),
        host_monotonic_ns: 1_000 + n * 20_000_000,
        host_wall_ns: 1_600_000_000_000_000_000 + n,
        imaginary: if n.is_multiple_of(3) { values.iter().map(|value| value / 3.0).collect() } else { Vec::new() },
        values,
        ..Frame::default()
    }
}

/// All content of a frame, with readings as bits.
fn bits(frame: &Frame) -> (u64, Option<u64>, u64, u64, Vec<u64>, Vec<u64>) {
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect();
    let Frame { sequence, device_time_ns, host_monotonic_ns, host_wall_ns, values, imaginary, .. } = frame;
    (*sequence, *device_time_ns, *host_monotonic_ns, *host_wall_ns, bits(values), bits(imaginary))
}

fn baseline() -> BaselineEntry {
    let record = ReferenceRecord { time_ns: 5, frames: 32, origin: ReferenceOrigin::Tare, reason: "button".to_owned() };
    BaselineEntry { record, values: vec![0.1, f64::NAN.copysign(-1.0), 3e-300], noise_std: vec![1e-6] }
}

/// Writes frames 0 to `frames`, with other entries after the second. Megabyte-sized events close a chunk after every
/// hundred frames.
fn record(path: &Path, frames: u64) {
    let mut recorder = Recorder::create(path, &head()).unwrap();
    for n in 0..frames {
        recorder.write_frame(&frame(n)).unwrap();
        if n == 1 {
            let BaselineEntry { record, values, noise_std } = baseline();
            recorder.write_baseline(9, &record, &values, &noise_std).unwrap();
            recorder.write_touches(10, 1, 1_500_000_000, &[], &[]).unwrap();
            recorder.write_event(11, "tare-refused", "a \"touch\" began", &[0.5]).unwrap();
        }
        if n % 100 == 99 {
            recorder.write_event(12, "filler", &"x".repeat(1 << 20), &[]).unwrap();
        }
    }
    let summary = recorder.finish(7).unwrap();
    assert_eq!(summary, RecordingSummary { frames, dropped: 7 });
}

fn recorded(frames: u64) -> Vec<u8> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    record(&path, frames);
    fs::read(path).unwrap()
}

fn open(bytes: &[u8]) -> Recording<Cursor<&[u8]>> {
    Recording::from_reader(Cursor::new(bytes), "a.mcap").unwrap()
}

/// Reads everything and returns the frames' numbers.
fn sequences(recording: &mut Recording<Cursor<&[u8]>>) -> Vec<u64> {
    recording.frames().map(|frame| frame.unwrap().sequence).collect()
}

/// Offset and length of every chunk record.
fn chunks(bytes: &[u8]) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut at = MAGIC.len();
    while at + 9 <= bytes.len() {
        let length = 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        match bytes[at] {
            0x06 => found.push((at, length)),
            0x02 => break,
            _ => {}
        }
        at += length;
    }
    found
}

#[test]
fn everything_is_read_back_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    record(&path, 250);
    let mut recording = Recording::open(&path).unwrap();
    assert_eq!(recording.head(), &head());
    assert_eq!(recording.skin_toml(), SKIN);
    assert_eq!((recording.frames_written(), recording.frames_dropped()), (Some(250), Some(7)));
    for pass in 0..2 {
        let mut n = 0;
        let mut others = Vec::new();
        while let Some(entry) = recording.next_entry().unwrap() {
            match entry {
                Entry::Frame(found) => {
                    assert_eq!(bits(found), bits(&frame(n)), "pass {pass}");
                    n += 1;
                }
                Entry::Baseline { wall_ns, entry } => {
                    let to_bits = |entry: &BaselineEntry| entry.values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                    assert_eq!((wall_ns, &entry.record), (9, &baseline().record));
                    assert_eq!((to_bits(entry), &entry.noise_std), (to_bits(&baseline()), &vec![1e-6]));
                    others.push("baseline".to_owned());
                }
                Entry::Touches { wall_ns, entry } => {
                    assert_eq!(
                        (wall_ns, entry.sequence, entry.time_ns, entry.touches.len()),
                        (10, 1, 1_500_000_000, 0)
                    );
                    others.push("touches".to_owned());
                }
                Entry::Event { entry: EventEntry { event, .. }, .. } if event == "filler" => {}
                Entry::Event { entry: EventEntry { event, detail, values }, .. } => {
                    others.push(format!("{event}: {detail} {values:?}"));
                }
            }
        }
        assert_eq!(n, 250);
        assert_eq!(others, ["baseline", "touches", "tare-refused: a \"touch\" began [0.5]"]);
        assert!(recording.damage().is_none(), "{:?}", recording.damage());
        recording.rewind();
    }
}

#[test]
fn the_final_name_appears_at_the_end_and_nothing_is_overwritten() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("press.mcap");
    let partial = directory.path().join("press.partial.mcap");
    let recorder = Recorder::create(&path, &head()).unwrap();
    assert!(!path.exists() && partial.exists());
    assert_eq!(Recording::open(&partial).unwrap().skin_toml(), SKIN, "the header is there from the start");
    assert!(Recorder::create(&path, &head()).unwrap_err().to_string().contains("press.partial.mcap"));
    recorder.finish(0).unwrap();
    assert!(path.exists() && !partial.exists());
    let message = Recorder::create(&path, &head()).unwrap_err().to_string();
    assert!(message.contains("press.mcap") && message.contains("never overwritten"), "{message}");
}

#[test]
fn frames_and_labels_that_do_not_fit_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    let labels = vec!["one".to_owned()];
    assert!(Recorder::create(&path, &RecordingHead { labels, ..head() }).is_err());
    let mut recorder = Recorder::create(&path, &head()).unwrap();
    let message = recorder.write_frame(&Frame { values: vec![1.0; 4], ..Frame::default() }).unwrap_err().to_string();
    assert_eq!(message, "frame 0 to record: expected 3 readings, got 4 real and 0 imaginary parts");
    recorder.write_frame(&frame(0)).unwrap();
    assert_eq!(recorder.finish(0).unwrap().frames, 1);
}

#[test]
fn a_cut_file_is_read_up_to_the_cut() {
    let bytes = recorded(450);
    let places = chunks(&bytes);
    assert!(places.len() >= 5, "{places:?}");
    let whole: Vec<u64> = sequences(&mut open(&bytes));
    // The first chunk holds only channels, so there are complete chunks with frames before the fourth.
    let (offset, length) = places[3];
    let mut recording = open(&bytes[..offset + length / 2]);
    let found = sequences(&mut recording);
    assert!(!found.is_empty() && whole.starts_with(&found));
    let damage = recording.damage();
    assert!(damage.cut_off && !damage.is_none());
    assert_eq!((damage.bytes, damage.chunks, damage.messages), ((length / 2) as u64, 0, 0));
    assert!(matches!(damage.frames, LostFrames::Unknown { in_damaged_chunks: 1.. }), "{damage:?}");
    assert_eq!((recording.frames_written(), recording.frames_dropped()), (None, None));
    // Only the closing records are missing, so every frame is present.
    let (offset, length) = *places.last().unwrap();
    let mut recording = open(&bytes[..offset + length]);
    assert_eq!(sequences(&mut recording), whole);
    assert!(recording.damage().cut_off && recording.damage().bytes == 0);
}

#[test]
fn a_damaged_chunk_is_passed_over_and_its_frames_counted() {
    let mut bytes = recorded(450);
    let whole: Vec<u64> = sequences(&mut open(&bytes));
    let (offset, length) = chunks(&bytes)[2];
    bytes[offset + length - 20] ^= 0x40;
    let mut recording = open(&bytes);
    let found = sequences(&mut recording);
    let missing = whole.iter().filter(|number| !found.contains(number)).count() as u64;
    assert!(missing > 0 && whole.len() as u64 == found.len() as u64 + missing);
    let damage = recording.damage();
    assert_eq!((damage.chunks, damage.bytes, damage.cut_off), (1, length as u64, false));
    assert_eq!(damage.frames, LostFrames::Exactly(missing));
}

#[test]
fn losing_the_channel_records_loses_no_frame_of_a_finished_recording() {
    let mut bytes = recorded(20);
    let whole: Vec<u64> = sequences(&mut open(&bytes));
    let (offset, length) = chunks(&bytes)[0];
    bytes[offset + length - 20] ^= 0x40;
    let mut recording = open(&bytes);
    assert_eq!(sequences(&mut recording), whole);
    assert_eq!(recording.damage().chunks, 1);
}

#[test]
fn foreign_files_are_named() {
    for (bytes, expected) in [
        (&b"1,2,3\n4,5,6\n"[..], "a.mcap: byte 0: expected an MCAP recording"),
        (&b""[..], "expected an MCAP recording"),
        (MAGIC, "metadata dermis.recording, key version: expected in a dermis recording, not found"),
    ] {
        let message = Recording::from_reader(Cursor::new(bytes), "a.mcap").unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    assert!(Recording::open(Path::new("none.mcap")).unwrap_err().to_string().starts_with("none.mcap: "));
}

#[test]
fn the_readable_part_of_a_broken_recording_becomes_a_complete_one() {
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["broken.mcap", "whole.mcap"].map(|name| directory.path().join(name));
    let mut bytes = recorded(450);
    let places = chunks(&bytes);
    let (offset, length) = places[2];
    bytes[offset + length - 20] ^= 0x40;
    bytes.truncate(places[4].0 + 100);
    fs::write(&from, &bytes).unwrap();
    let expected = sequences(&mut open(&bytes));
    let recovered = recover(&from, &to).unwrap();
    assert_eq!((recovered.frames, recovered.damage.chunks), (expected.len() as u64, 1));
    assert!(recovered.damage.cut_off && recovered.messages > recovered.frames);
    let whole = fs::read(&to).unwrap();
    let mut recording = open(&whole);
    assert_eq!(sequences(&mut recording), expected);
    assert!(recording.damage().is_none(), "{:?}", recording.damage());
    assert_eq!((recording.head(), recording.frames_dropped()), (&head(), None));
    assert!(recover(&from, &to).unwrap_err().to_string().contains("never overwritten"));
    assert_eq!(fs::read(&from).unwrap(), bytes, "what is broken stays as it is");
}

#[test]
fn messages_that_dermis_does_not_know_are_recovered_too() {
    let directory = tempfile::tempdir().unwrap();
    let [from, to] = ["a.mcap", "b.mcap"].map(|name| directory.path().join(name));
    fs::write(&from, made_of(&[(4, vec![1, 2, 3]), (4, vec![])])).unwrap();
    assert_eq!(recover(&from, &to).unwrap().messages, 2);
    let bytes = fs::read(&to).unwrap();
    let mut recording = open(&bytes);
    assert!(recording.next_entry().unwrap().is_none());
    assert_eq!(recording.counts().into_iter().collect::<Vec<_>>(), [("/other", 2)]);
}

fn drain(source: &mut dyn Source, most: usize) -> Vec<Frame> {
    let mut frame = Frame::default();
    let mut seen = Vec::new();
    while seen.len() < most && source.next_frame(&mut frame, Duration::MAX).unwrap() == SourceEvent::Frame {
        seen.push(frame.clone());
    }
    seen
}

#[test]
fn a_replay_hands_out_the_recorded_readings_and_counts_gaps() {
    let bytes = recorded(25);
    let mut replay = Replay::new(open(&bytes), Pacing::Immediate, Repeat::Once).unwrap();
    assert_eq!(replay.layout(), &head().layout);
    let seen = drain(&mut replay, 100);
    assert_eq!(seen.len(), 25);
    for (n, found) in (0..).zip(&seen) {
        let recorded = frame(n);
        assert_eq!((bits(found).0, bits(found).4, bits(found).5), (n + n / 10, bits(&recorded).4, bits(&recorded).5));
        assert_eq!(found.device_time_ns, Some(recorded.device_time_ns.unwrap_or(n * 20_000_000)));
        assert!(found.host_wall_ns > recorded.host_wall_ns, "stamped when handed out");
    }
    assert_eq!(replay.counters(), Counters { frames: 25, lost: 2, bad: 0 });
    assert_eq!(replay.next_frame(&mut Frame::default(), Duration::ZERO).unwrap(), SourceEvent::End);
}

#[test]
fn a_repeated_replay_continues_its_numbering() {
    let bytes = recorded(12);
    let mut replay = Replay::new(open(&bytes), Pacing::Immediate, Repeat::Forever).unwrap();
    let numbers: Vec<u64> = drain(&mut replay, 26).iter().map(|frame| frame.sequence).collect();
    let once: Vec<u64> = (0..10).chain(11..13).collect();
    let expected: Vec<u64> =
        [0, 13, 26].iter().flat_map(|start| once.iter().map(move |n| start + n)).take(26).collect();
    assert_eq!(numbers, expected);
    let empty = recorded(0);
    let mut replay = Replay::new(open(&empty), Pacing::Immediate, Repeat::Forever).unwrap();
    assert_eq!(replay.next_frame(&mut Frame::default(), Duration::MAX).unwrap(), SourceEvent::End);
}

#[test]
fn a_frame_that_is_not_due_yet_is_idle() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.mcap");
    let mut recorder = Recorder::create(&path, &head()).unwrap();
    for host_monotonic_ns in [5, 5, u64::MAX] {
        recorder.write_frame(&Frame { host_monotonic_ns, ..frame(1) }).unwrap();
    }
    recorder.finish(0).unwrap();
    let recording = Recording::open(&path).unwrap();
    let mut replay = Replay::new(recording, Pacing::Recorded, Repeat::Once).unwrap();
    assert_eq!(drain(&mut replay, 2).len(), 2);
    let mut frame = Frame::default();
    assert_eq!(replay.next_frame(&mut frame, Duration::from_millis(1)).unwrap(), SourceEvent::Idle);
    assert_eq!(frame, Frame::default(), "an idle wait must leave the frame alone");
    let rate = Pacing::Rate { frames_per_s: 0.0 };
    assert!(Replay::new(Recording::open(&path).unwrap(), rate, Repeat::Once).is_err());
}

/// Opens a file of any content and reads it to the end.
fn exhaust(bytes: &[u8]) {
    if let Ok(mut recording) = Recording::from_reader(Cursor::new(bytes), "a.mcap") {
        while recording.next_entry().unwrap().is_some() {}
        let _ = (recording.damage(), recording.frames_written(), recording.frames_dropped());
    }
}

/// A file with the metadata of a recording and arbitrary messages, with correct checksums.
fn made_of(messages: &[(usize, Vec<u8>)]) -> Vec<u8> {
    let topics = ["/dermis/frames", "/dermis/baselines", "/dermis/touches", "/dermis/events", "/other"];
    let map = |entries: &[(&str, &str)]| entries.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    let layout = r#"{"kind":"channels","count":1}"#;
    let recording = map(&[("version", "2"), ("source", "made"), ("layout", layout), ("labels", "[]")]);
    let mut bytes = Vec::new();
    let mut writer = mcap::Writer::new(Cursor::new(&mut bytes)).unwrap();
    for (name, metadata) in [("dermis.recording", recording), ("dermis.skin", map(&[("toml", SKIN)]))] {
        writer.write_metadata(&mcap::records::Metadata { name: name.to_owned(), metadata }).unwrap();
    }
    let ids = topics.map(|topic| writer.add_channel(0, topic, "", &Default::default()).unwrap());
    for (topic, data) in messages {
        let header =
            mcap::records::MessageHeader { channel_id: ids[*topic], sequence: 0, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(tail: Vec<u8>) {
        exhaust(&tail);
        exhaust(&[MAGIC, &tail].concat());
    }

    #[test]
    fn malformed_messages_in_sound_chunks_are_counted(
        messages in prop::collection::vec((0_usize..5, any::<Vec<u8>>()), 0..20),
    ) {
        let bytes = made_of(&messages);
        let mut recording = open(&bytes);
        let mut entries = 0;
        while recording.next_entry().unwrap().is_some() {
            entries += 1;
        }
        // The last topic is one that other programs may have added.
        let ours = messages.iter().filter(|(topic, _)| *topic < 4).count() as u64;
        prop_assert_eq!(entries + recording.damage().messages, ours);
    }

    #[test]
    fn mutated_recordings_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut: Option<prop::sample::Index>,
    ) {
        static WHOLE: std::sync::LazyLock<Vec<u8>> = std::sync::LazyLock::new(|| recorded(30));
        let mut bytes = WHOLE.clone();
        for (index, value) in edits {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        exhaust(&bytes);
    }
}
