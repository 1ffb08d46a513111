//! Channel health in the live pipeline. Channels that [`dermis_touch::health`] finds broken are excluded from image
//! and touches, and restored when they recover. Everything here depends only on the frames and their order, so a
//! replay gives the same result as the live run.

mod changes;
mod stage;
mod wiring;

pub use changes::{HealthChange, HealthWatch};
pub(crate) use stage::{HealthDecision, HealthFrame, HealthStage, Sight};
pub use wiring::{health_params, wiring};
