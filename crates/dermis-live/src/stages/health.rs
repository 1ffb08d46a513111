//! Channel health in the live pipeline: what [`dermis_touch::health`] finds broken is left out of image and touches,
//! and taken back when it is good again. Everything here follows from the frames alone, in their order, so that a
//! replay gives the same result as the live run.

mod changes;
mod stage;
mod wiring;

pub use changes::{HealthChange, HealthWatch};
pub(crate) use stage::{HealthDecision, HealthFrame, HealthStage, Sight};
pub use wiring::{health_params, wiring};
