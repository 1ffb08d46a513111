//! Frames in recordings of other programs: MCAP files and ROS 2 bags (a folder with `metadata.yaml` and one or
//! several files, in MCAP or SQLite) that have a topic of `std_msgs` arrays with one message per frame. Times are
//! those of the recorder.

mod array;
mod collector;
mod mcap_file;
#[cfg(feature = "sqlite")]
mod sqlite;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dermis_device::instruments::MOST_BYTES;
use dermis_device::{DeviceError, FrameTable, Layout, ReadOptions};

use crate::Error;
use array::ArrayKind;
use collector::Collector;

/// Maximum number of files in a split bag.
const MOST_FILES: usize = 10_000;
/// Number of skipped messages to describe one by one.
const DESCRIBED: usize = 3;

/// True if a folder is a bag, or holds the files of one.
pub(crate) fn is_bag(path: &Path) -> bool {
    path.is_dir() && (path.join("metadata.yaml").is_file() || bag_files(path).is_ok_and(|files| !files.is_empty()))
}

/// True if a file is an SQLite database, as bags are.
pub(crate) fn is_sqlite(path: &Path) -> bool {
    use std::io::Read;
    let mut first = [0; 16];
    dermis_device::open_regular(path)
        .and_then(|mut file| file.read_exact(&mut first))
        .is_ok_and(|()| first == *b"SQLite format 3\0")
}

/// Frames of a topic in a bag's folder, in one of its files, or in another program's MCAP file.
///
/// # Errors
/// A file cannot be read, no topic or several topics qualify, or frames differ in length.
pub(crate) fn read(path: &Path, options: &ReadOptions) -> Result<FrameTable, Error> {
    let files = if path.is_dir() { bag_files(path)? } else { vec![path.to_owned()] };
    let wanted = options.array.clone();
    let mut collector =
        Collector { wanted, topics: BTreeMap::new(), frames: BTreeMap::new(), held: 0, bad: Vec::new() };
    let mut notes = Vec::new();
    for file in &files {
        if is_sqlite(file) {
            read_sqlite(file, &mut collector)?
        } else {
            mcap_file::read(file, &mut collector, &mut notes)?
        }
        if collector.held > MOST_BYTES {
            let (file, found) = (path.to_owned(), collector.held);
            return Err(DeviceError::TooLarge { file, limit: MOST_BYTES, found }.into());
        }
    }
    let topic = chosen(&collector, path)?;
    let mut frames = collector.frames.remove(&topic).unwrap_or_default();
    frames.sort_by_key(|(at_ns, _)| *at_ns);
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    frames.iter().for_each(|(_, values)| *counts.entry(values.len()).or_default() += 1);
    let of_skin = options.channels.iter().copied().find(|channels| counts.contains_key(channels));
    let usual = counts.iter().max_by_key(|(_, messages)| **messages).map(|(count, _)| *count);
    let count = of_skin.or(usual).unwrap_or(0);
    if 2 * counts.get(&count).copied().unwrap_or(0) < frames.len() {
        let found: Vec<String> = counts.keys().take(6).map(usize::to_string).collect();
        let reason = format!("expected the same count of numbers in every message, found {} numbers", found.join(", "));
        return Err(Error::Live(dermis_live::Error::Content {
            file: path.to_owned(),
            field: format!("topic {topic}"),
            reason,
        }));
    }
    notes.insert(0, format!("topic `{topic}` ({})", collector.topics[&topic].kind));
    if files.len() > 1 {
        notes.push(format!("{} files", files.len()));
    }
    let (mut values, mut wall_ns, mut sequences) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (at_ns, frame)) in frames.into_iter().enumerate() {
        if frame.len() == count {
            values.extend(frame);
            wall_ns.push(at_ns);
            sequences.push(number as u64);
        } else {
            collector.bad.push(format!("message {number} has {} numbers", frame.len()));
        }
    }
    let bad = collector.bad;
    if !bad.is_empty() {
        let more = if bad.len() > DESCRIBED { ", ..." } else { "" };
        notes.push(format!("{} messages left out: {}{more}", bad.len(), bad[..bad.len().min(DESCRIBED)].join(", ")));
    }
    let first = wall_ns.first().copied().unwrap_or(0);
    let mut times_s: Vec<f64> =
        wall_ns.iter().map(|at: &i64| (i128::from(*at) - i128::from(first)) as f64 * 1e-9).collect();
    dermis_device::mend_times(&mut times_s, &mut notes);
    let table = FrameTable::new(Layout::Channels { count }, values, path)?.with_times_s(times_s)?;
    Ok(table.with_wall_ns(wall_ns)?.with_sequences(sequences)?.with_notes(notes))
}

