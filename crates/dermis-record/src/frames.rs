//! Frames of any file: recordings as well as the tables that [`dermis_device::read`] knows.

use std::io::Read;
use std::path::Path;

use dermis_device::instruments::MOST_BYTES;
use dermis_device::{DeviceError, FileSpec, Format, Frame, FrameTable, open_regular};

use super::reader::of_body;
use crate::{Error, Recording};

/// First bytes of every MCAP file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// True of a file that is a recording, by its first bytes, or, where it cannot be read, by its name.
pub fn is_recording(path: &Path) -> bool {
    let mut first = [0; MAGIC.len()];
    let place = of_body(path).map_or(path, |(place, _)| place);
    match open_regular(place).and_then(|mut file| file.read_exact(&mut first)) {
        Ok(()) => first == MAGIC,
        Err(_) => place.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap")),
    }
}

/// Reads the frames that `spec` names, of a recording or of a table in `format`, which is recognised where `None`. The
/// frames of a recording have its numbers, and times from its first frame on.
///
/// # Errors
/// A file that cannot be read or holds no frames, and a recording of more than [`MOST_BYTES`] of readings.
pub fn read_frames(spec: &FileSpec, format: Option<Format>) -> Result<FrameTable, Error> {
    if format.is_some() || spec.path.is_dir() || !is_recording(&spec.path) {
        return Ok(dermis_device::read(spec, format)?);
    }
    let mut recording = Recording::open(&spec.path)?;
    let layout = recording.head().layout.clone();
    let (mut values, mut imaginary, mut times_ns, mut sequences) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut frame = Frame::default();
    while recording.next_frame(&mut frame)? {
        values.extend_from_slice(&frame.values);
        imaginary.extend_from_slice(&frame.imaginary);
        times_ns.push(frame.device_time_ns.unwrap_or(frame.host_monotonic_ns));
        sequences.push(frame.sequence);
        let found = 8 * (values.len() + imaginary.len()) as u64;
        if found > MOST_BYTES {
            return Err(DeviceError::TooLarge { file: spec.path.clone(), limit: MOST_BYTES, found }.into());
        }
    }
    let first_ns = times_ns.first().copied().unwrap_or_default();
    let times_s = times_ns.iter().map(|ns| ns.saturating_sub(first_ns) as f64 * 1e-9).collect();
    let mut table = FrameTable::new(layout, values, &spec.path)?.with_times_s(times_s)?.with_sequences(sequences)?;
    if !imaginary.is_empty() {
        table = table.with_imaginary(imaginary)?;
    }
    Ok(table.select(&spec.select)?)
}
