//! Bodies against other programs and closed forms, and bad input.

mod bad_input;
mod frames;
mod joints;

use std::path::PathBuf;

/// A file of this crate's tests.
fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}
