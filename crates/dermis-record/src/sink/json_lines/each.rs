//! Lists and times in a line.

use serde::{Serialize, Serializer};

/// Items of a slice, converted one by one while they are written, so that nothing is allocated. A function may leave
/// items out.
pub(super) struct Each<'a, T, U>(pub &'a [T], pub fn(&T) -> Option<U>);

impl<T, U: Serialize> Serialize for Each<'_, T, U> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().filter_map(self.1))
    }
}

/// Nanoseconds in seconds: the number that has the same decimal digits.
pub(super) fn seconds(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e9
}
