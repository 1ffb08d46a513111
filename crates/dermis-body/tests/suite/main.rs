//! Bodies compared with other programs and closed forms, and invalid input.

mod bad_input;
mod frames;
mod joints;

use std::path::PathBuf;

/// Path of a test file of this crate.
fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}
