//! Decides which dimensions of an array count frames, and which make up a frame.

use std::path::Path;

use super::Array;
use crate::error::shorten;
use crate::{DeviceError, FrameTable, Layout, ReadOptions};

impl Array {
    /// Frames in rows. One dimension is a single frame, two are frames x channels. With more, all dimensions after the
    /// first make up a frame, for instance drives x measurements. Three dimensions with a second one of length 2 are
    /// frames x (real, imaginary) x channels, as `dermis export` writes complex readings.
    ///
    /// # Errors
    /// [`DeviceError::Field`] for a single number, [`DeviceError::Empty`], [`DeviceError::Infinite`].
    pub fn into_frames(self, file: &Path) -> Result<FrameTable, DeviceError> {
        self.into_frames_with(file, &ReadOptions::default())
    }

    pub(in crate::instruments) fn into_frames_with(
        self,
        file: &Path,
        options: &ReadOptions,
    ) -> Result<FrameTable, DeviceError> {
        of(self, file, options)
    }
}

/// Frames of an array; see [`Array::into_frames`].
fn of(array: Array, file: &Path, options: &ReadOptions) -> Result<FrameTable, DeviceError> {
    let array = if options.transpose { last_axis_first(array) } else { array };
    let wanted = |count: usize| options.channels.contains(&count);
    let (total, is_real) = (array.values.len(), array.imaginary.is_none());
    let mut notes = vec![format!("array of {}", shape_text(&array.shape))];
    if options.transpose {
        notes.push("frames in columns".to_owned());
    }
    let (count, is_in_two) = match array.shape[..] {
        [] => {
            let expected = "(channels,), (frames, channels) or (frames, drives, measurements)";
            return Err(DeviceError::field(file, 1, "shape", "()", expected));
        }
        [count] => (count, None),
        [_, count] if wanted(count) => (count, None),
        // A single frame, drives x measurements.
        [_, count] if wanted(total) && count > 0 => (total, None),
        [frames, count] if options.looks_transposed(frames, count) => {
            return Err(DeviceError::Transposed { file: file.to_owned(), frames, channels: count });
        }
        [rows, count] => (wrapped(rows, count, options).unwrap_or(count), None),
        [_, a, b] if wanted(a * b) => (a * b, None),
        [_, 2, b] if is_real && (options.channels.is_empty() || wanted(b)) => (b, Some(1)),
        [_, a, 2] if is_real && wanted(a) => (a, Some(2)),
        [1, _, b] if wanted(b) => (b, None),
        [a, b, frames] if wanted(a * b) => {
            return Err(DeviceError::Transposed { file: file.to_owned(), frames: a * b, channels: frames });
        }
        [_, ref inner @ ..] => (inner.iter().product(), None),
    };
    let layout = Layout::Channels { count };
    if let Some(axis) = is_in_two {
        notes.push("real and imaginary parts".to_owned());
        let part = |which: usize| -> Vec<f64> {
            let frames = array.values.chunks_exact(2 * count);
            match axis {
                1 => frames.flat_map(|frame| &frame[which * count..][..count]).copied().collect(),
                _ => array.values.iter().skip(which).step_by(2).copied().collect(),
            }
        };
        if count == 0 {
            return Err(DeviceError::Empty { file: file.to_owned() });
        }
        return Ok(FrameTable::new(layout, part(0), file)?.with_imaginary(part(1))?.with_notes(notes));
    }
    let mut frames = FrameTable::new(layout, array.values, file)?;
    if let Some(imaginary) = array.imaginary {
        frames = frames.with_imaginary(imaginary)?;
    }
    if array.shape.len() > 1 && count != array.shape[array.shape.len() - 1] {
        notes.push(format!("{count} numbers in a row make one frame"));
    }
    Ok(frames.with_notes(notes))
}

/// Readings in a frame that is wrapped over several rows, if the skin's channel count implies that.
fn wrapped(rows: usize, count: usize, options: &ReadOptions) -> Option<usize> {
    let fits = |wanted: &&usize| count > 0 && wanted.is_multiple_of(count) && rows.is_multiple_of(**wanted / count);
    options.channels.iter().find(fits).copied()
}

fn shape_text(shape: &[usize]) -> String {
    shorten(&shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x "))
}

/// Moves the last dimension to the front.
fn last_axis_first(array: Array) -> Array {
    let Some((&last, before)) = array.shape.split_last() else { return array };
    let turn = |values: Vec<f64>| -> Vec<f64> {
        (0..last).flat_map(|first| values.iter().skip(first).step_by(last).copied()).collect()
    };
    let shape = std::iter::once(last).chain(before.iter().copied()).collect();
    Array { shape, values: turn(array.values), imaginary: array.imaginary.map(turn) }
}
