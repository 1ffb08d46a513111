//! Frames from any file: recordings, bags and MCAP files of other programs, and the tables that
//! [`dermis_device::read`] knows.

use std::io::Read;
use std::path::Path;

use dermis_device::instruments::MOST_BYTES;
use dermis_device::{DeviceError, FileSpec, Frame, FrameSelect, FrameTable, ReadOptions, mend_times, open_regular};
use dermis_live::channels::{order_by_names, readings_of};
use dermis_live::same_skin::check_frames;
use dermis_skin::Skin;

use super::reader::of_body;
use crate::{Error, Recording, bag};

/// First bytes of every MCAP file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Log target for reports on how a file was interpreted, which the command always shows.
pub const UNDERSTOOD: &str = "understood";

/// True if a file is MCAP by its first bytes or, if it cannot be read, by its name.
fn is_mcap(path: &Path) -> bool {
    let mut first = [0; MAGIC.len()];
    let place = of_body(path).map_or(path, |(place, _)| place);
    match open_regular(place).and_then(|mut file| file.read_exact(&mut first)) {
        Ok(()) => first == MAGIC,
        Err(_) if place.is_dir() => false,
        Err(_) => place.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap")),
    }
}

/// Rejects a recording whose frames belong to another skin. Files of other kinds don't state their skin.
///
/// # Errors
/// [`dermis_live::Error::OtherSkin`], or the recording cannot be read.
pub fn check_skin(spec: &FileSpec, skin: &Skin) -> Result<(), Error> {
    if spec.path.is_dir() || !is_recording(&spec.path) {
        return Ok(());
    }
    let name = spec.path.display().to_string();
    let recorded = Skin::parse(&Recording::open(&spec.path)?.head().skin_toml, &name)?;
    Ok(check_frames(&name, &recorded, skin)?)
}

/// True if a file is a recording by its first bytes or, if it cannot be read, by its name. Another program's MCAP
/// file with arrays of numbers is not a recording.
pub fn is_recording(path: &Path) -> bool {
    is_mcap(path) && !is_of_others(path)
}

/// True for a readable MCAP file without anything from dermis in it.
fn is_of_others(path: &Path) -> bool {
    let Ok(file) = open_regular(path) else { return false };
    let outline = crate::scan::Outline::read(&mut std::io::BufReader::new(file));
    outline.ok().flatten().is_some_and(|outline| {
        !outline.metadata.keys().any(|name| name.starts_with("dermis."))
            && !outline.topics.values().any(|topic| topic.starts_with("/dermis/"))
            && (!outline.topics.is_empty() || !outline.chunks.is_empty())
    })
}

/// Reads the frames selected by `spec` from a recording, a bag or a table.
///
/// `options` is a [`ReadOptions`], a format, or `None`. Frames of a recording keep its sequence numbers and
/// wall-clock times, with times relative to its first frame. How the file was interpreted is logged under the target
/// [`UNDERSTOOD`].
///
/// # Errors
/// A file cannot be read, holds no frames, or has more than [`MOST_BYTES`] of readings.
pub fn read_frames(spec: &FileSpec, options: impl Into<ReadOptions>) -> Result<FrameTable, Error> {
    let options: ReadOptions = options.into();
    let table = read(spec, &options)?;
    say(&table);
    Ok(table)
}

/// Like `read_frames`, for frames of a skin: its channels settle ambiguities in the file, and columns that name
/// their electrodes are put in its order.
///
/// # Errors
/// As for [`read_frames`], and if the header names electrodes that are not a channel of the skin.
pub fn read_frames_of(skin: &Skin, spec: &FileSpec, options: impl Into<ReadOptions>) -> Result<FrameTable, Error> {
    let options: ReadOptions = options.into();
    let options = options.with_channels(readings_of(skin));
    let has_columns = options.columns != FrameSelect::All;
    let table = read(spec, &options)?;
    let table = if has_columns { table } else { order_by_names(table, skin)? };
    say(&table);
    Ok(table)
}

fn say(table: &FrameTable) {
    tracing::info!(target: UNDERSTOOD, "{}: {}", table.source().display(), table.understood());
}

fn read(spec: &FileSpec, options: &ReadOptions) -> Result<FrameTable, Error> {
    let path = spec.path.as_path();
    Ok(if options.format.is_none() && is_recording(path) {
        read_recording(path)?.select(&spec.select)?
    } else if options.format.is_none() && (is_mcap(path) || bag::is_bag(path) || bag::is_sqlite(path)) {
        bag::read(path, options)?.select(&spec.select)?
    } else {
        dermis_device::read(spec, options.clone())?
    })
}

fn read_recording(path: &Path) -> Result<FrameTable, Error> {
    let mut recording = Recording::open(path)?;
    let layout = recording.head().layout.clone();
    let (mut values, mut imaginary, mut times_ns, mut sequences) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut wall_ns = Vec::new();
    let mut frame = Frame::default();
    while recording.next_frame(&mut frame)? {
        values.extend_from_slice(&frame.values);
        imaginary.extend_from_slice(&frame.imaginary);
        times_ns.push(frame.device_time_ns.unwrap_or(frame.host_monotonic_ns));
        wall_ns.push(i64::try_from(frame.host_wall_ns).unwrap_or(i64::MAX));
        sequences.push(frame.sequence);
        let found = 8 * (values.len() + imaginary.len()) as u64;
        if found > MOST_BYTES {
            return Err(DeviceError::TooLarge { file: path.to_owned(), limit: MOST_BYTES, found }.into());
        }
    }
    let first_ns = times_ns.first().copied().unwrap_or_default();
    // A clock that restarted is before its first time.
    let mut times_s: Vec<f64> =
        times_ns.iter().map(|ns| (i128::from(*ns) - i128::from(first_ns)) as f64 * 1e-9).collect();
    let mut notes = vec!["a recording of dermis".to_owned()];
    mend_times(&mut times_s, &mut notes);
    let damage = recording.damage();
    if !damage.is_none() {
        notes.push(damage.to_string());
    }
    let table = FrameTable::new(layout, values, path)?.with_times_s(times_s)?.with_sequences(sequences)?;
    let table = table.with_wall_ns(wall_ns)?.with_notes(notes);
    Ok(if imaginary.is_empty() { table } else { table.with_imaginary(imaginary)? })
}