/// The requested topic, or the only one with arrays.
fn chosen(collector: &Collector, path: &Path) -> Result<String, Error> {
    let all = || {
        let shown = collector.topics.iter().take(20);
        let shown: Vec<String> =
            shown.map(|(name, topic)| format!("{name} ({}, {} messages)", topic.kind, topic.messages)).collect();
        if shown.is_empty() { "no topics".to_owned() } else { shown.join(", ") }
    };
    let refuse = |reason: String| {
        Err(Error::Live(dermis_live::Error::Content { file: path.to_owned(), field: "--topic".to_owned(), reason }))
    };
    if let Some(wanted) = &collector.wanted {
        return match collector.topics.get(wanted) {
            None => refuse(format!("expected a topic of the file, got {wanted}; it has {}", all())),
            Some(topic) if ArrayKind::of(&topic.kind).is_none() => {
                refuse(format!("{wanted} is {}; expected a topic of {}", topic.kind, ArrayKind::EXPECTED))
            }
            Some(_) if !collector.frames.contains_key(wanted) => refuse(format!("{wanted} has no message")),
            Some(_) => Ok(wanted.clone()),
        };
    }
    let mut candidates = collector.frames.keys();
    match (candidates.next(), candidates.next()) {
        (Some(only), None) => Ok(only.clone()),
        (Some(_), Some(_)) => refuse(format!("expected the topic with the frames, as there are several: {}", all())),
        (None, _) => refuse(format!("expected a topic of {}; the file has {}", ArrayKind::EXPECTED, all())),
    }
}

/// The files of a bag in order: as listed in `metadata.yaml`, or by name.
fn bag_files(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let listing = folder.join("metadata.yaml");
    let mut files = if listing.is_file() {
        let text = dermis_device::instruments::read_bytes(&listing)?;
        listed_files(&String::from_utf8_lossy(&text)).into_iter().map(|name| folder.join(name)).collect()
    } else {
        Vec::new()
    };
    if files.is_empty() {
        for entry in std::fs::read_dir(folder).map_err(Error::io(folder))? {
            let path = entry.map_err(Error::io(folder))?.path();
            if path.extension().is_some_and(|extension| extension == "mcap" || extension == "db3") && path.is_file() {
                files.push(path);
            }
        }
        files.sort();
    }
    if files.len() > MOST_FILES {
        let reason = format!("expected at most {MOST_FILES} files of a bag, found {}", files.len());
        return Err(Error::Live(dermis_live::Error::Content {
            file: folder.to_owned(),
            field: "files".to_owned(),
            reason,
        }));
    }
    if let Some(packed) =
        files.iter().find(|file| file.extension().is_some_and(|extension| extension == "zstd" || extension == "zst"))
    {
        let reason = "is compressed as a whole; unpack it first (zstd -d), or use ros2 bag convert".to_owned();
        return Err(Error::Live(dermis_live::Error::Content { file: packed.clone(), field: "bag".to_owned(), reason }));
    }
    Ok(files)
}

/// The names below `relative_file_paths:`, one per line as `- name`.
fn listed_files(yaml: &str) -> Vec<String> {
    let mut lines = yaml.lines().skip_while(|line| line.trim() != "relative_file_paths:").skip(1);
    let mut names = Vec::new();
    while let Some(name) = lines.next().and_then(|line| line.trim().strip_prefix("- ").map(str::trim)) {
        let name = name.trim_matches(['"', '\'']);
        // Older bags prefix the folder's own name.
        names.push(
            Path::new(name).file_name().map_or_else(|| name.to_owned(), |name| name.to_string_lossy().into_owned()),
        );
    }
    names
}

#[cfg(feature = "sqlite")]
fn read_sqlite(file: &Path, collector: &mut Collector) -> Result<(), Error> {
    sqlite::read(file, collector)
}

#[cfg(not(feature = "sqlite"))]
fn read_sqlite(file: &Path, _collector: &mut Collector) -> Result<(), Error> {
    let reason =
        "an SQLite bag, which this dermis was built without (feature sqlite); `ros2 bag convert` converts it to MCAP"
            .to_owned();
    Err(Error::Live(dermis_live::Error::Content { file: file.to_owned(), field: "bag".to_owned(), reason }))
}

#[cfg(test)]
mod tests;
