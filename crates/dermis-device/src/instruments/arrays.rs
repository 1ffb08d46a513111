//! Files that hold several named arrays. One holds the frames, another may hold their times.

use std::path::Path;

use super::{csv, times};
use crate::error::shorten;
use crate::{DeviceError, FrameTable, ReadOptions};

/// Maximum number of arrays in a file.
pub(super) const MOST_ARRAYS: usize = 1000;
/// Usual names for the array of frames, in lower case. Used if several arrays could hold them.
const USUAL: [&str; 8] = ["frames", "voltages", "readings", "data", "v", "meas", "measurements", "arr_0"];

/// An array in a file: its name and the length of each dimension.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Named {
    pub name: String,
    pub shape: Vec<usize>,
}

impl Named {
    /// Description for messages: `frames (40, 208)`.
    fn described(&self) -> String {
        let lengths: Vec<String> = self.shape.iter().map(usize::to_string).collect();
        format!("{} ({})", shorten(&self.name), lengths.join(", "))
    }

    /// Name without the structure: `meas` for `vi.meas`.
    fn last_name(&self) -> &str {
        self.name.rsplit('.').next().unwrap_or_default()
    }

    /// Name of the structure that holds the array: `vi` for `vi.meas`.
    fn parent(&self) -> &str {
        self.name.rsplit_once('.').map_or("", |(parent, _)| parent)
    }

    fn is_time(&self) -> Option<Option<f64>> {
        csv::is_time(self.last_name())
    }

    /// Total number of elements; saturates.
    fn count(&self) -> usize {
        self.shape.iter().fold(1, |product: usize, length| product.saturating_mul(*length))
    }
}

/// Chooses the array that the user asked for, the only one that can hold frames, or one with a usual name.
pub(super) fn choose(arrays: &[Named], file: &Path, options: &ReadOptions) -> Result<usize, DeviceError> {
    let listed = || arrays.iter().take(12).map(Named::described).collect::<Vec<_>>().join(", ");
    let refuse = |found: &str| DeviceError::field(file, 1, "--array", found, format!("one of {}", listed()));
    if let Some(wanted) = &options.array {
        return arrays.iter().position(|array| array.name == *wanted).ok_or_else(|| refuse(wanted));
    }
    let is_of_skin = |array: &Named| {
        let product = |lengths: &[usize]| lengths.iter().fold(1, |product: usize, next| product.saturating_mul(*next));
        let shape = &array.shape;
        options.channels.iter().any(|&channels| {
            shape.last() == Some(&channels)
                || (shape.len() > 1 && (product(&shape[1..]) == channels || shape[0] == channels))
        })
    };
    let is_of_many = |array: &Named| array.shape.len() > 1 && array.is_time().is_none();
    let which = |fits: &dyn Fn(&Named) -> bool| -> Vec<usize> {
        (0..arrays.len()).filter(|&index| fits(&arrays[index])).collect()
    };
    let of_skin = which(&is_of_skin);
    let candidates = if of_skin.is_empty() { which(&is_of_many) } else { of_skin };
    match candidates[..] {
        [only] => Ok(only),
        [] if arrays.len() == 1 => Ok(0),
        _ => USUAL
            .iter()
            .find_map(|usual| {
                let mut named = candidates.iter().filter(|&&index| arrays[index].last_name().to_lowercase() == *usual);
                // If two structures each have a `meas`, the choice is ambiguous.
                named.next().copied().filter(|_| named.next().is_none())
            })
            .ok_or_else(|| refuse("no array chosen")),
    }
}

/// Finds the array of frame times. One in the same structure as the frames is preferred.
pub(super) fn clock(arrays: &[Named], chosen: usize, frames: usize) -> Option<usize> {
    let has_times = |index: &usize| {
        let array = &arrays[*index];
        let is_vector = array.shape.iter().filter(|length| **length != 1).count() <= 1;
        *index != chosen && is_vector && array.count() == frames && array.is_time().is_some()
    };
    let found: Vec<usize> = (0..arrays.len()).filter(has_times).collect();
    let parent = arrays[chosen].parent();
    found.iter().find(|&&index| arrays[index].parent() == parent).or(found.first()).copied()
}

/// Adds notes on the chosen array and on the others in the file.
pub(super) fn with_notes(frames: FrameTable, arrays: &[Named], chosen: usize) -> FrameTable {
    let mut notes = vec![format!("array `{}`", shorten(&arrays[chosen].name))];
    if arrays.len() > 1 {
        let others = arrays.iter().enumerate().filter(|(index, _)| *index != chosen).take(6);
        notes.push(format!("others: {}", others.map(|(_, array)| array.described()).collect::<Vec<_>>().join(", ")));
    }
    frames.with_notes(notes)
}

/// Adds times from an array to the frames.
pub(super) fn with_times(frames: FrameTable, clock: &Named, values: &[f64]) -> Result<FrameTable, DeviceError> {
    let name = format!("array `{}`", shorten(&clock.name));
    let mut notes = vec![format!("times from {name}")];
    let mut times_s = times::seconds(values, clock.is_time().flatten(), &name, &mut notes);
    times::mend(&mut times_s, &mut notes);
    Ok(frames.with_times_s(times_s)?.with_notes(notes))
}
