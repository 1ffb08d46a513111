//! Four tanks measured by others, from file to images and touches with the function behind `dermis reconstruct`. The
//! data are not part of this repository; without them the tests count as skipped.

mod golfball;
mod ktc;
mod order;
mod pyeidors;
mod sciospec;
mod segment;

use std::path::{Path, PathBuf};

use dermis_device::FileSpec;
use dermis_lab::evidence::imaged::{Imaged, imaged};
use dermis_skin::Skin;

/// A file or folder in a set of measured data, if the set is present; otherwise the test counts as skipped.
pub(crate) fn measured(set: &str, path: &str) -> Option<PathBuf> {
    Some(dermis_testdata::set(set)?.join(path))
}

/// Selected frames of a file.
pub(crate) fn chosen(path: &Path, select: &str) -> FileSpec {
    FileSpec { path: path.to_path_buf(), select: select.parse().unwrap() }
}

/// Writes frames as comma-separated rows, missing values as `nan`.
pub(crate) fn write_frames(path: &Path, frames: &[Vec<f64>]) {
    let line = |frame: &Vec<f64>| frame.iter().map(f64::to_string).collect::<Vec<_>>().join(",").to_lowercase() + "\n";
    std::fs::write(path, frames.iter().map(line).collect::<String>()).unwrap();
}

/// Reconstructs with a skin.
pub(crate) fn run_with(skin: Skin, baseline: FileSpec, frames: FileSpec) -> Imaged {
    imaged(skin, Some(baseline), frames, None).unwrap()
}
