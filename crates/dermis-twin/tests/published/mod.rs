//! The options of published skins, for tests, examples and benches: what their papers give, and what is assumed.
#![allow(dead_code, unused_imports)]

mod em;
mod healing;
mod ionic;
mod piezo;

pub use em::*;
pub use healing::*;
pub use ionic::*;
pub use piezo::*;
