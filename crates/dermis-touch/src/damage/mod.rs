//! Damage, distinguished from touch. Touches are fast and raise the image of a skin against its intact reference;
//! damage lowers it and stays. [`DamageMonitor`] watches that image and the touches of each frame, and keeps a
//! [`Damage`] for every place that stays low. It finds damage only while nothing touches the skin, keeps it while
//! something presses on it, and follows it as it heals. [`LevelWatch`] needs no image: it tracks the drifting channel
//! levels and reports permanent changes.

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
