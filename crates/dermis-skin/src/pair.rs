//! One value for both directions, or one per direction.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One value for x and y, or `[x, y]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "expected a number, or [along x, along y]")]
pub enum Pair<T> {
    /// The same value along both.
    One(T),
    /// Along x and along y.
    Two([T; 2]),
}

impl<T: Copy> Pair<T> {
    /// The values along x and along y.
    pub fn both(&self) -> [T; 2] {
        match *self {
            Self::One(value) => [value; 2],
            Self::Two(values) => values,
        }
    }
}
