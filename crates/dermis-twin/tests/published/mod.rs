//! Options of published skins, for tests, examples and benches: values from their papers, and assumptions.
#![allow(dead_code, unused_imports)]

mod em;
mod healing;
mod ionic;
mod piezo;

pub use em::*;
pub use healing::*;
pub use ionic::*;
pub use piezo::*;
