//! Damage told from touch. Touches are fast and raise the image of a skin against its intact reference; damage lowers
//! it and stays. [`DamageMonitor`] watches that image with the touches of each frame and keeps a [`Damage`] for every
//! place that stays low: found only while nothing touches, kept while something presses on it, and followed as it
//! heals. [`LevelWatch`] does without an image: it follows the levels of channels that drift, and tells what changed
//! them for good.

mod declared;
#[cfg(test)]
mod level_tests;
mod levels;
mod monitor;
mod params;
mod region;
mod state;
#[cfg(test)]
mod tests;

pub use levels::{LevelChange, LevelParams, LevelWatch};
pub use monitor::{ClassProbabilities, DamageFrame, DamageMonitor};
pub use params::DamageParams;
pub use state::{Damage, DamageEvent, DamageShape, DamageState};
